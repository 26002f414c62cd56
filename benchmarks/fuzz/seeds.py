"""Small valid inputs of every kind, made by the project, for the campaign to damage."""

import gzip
import shutil
from importlib.resources import files

import netCDF4
import numpy as np
import pandas as pd
import xarray as xr
import yaml
from tests.reference.builders import PARALLELS, SOUTHWARD, build, grid_keys

NI, NJ = 20, 18
LEVELS = np.array([550.0, 650.0, 750.0])
WHEN = np.datetime64("2009-09-16T09:00", "ns")
METRES = {"DxInMetres": 50000, "DyInMetres": 50000}
LAMBERT = grid_keys("lambert", (NI, NJ), (268.8, 38.7), **PARALLELS, **METRES, uvRelativeToGrid=1)
LATLON = grid_keys(
    "regular_ll", (NI, NJ), (268.0, 46.5), (277.5, 38.0), **SOUTHWARD, uvRelativeToGrid=0
)
GRIBS = {
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
RUN = {"when": (20090916, 600), "step": 3, "bits": 12}
TEXTS = ("csv", "csv.gz", "yaml", "effects")
TABLES = ("parquet", "netcdf3", "netcdf4", "bufr")
PRODUCTS = ("headings.nc", "fits.nc", "corrected.nc")
KEPT = ("kept notes", "header cache")
STORES = ("zarr",)
FILES = ("gridded NetCDF-4", "gridded NetCDF-3", "wrfout", "GRIB2 model levels", "GRIB2 Gaussian")
DATASETS = (*FILES, *STORES)
STATIONS = ("station pairs", "station observations", "station GRIB")
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
REJECTED = "".join(
    [
        "reject: bias_T > 2, std_T > 2, bias_S > 2.5, std_S > 5, bias_DIR > 7, std_DIR > 30,\n",
        "rms_W > 8, std_W > 7\n",
        *(";\n" for _ in range(14)),
        "N401      T W R      --------  120  1.0 2.0 (wind)\n",
        "N402      - W -      00000402   90  0.1 9.0 (wind temperature)\n",
        "X9        - - R      --------    3\n",
    ]
)


def make_seeds(folder):
    """Write one valid file of every kind; for the notes of a run, its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    table = reports()
    makers = {
        "csv": lambda path: table.to_csv(path, index=False),
        "csv.gz": lambda path: path.write_bytes(gzip.compress(table.to_csv(index=False).encode())),
        "parquet": lambda path: table.to_parquet(path, index=False),
        "netcdf3": lambda path: _madis(path, "NETCDF3_CLASSIC"),
        "netcdf4": lambda path: _madis(path, "NETCDF4"),
        "bufr": bufr_file,
        "effects": lambda path: path.write_text(EFFECTS),
    }
    paths = {kind: folder / f"{number}.grib" for number, kind in enumerate(GRIBS)}
    for kind, path in paths.items():
        path.write_bytes(_grib(*GRIBS[kind]))
    paths |= _written(folder, makers) | make_dataset_seeds(folder) | _of_a_run(folder / "run")
    return paths | {"yaml": folder / "run" / "whole.yaml"}


def make_dataset_seeds(folder):
    """Write Datasets, native levels, stations and lists; a Zarr store is a folder."""
    packed = {"dtype": "i2", "scale_factor": 0.01, "add_offset": 5.0, "_FillValue": -32767}
    packed |= {"zlib": True, "chunksizes": (1, 1, NJ, NI)}
    table = files("airswing.handover") / "data" / "obserr.txt"
    return _written(
        folder,
        {
            "gridded NetCDF-4": lambda path: _latlon().to_netcdf(
                path, encoding=dict.fromkeys("uv", packed)
            ),
            "gridded NetCDF-3": lambda path: _latlon().to_netcdf(path, format="NETCDF3_64BIT"),
            "wrfout": lambda path: _wrfout().to_netcdf(path, format="NETCDF3_64BIT"),
            "zarr": lambda path: _latlon().to_zarr(
                path, zarr_format=2, encoding={key: {"chunks": (1, 2, NJ, NI)} for key in "uv"}
            ),
            "GRIB2 model levels": _model_levels,
            "GRIB2 Gaussian": _gaussian,
            "station GRIB": _surface,
            "station pairs": lambda path: path.write_text(_pairs()),
            "station observations": lambda path: path.write_text(_observations()),
            "reject list": lambda path: path.write_text(REJECTED),
            "error table": lambda path: path.write_bytes(table.read_bytes()),
        },
    )


def _written(folder, makers):
    paths = {kind: folder / f"seed.{kind.replace(' ', '_')}" for kind in makers}
    for kind, make in makers.items():
        make(paths[kind])
    return paths


def _winds(levels):
    """u and v, (2, levels, y, x): waves of a few metres a second on a mean flow."""
    y, x = np.mgrid[0:NJ, 0:NI]
    waves = np.stack([6 * np.sin(x / 4 + n) + 4 * np.cos(y / 5 - n) for n in range(levels)])
    return np.stack([waves + 12.0, waves - 4.0]).astype("f4")


def fields():
    return [wind.round(2).ravel() for level in zip(*_winds(3), strict=True) for wind in level]


def reports(count=60):
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


def _grib(edition, grid, packing, bitmap):
    hidden = (np.arange(NI * NJ) % 17 == 5) & bitmap
    return b"".join(
        build(
            grid,
            np.where(hidden, np.nan, values),
            edition=edition,
            parameter="uv"[number % 2],
            level=int(LEVELS[number // 2]),
            packing=packing,
            **RUN,
        )
        for number, values in enumerate(fields())
    )


def _model_levels(path):
    pv = np.concatenate([np.zeros(7), np.linspace(0.2, 1.0, 7)])
    level = {"typeOfFirstFixedSurface": 105}
    messages = [
        build(LATLON, wind[k].ravel(), parameter=name, level=k + 1, extra=level, pv=pv, **RUN)
        for k in range(6)
        for name, wind in zip("uv", _winds(6), strict=True)
    ]
    surface = {"parameterCategory": 3, "parameterNumber": 25, "level": 1}
    log_pressure = np.full(NJ * NI, np.log(98_000.0))
    messages.append(build(LATLON, log_pressure, extra=surface | level, pv=pv, **RUN))
    path.write_bytes(b"".join(messages))


def _gaussian(path):
    """A global Gaussian grid of 32 x 64 points, three levels."""
    corners = (0.0, 85.760587), (354.375, -85.760587)
    grid = grid_keys("regular_gg", (64, 32), *corners, N=16, **SOUTHWARD)
    grid |= {"iDirectionIncrement": 5625000}
    y, x = np.mgrid[0:32, 0:64]
    messages = [
        build(
            grid,
            (12.0 - 16 * n + 6 * np.sin(x / 4 + level) + 4 * np.cos(y / 5)).ravel(),
            parameter="uv"[n],
            level=int(level),
            **RUN,
        )
        for level in LEVELS
        for n in range(2)
    ]
    path.write_bytes(b"".join(messages))


def _surface(path):
    """Temperature at 2 m and wind at 10 m at two leads."""
    y, x = np.mgrid[0:NJ, 0:NI]
    parts = (((0, 0), 2, 285 + 3 * np.sin(x / 4)), ((2, 2), 10, 5 + y / 9), ((2, 3), 10, x / 9))
    messages = [
        build(
            LATLON,
            values.ravel(),
            extra={"parameterCategory": category, "parameterNumber": number}
            | {"typeOfLevel": "heightAboveGround", "level": height},
            **RUN | {"step": lead},
        )
        for lead in (3, 6)
        for (category, number), height, values in parts
    ]
    path.write_bytes(b"".join(messages))


def _latlon():
    """As reanalyses come: three hours about the reports' time, three levels."""
    u, v = np.repeat(_winds(LEVELS.size)[:, None], 3, axis=1)
    dims = ("time", "level", "latitude", "longitude")
    lat, lon = np.linspace(46.5, 38.0, NJ), np.linspace(-92.0, -82.5, NI)
    return xr.Dataset(
        {
            name: (dims, wind, {"units": "m s**-1", "standard_name": f"{way}ward_wind"})
            for name, way, wind in (("u", "east", u), ("v", "north", v))
        },
        coords={
            "time": WHEN + np.arange(-1, 2) * np.timedelta64(3_600_000_000_000, "ns"),
            "level": ("level", LEVELS.astype("i4"), {"units": "millibars"}),
            "latitude": ("latitude", lat.astype("f4"), {"units": "degrees_north"}),
            "longitude": ("longitude", lon.astype("f4"), {"units": "degrees_east"}),
        },
    )


def _wrfout():
    """Mercator mass points, staggered winds, pressure on model levels."""
    from pyproj import Proj

    proj = Proj("+proj=merc +lat_ts=40 +lon_0=-87 +R=6370000")
    x0, y0 = proj(-87.0, 42.0)
    step = 30_000.0
    x, y = (np.arange(NI) - NI / 2) * step + x0, (np.arange(NJ) - NJ / 2) * step + y0
    lon, lat = proj(*np.meshgrid(x, y), inverse=True)
    u, v = _winds(4)
    wide = np.concatenate([u, u[..., -1:]], axis=2)
    tall = np.concatenate([v, v[:, -1:]], axis=1)
    half = 100.0 * np.array([800.0, 700.0, 600.0, 500.0], "f4")[:, None, None]
    plane = ("Time", "south_north", "west_east")
    mass = ("Time", "bottom_top", "south_north", "west_east")
    east, north = (*mass[:3], "west_east_stag"), (*mass[:2], "south_north_stag", mass[3])
    stamp = np.array([str(WHEN)[:19].replace("T", "_").encode()], dtype="S19")
    start = {name: "2009-09-16_06:00:00" for name in ("START_DATE", "SIMULATION_START_DATE")}
    numbers = {"DX": step, "DY": step, "TRUELAT1": 40.0, "TRUELAT2": 0.0, "STAND_LON": -87.0}
    numbers |= {"CEN_LAT": 42.0, "CEN_LON": -87.0}
    return xr.Dataset(
        {
            "Times": ("Time", stamp),
            "U": (east, wide[None], {"units": "m s-1", "stagger": "X"}),
            "V": (north, tall[None], {"units": "m s-1", "stagger": "Y"}),
            "P": (mass, np.zeros((1, 4, NJ, NI), "f4") + 10.0, {"units": "Pa"}),
            "PB": (mass, np.broadcast_to(half, (1, 4, NJ, NI)).copy(), {"units": "Pa"}),
            "XLAT": (plane, lat[None].astype("f4")),
            "XLONG": (plane, lon[None].astype("f4")),
        },
        attrs={"TITLE": "OUTPUT FROM WRF V4.2 MODEL", "MAP_PROJ": np.int32(3)}
        | start
        | {name: np.float32(value) for name, value in numbers.items()},
    )


def _pairs():
    days = pd.date_range("2009-01-01", periods=12)
    rows = [
        f"{station},{day:%Y-%m-%d},{lead},{280 + n / 3:.1f},{281.5 + n / 3:.1f}"
        for station in ("ORD", "MSP")
        for n, day in enumerate(days)
        for lead in (12, 24)
    ]
    return "\n".join(["station,start,lead,forecast,observation", *rows, ""])


def _observations():
    rows = [
        f"{station},{lat},{lon},2009-09-16T{hour:02d}:00:00Z,{12 + hour},10,270"
        for station, lat, lon in (("ORD", 41.98, -87.9), ("MSP", 44.88, -91.2))
        for hour in (9, 12)
    ]
    names = "id,lat,lon,time,temperature_degC,wind_speed_kt,wind_direction_deg"
    return "\n".join([names, *rows, ""])


def _madis(path, kind):
    table = reports()
    size = len(table)
    with netCDF4.Dataset(path, "w", format=kind) as file:
        file.createDimension("recNum", None if kind == "NETCDF3_CLASSIC" else size)
        file.createDimension("tailLen", 9)
        numbers = {
            "timeObs": np.full(size, WHEN.astype("datetime64[s]").astype(np.int64)),
            "latitude": table["latitude"],
            "longitude": table["longitude"],
            "altitude": np.linspace(2500.0, 4800.0, size),
            "windDir": table["wind_direction_deg"],
            "windSpeed": table["wind_speed_kt"] * 0.5144,
            "temperature": table["temperature_degC"] + 273.15,
        }
        for name, values in numbers.items():
            variable = file.createVariable(name, "f8" if name == "timeObs" else "f4", ("recNum",))
            variable[:] = np.asarray(values)
        for name in ("rollFlag", "tempError", "windDirError", "windSpeedError"):
            code = ord("G") if name == "rollFlag" else ord("p")
            file.createVariable(name, "i1", ("recNum",))[:] = np.full(size, code, dtype="i1")
        tails = file.createVariable("en_tailNumber", "S1", ("recNum", "tailLen"))
        tails[:] = netCDF4.stringtochar(table["tail"].to_numpy().astype("S9"))


def bufr_file(path):
    """Write a dozen AMDAR messages of the sequence 3 11 001."""
    import eccodes

    with path.open("wb") as file:
        for number, row in enumerate(reports(12).to_dict("records")):
            handle = eccodes.codes_bufr_new_from_samples("BUFR4")
            eccodes.codes_set(handle, "masterTablesVersionNumber", 24)
            eccodes.codes_set(handle, "dataCategory", 4)
            eccodes.codes_set_array(handle, "unexpandedDescriptors", [311001])
            keys = {
                "aircraftFlightNumber": row["tail"],
                "latitude": row["latitude"],
                "longitude": row["longitude"],
                **{"year": 2009, "month": 9, "day": 16, "hour": 9, "minute": number},
                "height": 3000 + 100 * number,
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


def _of_a_run(folder):
    """Products, kept work and header cache of a small run, and its configuration."""
    from airswing.config_file import load_config
    from airswing.synthetic.archive import write_archive
    from airswing.workflow import make_corrected, make_fits, make_headings
    from airswing.workflow.job import Job
    from airswing.workflow.progress import Progress
    from airswing.workflow.stages import make_observation_errors

    coarse = {"columns": 24, "rows": 20, "spacing_km": 75.0, "interval_hours": 2}
    config = write_archive(folder, days=1, aircraft=2, seed=1, **coarse)
    content = yaml.safe_load(config.read_text())
    content["screening"] = {"phases": ["ascent", "cruise", "descent"], "max_turn": "10 deg"}
    content["fit"] = {"min_reports": 20, "harmonics": 1}
    content["compute"] = {"workers": 1, "threads": 1}
    config.write_text(yaml.safe_dump(content))
    test = {"start": "2009-10-20", "before_start": "2009-07-20"}
    content["field_test"] = test | {"corrected": ["N401"], "controls": ["N402"]}
    (folder / "whole.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    job = Job(load_config(config), Progress(quiet=True))
    headings = make_headings(job)
    corrected = make_corrected(job, make_fits(job, headings))
    make_observation_errors(job, headings, corrected)
    headings.close()
    shutil.rmtree(folder / "truth", ignore_errors=True)
    products = {}
    for name in PRODUCTS:
        months = folder / "results" / name.removesuffix(".nc")
        products[name] = next(months.glob("*.nc")) if months.is_dir() else months.with_suffix(".nc")
    return products | {kind: folder for kind in KEPT}
