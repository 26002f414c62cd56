"""Dimensions, times and grid of a variable, by MetPy's CF parsing and by usual names.

A name in the configuration takes precedence. Dimensions that MetPy (`parse_cf`) does not recognise
are an ensemble (CF `realization`), ECMWF's `expver`, levels, or have one entry. Times are known by
`standard_name`, else by the usual names and by dimensions: a time that does not vary along the
dimension of the leads is a base time, also if the configuration names it as `time`. Of valid time,
base time and lead any two give the third; a valid time without another is an analysis, lead 0. A
lead without units is in hours. Calendars without leap years are taken by their dates.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.config import Naming
from airswing.errors import InputError
from airswing.quantities import COMPACT
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.gridded.datasets import GRID, quiet
from airswing.reference.gridded.naming import factor_of, required_factor
from airswing.reference.grids import (
    LONGITUDE_LATITUDE,
    PROJECTION_REMEDY,
    AxesGrid,
    Frame,
    Grid,
    Ints,
    UnplaceableGridError,
    frame_of,
    grid_of_points,
    through_points,
)
from airswing.reports.columns import JULIAN_DATE_1970
from airswing.units import MODEL_EARTH_RADIUS

_LEAD = re.compile(
    r"(step|lead(_?time)?|prediction_timedelta|forecast_(period|hour|time)|fhr|tau|time_offset)\w*$",
    re.I,
)
_RUN = re.compile(
    r"(reftime|reference_?time|forecast_reference_time|init(ial)?(ization)?_?time|time_run"
    r"|analysis_time|base_?time|run_?time)\w*$",
    re.I,
)
_TIME = re.compile(r"(valid_?|forecast_?|x)?(times?|dates?)$|jd$|julian\w*$", re.I)
_STANDARD = ("forecast_reference_time", "forecast_period", "time")
_JULIAN = 2_415_020.0, 2_488_070.0  # Julian dates of the years 1900 and 2100
MISSING = int(np.iinfo(np.int64).min)  # value of a time that is not known, as numpy's NaT
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


def axes_of(ds: xr.Dataset, name: str, naming: Naming) -> Axes:
    """Dimensions of a variable."""
    import metpy.xarray  # noqa: F401  (registers the accessor)

    alone = ds.reset_coords(name) if name in ds.coords and name not in ds.dims else ds
    mapping = ds[name].attrs.get("grid_mapping", ds[name].encoding.get("grid_mapping"))
    written = str(mapping).split(":")[0].strip()  # the extended form names coordinates too
    mapped = mapping is not None and written in ds.variables
    alone = alone[[name, written] if mapped else [name]]
    if mapping is not None:
        alone[name] = alone[name].assign_attrs(grid_mapping=written)
    with quiet():
        parsed = alone.metpy.parse_cf()[name]
        recognised = {
            axis: getattr(parsed.metpy, axis, None)
            for axis in ("vertical", "time", "y", "x", "latitude", "longitude")
        }
    y, x = _horizontal(ds, parsed, recognised, naming)
    # levels before members, because only levels may lack any attribute
    outer = [str(d) for d in parsed.dims if d not in (*y.dims, *x.dims)]
    vertical = _vertical(ds, parsed, recognised, outer, naming)
    levels = [str(d) for d in vertical.dims] if vertical is not None else []
    outer = [d for d in outer if d not in levels]
    crs = getattr(parsed.coords.get("metpy_crs"), "item", lambda: None)()
    either = _EITHER if _EITHER in outer else ""
    return Axes(
        y,
        x,
        vertical,
        str(y.dims[0]),
        str(x.dims[-1]),
        (*(d for d in outer if d != either), *levels),
        next((d for d in outer if _is_member(ds, d)), ""),
        either,
        # MetPy assumes a longitude and latitude mapping if a file has none
        dict(crs.to_dict()) if crs is not None and mapped else None,
    )


def coordinate(ds: xr.Dataset, name: str, key: str) -> xr.DataArray:
    """A coordinate that the configuration names."""
    if name not in ds.variables and name not in ds.dims:
        seen = "variables " + ", ".join(map(str, ds.variables))
        raise InputError("no such variable", field=f"{key}: {name}", found=seen)
    return ds[name]


def _horizontal(
    ds: xr.Dataset, parsed: xr.DataArray, recognised: dict[str, xr.DataArray | None], naming: Naming
) -> tuple[xr.DataArray, xr.DataArray]:
    asked = {"y": naming.y or naming.latitude, "x": naming.x or naming.longitude}
    named = {key: coordinate(ds, name, key) for key, name in asked.items() if name}
    y, x = (named.get(key, recognised[key]) for key in ("y", "x"))
    # by axis first: a projected grid has y and x in addition to latitudes and longitudes of points
    if y is None or x is None or y.ndim != 1 or x.ndim != 1:
        y, x = named.get("y", recognised["latitude"]), named.get("x", recognised["longitude"])
    cells = next((str(d) for d in parsed.dims if _CELLS.match(str(d))), "")
    if cells or (y is not None and x is not None and y.ndim == 1 and y.dims == x.dims):
        raise InputError(
            "winds on an unstructured grid (one dimension of cells)",
            field=cells or str(parsed.dims[-1]),
            remedy="Interpolate to latitude and longitude first, for instance with cdo remapbil",
        )
    last = [d for d in parsed.dims[-2:] if _PROJECTED.match(str(d)) and d in parsed.coords]
    if (y is None or x is None) and len(last) == 2:  # recognised only by name and order, y before x
        y, x = (parsed.coords[d] for d in last)
    if y is None or x is None:
        raise InputError(
            "no horizontal coordinates",
            field=str(parsed.name),
            found=f"dimensions {', '.join(map(str, parsed.dims))}",
            remedy="Give latitude: and longitude: (or y: and x:) in the configuration; if there "
            "are several candidates, name one",
        )
    if y.ndim > 2 and y.ndim == x.ndim:  # coordinates of a moving grid
        y, x = (axis.isel({d: 0 for d in axis.dims[:-2]}) for axis in (y, x))
    return y, x


def _vertical(
    ds: xr.Dataset,
    parsed: xr.DataArray,
    recognised: dict[str, xr.DataArray | None],
    outer: list[str],
    naming: Naming,
) -> xr.DataArray | None:
    vertical, time = recognised["vertical"], recognised["time"]
    if naming.level:
        named = coordinate(ds, naming.level, "level")
        return named if named.ndim == 1 and named.dims[0] in outer else None
    if vertical is not None and vertical.ndim == 1 and vertical.dims[0] in outer:
        return vertical

    def is_explained(d: str) -> bool:
        of_time = time is not None and d in time.dims
        of_time |= bool(_LEAD.match(d)) or ds[d].dtype.kind == "m"
        of_time |= ds[d].attrs.get("standard_name") in _STANDARD or _stamps(ds[d]) is not None
        return of_time or d == _EITHER or _is_member(ds, d) or parsed.sizes[d] == 1

    unexplained = [d for d in outer if not is_explained(d)]
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
    with contextlib.suppress(KeyError, UnplaceableGridError):  # from its grid section
        grid, shape = read_grid(*ds.encoding[GRID]), (ds.sizes[axes.y_dim], ds.sizes[axes.x_dim])
        in_rows = not grid.by_column and not grid.alternate and (grid.nj, grid.ni) == shape
        if in_rows and grid.frame.kind != "longitude_latitude":
            return grid
    units = [naming.units.get(str(c.name), c.attrs.get("units")) for c in (axes.y, axes.x)]
    if axes.y.ndim == 2:
        lat, lon = (
            np.asarray(axis.values, dtype=np.float64) * (factor_of(unit, "angle") or 1.0)
            for axis, unit in zip((axes.y, axes.x), units, strict=True)
        )
        mapping = naming.projection or axes.crs or _grib_projection(ds[name])
        frame = None if mapping is None else frame_of(mapping, field="projection")
        laid = None if frame is None else through_points(frame, lat, lon)
        if laid is None and naming.projection is not None:
            raise InputError(
                "points that are not rows and columns of the given projection",
                field="projection",
                found=str(naming.projection),
                remedy="Correct or remove it: the points' latitudes and longitudes are enough",
            )
        return laid or grid_of_points(lat, lon)
    if min(axes.y.size, axes.x.size) < 2:
        text = f"{axes.y.size} x {axes.x.size}"
        raise InputError("a grid of a single row or column", field=name, found=text)
    frame = LONGITUDE_LATITUDE
    if naming.projection is not None:
        frame = frame_of(naming.projection, field="projection")
    elif axes.crs is not None:
        frame = frame_of(axes.crs, field="grid mapping")
    elif _is_projected(axes, units):
        if points := _points(ds, axes):
            return grid_of_points(points["latitude"], points["longitude"])
        raise InputError(
            "coordinates of a projection that is not given",
            field="projection",
            found=f"{axes.y.name}, {axes.x.name} of {name}",
            remedy=PROJECTION_REMEDY,
        )
    y, x = (_monotonic(*pair, frame) for pair in zip((axes.y, axes.x), units, strict=True))
    return AxesGrid(frame, x, y)


def _is_projected(axes: Axes, units: Sequence[object]) -> bool:
    """Coordinates that are lengths, or a rotated frame's, without a grid mapping."""
    return any(factor_of(unit, "length") is not None for unit in units) or any(
        re.search("projection|grid_", str(axis.attrs.get("standard_name", "")))
        or str(axis.name).lower().startswith(("projection_", "rlat", "rlon"))
        for axis in (axes.y, axes.x)
    )


