"""wrfout files of WRF-ARW: staggered winds along the grid, pressure on model levels.

Assumptions and validity
------------------------
* U and V are staggered (Arakawa C) and along the grid; at a mass point the mean of the two
  neighbours counts, as wrf-python's ``ua`` and ``va`` have it. Pressure is P + PB (Pa).
* The grid is that of MAP_PROJ, TRUELAT1, TRUELAT2, STAND_LON, DX and DY on WRF's sphere of
  6,370 km, laid through the first mass point (WRF share/module_llxy.F); where the last
  mass point is not met within a tenth of a grid length, and for rotated latitudes and
  longitudes, the grid is that of XLAT and XLONG at every point, its direction that of
  SINALPHA and COSALPHA, or of the points themselves where these are missing.
* A grid that moves (vortex-following nests) has one grid a time.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.geometry.placing import Placing
from airswing.reference.gridded.cf.axes_grid import AxesGrid
from airswing.reference.gridded.cf.curvilinear import CurvilinearGrid
from airswing.reference.gridded.cf.projection import LONGITUDE_LATITUDE, Frame

Floats = NDArray[np.float64]

RADIUS = 6370000.0  # WRF's earth (share/module_llxy.F, EARTH_RADIUS_M), m
_MET = 0.1  # Grid lengths by which the last point of the projection may miss the file's
# Radians by which the file's direction of the grid may differ from the projection's.
_SAME_ANGLE = 1e-3
Y, X = "south_north", "west_east"


def is_wrfout(ds: xr.Dataset) -> bool:
    """Whether a Dataset is a wrfout as WRF writes it."""
    return "MAP_PROJ" in ds.attrs and {"XLAT", "XLONG"} <= set(ds.variables) and X in ds.dims


def required(ds: xr.Dataset, file: str) -> None:
    """Refuse a wrfout without winds on their staggered grid or without pressure."""
    absent = [name for name in ("U", "V") if name not in ds.variables]
    if absent:
        raise InputError(
            "wrfout without " + " and ".join(absent),
            file=file,
            remedy="Keep U and V in WRF's output stream",
        )
    for name, dims in (("U", (Y, X + "_stag")), ("V", (Y + "_stag", X))):
        if ds[name].dims[-2:] != dims:
            raise InputError(
                "winds that are not on WRF's staggered grid",
                file=file,
                field=name,
                found="dimensions " + ", ".join(map(str, ds[name].dims)),
                remedy="Give the file as WRF wrote it, or both components at mass points with "
                "engine: netcdf",
            )
    missing = [name for name in ("P", "PB") if name not in ds.variables]
    if missing:
        raise InputError(
            "wrfout without pressure",
            file=file,
            field=" and ".join(missing),
            remedy="Keep P and PB in WRF's output stream",
        )


def times_of_wrfout(ds: xr.Dataset, file: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Valid times (ns since 1970) and leads (s) of a wrfout.

    Raises
    ------
    InputError
        Without times.
    """
    if "Times" in ds.variables:
        stamps = [_stamp(text) for text in np.atleast_1d(ds["Times"].values)]
    elif "XTIME" in ds.variables and ds["XTIME"].dtype.kind == "M":
        stamps = list(np.atleast_1d(ds["XTIME"].values))
    else:
        raise InputError("no time axis", file=file, field="Times")
    valid = np.array(stamps, dtype="datetime64[ns]")
    written = ds.attrs.get("SIMULATION_START_DATE", ds.attrs.get("START_DATE"))
    begun = _stamp(written) if written is not None else np.datetime64("NaT", "ns")
    lead = (valid - begun) / np.timedelta64(1, "s")
    return valid.astype(np.int64), np.where(np.isfinite(lead), lead, 0).astype(np.int64)


def _stamp(text: object) -> np.datetime64:
    if isinstance(text, np.ndarray):
        text = b"".join(text.tolist())
    written = text.decode() if isinstance(text, bytes) else str(text)
    try:
        return np.datetime64(written.strip().replace("_", "T"), "ns")
    except ValueError:
        return np.datetime64("NaT", "ns")


def grids_of_wrfout(ds: xr.Dataset, count: int) -> list[Placing]:
    """The grid of each of so many times; the same object where the grid has not moved."""
    lat, lon = ds["XLAT"], ds["XLONG"]
    if lat.ndim == 2:
        return [_grid(ds, lat, lon, None)] * count
    first: dict[tuple[float, float], Placing] = {}
    found: list[Placing] = []
    for number in range(count):
        here = lat[number], lon[number]
        corner = float(here[0][0, 0]), float(here[1][0, 0])
        if corner not in first:
            first[corner] = _grid(ds, *here, number)
        found.append(first[corner])
    return found


