"""One model time as a catalogue knows it: where its fields lie, nothing decoded.

Assumes files that keep their size and time of modification keep their content.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from numpy.typing import NDArray

from airswing.reference.geometry.grids import Grid

#: Kinds of level.
ISOBARIC, HYBRID = 0, 1


class SourceFile(NamedTuple):
    """A file as the catalogue saw it."""

    path: str
    size: int
    mtime_ns: int
    sample: str


@dataclass(frozen=True, slots=True, eq=False)
class ModelTime:
    """One reference's wind profile at one valid time: where it lies, nothing decoded.

    Parameters
    ----------
    valid : int
        Valid time, ns since 1970.
    lead : int
        Lead time, s.
    grid : Grid
    level_kind : int
        `ISOBARIC` or `HYBRID`.
    u, v, pressure : (level,) arrays of `fields.FIELD_DTYPE`
        One row a level, isobaric levels by increasing pressure; `pressure` is
        empty for isobaric levels. ``file`` numbers `files`.
    files : tuple of SourceFile
    """

    valid: int
    lead: int
    grid: Grid
    level_kind: int
    u: NDArray[Any]
    v: NDArray[Any]
    pressure: NDArray[Any]
    files: tuple[SourceFile, ...]

    @property
    def native(self) -> bool:
        """Levels are native ones, with a pressure field."""
        return self.level_kind != ISOBARIC