def _points(ds: xr.Dataset, axes: Axes) -> dict[str, NDArray[np.float64]]:
    """Latitudes and longitudes of all points; empty without both."""
    places: dict[str, NDArray[np.float64]] = {}
    for key, variable in ds.variables.items():
        if variable.dims != (axes.y_dim, axes.x_dim):
            continue
        units = str(variable.attrs.get("units", "")).lower().replace("degrees", "degree")
        names = (variable.attrs.get("standard_name"), str(key).lower())
        for place, letter in (("latitude", "n"), ("longitude", "e")):
            if place in names or units.replace(" ", "_")[:8] == f"degree_{letter}":
                places[place] = np.asarray(variable.values, dtype=np.float64)
    return places if len(places) == 2 else {}


def _monotonic(axis: xr.DataArray, unit: object, frame: Frame) -> NDArray[np.float64]:
    """Values of an axis in degrees, or metres of a projection."""
    meridional = frame.meridional
    if meridional:
        scale = factor_of(unit, "angle") or 1.0
    else:
        scale = required_factor(unit, "length", name=str(axis.name))
    values = np.asarray(axis.values, dtype=np.float64) * scale
    steps = np.diff(np.unwrap(values, period=360.0) if meridional else values)
    if not ((steps > 0).all() or (steps < 0).all()):
        remedy = "Sort the Dataset by it"
        raise InputError("a coordinate that is not monotonic", field=str(axis.name), remedy=remedy)
    return values


