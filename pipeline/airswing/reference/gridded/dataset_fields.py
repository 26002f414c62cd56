"""All a Dataset holds of winds, as rows: one a component, level, time and member.

Assumptions and validity
------------------------
* Fields of one profile share a grid; whether components point along it is settled for all.
* A component of lesser standing (known by its name alone) counts only where there is none that
  its `standard_name` tells; of two of the same standing on levels of the same kind neither is
  chosen: the configuration says which.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.geometry.placing import Placing
from airswing.reference.grib.fields import PRESSURE
from airswing.reference.gridded.cf.axes_grid import AxesGrid, through_points
from airswing.reference.gridded.cf.cf_axes import Axes, axes_of, coordinate, members_of
from airswing.reference.gridded.cf.cf_times import times_of
from airswing.reference.gridded.cf.cf_units import factor_of, required_factor, written_units
from airswing.reference.gridded.cf.curvilinear import CurvilinearGrid
from airswing.reference.gridded.cf.naming import Naming
from airswing.reference.gridded.cf.projection import (
    LONGITUDE_LATITUDE,
    frame_of,
    grib_projection,
    unknown_projection,
)
from airswing.reference.gridded.cf.vertical import Levels, OtherLevelsError, levels_of
from airswing.reference.gridded.cf.wind_names import (
    Component,
    along_grid,
    averaged,
    components,
    speed_only,
)
from airswing.reference.gridded.cfgrib_parts import SKIPPED, known_grid
from airswing.reference.gridded.stored import ROW_DTYPE, SURFACE, StoredField
from airswing.reference.gridded.wrfout import (
    X,
    Y,
    grids_of_wrfout,
    required,
    times_of_wrfout,
)

Table = NDArray[np.void]


class Rows(NamedTuple):
    """Fields of one variable: how they are read, on which grids, and a row of each.

    `table["grid"]` numbers `grids`; `along`: whether its winds point along the grid, None where
    nothing says or it is no wind; `why`: what says so.
    """

    stored: StoredField
    grids: tuple[Placing, ...]
    table: Table
    along: bool | None
    why: str


@dataclass
class Described:
    """What a Dataset holds: rows by variable, and what is not used and why, counted."""

    rows: list[Rows] = field(default_factory=list)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)


def describe_dataset(ds: xr.Dataset, naming: Naming, file: str) -> Described:
    """Find the wind fields of a CF Dataset, and what gives their pressure.

    Raises
    ------
    InputError
        Where something needed is missing or ambiguous, naming the file.
    """
    # what cfgrib could not place was counted when the parts were opened
    found = Described(skipped=Counter(ds.encoding.get(SKIPPED, {})))
    chosen: dict[tuple[int, bool], tuple[int, str]] = {}
    native: list[str] = []
    for one in components(ds, naming):
        why = averaged(ds[one.name])
        if why:
            found.skipped["wind", f"{one.name} is no wind at a time ({why})"] += 1
            continue
        try:
            axes, levels = _profile(ds, one, naming, file)
        except OtherLevelsError as reason:
            found.skipped["wind", f"{one.name} on {reason}"] += 1
            continue
        key = one.number, levels.native
        if key in chosen and _less(one, chosen[key], file):
            continue
        chosen[key] = one.tier, one.name
        found.rows.append(_rows(ds, one.name, one.number, axes, levels, naming, file))
        if levels.native:
            native.append(one.name)
            found.rows += _pressure_of(ds, levels, naming, file)
    # after the winds: only those on native levels ask for a pressure of their own
    found.rows += _pressures(ds, native, naming, file)
    speed = speed_only(ds)
    # beside components it is a further variable and nothing is missing
    if not chosen and speed:
        raise InputError(
            "a wind speed without components",
            file=file,
            field=speed,
            remedy="Winds are needed as u and v",
        )
    return found


def _less(one: Component, other: tuple[int, str], file: str) -> bool:
    """Whether a component stands behind the one that is chosen; two of a kind are refused."""
    tier, name = other
    if one.tier > tier:
        return True
    raise InputError(
        f"two candidates for {'uv'[one.number]}",
        file=file,
        found=f"{name}, {one.name}",
        remedy=f"Say which in the configuration as {'uv'[one.number]}: NAME",
    )


def _profile(ds: xr.Dataset, one: Component, naming: Naming, file: str) -> tuple[Axes, Levels]:
    """Axes and levels of a component; `OtherLevelsError` where it is no profile."""
    axes = axes_of(ds, one.name, naming, file)
    level = axes.vertical
    if level is None:
        level = _scalar_level(ds, one.name, naming)
        if level is None:
            raise OtherLevelsError("no vertical axis")
    return axes, levels_of(ds, one.name, level, naming, file)


def _scalar_level(ds: xr.Dataset, name: str, naming: Naming) -> xr.DataArray | None:
    """A level that the variable's only level says of itself, as a coordinate of one entry."""
    if naming.level:
        named: xr.DataArray = ds[naming.level]
        return named.expand_dims(naming.level) if named.ndim == 0 else named
    for key, one in ds[name].coords.items():
        if one.size == 1 and factor_of(one.attrs.get("units"), "pressure") is not None:
            found: xr.DataArray = one if one.ndim else one.expand_dims(str(key))
            return found
    return None


