"""Rows of wind fields and the profile of one model time, however its values are stored.

A row is one field of one level: its file, place in the file, kind, level, time, lead, member and
grid. Rows of GRIB and of Datasets share these columns; each reader adds those it reads by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.files import SourceFile
from airswing.reference.grids import Grid, are_shifted

Table = NDArray[np.void]

U, V, PRESSURE, SURFACE = 0, 1, 2, 3
"""Kinds of field; SURFACE is the surface pressure of hybrid levels."""
ISOBARIC, HYBRID = 0, 1
"""Kinds of level; further ones are GRIB level types."""
GIVEN = "given"
"""Engine of Datasets given in Python."""


class StoredField(NamedTuple):
    """How the fields of one variable of a Dataset are read."""

    names: tuple[str, ...]  # variables, summed
    dims: tuple[str, ...]
    outer: tuple[tuple[str, int], ...]  # dimensions that a row's `index` counts, and their sizes
    level: str  # dimension of the levels (empty without), of rows and of columns
    y: str
    x: str
    shape: tuple[int, ...]
    chunks: tuple[tuple[int, ...], ...]  # start of every chunk along each dimension, and the end
    scale: float = 1.0  # to SI units
    # "x" or "y": points lie half a grid length before the grid's along this axis, and one more
    # follows the last: the mean of two neighbours counts
    stagger: str = ""
    exponential: bool = False  # the logarithm is stored
    either: str = ""  # dimension along which the first value that is not missing counts

    def outer_places(self, index: NDArray[np.integer]) -> list[tuple[str, NDArray[np.int64]]]:
        """Outer dimensions and the indices along them of rows' `index`."""
        if not self.outer:
            return []
        places = np.unravel_index(np.asarray(index), tuple(size for _, size in self.outer))
        return [
            (dim, np.asarray(place)) for (dim, _), place in zip(self.outer, places, strict=True)
        ]


#: Rows of Datasets: `index` counts the fields of a variable over its outer dimensions,
#: `level_index` its levels; the value of a pressure is ``a + b * field``; `offset` numbers the
#: stored field, `points` the field's grid, and `grid` that of the profile it belongs to.
ROW_DTYPE = np.dtype(
    [
        *[(name, "i4") for name in ("file", "offset", "member", "grid", "points")],
        *[(name, "i4") for name in ("index", "level_index")],
        *[(name, "i2") for name in ("part", "kind", "level_kind")],
        *[(name, "f8") for name in ("level", "a", "b")],
        *[(name, "i8") for name in ("valid", "lead")],
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class ModelTime:
    """The wind profile of one valid time, small enough to send to another process.

    Rows of u, v and pressure are those of the catalogue, one a level; isobaric levels by increasing
    pressure. `pressure` is empty for isobaric levels.
    """

    grids: tuple[Grid, Grid, Grid]  # of u, v and pressure
    native: bool  # levels have a pressure field
    u: Table
    v: Table
    pressure: Table
    files: tuple[SourceFile, ...]  # as the rows' ``file`` numbers them
    stored: tuple[StoredField, ...] = ()  # as the rows' ``offset`` numbers them; empty for GRIB
    engine: str = "grib"

    @property
    def grid(self) -> Grid:
        """Grid of u."""
        return self.grids[0]


def on_one_grid(table: Table, grids: Sequence[Grid]) -> Table:
    """Give v and pressure the grid number of u if they lie on points shifted against u's.

    The number of a row's own grid is kept in ``points``.
    """
    table["points"] = table["grid"]
    known: dict[tuple[int, int], bool] = {}

    def shifted(one: int, other: int) -> bool:
        if (one, other) not in known:
            known[one, other] = are_shifted(grids[one], grids[other])
        return known[one, other]

    numbers = {kind: np.unique(table["grid"][table["kind"] == kind]).tolist() for kind in range(4)}
    for kind in (V, PRESSURE, SURFACE):
        mine = table["kind"] == kind
        for number in set(numbers[kind]) - set(numbers[U]):
            target = next((one for one in numbers[U] if shifted(one, number)), number)
            table["grid"][mine & (table["points"] == number)] = target
    return table
