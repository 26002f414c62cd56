"""Tiny sound inputs of every kind, made by the project itself, for the campaign to damage."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import xarray as xr
import yaml
from benchmarks.fuzz.dataset_seeds import LATLON, make_dataset_seeds

import airswing  # noqa: F401  (imports pyproj before eccodes can be)

NI, NJ = 20, 18
LEVELS = (550, 650, 750)
WHEN = np.datetime64("2009-09-16T09:00", "ns")
LAMBERT = {
    "gridType": "lambert",
    "Nx": NI,
    "Ny": NJ,
    "latitudeOfFirstGridPointInDegrees": 38.7,
    "longitudeOfFirstGridPointInDegrees": 268.8,
    "LoVInDegrees": 265.0,
    "Latin1InDegrees": 25.0,
    "Latin2InDegrees": 25.0,
    "DxInMetres": 50000,
    "DyInMetres": 50000,
    "iScansNegatively": 0,
    "jScansPositively": 1,
    "uvRelativeToGrid": 1,
}
GRIBS: dict[str, tuple[int, dict[str, Any], str, bool]] = {
    "grib1 simple": (1, LAMBERT, "grid_simple", False),
    "grib1 simple, bitmap": (1, LATLON, "grid_simple", True),
    "grib1 second order": (1, LATLON, "grid_second_order", False),
    "grib2 simple": (2, LAMBERT, "grid_simple", False),
    "grib2 simple, bitmap": (2, LATLON, "grid_simple", True),
    "grib2 complex": (2, LAMBERT, "grid_complex", False),
    "grib2 spatial differencing": (2, LAMBERT, "grid_complex_spatial_differencing", False),
    "grib2 complex, bitmap": (2, LATLON, "grid_complex", True),
    "grib2 PNG": (2, LATLON, "grid_png", False),
    "grib2 JPEG 2000": (2, LAMBERT, "grid_jpeg", False),
    "grib2 CCSDS": (2, LATLON, "grid_ccsds", False),
    "grib2 IEEE": (2, LATLON, "grid_ieee", False),
}
"""Edition, grid, packing and whether points are missing."""
TEXTS = ("csv", "csv.gz", "yaml", "effects")
TABLES = ("parquet", "netcdf3", "netcdf4", "bufr")
PRODUCTS = ("headings.nc", "fits.nc")
HANDED_OVER = ("corrected.nc",)
KEPT = ("kept notes", "header cache")


def make_seeds(folder: Path) -> dict[str, Path]:
    """Write one sound file of every kind.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict of str to Path
        By kind; kept work stands for the folder it lies in.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made = {kind: _grib(folder / f"{n}.grib", kind) for n, kind in enumerate(GRIBS)}
    table = reports()
    makers: dict[str, Callable[[Path], object]] = {
        "csv": lambda path: table.to_csv(path, index=False),
        "csv.gz": lambda path: path.write_bytes(gzip.compress(table.to_csv(index=False).encode())),
        "parquet": lambda path: table.to_parquet(path, index=False),
        "netcdf3": lambda path: _madis(path, "NETCDF3_CLASSIC"),
        "netcdf4": lambda path: _madis(path, "NETCDF4"),
        "bufr": bufr_file,
        "effects": lambda path: path.write_text(EFFECTS),
    }
    for kind, make in makers.items():
        made[kind] = folder / f"seed.{kind}"
        make(made[kind])
    made |= make_dataset_seeds(folder)
    made |= _of_a_run(folder / "run")
    made["yaml"] = folder / "run" / "whole.yaml"
    return made


def fields() -> list[np.ndarray]:
    """u and v of each level: waves of a few metres a second on a mean flow."""
    y, x = np.mgrid[0:NJ, 0:NI]
    found = []
    for number in range(2 * len(LEVELS)):
        waves = 6 * np.sin(x / 4.0 + number) + 4 * np.cos(y / 5.0 - number)
        found.append(np.round((12.0, -4.0)[number % 2] + waves, 2).ravel())
    return found


def reports(count: int = 60) -> pd.DataFrame:
    """Reports at the model's time, each of another aircraft."""
    rng = np.random.default_rng(3)
    return pd.DataFrame(
        {
            "tail": [f"N{400 + n}" for n in range(count)],
            "time": np.datetime_as_string(np.full(count, WHEN), unit="s"),
            "latitude": rng.uniform(40.0, 45.0, count).round(4),
            "longitude": rng.uniform(-90.0, -85.0, count).round(4),
            "pressure_hPa": rng.uniform(555.0, 745.0, count).round(1),
            "wind_direction_deg": rng.uniform(0.0, 360.0, count).round(0),
            "wind_speed_kt": rng.uniform(2.0, 60.0, count).round(1),
            "temperature_degC": rng.uniform(-20.0, 5.0, count).round(1),
            "heading_deg": rng.uniform(0.0, 360.0, count).round(1),
            "true_airspeed_kt": rng.uniform(220.0, 280.0, count).round(1),
            "roll_flag": "G",
            "phase": "cruise",
        }
    )