def _rows(
    ds: xr.Dataset,
    name: str,
    kind: int,
    axes: Axes,
    levels: Levels | None,
    naming: Naming,
    file: str,
) -> Rows:
    """Rows of one variable; `levels` None for a surface."""
    outer = {d: int(ds.sizes[d]) for d in axes.outer}
    valid, lead = times_of(ds, name, outer, naming, file)
    member = np.zeros(valid.size, dtype=np.int64)
    if axes.member:
        numbers = members_of(ds, axes.member, outer[axes.member])
        shape = [outer[d] if d == axes.member else 1 for d in outer]
        # rows stand in the order in which the outer dimensions are stored
        member = np.broadcast_to(numbers.reshape(shape), tuple(outer.values())).ravel()
    wind = kind < PRESSURE
    written = naming.units.get(name, written_units(ds[name].attrs))
    # surface pressure without a unit of pressure is its logarithm, as spectral models write it
    exponential = kind == SURFACE and factor_of(written, "pressure") is None
    scale = 1.0
    if not exponential:
        kind_of_unit = "wind" if wind else "pressure"
        scale = required_factor(written, kind_of_unit, file=file, name=name)
    stored = _stored(ds[name], axes, outer, scale=scale, exponential=exponential)
    along, why = along_grid(ds[name], naming) if wind else (None, "")
    table = _table(kind, levels, valid, lead, member)
    return Rows(stored, (_grid(ds, name, axes, naming, file),), table, along, why)


def _table(
    kind: int,
    levels: Levels | None,
    valid: NDArray[np.int64],
    lead: NDArray[np.int64],
    member: NDArray[np.int64],
) -> Table:
    """A row a field and level; fields without a time are left out."""
    count = 1 if levels is None else levels.values.size
    # the least integer is what not-a-time becomes
    known = np.flatnonzero(valid != np.iinfo(np.int64).min)
    table = np.zeros((known.size, count), dtype=ROW_DTYPE)
    columns = {"valid": valid, "lead": lead, "member": member, "index": np.arange(valid.size)}
    for column, values in columns.items():
        table[column] = values[known, None]
    # a surface's own pressure is b = 1 of itself: rows of levels write over it
    table["kind"], table["level_kind"], table["b"] = kind, HYBRID, 1.0
    if levels is not None:
        table["level"], table["level_index"] = levels.values, np.arange(count)
        table["level_kind"] = HYBRID if levels.native else ISOBARIC
        if kind < PRESSURE:
            table["a"], table["b"] = levels.a, levels.b
    return table.ravel()


def _stored(
    one: xr.DataArray, axes: Axes, outer: dict[str, int], *, scale: float, exponential: bool
) -> StoredField:
    return StoredField(
        names=(str(one.name),),
        dims=tuple(map(str, one.dims)),
        outer=tuple(outer.items()),
        level=axes.level_dim,
        y=axes.y_dim,
        x=axes.x_dim,
        shape=tuple(one.shape),
        chunks=_chunks_of(one, (axes.y_dim, axes.x_dim)),
        scale=scale,
        exponential=exponential,
        either=axes.either,
    )


