"""All winds of Datasets as rows of a catalogue: one a component, level, time and member.

* A component known by its name alone counts only if there is none known by its `standard_name`; of
  two known in the same way on levels of the same kind neither is chosen: the configuration decides.
* Isobaric levels: a coordinate in units of pressure, or the logarithm that CF defines
  (``atmosphere_ln_pressure_coordinate``). A coordinate with a name of pressure levels and without
  units is in hPa if its largest value is 200 to 1,100, in Pa if it is 20,000 to 110,000 (and the
  values are no consecutive numbers): the levels of aircraft cannot be anything else.
* Native levels: pressure is ``a + b ps``, by the CF formula terms of hybrid (``ap, b, ps``;
  ``a, p0, b, ps``) and sigma coordinates (``sigma, ps, ptop``: ``a = (1 - sigma) ptop``), or by the
  half levels a and b of a GRIB's pv section, of which a full level has the mean (Simmons and
  Burridge 1981; ECMWF IFS documentation, part III); or it is a variable on the same levels. A
  coordinate that is hybrid or sigma by its attributes is that, whatever its units: some models
  write ``hPa`` on a number that is no pressure.
* The surface pressure of hybrid levels is that of the same time, lead, member and grid; if both are
  present its logarithm takes precedence (ECMWF archives the logarithm on model levels).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.files import Skipped, skip
from airswing.reference.gridded.axes import (
    Axes,
    axes_of,
    cell_dimension,
    coordinate,
    grid_of_axes,
    members_of,
    unstructured,
)
from airswing.reference.gridded.datasets import NOTES, SKIPPED
from airswing.reference.gridded.naming import (
    Component,
    Naming,
    along_grid,
    components,
    factor_of,
    required_factor,
    speed_only,
    written_units,
)
from airswing.reference.gridded.times import MISSING, times_of
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

# what attributes and coordinates of an unexpected kind lead to, here and in libraries
_FAULTS = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
_NATIVE = ("hybrid", "sigma", "eta", "model_level", "generalvertical", "theta_level")
# a pressure that is not the level's own, such as that above the ground
_RELATIVE = re.compile(r"difference|above|from ?ground|potential ?vorticity|tropopause", re.I)
_NO_UNITS = ("", "1", "level", "levels", "layer", "dimensionless")
_LIKE_PRESSURE = ("lev", "plev", "pres", "isobar")
_LOWEST_PRESSURE = 5_000.0  # Pa: the lowest level of any model that aircraft can be compared with


class Levels(NamedTuple):
    """Levels of a variable."""

    values: Floats  # Pa if isobaric, else numbers in the order of the file
    native: bool
    a: Floats  # Pa; coefficients by level, NaN if pressure is a variable
    b: Floats
    surface: str = ""  # the surface pressure in the formula, empty if it is not named
    note: str = ""  # what was assumed


class OtherLevelsError(Exception):
    """Levels without a pressure; the text describes them."""


class Rows(NamedTuple):
    """Fields of one variable: how they are read, their grids, and a row of each.

    `table["grid"]` numbers `grids`; `along`: whether its winds point along the grid, None if
    unknown or if it is no wind; `why`: the evidence.
    """

    stored: StoredField
    grids: tuple[Grid, ...]
    table: Table
    along: bool | None
    why: str


class Described(NamedTuple):
    """Content of a Dataset: rows by variable, what is not used and why (counted), and notes."""

    rows: list[Rows]
    skipped: Counter[tuple[str, str]]
    notes: set[str]


class Gathering:
    """Rows of all files of a reference, with grids and stored fields numbered over them."""

    def __init__(self, naming: Naming, skipped: Skipped) -> None:
        self.naming, self.skipped = naming, skipped
        self.stored: dict[StoredField, int] = {}
        self._tables: list[Table] = [np.empty(0, dtype=ROW_DTYPE)]
        self._grids: dict[Grid, int] = {}
        self._first = ""
        self._variables: set[str] = set()
        self._notes: dict[str, None] = {}
        self._along: dict[int, dict[bool | None, str]] = {}

    def add(self, number: int, parts: Sequence[xr.Dataset], path: str) -> None:
        """Add the rows of one file."""
        self._first = self._first or path
        for part, ds in enumerate(parts):
            self._notes |= dict.fromkeys(ds.encoding.get(NOTES, ()))
            try:
                self._variables |= {str(name) for name in (*ds.variables, *ds.dims)}
                if is_wrf(ds) and not (self.naming.u or self.naming.v):
                    found = _describe_wrf(ds, self.naming)
                else:
                    found = _describe_dataset(ds, self.naming)
            except InputError as error:
                raise InputError(
                    error.what,
                    file=path,
                    field=error.field,
                    found=error.found,
                    remedy=error.remedy,
                ) from error
            except _FAULTS as error:
                raise InputError(
                    "cannot be understood",
                    file=path,
                    found=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                    remedy="Its attributes or coordinates contradict each other; their meaning can "
                    "be given under the reference",
                ) from error
            self._notes |= dict.fromkeys(sorted(found.notes))
            self.skipped += [skip(path, *key, count) for key, count in found.skipped.items()]
            for rows in found.rows:
                self._tables.append(self._numbered(rows, number, part))

    def _numbered(self, rows: Rows, number: int, part: int) -> Table:
        table = rows.table
        table["file"], table["part"] = number, part
        table["offset"] = self.stored.setdefault(rows.stored, len(self.stored))
        numbers = [self._grids.setdefault(grid, len(self._grids)) for grid in rows.grids]
        table["grid"] = np.array(numbers)[table["grid"]]
        if table.size and table["kind"][0] < PRESSURE:
            for one in numbers:
                self._along.setdefault(one, {})[rows.along] = rows.why
        return table

    def table(self) -> Table:
        """All rows, with a pressure for each native level that a formula gives one."""
        for key, name in self.naming.named():
            if name not in self._variables:
                raise InputError(
                    "no such variable",
                    file=self._first,
                    field=f"{key}: {name}",
                    found="variables " + ", ".join(sorted(self._variables)),
                )
        table = on_one_grid(np.concatenate(self._tables), list(self._grids))
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
        known = {along for along in self._along.get(number, {}) if along is not None}
        if len(known) > 1:
            raise InputError(
                "one component points along the grid, the other to true east or north",
                file=self._first,
                found="; ".join(self._along[number].values()),
                remedy="Give winds: grid or winds: earth",
            )
        return known.pop() if known else True  # models write components along their grids

    def notes(self, used: NDArray[np.int64]) -> list[str]:
        """Direction of the winds on each grid that is used, and the evidence."""
        notes = dict(self._notes)
        for grid, number in self._grids.items():
            if grid.north_up or number not in used:
                continue
            known = self._along.get(number, {})
            why = ", ".join(dict.fromkeys(why for along, why in known.items() if along is not None))
            way = "along the grid" if self._is_along(number) else "to true east and north"
            notes[
                f"winds point {way} ({why})"
                if why
                else "direction of the winds not given: taken as along the grid, as models write "
                "them; give winds: earth if they point to true east and north"
            ] = None
        return list(notes)


def _describe_dataset(ds: xr.Dataset, naming: Naming) -> Described:
    """Wind fields of a CF Dataset, and what gives their pressure."""
    found = Described([], Counter(ds.encoding.get(SKIPPED, {})), set())
    chosen: dict[tuple[int, bool], Component] = {}
    native: list[str] = []
    candidates = components(ds, naming)
    for one in candidates:
        variable = ds[one.name]
        others = [(str(key), other.attrs) for key, other in variable.coords.items()]
        others += [(str(dim), {}) for dim in variable.dims if dim not in variable.coords]
        why = variable_statistic(one.name, variable.attrs, others, ds.attrs)
        if why:
            found.skipped["wind", f"{one.name} is no state of the atmosphere ({why})"] += 1
            continue
        try:
            axes = axes_of(ds, one.name, naming)
            levels = _levels_of(ds, one.name, axes.vertical, naming)
        except OtherLevelsError as reason:
            found.skipped["wind", f"{one.name} on {reason}"] += 1
            continue
        other = chosen.get((one.number, levels.native))
        if other is not None:
            if one.tier > other.tier:
                continue
            raise InputError(
                f"two candidates for {'uv'[one.number]}",
                found=f"{other.name}, {one.name}",
                remedy=f"Name one in the configuration as {'uv'[one.number]}: NAME",
            )
        chosen[one.number, levels.native] = one
        if levels.note:
            found.notes.add(levels.note)
        found.rows.append(_rows(ds, one.name, one.number, axes, levels, naming))
        if levels.native:
            native.append(one.name)
            found.rows.extend(_surface_pressure(ds, levels, naming))
    found.rows.extend(_pressures(ds, native, naming))
    if not chosen and not candidates:
        cells, speed = cell_dimension(ds), speed_only(ds)
        if cells:
            raise unstructured(cells)
        if speed:
            raise InputError(
                "a wind speed without components",
                field=speed,
                remedy="Winds are needed as u and v",
            )
    return found


def _only_level(ds: xr.Dataset, name: str, naming: Naming) -> xr.DataArray:
    single = {
        str(key)
        for key, one in ds[name].coords.items()
        if one.size == 1 and factor_of(one.attrs.get("units"), "pressure") is not None
    }
    key = naming.level or min(single, default=None)
    if key is None:
        raise OtherLevelsError("no vertical axis")
    found: xr.DataArray = ds[key] if ds[key].ndim else ds[key].expand_dims(key)
    return found


def _rows(
    ds: xr.Dataset, name: str, kind: int, axes: Axes, levels: Levels | None, naming: Naming
) -> Rows:
    """Rows of one variable; `levels` is None for a surface."""
    outer = {d: int(ds.sizes[d]) for d in axes.outer}
    valid, lead = times_of(ds, name, outer, naming)
    member = np.zeros(valid.size, dtype=np.int64)
    if axes.member:
        numbers = members_of(ds, axes.member, outer[axes.member])
        shape = [outer[d] if d == axes.member else 1 for d in outer]
        member = np.broadcast_to(numbers.reshape(shape), tuple(outer.values())).ravel()
    wind = kind < PRESSURE
    written = naming.units.get(name, written_units(ds[name].attrs))
    # surface pressure without a unit of pressure is its logarithm, as spectral models write it
    exponential = kind == SURFACE and factor_of(written, "pressure") is None
    unit = "wind" if wind else "pressure"
    scale = 1.0 if exponential else required_factor(written, unit, name=name)
    stored = StoredField(
        names=(name,),
        dims=tuple(map(str, ds[name].dims)),
        outer=tuple(outer.items()),
        level=axes.level_dim,
        y=axes.y_dim,
        x=axes.x_dim,
        shape=tuple(ds[name].shape),
        chunks=_chunks_of(ds[name], (axes.y_dim, axes.x_dim)),
        scale=scale,
        exponential=exponential,
        either=axes.either,
    )
    along, why = along_grid(ds[name], naming) if wind else (None, "")
    table = _table(kind, levels, valid, lead, member)
    return Rows(stored, (grid_of_axes(ds, name, axes, naming),), table, along, why)


def _table(
    kind: int,
    levels: Levels | None,
    valid: NDArray[np.int64],
    lead: NDArray[np.int64],
    member: NDArray[np.int64],
) -> Table:
    """A row a field and level; fields without a time are left out."""
    count = 1 if levels is None else levels.values.size
    known = np.flatnonzero(valid != MISSING)
    table = np.zeros((known.size, count), dtype=ROW_DTYPE)
    columns = {"valid": valid, "lead": lead, "member": member, "index": np.arange(valid.size)}
    for column, values in columns.items():
        table[column] = values[known, None]
    table["kind"], table["level_kind"], table["b"] = kind, HYBRID, 1.0
    if levels is not None:
        table["level"], table["level_index"] = levels.values, np.arange(count)
        table["level_kind"] = HYBRID if levels.native else ISOBARIC
        if kind < PRESSURE:
            table["a"], table["b"] = levels.a, levels.b
    return table.ravel()


def _chunks_of(one: xr.DataArray, plane: tuple[str, str]) -> tuple[tuple[int, ...], ...]:
    """Start of every chunk along each dimension, and the end.

    Rows and columns count as one chunk: of these the box around the reports is read.
    """
    if one.chunks is not None:
        lengths = [tuple(sizes) for sizes in one.chunks]
    else:
        # netCDF files have the first, Zarr the second; a field in one piece is read by levels
        written = one.encoding.get("chunksizes") or one.encoding.get("preferred_chunks") or ()
        if isinstance(written, dict):
            written = [written.get(d) or 1 for d in one.dims]
        if len(written) != one.ndim:
            written = [1] * one.ndim
        lengths = [
            (*(int(n),) * (size // int(n)), size % int(n)) if n else (size,)
            for n, size in zip(written, one.shape, strict=True)
        ]
    found = []
    for dim, size, sizes in zip(map(str, one.dims), one.shape, lengths, strict=True):
        ends = np.concatenate([[0], np.cumsum([n for n in sizes if n])])
        found.append((0, size) if dim in plane else tuple(int(n) for n in ends))
    return tuple(found)


def _surface_pressure(ds: xr.Dataset, levels: Levels, naming: Naming) -> list[Rows]:
    name = naming.surface_pressure or levels.surface
    if not name or np.isnan(levels.b).all():
        return []
    coordinate(ds, name, "surface_pressure")
    return [_rows(ds, name, SURFACE, axes_of(ds, name, naming), None, naming)]


def _pressures(ds: xr.Dataset, native: list[str], naming: Naming) -> list[Rows]:
    found = []
    for key in ds.data_vars:
        one, name = ds[key], str(key)
        same = any(set(ds[n].dims) == set(one.dims) or ds[n].ndim == one.ndim for n in native)
        named = one.attrs.get("standard_name") == "air_pressure" and same
        if name == naming.pressure or one.attrs.get("GRIB_shortName") == "pres" or named:
            axes = axes_of(ds, name, naming)
            if axes.vertical is not None:
                levels = _levels_of(ds, name, axes.vertical, naming)
                found.append(_rows(ds, name, PRESSURE, axes, levels, naming))
        elif one.attrs.get("GRIB_shortName") in ("sp", "lnsp"):
            axes = axes_of(ds, name, naming)
            found.append(_rows(ds, name, SURFACE, axes, None, naming))
    return found


def _describe_wrf(ds: xr.Dataset, naming: Naming) -> Described:
    odd = [key for key in naming.given() if key not in ("winds", "time")]
    if odd:
        raise InputError(
            "this key does not apply to files of WRF, which describe themselves",
            field=odd[0],
            remedy="Remove it, or give u: and v: too to have the file read as any other NetCDF",
        )
    layout = layout_of(ds)
    valid, lead = times_of_wrf(ds, naming.time)
    grids = grids_of_wrf(ds, valid.size)
    distinct = tuple(dict.fromkeys(grids))
    unknown = np.full(layout.levels.size, np.nan)
    levels = Levels(layout.levels, bool(layout.pressure), unknown, unknown)
    found = Described([], Counter(), set())
    along = naming.winds != "earth"
    kinds = [(0, layout.winds[:1]), (1, layout.winds[1:])]
    for kind, names in [*kinds, *([(PRESSURE, layout.pressure)] if layout.pressure else [])]:
        one = ds[names[0]]
        y, x = str(one.dims[-2]), str(one.dims[-1])
        stored = StoredField(
            names=names,
            dims=tuple(map(str, one.dims)),
            outer=tuple((str(d), int(ds.sizes[d])) for d in one.dims[:-3]),
            level=layout.level,
            y=y,
            x=x,
            shape=tuple(one.shape),
            chunks=_chunks_of(one, (y, x)),
            scale=layout.scale if kind == PRESSURE else 1.0,
            stagger="x" if x != X else "y" if y != Y else "",
        )
        table = _table(kind, levels, valid, lead, np.zeros_like(valid))
        table["grid"] = np.array([distinct.index(one) for one in grids])[table["index"]]
        table = table[table["level_index"] >= layout.first]
        why = "the configuration" if naming.winds else "WRF's grid"
        found.rows.append(Rows(stored, distinct, table, along, why))
    return found


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
    # of several of one time the first stored field counts
    last = pd.DataFrame({c: surface[c] for c in names} | {"row": np.arange(surface.size)})
    last = last.iloc[np.argsort(surface["offset"], kind="stable")].drop_duplicates(names)
    row = pd.DataFrame({c: levels[c] for c in names}).merge(last, "left", names)["row"]
    levels, made = levels[row.notna()], surface[row.dropna().astype(int)]
    for column in ("level", "level_kind", "a", "b"):
        made[column] = levels[column]
    made["kind"] = PRESSURE
    # levels that have a pressure field keep it
    keys = [*names, "level"]
    given = pd.MultiIndex.from_frame(pd.DataFrame(rest[rest["kind"] == PRESSURE][keys]))
    made = made[~pd.MultiIndex.from_frame(pd.DataFrame(made[keys])).isin(given)]
    return np.concatenate([rest, made])


def _levels_of(ds: xr.Dataset, name: str, level: xr.DataArray | None, naming: Naming) -> Levels:
    level = _only_level(ds, name, naming) if level is None else level
    words = str(level.attrs.get("formula_terms", level.encoding.get("formula_terms", ""))).split()
    terms = {key.rstrip(":"): value for key, value in zip(words[::2], words[1::2], strict=False)}
    kind, key = str(level.attrs.get("standard_name", "")), str(level.name)
    units = naming.units.get(key, level.attrs.get("units"))
    values, unknown = _numbers(level), np.full(level.size, np.nan)
    if kind == "atmosphere_ln_pressure_coordinate":
        reference = _term(ds, terms, "p0", "pressure")
        return _isobaric(reference * np.exp(-values), key)
    formula = _formula(ds, kind, terms, level)
    if formula is not None:
        numbers = np.arange(level.size, dtype=np.float64)
        return Levels(numbers, True, *formula, surface=terms.get("ps", ""))
    native = any(word in kind or word in key.lower() for word in _NATIVE)
    described = f"{key} {level.attrs.get('long_name', '')}".replace("_", " ")
    if not native and not _RELATIVE.search(described):
        factor = factor_of(units, "pressure")
        if factor is None and str(units or "").strip() in _NO_UNITS and naming.pressure is None:
            factor = _factor_by_values(key, values)
            unit = "hPa" if factor == 100.0 else "Pa"
            if factor is not None:
                found = _isobaric(values * factor, key)
                return found._replace(note=f"{key} has no units: taken as {unit} from its values")
        if factor is not None:
            return _isobaric(values * factor, key)
    pv = ds[name].attrs.get("GRIB_pv", ())
    if np.size(pv) > 2:
        return Levels(values, True, *_half_levels(np.asarray(pv), values))
    if native or naming.pressure or _pressure_on(ds, name):
        return Levels(np.arange(level.size, dtype=np.float64), True, unknown, unknown)
    if not units and any(word in key.lower() for word in _LIKE_PRESSURE):
        required_factor(units, "pressure", name=key)
    raise OtherLevelsError(f"levels of another kind ({key}{f', {units}' if units else ''})")


def _numbers(level: xr.DataArray) -> Floats:
    try:
        return np.asarray(level.values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.arange(level.size, dtype=np.float64)


def _isobaric(values: Floats, key: str) -> Levels:
    if values.size > 1 and float(np.nanmax(values)) < _LOWEST_PRESSURE:
        raise InputError(
            f"pressure levels end at {float(np.nanmax(values)) / 100:g} hPa, above all aircraft",
            field=key,
            remedy=f"Check their unit; if they are in hPa give units: {{{key}: hPa}}",
        )
    none = np.full(values.size, np.nan)
    return Levels(values, False, none, none)


def _factor_by_values(key: str, values: Floats) -> float | None:
    """Factor to Pa of levels without units, by name and values; None if they may be others."""
    if not any(word in key.lower() for word in _LIKE_PRESSURE) or values.size < 2:
        return None
    low, high = float(values.min()), float(values.max())
    numbers = np.array_equal(np.sort(values), np.arange(low, low + values.size))
    for factor in (100.0, 1.0):
        if low > 0.0 and 20_000.0 <= high * factor <= 110_000.0 and not numbers:
            return factor
    return None


def _pressure_on(ds: xr.Dataset, name: str) -> str:
    for key in ds.variables:
        one = ds.variables[key]
        pressure = one.attrs.get("standard_name") == "air_pressure"
        if pressure and one.dims == ds[name].dims and factor_of(one.attrs.get("units"), "pressure"):
            return str(key)
    return ""


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
        raise InputError(
            "formula terms do not fit the levels",
            field=str(level.name),
            found=f"{a.size} and {b.size} coefficients of {level.size} levels",
        )
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


def _half_levels(pv: Floats, numbers: Floats) -> tuple[Floats, Floats]:
    """Coefficients (n,) of full levels, 1 the topmost, from those of half levels (2 m,)."""
    a, b = np.asarray(pv, dtype=np.float64).reshape(2, -1)
    k = numbers.astype(np.int64)
    if k.size and (k.min() < 1 or k.max() >= a.size):
        raise OtherLevelsError(f"hybrid level {k.max()} of {a.size - 1} in the pv section")
    return (a[k - 1] + a[k]) / 2.0, (b[k - 1] + b[k]) / 2.0
