"""Tiny sound inputs beside GRIB on pressure levels: Datasets, native levels, stations, lists."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

NI, NJ = 20, 18
LEVELS = np.array([550.0, 650.0, 750.0])
WHEN = np.datetime64("2009-09-16T09:00", "ns")
STORES = ("zarr",)
FILES = ("gridded NetCDF-4", "gridded NetCDF-3", "wrfout", "GRIB2 model levels", "GRIB2 Gaussian")
DATASETS = (*FILES, *STORES)
STATIONS = ("station pairs", "station observations", "station GRIB")


def make_dataset_seeds(folder: Path) -> dict[str, Path]:
    """Write one of every kind.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict of str to Path
        A Zarr store is a folder.
    """
    makers: dict[str, Callable[[Path], object]] = {
        "gridded NetCDF-4": lambda path: _latlon().to_netcdf(path, encoding=_packed()),
        "gridded NetCDF-3": lambda path: _latlon().to_netcdf(path, format="NETCDF3_64BIT"),
        "wrfout": lambda path: _wrfout().to_netcdf(path, format="NETCDF3_64BIT"),
        "zarr": lambda path: _latlon().to_zarr(path, zarr_format=2, encoding=_chunked()),
        "GRIB2 model levels": _model_levels,
        "GRIB2 Gaussian": _gaussian,
        "station GRIB": _surface,
        "station pairs": lambda path: path.write_text(_pairs()),
        "station observations": lambda path: path.write_text(_observations()),
        "reject list": lambda path: path.write_text(REJECTED),
        "error table": lambda path: path.write_text(_errors()),
    }
    made = {}
    for kind, make in makers.items():
        made[kind] = folder / f"seed.{kind.replace(' ', '_')}"
        make(made[kind])
    return made


def _axes() -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(46.5, 38.0, NJ), np.linspace(-92.0, -82.5, NI)


def _winds(levels: int) -> np.ndarray:
    """u and v, (2, levels, y, x): waves of a few metres a second on a mean flow."""
    y, x = np.mgrid[0:NJ, 0:NI]
    waves = [6 * np.sin(x / 4 + n) + 4 * np.cos(y / 5 - n) for n in range(levels)]
    return np.stack([np.stack(waves) + 12.0, np.stack(waves) - 4.0]).astype("f4")


def _latlon() -> xr.Dataset:
    """As reanalyses come: three hours about the reports' time, three levels."""
    lat, lon = _axes()
    u, v = np.repeat(_winds(LEVELS.size)[:, None], 3, axis=1)
    dims = ("time", "level", "latitude", "longitude")
    wind = {"units": "m s**-1"}
    return xr.Dataset(
        {
            "u": (dims, u, wind | {"standard_name": "eastward_wind"}),
            "v": (dims, v, wind | {"standard_name": "northward_wind"}),
        },
        coords={
            "time": WHEN + np.arange(-1, 2) * np.timedelta64(3_600_000_000_000, "ns"),
            "level": ("level", LEVELS.astype("i4"), {"units": "millibars"}),
            "latitude": ("latitude", lat.astype("f4"), {"units": "degrees_north"}),
            "longitude": ("longitude", lon.astype("f4"), {"units": "degrees_east"}),
        },
    )


def _packed() -> dict[str, dict[str, Any]]:
    how = {"dtype": "i2", "scale_factor": 0.01, "add_offset": 5.0, "_FillValue": -32767}
    return {name: how | {"zlib": True, "chunksizes": (1, 1, NJ, NI)} for name in "uv"}


def _chunked() -> dict[str, dict[str, Any]]:
    return {name: {"chunks": (1, 2, NJ, NI)} for name in "uv"}


def _wrfout() -> xr.Dataset:
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
    mass = ("Time", "bottom_top", "south_north", "west_east")
    stamp = np.array([str(WHEN)[:19].replace("T", "_").encode()], dtype="S19")
    plane = ("Time", "south_north", "west_east")
    return xr.Dataset(
        {
            "Times": ("Time", stamp),
            "U": ((*mass[:3], "west_east_stag"), wide[None], {"units": "m s-1", "stagger": "X"}),
            "V": (
                (*mass[:2], "south_north_stag", mass[3]),
                tall[None],
                {"units": "m s-1", "stagger": "Y"},
            ),
            "P": (mass, np.zeros((1, 4, NJ, NI), "f4") + 10.0, {"units": "Pa"}),
            "PB": (mass, np.broadcast_to(half, (1, 4, NJ, NI)).copy(), {"units": "Pa"}),
            "XLAT": (plane, lat[None].astype("f4")),
            "XLONG": (plane, lon[None].astype("f4")),
        },
        attrs={
            "TITLE": "OUTPUT FROM WRF V4.2 MODEL",
            "START_DATE": "2009-09-16_06:00:00",
            "SIMULATION_START_DATE": "2009-09-16_06:00:00",
            "DX": np.float32(step),
            "DY": np.float32(step),
            "MAP_PROJ": np.int32(3),
            "TRUELAT1": np.float32(40.0),
            "TRUELAT2": np.float32(0.0),
            "STAND_LON": np.float32(-87.0),
            "CEN_LAT": np.float32(42.0),
            "CEN_LON": np.float32(-87.0),
        },
    )