def _chunks_of(one: xr.DataArray, plane: tuple[str, str]) -> tuple[int | tuple[int, ...], ...]:
    """Chunk lengths of a variable, as `StoredField.chunks`.

    Fields stored in one piece are read level by level of their plane of rows and columns.
    """
    if one.chunks is not None:
        starts = [np.concatenate([[0], np.cumsum(lengths)]) for lengths in one.chunks]
        return tuple(tuple(int(n) for n in ends) for ends in starts)
    # netCDF files have the first, Zarr the second
    written = one.encoding.get("chunksizes") or one.encoding.get("preferred_chunks")
    if isinstance(written, dict):
        written = [written.get(d) for d in one.dims]
    if (
        written
        and len(written) == one.ndim
        and all(isinstance(n, int | np.integer) for n in written)
    ):
        return tuple(min(int(n), size) or 1 for n, size in zip(written, one.shape, strict=True))
    return tuple(size if d in plane else 1 for d, size in zip(one.dims, one.shape, strict=True))


def _grid(ds: xr.Dataset, name: str, axes: Axes, naming: Naming, file: str) -> Placing:
    """The grid of a variable, by its projection, its coordinates or its points."""
    known = known_grid(ds)
    if known is not None and (known.nj, known.ni) == (ds.sizes[axes.y_dim], ds.sizes[axes.x_dim]):
        return known
    if axes.y.ndim == 2:
        lat, lon = (np.asarray(one.values, dtype=np.float64) for one in (axes.y, axes.x))
        mapping = naming.projection or axes.crs or grib_projection(ds[name])
        laid = None
        if mapping is not None:
            laid = through_points(frame_of(mapping, file=file, field="projection"), lat, lon)
        # two-dimensional coordinates of a plain grid: placed by two rows, not by search
        if laid is None and (lat == lat[:, :1]).all() and (lon == lon[:1]).all():
            laid = AxesGrid(LONGITUDE_LATITUDE, lon[0], lat[:, 0])
        return laid or CurvilinearGrid(lat, lon)
    if min(axes.y.size, axes.x.size) < 2:
        raise InputError(
            "a grid of a single row or column",
            file=file,
            field=name,
            found=f"{axes.y.size} x {axes.x.size}",
        )
    factors = [factor_of(_units(one, naming), "length") for one in (axes.y, axes.x)]
    frame = LONGITUDE_LATITUDE
    if naming.projection is not None:
        frame = frame_of(naming.projection, file=file, field="projection")
    elif axes.crs is not None:
        frame = frame_of(axes.crs, file=file, field="grid mapping")
    elif _projected(axes, factors):
        places = _points(ds, name, axes)
        if places is not None:
            return places
        raise unknown_projection(file, f"{axes.y.name}, {axes.x.name} of {name}")
    scales = [1.0, 1.0]
    if frame.kind == "projected":
        scales = [
            required_factor(_units(one, naming), "length", file=file, name=str(one.name))
            for one in (axes.y, axes.x)
        ]
    y, x = (
        _monotonic(one, scale, frame.meridional, file)
        for one, scale in zip((axes.y, axes.x), scales, strict=True)
    )
    return AxesGrid(frame, x, y)


def _units(one: xr.DataArray, naming: Naming) -> str | None:
    return naming.units.get(str(one.name), one.attrs.get("units"))


def _projected(axes: Axes, factors: list[float | None]) -> bool:
    """Coordinates that are lengths, or a rotated frame's, without a grid mapping."""
    named = [str(one.attrs.get("standard_name", "")) for one in (axes.y, axes.x)]
    if any(factor is not None for factor in factors):
        return True
    return any("projection" in name or "grid_" in name for name in named) or any(
        str(one.name).lower().startswith(("projection_", "rlat", "rlon"))
        for one in (axes.y, axes.x)
    )


def _points(ds: xr.Dataset, name: str, axes: Axes) -> CurvilinearGrid | None:
    """The grid of latitudes and longitudes of every point beside projected coordinates."""
    dims = (axes.y_dim, axes.x_dim)
    found: dict[str, np.ndarray] = {}
    for key, one in ds.variables.items():
        standard, units = one.attrs.get("standard_name"), str(one.attrs.get("units", ""))
        for place in ("latitude", "longitude"):
            letter = {"latitude": "n", "longitude": "e"}[place]
            if one.dims == dims and (
                standard == place or _compass_letter(units) == letter or str(key).lower() == place
            ):
                found[place] = np.asarray(one.values, dtype=np.float64)
    if len(found) < 2:
        return None
    return CurvilinearGrid(found["latitude"], found["longitude"])


