"""All files of a reference as one table of rows, and how their winds point.

Assumptions and validity
------------------------
* The surface pressure of hybrid levels is that of the same time, lead, member and grid; where
  both are there its logarithm goes before (ECMWF archives the logarithm on model levels).
* All winds on one grid point the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.reference.geometry.grids import Grid
from airswing.reference.geometry.model_time import HYBRID
from airswing.reference.geometry.placing import Placing
from airswing.reference.geometry.wind_profiles import Catalogue, Skipped, Table, skip
from airswing.reference.grib.fields import PRESSURE
from airswing.reference.gridded.cf.axes_grid import AxesGrid
from airswing.reference.gridded.cf.curvilinear import CurvilinearGrid
from airswing.reference.gridded.cf.naming import Naming
from airswing.reference.gridded.dataset_fields import (
    Described,
    Rows,
    describe_dataset,
    describe_wrfout,
)
from airswing.reference.gridded.stored import ROW_DTYPE, SURFACE, StoredField
from airswing.reference.gridded.wrfout import is_wrfout

# What attributes and coordinates of another kind than they should be lead to, here and in the
# libraries that read them.
_LYING = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)


class Gathering:
    """Rows of all files, with grids and stored fields numbered over them; takes what is skipped."""

    def __init__(self, naming: Naming, skipped: Skipped) -> None:
        self.naming, self.skipped = naming, skipped
        self.stored: dict[StoredField, int] = {}
        self._tables: list[Table] = [np.empty(0, dtype=ROW_DTYPE)]
        self._grids: dict[str, int] = {}
        self._places: list[Placing] = []
        self._first = ""
        self._along: dict[int, dict[bool | None, str]] = {}

    def add(self, number: int, parts: Sequence[xr.Dataset], path: str) -> None:
        """Rows of one file."""
        self._first = self._first or path
        for part, ds in enumerate(parts):
            found = self._described(ds, path)
            self.skipped += [skip(path, *key, count) for key, count in found.skipped.items()]
            for rows in found.rows:
                self._tables.append(self._numbered(rows, number, part))

    def _described(self, ds: xr.Dataset, path: str) -> Described:
        try:
            if is_wrfout(ds) and not (self.naming.u or self.naming.v):
                return describe_wrfout(ds, path)
            return describe_dataset(ds, self.naming, path)
        except _LYING as error:
            raise InputError(
                "cannot be understood",
                file=path,
                found=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                remedy="Its attributes or coordinates contradict each other; what they should say "
                "can be given under the reference",
            ) from error

    def _numbered(self, rows: Rows, number: int, part: int) -> Table:
        table = rows.table
        table["file"], table["part"] = number, part
        table["offset"] = self.stored.setdefault(rows.stored, len(self.stored))
        numbers = np.array([self._grid_number(grid) for grid in rows.grids])
        table["grid"] = numbers[table["grid"]]
        if table.size and table["kind"][0] < PRESSURE:
            for grid in numbers:
                self._along.setdefault(int(grid), {})[rows.along] = rows.why
        return table

    def _grid_number(self, grid: Placing) -> int:
        if grid.key not in self._grids:
            self._grids[grid.key] = len(self._places)
            self._places.append(grid)
        return self._grids[grid.key]

    def table(self) -> Table:
        """All rows, with a pressure for each native level that a formula gives one."""
        return _with_formula_pressures(np.concatenate(self._tables))

    def grids(self) -> tuple[Placing, ...]:
        """Grids, with the direction of the winds on them."""
        return tuple(
            _directed(grid, not _meridians(grid) and self._is_along(number))
            for number, grid in enumerate(self._places)
        )

    def _is_along(self, number: int) -> bool:
        said = {along for along in self._along.get(number, {}) if along is not None}
        if len(said) > 1:
            raise InputError(
                "one component points along the grid, the other to true east or north",
                file=self._first,
                found="; ".join(self._along[number].values()),
                remedy="Say which it is as winds: grid or winds: earth",
            )
        return said.pop() if said else True  # models write components along their grids

    def notes(self, found: Catalogue) -> list[str]:
        """How winds point on each grid that is used, and what says so."""
        notes = []
        for number in np.unique(found.grid_numbers):
            grid, said = self._places[int(number)], self._along.get(int(number), {})
            why = ", ".join(dict.fromkeys(why for along, why in said.items() if along is not None))
            if _meridians(grid):
                continue
            way = "along the grid" if self._is_along(int(number)) else "to true east and north"
            if why:
                notes.append(f"winds point {way} ({why})")
            else:
                notes.append(
                    "nothing says whether winds point along the grid: taken so, as models write "
                    "them; say winds: earth if they do not"
                )
        return list(dict.fromkeys(notes))


def _meridians(grid: Placing) -> bool:
    """Whether the grid's direction is true north everywhere."""
    kind = getattr(getattr(grid, "frame", grid), "kind", "curvilinear")
    return kind in ("longitude_latitude", "regular_ll")


def _directed(grid: Placing, along: bool) -> Placing:
    """A grid with the direction of its winds."""
    if isinstance(grid, CurvilinearGrid):
        return grid.directed(along)
    assert isinstance(grid, AxesGrid | Grid)
    return replace(grid, wind_along_grid=along)


def _with_formula_pressures(table: Table) -> Table:
    """Turn surface pressures into a pressure of every native level: ``a + b ps``.

    Rows of u have `a` and `b` of their level; rows of surface pressure are gone.
    """
    surface = table[table["kind"] == SURFACE]
    rest: Table = table[table["kind"] != SURFACE]
    levels = rest[(rest["kind"] == 0) & (rest["level_kind"] == HYBRID) & np.isfinite(rest["b"])]
    rest["a"][rest["kind"] < PRESSURE], rest["b"][rest["kind"] < PRESSURE] = 0.0, 1.0
    if not levels.size or not surface.size:
        return rest
    known: dict[tuple[int, ...], int] = {}
    names = ("valid", "lead", "member", "grid")
    # from the last to the first: of several of one time the first stays
    for number in np.argsort(surface["offset"], kind="stable")[::-1]:
        known[tuple(int(surface[c][number]) for c in names)] = int(number)
    keys = zip(*(levels[c].tolist() for c in names), strict=True)
    number = np.array([known.get(key, -1) for key in keys])
    levels, number = levels[number >= 0], number[number >= 0]
    made = surface[number]
    for column in ("level", "level_kind", "a", "b"):
        made[column] = levels[column]
    made["kind"] = PRESSURE
    # levels that have a pressure of their own keep it
    own = rest[rest["kind"] == PRESSURE]
    if own.size:
        taken = {tuple(row) for row in own[[*names, "level"]].tolist()}
        keep = [tuple(row) not in taken for row in made[[*names, "level"]].tolist()]
        made = made[np.array(keep, dtype=bool)]
    together: Table = np.concatenate([rest, made])
    return together