def _grib_projection(variable: xr.DataArray) -> str | None:
    """PROJ string by the GRIB keys that a decoder noted with a variable; None without them.

    For a sphere of any radius; the scale follows from the points.
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


# times


def times_of(ds: xr.Dataset, name: str, outer: dict[str, int], naming: Naming) -> tuple[Ints, Ints]:
    """Valid times (ns since 1970; `MISSING`) and leads (s) of a variable's fields.

    Fields are in the order of `outer`, its dimensions other than level, y and x with their sizes,
    the last varying first.
    """
    near = {str(key): coord for key, coord in ds[name].coords.items()}
    for key, variable in ds.variables.items():
        if variable.attrs.get("standard_name") in _STANDARD or _TIME.match(str(key)):
            near.setdefault(str(key), ds[key])
    near = {key: coord for key, coord in near.items() if set(map(str, coord.dims)) <= set(outer)}
    stamps = {key: times for key, coord in near.items() if (times := _stamps(coord)) is not None}
    leads = [coord for key, coord in near.items() if key not in stamps and _is_lead(key, coord)]
    valid, run, lead = _roles([near[key] for key in stamps], leads, naming, name)
    if valid is None and run is None:
        remedy = "Each field needs a valid time; name its coordinate as time: NAME"
        seen = "coordinates " + (", ".join(map(str, ds[name].coords)) or "none")
        raise InputError("no time axis", field=name, found=seen, remedy=remedy)
    begun, at = (
        None if coord is None else spread(stamps[str(coord.name)], coord.dims, outer)
        for coord in (run, valid)
    )
    after = None if lead is None else spread(_seconds(lead, naming), lead.dims, outer)
    if at is None:
        assert begun is not None
        at = begun if after is None else begun + after * 1_000_000_000
    if after is None:
        after = np.zeros_like(at) if begun is None else (at - begun) // 1_000_000_000
    return at, np.where(at == MISSING, 0, after)


def _stamps(coord: xr.DataArray) -> Ints | None:
    """Times of a coordinate, ns since 1970; None if it holds no times."""
    values = np.asarray(coord.values)
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)
    if str(coord.attrs.get("units", "")).startswith("day as %Y%m%d"):
        digits = np.nan_to_num(values.ravel().astype(np.float64))
        days = pd.to_datetime(digits.astype(int).astype(str), format="%Y%m%d", errors="coerce")
        return _nanoseconds(days + pd.to_timedelta(np.rint(digits % 1 * 86400), unit="s"), values)
    if values.dtype.kind == "O" and values.size and hasattr(values.ravel()[0], "calendar"):
        if values.ravel()[0].calendar == "360_day":
            text, remedy = "times of a calendar of 360 days", "Use winds of real dates"
            raise InputError(text, field=str(coord.name), remedy=remedy)
        dates = [np.datetime64(date.isoformat(), "ns") for date in values.ravel()]
        return np.array(dates).reshape(values.shape).astype(np.int64)
    return _written(coord, values) if _TIME.match(str(coord.name)) and values.size else None


def _nanoseconds(times: pd.DatetimeIndex, values: NDArray[np.generic]) -> Ints:
    return times.to_numpy().astype("datetime64[ns]").astype(np.int64).reshape(values.shape)


def _written(coord: xr.DataArray, values: NDArray[np.generic]) -> Ints | None:
    """Times written as text, as digits (yyyymmdd, yyyymmddHH ...) or as Julian dates, else None."""
    if values.dtype.kind not in "iufSUO":
        return None
    if values.dtype.kind in "iuf":
        numbers = values.astype(np.float64)
        units = f"{coord.attrs.get('units', '')} {coord.attrs.get('long_name', '')}".lower()
        lead = factor_of(coord.attrs.get("units"), "time") is not None and "jul" not in units
        if lead or not np.isfinite(numbers).all():
            return None
        if _JULIAN[0] <= numbers.min() and numbers.max() <= _JULIAN[1]:
            seconds = np.rint((numbers - JULIAN_DATE_1970) * 86400.0)
            return seconds.astype(np.int64) * 1_000_000_000
    texts = [v.decode() if isinstance(v, bytes) else str(v) for v in values.ravel().tolist()]
    texts = [text.strip().removesuffix("Z").removesuffix(".0") for text in texts]
    digits = all(text.isdigit() for text in texts)
    written = COMPACT.get(len(texts[0])) if digits else "ISO8601"
    if written is None or (values.dtype.kind in "iuf" and not digits):
        return None
    texts = [text.replace("_", "T").replace(" ", "T") for text in texts]
    times = pd.to_datetime(texts, format=written, errors="coerce")
    if times.isna().any() or times.year.min() < 1900 or times.year.max() >= 2100:
        return None
    return _nanoseconds(times, values)


def _is_lead(key: str, coord: xr.DataArray) -> bool:
    if coord.attrs.get("standard_name") == "forecast_period" or coord.dtype.kind == "m":
        return True
    units = coord.attrs.get("units")
    has_unit = factor_of(units, "time") is not None or (not units and coord.dtype.kind in "iuf")
    return bool(_LEAD.match(key)) and has_unit


def _roles(
    stamps: Iterable[xr.DataArray], leads: list[xr.DataArray], naming: Naming, name: str
) -> tuple[xr.DataArray | None, xr.DataArray | None, xr.DataArray | None]:
    """Coordinates of the valid time, the base time and the lead."""
    # a lead that varies takes precedence over one that is the same for all
    lead = max(leads, key=lambda coord: coord.ndim > 0, default=None)
    runs, valids = list[xr.DataArray](), list[xr.DataArray]()
    by_name = {str(coord.name): coord for coord in stamps}
    for key, coord in by_name.items():
        named = coord.attrs.get("standard_name")
        of_run = named == "forecast_reference_time" or (named != "time" and bool(_RUN.match(key)))
        if not of_run and key != "valid_time" and lead is not None:
            same_for_all = bool(set(lead.dims) - set(coord.dims))
            of_run = same_for_all and (named != "time" or "valid_time" not in by_name)
        (runs if of_run else valids).append(coord)
    if naming.time:
        if naming.time not in by_name:
            seen = "times " + (", ".join(by_name) or "none")
            raise InputError("no such time", field=f"time: {naming.time}", found=seen)
        named_time = by_name[naming.time]
        if lead is not None and set(lead.dims) - set(named_time.dims):
            return None, named_time, lead
        valids, runs = [named_time], [coord for coord in runs if coord.name != naming.time]
    return _valid_time_of(valids, name), max(runs, key=lambda coord: coord.ndim, default=None), lead


def _valid_time_of(candidates: list[xr.DataArray], name: str) -> xr.DataArray | None:
    most = max((coord.ndim for coord in candidates), default=0)
    for test in (
        lambda coord: coord.attrs.get("standard_name") == "time" or coord.name == "valid_time",
        lambda coord: coord.name in coord.dims,
        lambda coord: coord.ndim == most,
    ):
        candidates = [coord for coord in candidates if test(coord)] or candidates
    if len(candidates) > 1:
        remedy = "Name one in the configuration as time: NAME"
        seen = ", ".join(str(coord.name) for coord in candidates)
        raise InputError("two candidates for the valid time", field=name, found=seen, remedy=remedy)
    return candidates[0] if candidates else None


def _seconds(coord: xr.DataArray, naming: Naming) -> Ints:
    values = np.asarray(coord.values)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[s]").astype(np.int64)
    units = naming.units.get(str(coord.name), coord.attrs.get("units"))
    factor = factor_of(units, "time") or 3600.0
    return np.rint(np.asarray(values, dtype=np.float64) * factor).astype(np.int64)


def spread(values: Ints, dims: Sequence[Hashable], outer: dict[str, int]) -> Ints:
    """Values of a coordinate for every field, in the order of `outer`."""
    fields = xr.DataArray(np.empty(tuple(outer.values()), dtype=np.int8), dims=tuple(outer))
    expanded = xr.DataArray(values, dims=dims).broadcast_like(fields).transpose(*outer)
    return np.asarray(expanded.values).ravel()