def _compass_letter(units: str) -> str:
    """``n`` or ``e`` of ``degrees_north`` or ``degrees_east``, else empty."""
    words = units.lower().replace("degrees", "degree").replace(" ", "_")
    return {"degree_north": "n", "degree_n": "n", "degree_east": "e", "degree_e": "e"}.get(
        words, ""
    )


def _monotonic(one: xr.DataArray, scale: float, meridional: bool, file: str) -> NDArray[np.float64]:
    values = np.asarray(one.values, dtype=np.float64) * scale
    steps = np.diff(np.unwrap(values, period=360.0) if meridional else values)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise InputError(
            "a coordinate that goes back and forth",
            file=file,
            field=str(one.name),
            remedy="Sort the Dataset by it",
        )
    return values


def _pressure_of(ds: xr.Dataset, levels: Levels, naming: Naming, file: str) -> list[Rows]:
    """The surface pressure that a formula of hybrid levels names."""
    name = naming.surface_pressure or levels.surface
    if not name or np.isnan(levels.b).all():
        return []
    if name not in ds.variables:
        coordinate(ds, name, "surface_pressure", file)
    return [_rows(ds, name, SURFACE, axes_of(ds, name, naming, file), None, naming, file)]


def _pressures(ds: xr.Dataset, native: list[str], naming: Naming, file: str) -> list[Rows]:
    """Pressure variables on native levels, and what a GRIB decoder calls surface pressure."""
    found = []
    for key in ds.data_vars:
        one, name = ds[key], str(key)
        if name == naming.pressure or _is_pressure(one, [ds[n] for n in native]):
            axes = axes_of(ds, name, naming, file)
            if axes.vertical is not None:
                levels = levels_of(ds, name, axes.vertical, naming, file)
                found.append(_rows(ds, name, PRESSURE, axes, levels, naming, file))
        elif one.attrs.get("GRIB_shortName") in ("sp", "lnsp"):
            axes = axes_of(ds, name, naming, file)
            found.append(_rows(ds, name, SURFACE, axes, None, naming, file))
    return found


def _is_pressure(one: xr.DataArray, winds: list[xr.DataArray]) -> bool:
    if one.attrs.get("GRIB_shortName") == "pres":
        return True
    return one.attrs.get("standard_name") == "air_pressure" and any(
        wind.dims == one.dims for wind in winds
    )


def describe_wrfout(ds: xr.Dataset, file: str) -> Described:
    """Winds and pressure of a wrfout.

    Raises
    ------
    InputError
        Without winds on the staggered grid, pressure or times.
    """
    required(ds, file)
    valid, lead = times_of_wrfout(ds, file)
    grids = grids_of_wrfout(ds, valid.size)
    numbers = {id(one): n for n, one in enumerate(dict.fromkeys(grids))}
    distinct = tuple(dict.fromkeys(grids))
    count = int(ds.sizes["bottom_top"])
    unknown = np.full(count, np.nan)
    levels = Levels(np.arange(count, dtype=np.float64), True, unknown, unknown)
    found = Described()
    for kind, names, stagger in ((0, ("U",), "x"), (1, ("V",), "y"), (PRESSURE, ("P", "PB"), "")):
        one = ds[names[0]]
        y, x = Y + "_stag" * (stagger == "y"), X + "_stag" * (stagger == "x")
        outer = tuple((str(d), int(ds.sizes[d])) for d in one.dims[:-3])
        stored = StoredField(
            names=names,
            dims=tuple(map(str, one.dims)),
            outer=outer,
            level="bottom_top",
            y=y,
            x=x,
            shape=tuple(one.shape),
            chunks=_chunks_of(one, (y, x)),
            stagger=stagger,
        )
        table = _table(kind, levels, valid, lead, np.zeros_like(valid))
        table["grid"] = np.array([numbers[id(one)] for one in grids])[table["index"]]
        found.rows.append(Rows(stored, distinct, table, True, "WRF's grid"))
    return found
