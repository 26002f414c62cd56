"""Files of WRF-ARW: wrfout, winds on pressure levels (pld, p_interp), and met_em.

U and V (met_em: UU, VV) are staggered (Arakawa C) and point along the grid; at a mass point the
mean of the two neighbours counts, as in wrf-python. Pressure (Pa) is P + PB on model levels, PRES
on those of met_em, whose first level is the ground and is left out; P_PL, or PRES by level alone,
are isobaric levels. The grid is that of XLAT and XLONG at every point, and its direction that of
SINALPHA and COSALPHA where they are there.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.naming import factor_of
from airswing.reference.grids import Floats, Grid, grid_of_points

Y, X = "south_north", "west_east"
_PLACES = (("XLAT", "XLONG"), ("XLAT_M", "XLONG_M"))
_WINDS = (("U", "V"), ("UU", "VV"), ("U_PL", "V_PL"), ("ua", "va"))


class Layout(NamedTuple):
    """Variables of a WRF file that hold winds and their pressure."""

    winds: tuple[str, str]
    pressure: tuple[str, ...]  # summed; empty for isobaric levels
    first: int  # first level used
    levels: Floats  # Pa of isobaric levels, else numbers
    scale: float = 1.0  # of the pressure, to Pa


def is_wrf(ds: xr.Dataset) -> bool:
    """Whether a Dataset is a file of WRF."""
    places = any(set(names) <= set(ds.variables) for names in _PLACES)
    return "MAP_PROJ" in ds.attrs and places and X in ds.dims


def layout_of(ds: xr.Dataset) -> Layout:
    """Winds and pressure of a file of WRF."""
    winds = next((names for names in _WINDS if set(names) <= set(ds.variables)), None)
    if winds is None:
        absent = [name for name in ("U", "V") if name not in ds.variables]
        remedy = "Keep U and V in WRF's output stream"
        raise InputError("WRF file without " + " and ".join(absent), remedy=remedy)
    level = str(ds[winds[0]].dims[-3])
    for name, (y, x) in zip(winds, ((Y, X + "_stag"), (Y + "_stag", X)), strict=True):
        if ds[name].dims[-2:] not in ((y, x), (Y, X)):
            raise InputError(
                "winds that are not on WRF's points",
                field=name,
                found="dimensions " + ", ".join(map(str, ds[name].dims)),
                remedy="Give the file as WRF wrote it, or both components at mass points with "
                "engine: netcdf",
            )
    size = int(ds.sizes[level])
    for key in ("P_PL", "PRES", "pressure", "p"):
        if key not in ds.variables or level not in ds[key].dims:
            continue
        variable = ds[key]
        if variable.ndim >= 3:
            first = 1 if winds[0] == "UU" else 0
            numbers = np.arange(size, dtype=np.float64)
            scale = factor_of(variable.attrs.get("units"), "pressure") or 1.0
            return Layout(winds, (key,), first, numbers, scale)
        values = _floats(variable.isel({d: 0 for d in variable.dims if d != level}))
        scale = 100.0 if float(np.nanmax(values)) < 2000.0 else 1.0  # p_interp writes hPa or Pa
        return Layout(winds, (), 0, values * scale)
    missing = [name for name in ("P", "PB") if name not in ds.variables]
    if missing or level not in ds["P"].dims:
        raise InputError(
            "WRF file without pressure",
            field=" and ".join(missing) or "P",
            remedy="Keep P and PB in WRF's output stream",
        )
    return Layout(winds, ("P", "PB"), 0, np.arange(size, dtype=np.float64))


def times_of_wrf(ds: xr.Dataset, named: str | None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Valid times (ns since 1970) and leads (s), by the named of ``Times`` and ``XTIME``."""
    if named not in (None, "Times", "XTIME"):
        raise InputError("times of WRF are Times or XTIME", field=f"time: {named}")
    written = ds.attrs.get("SIMULATION_START_DATE", ds.attrs.get("START_DATE"))
    begun = _stamp(written) if written is not None else np.datetime64("NaT", "ns")
    if "Times" in ds.variables and named != "XTIME":
        stamps = [_stamp(text) for text in np.atleast_1d(ds["Times"].values)]
    else:
        coordinate = next((key for key in ("XTIME", "time", "Time") if key in ds.variables), None)
        stamps = [] if coordinate is None else _from_xtime(ds[coordinate], begun)
    valid = np.array(stamps, dtype="datetime64[ns]")
    if not valid.size or np.isnat(valid).all():
        raise InputError("no time axis", field="Times", remedy="Keep Times or XTIME")
    lead = (valid - begun) / np.timedelta64(1, "s")
    return valid.astype(np.int64), np.where(np.isfinite(lead), lead, 0).astype(np.int64)


def _from_xtime(variable: xr.DataArray, begun: np.datetime64) -> list[np.datetime64]:
    values = np.atleast_1d(variable.values)
    if values.dtype.kind == "M":
        return list(values.astype("datetime64[ns]"))
    text = f"{variable.attrs.get('units', '')} {variable.attrs.get('description', '')}"
    match = re.search(r"(\w+) since (\d{4}-\d\d-\d\d)[ T_]?(\d\d:\d\d(?::\d\d)?)?", text, re.I)
    unit = {"h": 3600.0, "d": 86400.0, "s": 1.0}.get(match[1][0].lower(), 60.0) if match else 60.0
    start = _stamp(f"{match[2]}T{match[3] or '00:00'}") if match else begun
    seconds = np.rint(np.asarray(values, dtype=np.float64) * unit)
    return [start + np.timedelta64(int(second), "s") for second in seconds]


def _stamp(text: object) -> np.datetime64:
    if isinstance(text, np.ndarray):
        text = b"".join(text.tolist())
    written = text.decode() if isinstance(text, bytes) else str(text)
    try:
        return np.datetime64(written.strip().replace("_", "T"), "ns")
    except ValueError:
        return np.datetime64("NaT", "ns")


def grids_of_wrf(ds: xr.Dataset, count: int) -> list[Grid]:
    """The grid at each time; the same object if the grid has not moved."""
    latitude, longitude = next(names for names in _PLACES if set(names) <= set(ds.variables))
    angles = [name for name in ("SINALPHA", "COSALPHA") if name in ds.variables]
    places = ds[[latitude, longitude, *angles]]
    if places[latitude].ndim == 2:
        return [_grid(places, places[latitude], places[longitude])] * count
    seen: dict[tuple[float, float], Grid] = {}  # by the first point
    grids: list[Grid] = []
    for number in range(count):
        place = places.isel({places[latitude].dims[0]: number})
        lat, lon = place[latitude], place[longitude]
        corner = float(lat[0, 0]), float(lon[0, 0])
        grids.append(seen.get(corner) or seen.setdefault(corner, _grid(place, lat, lon)))
    return grids


def _grid(ds: xr.Dataset, lat: xr.DataArray, lon: xr.DataArray) -> Grid:
    turned = None
    if {"SINALPHA", "COSALPHA"} <= set(ds.variables):
        # WRF: u_e = cos u - sin v; the angle here turns the other way
        turned = np.asarray(np.arctan2(-_floats(ds["SINALPHA"]), _floats(ds["COSALPHA"])))
    return grid_of_points(_floats(lat), _floats(lon), turned)


def _floats(array: xr.DataArray) -> Floats:
    return np.asarray(array.values, dtype=np.float64)
