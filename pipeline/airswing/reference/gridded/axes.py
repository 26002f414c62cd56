"""Dimensions and grid of a variable: horizontal, vertical, time, ensemble; by MetPy's CF parsing.

A name in the configuration takes precedence. Dimensions that MetPy (`parse_cf`) does not recognise
are an ensemble (CF `realization`), ECMWF's `expver`, levels, or have one entry. Horizontal
coordinates are one-dimensional along two dimensions, or latitudes and longitudes of every point.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.gridded.datasets import GRID, quiet
from airswing.reference.gridded.naming import Naming, factor_of, required_factor
from airswing.reference.gridded.times import is_time_dimension
from airswing.reference.grids import (
    LONGITUDE_LATITUDE,
    PROJECTION_REMEDY,
    AxesGrid,
    Frame,
    Grid,
    PointsGrid,
    UnplaceableGridError,
    frame_of,
    through_points,
)
from airswing.units import MODEL_EARTH_RADIUS

_MEMBER = re.compile(r"(number|members?|realization|ens\d*|ensemble\w*|perturbation\w*)$", re.I)
_EITHER = "expver"  # ECMWF's dimension of final and preliminary data: each time is in one of them
_PROJECTED = re.compile(r"(projection_)?[xy](_coordinate|c)?$", re.I)
_LEVEL = re.compile(r"(p?lev(el)?s?|pressure(_levels?)?|isobaric\w*|plevs?)$", re.I)
_CELLS = re.compile(r"(n_?cells?\w*|cells?|ncol|ncells_\d+|nodes?|faces?|nMesh\w*|values)$", re.I)


class Axes(NamedTuple):
    """Dimensions of a variable."""

    y: xr.DataArray  # coordinates, one-dimensional or both two-dimensional
    x: xr.DataArray
    vertical: xr.DataArray | None  # coordinate of the levels
    y_dim: str
    x_dim: str
    outer: tuple[str, ...]  # dimensions of time, member and level
    member: str  # the ensemble's and the alternatives' dimension, empty if there is none
    either: str
    crs: dict[str, object] | None  # attributes of the grid mapping


def unstructured(dimension: str) -> InputError:
    """The error for winds on an unstructured grid."""
    return InputError(
        "winds on an unstructured grid (one dimension of cells)",
        field=dimension,
        remedy="Interpolate to latitude and longitude first, for instance with cdo remapbil",
    )


def cell_dimension(ds: xr.Dataset) -> str:
    """Dimension of the cells of an unstructured grid, empty if there is none."""
    for name in map(str, ds.dims):
        if _CELLS.match(name) and ds.sizes[name] > 1:
            return name
    return ""


def axes_of(ds: xr.Dataset, name: str, naming: Naming) -> Axes:
    """Dimensions of a variable."""
    import metpy.xarray  # noqa: F401  (registers the accessor)

    with quiet():
        parsed = _alone(ds, name).metpy.parse_cf()[name]
        found = {
            axis: getattr(parsed.metpy, axis, None)
            for axis in ("vertical", "time", "y", "x", "latitude", "longitude")
        }
    y, x = _horizontal(ds, parsed, found, naming)
    # levels before members, since only levels may be without any mark
    left = [str(d) for d in parsed.dims if d not in (*y.dims, *x.dims)]
    vertical = _vertical(ds, parsed, found, left, naming)
    levels = [str(d) for d in vertical.dims] if vertical is not None else []
    left = [d for d in left if d not in levels]
    crs = getattr(parsed.coords.get("metpy_crs"), "item", lambda: None)()
    # MetPy assumes a longitude and latitude mapping if a file has none
    mapped = parsed.attrs.get("grid_mapping") in ds.variables
    either = _EITHER if _EITHER in left else ""
    return Axes(
        y,
        x,
        vertical,
        str(y.dims[0]),
        str(x.dims[-1]),
        (*(d for d in left if d != either), *levels),
        next((d for d in left if _is_member(ds, d)), ""),
        either,
        dict(crs.to_dict()) if crs is not None and mapped else None,
    )


def _alone(ds: xr.Dataset, name: str) -> xr.Dataset:
    one = ds.reset_coords(name) if name in ds.coords and name not in ds.dims else ds
    mapping = one[name].attrs.get("grid_mapping", one[name].encoding.get("grid_mapping"))
    if mapping is None:
        return one[[name]]
    written = str(mapping).split(":")[0].strip()  # the extended form names coordinates too
    kept = one[[name, *([written] if written in one.variables else [])]]
    kept[name] = one[name].assign_attrs(grid_mapping=written)
    return kept


def coordinate(ds: xr.Dataset, name: str, key: str) -> xr.DataArray:
    """A coordinate that the configuration names."""
    if name not in ds.variables and name not in ds.dims:
        raise InputError(
            "no such variable",
            field=f"{key}: {name}",
            found="variables " + ", ".join(map(str, ds.variables)),
        )
    return ds[name]


def _horizontal(
    ds: xr.Dataset, parsed: xr.DataArray, found: dict[str, xr.DataArray | None], naming: Naming
) -> tuple[xr.DataArray, xr.DataArray]:
    said = {"y": naming.y or naming.latitude, "x": naming.x or naming.longitude}
    named = {key: coordinate(ds, name, key) for key, name in said.items() if name}
    y, x = (named.get(key, found[key]) for key in ("y", "x"))
    # by axis first: a projected grid has y and x and also latitudes and longitudes of points
    if y is None or x is None or y.ndim != 1 or x.ndim != 1:
        y, x = named.get("y", found["latitude"]), named.get("x", found["longitude"])
    cells = next((str(d) for d in parsed.dims if _CELLS.match(str(d))), "")
    if cells or (y is not None and x is not None and y.ndim == 1 and y.dims == x.dims):
        raise unstructured(cells or str(parsed.dims[-1]))
    last = [d for d in parsed.dims[-2:] if _PROJECTED.match(str(d)) and d in parsed.coords]
    if (y is None or x is None) and len(last) == 2:  # known by name and place alone, y before x
        y, x = (parsed.coords[d] for d in last)
    if y is None or x is None:
        raise InputError(
            "no horizontal coordinates",
            field=str(parsed.name),
            found=f"dimensions {', '.join(map(str, parsed.dims))}",
            remedy="Give latitude: and longitude: (or y: and x:) in the configuration; if there "
            "are several candidates, name one",
        )
    if y.ndim > 2 and y.ndim == x.ndim:  # of a moving grid
        y, x = (one.isel({d: 0 for d in one.dims[:-2]}) for one in (y, x))
    return y, x


def _vertical(
    ds: xr.Dataset,
    parsed: xr.DataArray,
    found: dict[str, xr.DataArray | None],
    left: list[str],
    naming: Naming,
) -> xr.DataArray | None:
    vertical, time = found["vertical"], found["time"]
    if naming.level:
        named = coordinate(ds, naming.level, "level")
        return named if named.ndim == 1 and named.dims[0] in left else None
    if vertical is not None and vertical.ndim == 1 and vertical.dims[0] in left:
        return vertical
    times = set() if time is None else {str(d) for d in time.dims}
    unexplained = [
        d
        for d in left
        if d not in times
        and d != _EITHER
        and not _is_member(ds, d)
        and not is_time_dimension(d, ds[d])
        and parsed.sizes[d] > 1
    ]
    levels = [d for d in unexplained if _LEVEL.match(d)]
    if len(levels) == 1:
        unexplained = levels
    if len(unexplained) > 1:
        raise InputError(
            "several dimensions may hold the levels",
            field=str(parsed.name),
            found=", ".join(unexplained),
            remedy="Name it in the configuration as level: NAME",
        )
    return ds[unexplained[0]] if unexplained else None


def _is_member(ds: xr.Dataset, dim: str) -> bool:
    attrs = ds[dim].attrs if dim in ds.variables else {}
    return attrs.get("standard_name") == "realization" or bool(_MEMBER.match(dim))


def grid_of_axes(ds: xr.Dataset, name: str, axes: Axes, naming: Naming) -> Grid:
    """The grid of a variable, by its projection, its coordinates or its points."""
    with contextlib.suppress(KeyError, UnplaceableGridError):  # by the section of its messages
        known, shape = read_grid(*ds.encoding[GRID]), (ds.sizes[axes.y_dim], ds.sizes[axes.x_dim])
        in_rows = not known.by_column and not known.alternate and (known.nj, known.ni) == shape
        if in_rows and known.frame.kind != "longitude_latitude":
            return known
    units = [naming.units.get(str(c.name), c.attrs.get("units")) for c in (axes.y, axes.x)]
    if axes.y.ndim == 2:
        lat, lon = (
            np.asarray(one.values, dtype=np.float64) * _degrees(unit)
            for one, unit in zip((axes.y, axes.x), units, strict=True)
        )
        mapping = naming.projection or axes.crs or _grib_projection(ds[name])
        laid = None
        if mapping is not None:
            laid = through_points(frame_of(mapping, field="projection"), lat, lon)
        if laid is None and naming.projection is not None:
            raise InputError(
                "points that are no rows and columns of the projection given",
                field="projection",
                found=str(naming.projection),
                remedy="Correct or remove it: the points' latitudes and longitudes are enough",
            )
        # two-dimensional coordinates of a plain grid
        if laid is None and (lat == lat[:, :1]).all() and (lon == lon[:1]).all():
            laid = AxesGrid(LONGITUDE_LATITUDE, lon[0], lat[:, 0])
        return laid or PointsGrid(lat, lon)
    if min(axes.y.size, axes.x.size) < 2:
        found = f"{axes.y.size} x {axes.x.size}"
        raise InputError("a grid of a single row or column", field=name, found=found)
    frame = LONGITUDE_LATITUDE
    if naming.projection is not None:
        frame = frame_of(naming.projection, field="projection")
    elif axes.crs is not None:
        frame = frame_of(axes.crs, field="grid mapping")
    elif _is_projected(axes, units):
        points = _points(ds, axes)
        if points is not None:
            return points
        raise InputError(
            "coordinates of a projection that is not given",
            field="projection",
            found=f"{axes.y.name}, {axes.x.name} of {name}",
            remedy=PROJECTION_REMEDY,
        )
    y, x = (_monotonic(*one, frame) for one in zip((axes.y, axes.x), units, strict=True))
    return AxesGrid(frame, x, y)


def _degrees(unit: object) -> float:
    """Factor to degrees of a latitude or longitude; 1 without a unit of angles."""
    return np.degrees(1.0) if str(unit or "").lower().startswith("rad") else 1.0


def _is_projected(axes: Axes, units: Sequence[object]) -> bool:
    """Coordinates that are lengths, or a rotated frame's, without a grid mapping."""
    return any(factor_of(one, "length") is not None for one in units) or any(
        "projection" in str(one.attrs.get("standard_name", ""))
        or "grid_" in str(one.attrs.get("standard_name", ""))
        or str(one.name).lower().startswith(("projection_", "rlat", "rlon"))
        for one in (axes.y, axes.x)
    )