def _grib(path: Path, kind: str) -> Path:
    edition, grid, packing, bitmap = GRIBS[kind]
    with path.open("wb") as file:
        for number, values in enumerate(fields()):
            level, v = LEVELS[number // 2], number % 2
            hidden = np.arange(values.size) % 17 == 5
            data = np.where(hidden, np.nan, values) if bitmap else values
            file.write(grib_message(edition, grid, packing, data, level=level, v=v))
    return path


def grib_message(
    edition: int, grid: dict[str, Any], packing: str, values: np.ndarray, *, level: int, v: int
) -> bytes:
    """One message by eccodes; NaN is missing."""
    import eccodes

    handle = eccodes.codes_grib_new_from_samples("GRIB2" if edition == 2 else "regular_ll_pl_grib1")
    if edition == 1:
        keys: dict[str, Any] = {"centre": 59, "table2Version": 2, "indicatorOfParameter": 33 + v}
        keys |= {"indicatorOfTypeOfLevel": 100, "timeRangeIndicator": 0, "P1": 3}
    else:
        keys = {"discipline": 0, "parameterCategory": 2, "parameterNumber": 2 + v}
        keys |= {"typeOfLevel": "isobaricInhPa", "forecastTime": 3}
    keys |= {"dataDate": 20090916, "dataTime": 600, "level": level, **grid}
    missing = np.isnan(values)
    if missing.any():
        keys |= {"bitmapPresent": 1, "missingValue": 9999.0}
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)
    data = np.where(missing, 9999.0, values)
    eccodes.codes_set(handle, "bitsPerValue", 12)
    eccodes.codes_set_values(handle, data)
    if packing != "grid_simple":
        eccodes.codes_set(handle, "packingType", packing)
        if packing != "grid_ieee":
            eccodes.codes_set(handle, "bitsPerValue", 12)
        eccodes.codes_set_values(handle, data)
    message = bytes(eccodes.codes_get_message(handle))
    eccodes.codes_release(handle)
    return message


def _madis(path: Path, kind: Any) -> None:
    table = reports()
    count = len(table)
    with netCDF4.Dataset(path, "w", format=kind) as file:
        file.createDimension("recNum", None if kind == "NETCDF3_CLASSIC" else count)
        file.createDimension("tailLen", 9)
        numbers = {
            "timeObs": np.full(count, WHEN.astype("datetime64[s]").astype(np.int64)),
            "latitude": table["latitude"],
            "longitude": table["longitude"],
            "altitude": np.linspace(2500.0, 4800.0, count),
            "windDir": table["wind_direction_deg"],
            "windSpeed": table["wind_speed_kt"] * 0.5144,
            "temperature": table["temperature_degC"] + 273.15,
        }
        for name, values in numbers.items():
            kept = file.createVariable(name, "f8" if name == "timeObs" else "f4", ("recNum",))
            kept[:] = np.asarray(values)
        for name in ("rollFlag", "tempError", "windDirError", "windSpeedError"):
            code = ord("G") if name == "rollFlag" else ord("p")
            file.createVariable(name, "i1", ("recNum",))[:] = np.full(count, code, dtype="i1")
        tails = file.createVariable("en_tailNumber", "S1", ("recNum", "tailLen"))
        tails[:] = netCDF4.stringtochar(table["tail"].to_numpy().astype("S9"))


def bufr_file(path: Path) -> None:
    """A dozen AMDAR messages of the sequence 3 11 001."""
    import eccodes

    table = reports(12)
    with path.open("wb") as file:
        for number, row in table.iterrows():
            handle = eccodes.codes_bufr_new_from_samples("BUFR4")
            eccodes.codes_set(handle, "masterTablesVersionNumber", 24)
            eccodes.codes_set(handle, "dataCategory", 4)
            eccodes.codes_set_array(handle, "unexpandedDescriptors", [311001])
            keys = {
                "aircraftFlightNumber": row["tail"],
                "latitude": row["latitude"],
                "longitude": row["longitude"],
                "year": 2009,
                "month": 9,
                "day": 16,
                "hour": 9,
                "minute": int(number) % 60,
                "height": 3000 + 100 * int(number),
                "airTemperature": 270.0,
                "windDirection": int(row["wind_direction_deg"]),
                "windSpeed": row["wind_speed_kt"] * 0.5144,
                "phaseOfAircraftFlight": 3,
            }
            for key, value in keys.items():
                eccodes.codes_set(handle, key, value)
            eccodes.codes_set(handle, "pack", 1)
            file.write(eccodes.codes_get_message(handle))
            eccodes.codes_release(handle)


EFFECTS = """\
effects:
  - name: hard_iron
    tails: [N401, N402]
    parameters: {amplitude_deg: 3.9, phase_deg: 40.1}
    period: [2009-08-01, null]
  - name: tas_scale
    tails: all
    parameters: {scale_percent: 2.0}
    period: null
"""


def _of_a_run(folder: Path) -> dict[str, Path]:
    """Products, kept work and header cache of a small run, and its configuration."""
    from airswing.config_file import load_config
    from airswing.synthetic.archive import write_archive
    from airswing.workflow import make_corrected, make_fits, make_headings
    from airswing.workflow.evaluation_stage import make_observation_errors
    from airswing.workflow.job import Job
    from airswing.workflow.progress import Progress

    write_archive(folder, days=1, aircraft=2, seed=1)
    config = folder / "config.yaml"
    content = yaml.safe_load(config.read_text())
    content["screening"] = {"phases": ["ascent", "cruise", "descent"], "max_turn": "10 deg"}
    content["fit"] = {"min_reports": 20, "harmonics": 1}
    content["compute"] = {"workers": 1, "threads": 1}
    config.write_text(yaml.safe_dump(content))
    content["field_test"] = {
        "start": "2009-10-20",
        "before_start": "2009-07-20",
        "corrected": ["N401"],
        "controls": ["N402"],
    }
    (folder / "whole.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    job = Job(load_config(config), Progress(quiet=True))
    headings = make_headings(job)
    corrected = make_corrected(job, headings, make_fits(job, headings))
    make_observation_errors(job, headings, corrected)
    xr.Dataset.close(headings)
    shutil.rmtree(folder / "truth", ignore_errors=True)
    made = {}
    for name in (*PRODUCTS, *HANDED_OVER):
        months = folder / "results" / name.removesuffix(".nc")
        made[name] = next(months.glob("*.nc")) if months.is_dir() else months.with_suffix(".nc")
    return made | {kind: folder for kind in KEPT}
