"""One model time as a catalogue knows it: where its fields lie, nothing decoded.

Assumes files that keep their size and time of modification keep their content.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.geometry.placing import Placing

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

    Rows are of `fields.FIELD_DTYPE`, one a level, isobaric ones by increasing pressure.
    """

    valid: int  # ns since 1970
    lead: int  # s
    grid: Placing
    level_kind: int  # `ISOBARIC` or `HYBRID`
    u: NDArray[np.void]
    v: NDArray[np.void]
    pressure: NDArray[np.void]  # empty for isobaric levels
    files: tuple[SourceFile, ...]  # as the rows' ``file`` numbers them

    @property
    def native(self) -> bool:
        """Levels are native ones, with a pressure field."""
        return self.level_kind != ISOBARIC

    @property
    def storage(self) -> str:
        """What its values depend on beside rows, files and grid."""
        return ""


class Sample(NamedTuple):
    """Winds of one model time at its reports.

    `table` is (2 or 9, report): u and v, then derivatives, see
    :mod:`airswing.reference.geometry.winds`. `problems` lists (file, reason) of what could not
    be read; `decoded` counts messages or chunks read, `octets` their length, and `seconds` is the
    time that reading and decoding them took.
    """

    table: NDArray[np.float64]
    problems: tuple[tuple[str, str], ...]
    decoded: int
    octets: int = 0
    seconds: float = 0.0


NOT_OPENED, REPLACED = "cannot be opened", "replaced since it was catalogued"


def of_a_lost_file(reason: str) -> bool:
    """Whether a problem is of a file that vanished or changed, not of what stands in it.

    Such a problem may be gone when the file is there again, though nothing tells it is another.
    """
    return reason.startswith((NOT_OPENED, REPLACED))