def _points(ds: xr.Dataset, axes: Axes) -> PointsGrid | None:
    found: dict[str, NDArray[np.float64]] = {}
    for key, one in ds.variables.items():
        if one.dims != (axes.y_dim, axes.x_dim):
            continue
        units = str(one.attrs.get("units", "")).lower().replace("degrees", "degree")
        names = (one.attrs.get("standard_name"), str(key).lower())
        for place, letter in (("latitude", "n"), ("longitude", "e")):
            if place in names or units.replace(" ", "_")[:8] == f"degree_{letter}":
                found[place] = np.asarray(one.values, dtype=np.float64)
    if len(found) < 2:
        return None
    return PointsGrid(found["latitude"], found["longitude"])


def _monotonic(one: xr.DataArray, unit: object, frame: Frame) -> NDArray[np.float64]:
    """Values of an axis in degrees, or metres of a projection."""
    meridional = frame.meridional
    scale = _degrees(unit) if meridional else required_factor(unit, "length", name=str(one.name))
    values = np.asarray(one.values, dtype=np.float64) * scale
    steps = np.diff(np.unwrap(values, period=360.0) if meridional else values)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise InputError(
            "a coordinate that is not monotonic",
            field=str(one.name),
            remedy="Sort the Dataset by it",
        )
    return values


def _grib_projection(variable: xr.DataArray) -> str | None:
    """PROJ string by the GRIB keys that a decoder noted with a variable; None without them.

    On a sphere of any radius: the points settle the scale.
    """

    def of(key: str) -> float:
        return float(variable.attrs.get(f"GRIB_{key}InDegrees", np.nan))

    lad = of("LaD")
    pole, meridian = np.copysign(90.0, lad), of("orientationOfTheGrid")
    text = {
        "lambert": f"lcc +lat_1={of('Latin1')} +lat_2={of('Latin2')} +lat_0={lad} "
        f"+lon_0={of('LoV')}",
        "polar_stereographic": f"stere +lat_0={pole} +lat_ts={lad} +lon_0={meridian}",
        # a meridian east of the first column keeps all columns away from the antimeridian
        "mercator": f"merc +lat_ts={lad} +lon_0={of('longitudeOfFirstGridPoint') + 90.0}",
    }.get(variable.attrs.get("GRIB_gridType", ""), "nan")
    return None if "nan" in text else f"+proj={text} +R={MODEL_EARTH_RADIUS:.0f}"
