"""Where a field of a Dataset is stored, as rows a catalogue can hold and a task can carry.

A row (`ROW_DTYPE`) is one level of one component at one time; a `StoredField` says how rows of
one variable are read: dimensions, chunks, units, staggering. Neither holds values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

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
    """How the fields of one variable are read.

    Parameters
    ----------
    names : tuple of str
        Variables, summed.
    dims : tuple of str
        Dimensions of the variable as stored.
    outer : tuple of (str, int)
        Dimensions that a row's `index` counts, with their sizes.
    level, y, x : str
        Dimensions of levels (empty without), rows and columns.
    chunks : tuple of int or tuple of int
        Along each dimension, the length of a chunk or the start of every chunk and the end.
    scale : float
        To SI units.
    stagger : {"", "x", "y"}
        Points lie half a grid length before the grid's along this axis, and one more follows
        the last: the mean of two neighbours counts.
    exponential : bool
        The logarithm is stored.
    either : str
        Dimension along which the first value that is not missing counts.
    """

    names: tuple[str, ...]
    dims: tuple[str, ...]
    outer: tuple[tuple[str, int], ...]
    level: str
    y: str
    x: str
    shape: tuple[int, ...]
    chunks: tuple[int | tuple[int, ...], ...]
    scale: float = 1.0
    stagger: str = ""
    exponential: bool = False
    either: str = ""

    def starts(self, dim: str) -> NDArray[np.int64]:
        """Start of every chunk along a dimension, and the end of the last."""
        number = self.dims.index(dim)
        size, length = self.shape[number], self.chunks[number]
        if isinstance(length, tuple):
            return np.array(length, dtype=np.int64)
        return np.append(np.arange(0, size, max(length, 1)), size).astype(np.int64)

    def outer_places(self, index: Any) -> tuple[NDArray[np.int64], ...]:
        """Index along each outer dimension of rows' `index`."""
        shape = tuple(size for _, size in self.outer)
        if not shape:
            return ()
        return tuple(np.asarray(p) for p in np.unravel_index(np.asarray(index), shape))


@dataclass(frozen=True, slots=True, eq=False)
class GriddedTime(ModelTime):
    """One model time of a Dataset: its rows are of `ROW_DTYPE`, ``offset`` numbers `fields`.

    Parameters
    ----------
    engine : str
        How the files are opened, see :mod:`airswing.reference.gridded.opening`; ``given`` for a
        Dataset given in Python.
    """

    fields: tuple[StoredField, ...] = ()
    engine: str = ""

    @property
    def storage(self) -> str:
        """What its values depend on beside rows, files and grid."""
        return repr((self.fields, self.engine))
