"""Where a field of a Dataset is stored, as rows a catalogue can hold and a task can carry.

A row (`ROW_DTYPE`) is one level of one component at one time; a `StoredField` says how rows of
one variable are read: dimensions, chunks, units, staggering. Neither holds values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.geometry.model_time import ModelTime

#: Kinds of field beside u, v and pressure (0, 1, 2): the surface pressure of hybrid levels.
SURFACE = 3

#: `index` counts the fields of a variable over its outer dimensions, `level_index` its levels;
#: the value of a pressure is ``a + b * field``. `offset` numbers the stored field.
ROW_DTYPE = np.dtype(
    [
        ("file", "i4"),
        ("part", "i2"),
        ("offset", "i4"),
        ("kind", "i1"),
        ("level_kind", "i1"),
        ("level", "f8"),
        ("valid", "i8"),
        ("lead", "i8"),
        ("member", "i4"),
        ("grid", "i4"),
        ("index", "i4"),
        ("level_index", "i4"),
        ("a", "f8"),
        ("b", "f8"),
    ]
)


class StoredField(NamedTuple):
    """How the fields of one variable are read."""

    names: tuple[str, ...]  # variables, summed
    dims: tuple[str, ...]  # of the variable as stored
    outer: tuple[tuple[str, int], ...]  # dimensions that a row's `index` counts, and their sizes
    level: str  # dimensions of levels (empty without), rows and columns
    y: str
    x: str
    shape: tuple[int, ...]
    # Along each dimension, the length of a chunk or the start of every chunk and the end.
    chunks: tuple[int | tuple[int, ...], ...]
    scale: float = 1.0  # to SI units
    # Axis (x or y) along which points lie half a grid length before the grid's, and one more
    # follows the last: the mean of two neighbours counts.
    stagger: str = ""
    exponential: bool = False  # the logarithm is stored
    either: str = ""  # dimension along which the first value that is not missing counts

    def starts(self, dim: str) -> NDArray[np.int64]:
        """Start of every chunk along a dimension, and the end of the last."""
        number = self.dims.index(dim)
        size, length = self.shape[number], self.chunks[number]
        if isinstance(length, tuple):
            return np.array(length, dtype=np.int64)
        return np.append(np.arange(0, size, max(length, 1)), size).astype(np.int64)

    def outer_places(self, index: int | NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
        """Index along each outer dimension of rows' `index`."""
        shape = tuple(size for _, size in self.outer)
        if not shape:
            return ()
        return tuple(np.asarray(p) for p in np.unravel_index(np.asarray(index), shape))


@dataclass(frozen=True, slots=True, eq=False)
class GriddedTime(ModelTime):
    """One model time of a Dataset: its rows are of `ROW_DTYPE`, ``offset`` numbers `fields`."""

    fields: tuple[StoredField, ...] = ()
    engine: str = ""  # how the files are opened; ``given`` for a Dataset given in Python

    @property
    def storage(self) -> str:
        """What its values depend on beside rows, files and grid."""
        return repr((self.fields, self.engine))