LATLON = {
    "gridType": "regular_ll",
    "Ni": NI,
    "Nj": NJ,
    "latitudeOfFirstGridPointInDegrees": 46.5,
    "longitudeOfFirstGridPointInDegrees": 268.0,
    "latitudeOfLastGridPointInDegrees": 38.0,
    "longitudeOfLastGridPointInDegrees": 277.5,
    "iDirectionIncrementInDegrees": 0.5,
    "jDirectionIncrementInDegrees": 0.5,
    "iScansNegatively": 0,
    "jScansPositively": 0,
    "uvRelativeToGrid": 0,
}


def _message(keys: dict[str, Any], values: np.ndarray, pv: np.ndarray | None = None) -> bytes:
    import eccodes

    handle = eccodes.codes_grib_new_from_samples("GRIB2")
    for key, value in ({"dataDate": 20090916, "dataTime": 600, "forecastTime": 3} | keys).items():
        eccodes.codes_set(handle, key, value)
    if pv is not None:
        eccodes.codes_set(handle, "PVPresent", 1)
        eccodes.codes_set_double_array(handle, "pv", pv.tolist())
    eccodes.codes_set(handle, "bitsPerValue", 12)
    eccodes.codes_set_values(handle, values.ravel().astype(float))
    made = bytes(eccodes.codes_get_message(handle))
    eccodes.codes_release(handle)
    return made


def _model_levels(path: Path) -> None:
    """Six hybrid levels whose coefficients stand in every message, and ln of surface pressure."""
    half = np.linspace(0.2, 1.0, 7)
    pv = np.concatenate([np.zeros(7), half])
    u, v = _winds(6)
    level = {"typeOfFirstFixedSurface": 105, "discipline": 0}
    wind = {"parameterCategory": 2}
    made = [
        _message(LATLON | level | wind | {"parameterNumber": 2 + n, "level": k + 1}, one[k], pv)
        for k in range(6)
        for n, one in enumerate((u, v))
    ]
    surface = level | {"parameterCategory": 3, "parameterNumber": 25, "level": 1}
    made.append(_message(LATLON | surface, np.full((NJ, NI), np.log(98_000.0)), pv))
    path.write_bytes(b"".join(made))


def _gaussian(path: Path) -> None:
    """A global Gaussian grid of 32 x 64 points, three levels."""
    grid = {"gridType": "regular_gg", "N": 16, "Ni": 64, "Nj": 32, "iDirectionIncrement": 5625000}
    grid |= {
        "latitudeOfFirstGridPointInDegrees": 85.760587,
        "latitudeOfLastGridPointInDegrees": -85.760587,
        "longitudeOfFirstGridPointInDegrees": 0.0,
        "longitudeOfLastGridPointInDegrees": 354.375,
    }
    y, x = np.mgrid[0:32, 0:64]
    made = [
        _message(
            grid
            | {"discipline": 0, "parameterCategory": 2, "parameterNumber": 2 + n}
            | {"typeOfLevel": "isobaricInhPa", "level": int(level)},
            12.0 - 16 * n + 6 * np.sin(x / 4 + level) + 4 * np.cos(y / 5),
        )
        for level in LEVELS
        for n in range(2)
    ]
    path.write_bytes(b"".join(made))


def _surface(path: Path) -> None:
    """Temperature at 2 m and wind at 10 m at two leads."""
    y, x = np.mgrid[0:NJ, 0:NI]
    fields = (((0, 0), 2, 285 + 3 * np.sin(x / 4)), ((2, 2), 10, 5 + y / 9), ((2, 3), 10, x / 9))
    made = [
        _message(
            LATLON
            | {"discipline": 0, "parameterCategory": category, "parameterNumber": number}
            | {"typeOfLevel": "heightAboveGround", "level": height, "forecastTime": lead},
            values,
        )
        for lead in (3, 6)
        for (category, number), height, values in fields
    ]
    path.write_bytes(b"".join(made))


def _pairs() -> str:
    days = pd.date_range("2009-01-01", periods=12)
    rows = [
        f"{station},{day:%Y-%m-%d},{lead},{280 + n / 3:.1f},{281.5 + n / 3:.1f}"
        for station in ("ORD", "MSP")
        for n, day in enumerate(days)
        for lead in (12, 24)
    ]
    return "\n".join(["station,start,lead,forecast,observation", *rows, ""])


def _observations() -> str:
    rows = [
        f"{station},{lat},{lon},2009-09-16T{hour:02d}:00:00Z,{12 + hour},10,270"
        for station, lat, lon in (("ORD", 41.98, -87.9), ("MSP", 44.88, -91.2))
        for hour in (9, 12)
    ]
    head = "id,lat,lon,time,temperature_degC,wind_speed_kt,wind_direction_deg"
    return "\n".join([head, *rows, ""])


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


def _errors() -> str:
    """WRF's table of observation errors."""
    from importlib.resources import files

    return (files("airswing.handover") / "data" / "obserr.txt").read_text(encoding="ascii")
