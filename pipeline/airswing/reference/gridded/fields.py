"""All winds of Datasets as rows of a catalogue: one a component, level, time and member.

Components known equally well on levels of one kind are refused: the configuration must name one.
The pressure of native levels is a variable on them, or ``a + b ps`` by the CF formula terms of
hybrid (``ap, b, ps``; ``a, p0, b, ps``) and sigma levels (``a = (1 - sigma) ptop``), or by the half
levels of a GRIB's pv section, of which a full level has the mean (Simmons and Burridge 1981). The
surface pressure is that of the same time, lead, member and grid.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.config import Naming
from airswing.errors import InputError
from airswing.reference.files import Skipped, skip
from airswing.reference.gridded.axes import (
    MISSING,
    Axes,
    axes_of,
    coordinate,
    grid_of_axes,
    spread,
    times_of,
)
from airswing.reference.gridded.datasets import NOTES, SKIPPED
from airswing.reference.gridded.naming import (
    Component,
    along_grid,
    components,
    factor_of,
    required_factor,
    written_units,
)
from airswing.reference.gridded.wrf import X, Y, grids_of_wrf, is_wrf, layout_of, times_of_wrf
from airswing.reference.grids import Floats, Grid
from airswing.reference.state import variable_statistic
from airswing.reference.winds import (
    HYBRID,
    ISOBARIC,
    PRESSURE,
    ROW_DTYPE,
    SURFACE,
    StoredField,
    Table,
    on_one_grid,
)

# exceptions for attributes and coordinates of an unexpected kind, here and in libraries
_FAULTS = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
_NATIVE = ("hybrid", "sigma", "eta", "model_level", "generalvertical", "theta_level")
# a pressure that is not that of the level, such as that above the ground
_RELATIVE = re.compile(r"difference|above|from ?ground|potential ?vorticity|tropopause", re.I)
_NO_UNITS = ("", "1", "level", "levels", "layer", "dimensionless")
_LIKE_PRESSURE = ("lev", "plev", "pres", "isobar")
_LOWEST_PRESSURE = 5_000.0  # Pa: the lowest level of any model that aircraft can be compared with


class Levels(NamedTuple):
    """Levels of a variable."""

    values: Floats  # Pa if isobaric, else numbers in the order of the file
    native: bool
    a: Floats | float = np.nan  # Pa; coefficients by level, NaN if pressure is a variable
    b: Floats | float = np.nan
    surface: str = ""  # the surface pressure in the formula, empty if it is not named
    note: str = ""  # assumptions made
    first: int = 0  # first level used


class OtherLevelsError(Exception):
    """Levels without a pressure; the text describes them."""


class Gathering:
    """Rows of all files of a reference, with grids and stored fields numbered over them."""

    def __init__(self, naming: Naming, skipped: Skipped) -> None:
        self.naming, self.skipped = naming, skipped
        self.stored: dict[StoredField, int] = {}
        self._grids: dict[Grid, int] = {}
        # rows of a variable of a file, whether its winds point along the grid, and the evidence
        self._rows: list[tuple[Table, bool | None, str]] = []
        self._along: dict[int, dict[bool | None, str]] = {}  # by the number of a grid
        self._notes: dict[str, None] = {}
        self._variables: set[str] = set()
        self._first = self._path = ""
        self._file = self._subindex = 0

    def add(self, number: int, parts: Sequence[xr.Dataset], path: str) -> None:
        """Add the rows of one file, or none of them if it is refused."""
        self._path, self._file, self._first = path, number, self._first or path
        rows, skipped = len(self._rows), len(self.skipped)
        try:
            for self._subindex, ds in enumerate(parts):
                self._notes |= dict.fromkeys(ds.encoding.get(NOTES, ()))
                self._variables |= {str(name) for name in (*ds.variables, *ds.dims)}
                if is_wrf(ds) and not (self.naming.u or self.naming.v):
                    self._add_wrf(ds)
                else:
                    self._add_dataset(ds)
        except (InputError, *_FAULTS) as error:
            del self._rows[rows:], self.skipped[skipped:]
            if isinstance(error, InputError):
                raise error.located(file=path) from error
            raise InputError(
                "cannot be understood",
                file=path,
                found=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                remedy="Its attributes or coordinates contradict each other; their meaning can "
                "be given under the reference",
            ) from error

    def table(self) -> Table:
        """All rows, with a pressure for each native level that has a formula."""
        for key, name in self.naming.named():
            if name not in self._variables:
                raise InputError(
                    "no such variable",
                    file=self._first,
                    field=f"{key}: {name}",
                    found="variables " + ", ".join(sorted(self._variables)),
                )
        for rows, along, why in self._rows:
            for number in np.unique(rows["grid"][rows["kind"] < PRESSURE]).tolist():
                self._along.setdefault(number, {})[along] = why
        tables = [np.empty(0, dtype=ROW_DTYPE), *(rows for rows, _, _ in self._rows)]
        table = on_one_grid(np.concatenate(tables), list(self._grids))
        native = bool((table["level_kind"] != ISOBARIC).any())
        for key in ("pressure", "surface_pressure"):
            if getattr(self.naming, key) and table.size and not native:
                raise InputError(
                    "this key applies to native levels; these have one pressure each",
                    file=self._first,
                    field=f"{key}: {getattr(self.naming, key)}",
                    remedy="Remove it",
                )
        return _with_formula_pressures(table)

    def grids(self) -> tuple[Grid, ...]:
        """Grids, with the direction of the winds on them."""
        return tuple(
            grid.directed(not grid.north_up and self._is_along(number))
            for grid, number in self._grids.items()
        )

    def _is_along(self, number: int) -> bool:
        directions = {along for along in self._along.get(number, {}) if along is not None}
        if len(directions) > 1:
            raise InputError(
                "one component points along the grid, the other to true east or north",
                file=self._first,
                found="; ".join(self._along[number].values()),
                remedy="Give winds: grid or winds: earth",
            )
        return directions.pop() if directions else True  # models write components along their grids

    def notes(self, used: NDArray[np.int64]) -> list[str]:
        """Direction of the winds on each grid that is used, and the evidence."""
        notes = dict(self._notes)
        for grid, number in self._grids.items():
            if grid.north_up or number not in used:
                continue
            evidence = self._along.get(number, {})
            why = ", ".join(dict.fromkeys(w for along, w in evidence.items() if along is not None))
            way = "along the grid" if self._is_along(number) else "to true east and north"
            note = (
                "direction of the winds not given: taken as along the grid, as models write "
                "them; give winds: earth if they point to true east and north"
            )
            notes[f"winds point {way} ({why})" if why else note] = None
        return list(notes)

    def _skip(self, kind: str, reason: str, count: int = 1) -> None:
        self.skipped.append(skip(self._path, kind, reason, count))

    def _add_dataset(self, ds: xr.Dataset) -> None:
        """Wind fields of a CF Dataset, and the variables of their pressure."""
        naming = self.naming
        for (kind, reason), count in ds.encoding.get(SKIPPED, {}).items():
            self._skip(kind, reason, count)
        accepted: dict[tuple[int, bool], Component] = {}
        native: list[str] = []
        for component in components(ds, naming):
            variable = ds[component.name]
            coords = [(str(key), coord.attrs) for key, coord in variable.coords.items()]
            coords += [(str(dim), {}) for dim in variable.dims if dim not in variable.coords]
            why = variable_statistic(component.name, variable.attrs, coords, ds.attrs)
            if why:
                self._skip("wind", f"{component.name} is not an atmospheric state ({why})")
                continue
            try:
                axes = axes_of(ds, component.name, naming)
                levels = _levels_of(ds, component.name, axes.vertical, naming)
            except OtherLevelsError as reason:
                self._skip("wind", f"{component.name} on {reason}")
                continue
            previous = accepted.setdefault((component.number, levels.native), component)
            if component.tier > previous.tier:
                continue
            if previous is not component:
                raise InputError(
                    f"two candidates for {'uv'[component.number]}",
                    found=f"{previous.name}, {component.name}",
                    remedy=f"Name one in the configuration as {'uv'[component.number]}: NAME",
                )
            if levels.note:
                self._notes[levels.note] = None
            self._add_variable(ds, component.name, component.number, axes, levels)
            if levels.native:
                native.append(component.name)
                surface = naming.surface_pressure or levels.surface
                if surface and not np.isnan(levels.b).all():
                    coordinate(ds, surface, "surface_pressure")
                    self._add_variable(ds, surface, SURFACE, axes_of(ds, surface, naming), None)
        for key in ds.data_vars:
            pressure, name = ds[key], str(key)
            short, dims = pressure.attrs.get("GRIB_shortName"), set(pressure.dims)
            same = any(set(ds[n].dims) == dims or ds[n].ndim == pressure.ndim for n in native)
            named = pressure.attrs.get("standard_name") == "air_pressure" and same
            if name == naming.pressure or short == "pres" or named:
                axes = axes_of(ds, name, naming)
                if axes.vertical is not None:
                    levels = _levels_of(ds, name, axes.vertical, naming)
                    self._add_variable(ds, name, PRESSURE, axes, levels)
            elif short in ("sp", "lnsp"):
                self._add_variable(ds, name, SURFACE, axes_of(ds, name, naming), None)

    def _add_variable(
        self, ds: xr.Dataset, name: str, kind: int, axes: Axes, levels: Levels | None
    ) -> None:
        """Rows of one variable; `levels` is None for a surface."""
        naming, levels_at = self.naming, () if axes.vertical is None else axes.vertical.dims
        outer = {d: int(ds.sizes[d]) for d in axes.outer if d not in levels_at}
        valid, lead = times_of(ds, name, outer, naming)
        member = np.zeros(valid.size, dtype=np.int64)
        if axes.member:  # numbers as written, else (no coordinate, or no number) counted from 0
            numbers = ds[axes.member].values
            numbers = numbers if numbers.dtype.kind in "iuf" else np.arange(numbers.size)
            member = spread(numbers.astype(np.int64), [axes.member], outer)
        wind = kind < PRESSURE
        written = naming.units.get(name, written_units(ds[name].attrs))
        # surface pressure without a unit of pressure is its logarithm, as spectral models write it
        exponential = kind == SURFACE and factor_of(written, "pressure") is None
        unit = "wind" if wind else "pressure"
        stored = _stored(
            ds[name],
            (name,),
            axes.outer,
            (axes.y_dim, axes.x_dim),
            scale=1.0 if exponential else required_factor(written, unit, name=name),
            exponential=exponential,
            either=axes.either,
        )
        along, why = along_grid(ds[name], naming) if wind else (None, "")
        grids = [grid_of_axes(ds, name, axes, naming)]
        self._add_rows(stored, kind, levels, (valid, lead, member), grids, along, why)

    def _add_wrf(self, ds: xr.Dataset) -> None:
        naming = self.naming
        odd = [key for key in naming.stated() if key not in ("winds", "time")]
        if odd:
            raise InputError(
                "this key does not apply to files of WRF, which describe themselves",
                field=odd[0],
                remedy="Remove it, or give u: and v: too to have the file read as any other NetCDF",
            )
        layout = layout_of(ds)
        valid, lead = times_of_wrf(ds, naming.time)
        grids = grids_of_wrf(ds, valid.size)
        levels = Levels(layout.levels, bool(layout.pressure), first=layout.first)
        kinds = {0: layout.winds[:1], 1: layout.winds[1:], PRESSURE: layout.pressure}
        why = "the configuration" if naming.winds else "WRF's grid"
        for kind, names in kinds.items():
            if not names:
                continue
            variable = ds[names[0]]
            *outer, y, x = map(str, variable.dims)
            stored = _stored(
                variable,
                names,
                outer,
                (y, x),
                scale=layout.scale if kind == PRESSURE else 1.0,
                stagger="x" if x != X else "y" if y != Y else "",
            )
            times = valid, lead, np.zeros_like(valid)
            self._add_rows(stored, kind, levels, times, grids, naming.winds != "earth", why)

    def _add_rows(
        self,
        stored: StoredField,
        kind: int,
        levels: Levels | None,
        times: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
        grids: Sequence[Grid],
        along: bool | None,
        why: str,
    ) -> None:
        """A row a field and level, without fields that have no time.

        `times` are valid times, leads and members by field, `grids` one or one a field.
        """
        count = 1 if levels is None else levels.values.size
        table = np.zeros((times[0].size, count), dtype=ROW_DTYPE)
        for name, values in zip(("valid", "lead", "member"), times, strict=True):
            table[name] = values[:, None]
        numbers = [self._grids.setdefault(grid, len(self._grids)) for grid in grids]
        table["grid"] = np.array(numbers)[:, None]
        # of a surface given on levels the first
        step = math.prod(size for _, size in stored.outer) // max(table.size, 1)
        table["index"] = np.arange(table.size).reshape(table.shape) * step
        table["file"], table["subindex"], table["kind"] = self._file, self._subindex, kind
        table["offset"] = self.stored.setdefault(stored, len(self.stored))
        table["level_kind"], table["b"] = HYBRID, 1.0
        if levels is not None:
            table["level"] = levels.values
            table["level_kind"] = HYBRID if levels.native else ISOBARIC
            if kind < PRESSURE:
                table["a"], table["b"] = levels.a, levels.b
            table = table[:, levels.first :]
        self._rows.append((table[times[0] != MISSING].ravel(), along, why))


def _stored(
    variable: xr.DataArray,
    names: tuple[str, ...],
    outer: Sequence[str],
    plane: tuple[str, str],
    **options: Any,
) -> StoredField:
    """How a variable is read: its dimensions, and the length of chunks along the outer ones."""
    # netCDF files have the first, Zarr the second; a field in one piece is read by levels
    written = variable.encoding.get("chunksizes") or variable.encoding.get("preferred_chunks") or {}
    if variable.chunks is not None:
        written = [max(sizes, default=1) for sizes in variable.chunks]
    if not isinstance(written, dict):
        written = dict(zip(variable.dims, written, strict=False))
    return StoredField(
        names=names,
        dims=tuple(map(str, variable.dims)),
        outer=tuple((d, int(variable.sizes[d])) for d in outer),
        y=plane[0],
        x=plane[1],
        shape=tuple(variable.shape),
        chunks=tuple(int(written.get(d) or 1) for d in outer),
        **options,
    )


def _with_formula_pressures(table: Table) -> Table:
    """Replace surface pressures by a pressure of every native level: ``a + b ps``.

    Rows of u have `a` and `b` of their level.
    """
    surface = table[table["kind"] == SURFACE]
    rest: Table = table[table["kind"] != SURFACE]
    levels = rest[(rest["kind"] == 0) & (rest["level_kind"] == HYBRID) & np.isfinite(rest["b"])]
    rest["a"][rest["kind"] < PRESSURE], rest["b"][rest["kind"] < PRESSURE] = 0.0, 1.0
    if not levels.size or not surface.size:
        return rest
    names = ["valid", "lead", "member", "grid"]
    # the first of several stored fields of one time is used
    surface = surface[np.argsort(surface["offset"], kind="stable")]
    first = pd.DataFrame(surface[names]).assign(row=np.arange(surface.size)).drop_duplicates(names)
    row = pd.DataFrame(levels[names]).merge(first, "left", names)["row"]
    levels, pressures = levels[row.notna()], surface[row.dropna().astype(int)]
    for column in ("level", "level_kind", "a", "b"):
        pressures[column] = levels[column]
    pressures["kind"] = PRESSURE
    # levels that have a pressure field keep it
    existing, keys = (
        pd.MultiIndex.from_frame(pd.DataFrame(rows[[*names, "level"]]))
        for rows in (rest[rest["kind"] == PRESSURE], pressures)
    )
    return np.concatenate([rest, pressures[~keys.isin(existing)]])


def _levels_of(ds: xr.Dataset, name: str, level: xr.DataArray | None, naming: Naming) -> Levels:
    if level is None:  # a scalar coordinate
        single = {
            str(key)
            for key, coord in ds[name].coords.items()
            if coord.size == 1 and factor_of(coord.attrs.get("units"), "pressure") is not None
        }
        only = naming.level or min(single, default=None)
        if only is None:
            raise OtherLevelsError("no vertical axis")
        level = ds[only] if ds[only].ndim else ds[only].expand_dims(only)
    words = str(level.attrs.get("formula_terms", level.encoding.get("formula_terms", ""))).split()
    terms = {key.rstrip(":"): value for key, value in zip(words[::2], words[1::2], strict=False)}
    kind, key = str(level.attrs.get("standard_name", "")), str(level.name)
    units = naming.units.get(key, level.attrs.get("units"))
    try:
        values = np.asarray(level.values, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.arange(level.size, dtype=np.float64)
    if kind == "atmosphere_ln_pressure_coordinate":
        return _isobaric(_term(ds, terms, "p0", "pressure") * np.exp(-values), key)
    formula = _formula(ds, kind, terms, level)
    if formula is not None:
        numbers = np.arange(level.size, dtype=np.float64)
        return Levels(numbers, True, *formula, surface=terms.get("ps", ""))
    native = any(word in kind or word in key.lower() for word in _NATIVE)
    described = f"{key} {level.attrs.get('long_name', '')}".replace("_", " ")
    if not native and not _RELATIVE.search(described):
        factor, note = factor_of(units, "pressure"), ""
        if factor is None and str(units or "").strip() in _NO_UNITS and naming.pressure is None:
            factor = _factor_by_values(key, values)
            unit = "hPa" if factor == 100.0 else "Pa"
            note = f"{key} has no units: taken as {unit} from its values"
        if factor is not None:
            return _isobaric(values * factor, key)._replace(note=note)
    pv = ds[name].attrs.get("GRIB_pv", ())
    if np.size(pv) > 2:  # coefficients of half levels, the topmost first
        half, k = np.asarray(pv, dtype=np.float64).reshape(2, -1), values.astype(np.int64)
        if k.size and (k.min() < 1 or k.max() >= half.shape[1]):
            last = half.shape[1] - 1
            raise OtherLevelsError(f"hybrid level {k.max()} of {last} in the pv section")
        return Levels(values, True, *((half[:, k - 1] + half[:, k]) / 2.0))
    pressure_given = any(
        variable.attrs.get("standard_name") == "air_pressure"
        and variable.dims == ds[name].dims
        and factor_of(variable.attrs.get("units"), "pressure")
        for variable in ds.variables.values()
    )
    if native or naming.pressure or pressure_given:
        return Levels(np.arange(level.size, dtype=np.float64), True)
    if not units and any(word in key.lower() for word in _LIKE_PRESSURE):
        required_factor(units, "pressure", name=key)
    raise OtherLevelsError(f"levels of another kind ({key}{f', {units}' if units else ''})")


def _isobaric(values: Floats, key: str) -> Levels:
    if values.size > 1 and float(np.nanmax(values)) < _LOWEST_PRESSURE:
        raise InputError(
            f"pressure levels end at {float(np.nanmax(values)) / 100:g} hPa, above all aircraft",
            field=key,
            remedy=f"Check their unit; if they are in hPa give units: {{{key}: hPa}}",
        )
    return Levels(values, False)


def _factor_by_values(key: str, values: Floats) -> float | None:
    """Factor to Pa of levels without units, by name and values; None if they may be others."""
    if not any(word in key.lower() for word in _LIKE_PRESSURE) or values.size < 2:
        return None
    low, high = float(values.min()), float(values.max())
    numbers = np.array_equal(np.sort(values), np.arange(low, low + values.size))
    possible = (factor for factor in (100.0, 1.0) if 20_000.0 <= high * factor <= 110_000.0)
    return next(possible, None) if low > 0.0 and not numbers else None


def _formula(
    ds: xr.Dataset, kind: str, terms: dict[str, str], level: xr.DataArray
) -> tuple[Floats, Floats] | None:
    """Coefficients a (Pa) and b of each level; None without a formula of surface pressure."""
    if kind == "atmosphere_sigma_coordinate" or {"sigma", "ptop"} <= set(terms):
        top = _term(ds, terms, "ptop", "pressure")
        sigma = np.asarray(level.values, dtype=np.float64)
        if terms.get("sigma") in ds.variables:
            sigma = _term(ds, terms, "sigma", None)
        return (1.0 - sigma) * top, sigma  # p = ptop + sigma (ps - ptop)
    if "b" not in terms or not {"a", "ap"} & set(terms):
        return None
    b = _term(ds, terms, "b", None)
    if "ap" in terms:
        a = _term(ds, terms, "ap", "pressure")
    else:
        a = _term(ds, terms, "a", None) * _term(ds, terms, "p0", "pressure")
    if a.shape != b.shape or b.shape != level.shape:
        seen = f"{a.size} and {b.size} coefficients of {level.size} levels"
        raise InputError("formula terms do not fit the levels", field=str(level.name), found=seen)
    return a, b


def _term(ds: xr.Dataset, terms: dict[str, str], term: str, kind: str | None) -> Floats:
    name = terms.get(term, "")
    if name not in ds.variables:
        raise InputError(
            f"formula term {term} of the hybrid levels is missing",
            field=name or term,
            found="terms " + (", ".join(f"{k}: {v}" for k, v in terms.items()) or "none"),
        )
    values = np.asarray(ds[name].values, dtype=np.float64)
    if kind is not None:
        values = values * required_factor(ds[name].attrs.get("units"), kind, name=name)
    return values