def _grid(ds: xr.Dataset, lat: xr.DataArray, lon: xr.DataArray, number: int | None) -> Placing:
    """The grid of one time, by the projection where that meets the points."""
    turned = _angle(ds, number)
    frame = _frame(ds)
    if frame is not None:
        grid = _laid(frame, ds, lat, lon)
        if grid is not None and _agrees(grid, turned, lat, lon):
            return grid
    return CurvilinearGrid(_floats(lat), _floats(lon), turned=turned, wind_along_grid=True)


def _angle(ds: xr.Dataset, number: int | None) -> Floats | None:
    """Angle (rad) that turns winds along the grid to true ones, as the file has it."""
    if not {"SINALPHA", "COSALPHA"} <= set(ds.variables):
        return None
    sine, cosine = (
        ds[name] if number is None or ds[name].ndim == 2 else ds[name][number]
        for name in ("SINALPHA", "COSALPHA")
    )
    # WRF: u_e = cos u - sin v; the angle here turns the other way.
    return np.asarray(np.arctan2(-_floats(sine), _floats(cosine)))


def _agrees(grid: AxesGrid, turned: Floats | None, lat: xr.DataArray, lon: xr.DataArray) -> bool:
    """Whether the file's own angle is the projection's."""
    if turned is None:
        return True
    ends = [0, -1]
    ours = grid.convergence(*(_floats(one[ends, ends]).ravel() for one in (lat, lon)))
    theirs = turned[np.ix_(ends, ends)].ravel()
    return bool(np.abs(np.sin(ours - theirs)).max() < _SAME_ANGLE)


def _floats(one: xr.DataArray) -> Floats:
    return np.asarray(one.values, dtype=np.float64)


def _frame(ds: xr.Dataset) -> Frame | None:
    """The projection of a wrfout's attributes; None where it is not one of WRF's plain ones."""
    kind = int(np.ravel(ds.attrs["MAP_PROJ"])[0])

    def of(name: str, default: float = 0.0) -> float:
        return float(np.ravel(ds.attrs.get(name, default))[0])

    one, two, stand = of("TRUELAT1"), of("TRUELAT2"), of("STAND_LON")
    sphere = f"+lon_0={stand!r} +R={RADIUS!r} +units=m +no_defs"
    if kind == 1:
        # WRF writes 1e20 for a second parallel that is not there.
        two = two if abs(two) <= 90.0 else one
        return Frame(
            "projected", f"+proj=lcc +lat_1={one!r} +lat_2={two!r} +lat_0={one!r} {sphere}"
        )
    if kind == 2:
        pole = 90.0 if one >= 0 else -90.0
        return Frame("projected", f"+proj=stere +lat_0={pole!r} +lat_ts={one!r} {sphere}")
    if kind == 3:
        return Frame("projected", f"+proj=merc +lat_ts={one!r} {sphere}")
    if kind == 6 and of("POLE_LAT", 90.0) == 90.0:
        return LONGITUDE_LATITUDE
    return None


def _laid(frame: Frame, ds: xr.Dataset, lat: xr.DataArray, lon: xr.DataArray) -> AxesGrid | None:
    """The projection's grid through the first point; None where it misses the last."""
    nj, ni = lat.shape
    ends = np.array([0, -1])
    corners = (
        np.asarray([float(one[j, i]) for j, i in ((0, 0), (0, -1), (-1, 0), (-1, -1))])
        for one in (lat, lon)
    )
    x, y = frame.xy(*corners)
    if frame.meridional:
        row, column = _floats(lon[0]), _floats(lat[:, 0])
        grid = AxesGrid(frame, np.unwrap(row, period=360.0), column, wind_along_grid=True)
        lattice = np.meshgrid(row[ends], column[ends])
        met = np.allclose(lattice[0].ravel(), _floats(lon[ends, ends.tolist()]).ravel(), atol=1e-3)
        return grid if met else None
    dx, dy = (float(np.ravel(ds.attrs[name])[0]) for name in ("DX", "DY"))
    grid = AxesGrid(
        frame, x[0] + dx * np.arange(ni), y[0] + dy * np.arange(nj), wind_along_grid=True
    )
    misses = np.hypot((x - grid.x[[0, -1, 0, -1]]) / dx, (y - grid.y[[0, 0, -1, -1]]) / dy)
    return grid if float(misses.max()) < _MET else None
