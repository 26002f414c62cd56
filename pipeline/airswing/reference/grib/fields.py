"""Rows of a catalogue and the small tools that both GRIB editions' scanners share.

Offsets in octets from the start of the file, times in ns since 1970, leads in
s, pressure levels in Pa, hybrid levels by number.
"""

from __future__ import annotations

import calendar
import os
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.grib.gridsections import read_grid

#: Kinds of field: eastward (along x) wind, northward (along y) wind, pressure.
U, V, PRESSURE = 0, 1, 2

#: Octets read at once where a message begins.
HEAD = 512
RANGES = {2: "range", 3: "average", 4: "accumulation", 5: "difference", 6: "average", 7: "average"}


SPEED_ALONE = "wind", "wind speed or direction, not u and v"
"""What is said of messages that hold a wind in another form."""


class Field(NamedTuple):
    """One field of a file, a row of `FIELD_DTYPE`; -1 where an offset or a count is not there."""

    offset: int  # of the message
    length: int
    edition: int
    kind: int
    level_kind: int
    level: float
    valid: int
    lead: int
    grid: int  # numbers `FileContents.grids`
    section_grid: int  # offsets of whole sections
    section_product: int
    section_packing: int
    section_bitmap: int
    section_data: int
    file: int = 0
    part: int = 0  # which field of its message
    member: int = 0
    packing: int = 0
    sparse: bool = False  # can be read in place
    coded: int = -1  # count of values that section 5 of GRIB2 states
    # Of packings that have them: bits a value, E, D and R, offsets of the packed values.
    bits: int = 0
    binary_scale: int = 0
    decimal_scale: int = 0
    reference_value: float = 0.0
    data_start: int = 0
    data_end: int = 0


# Columns that need less than eight octets, or are no integers.
_TYPES = {
    **dict.fromkeys(("edition", "kind", "level_kind"), "i1"),
    **dict.fromkeys(("part", "bits"), "i2"),
    **dict.fromkeys(("file", "member", "grid", "packing", "binary_scale", "decimal_scale"), "i4"),
    **dict.fromkeys(("level", "reference_value"), "f8"),
    "sparse": "?",
}
FIELD_DTYPE = np.dtype([(name, _TYPES.get(name, "i8")) for name in Field._fields])


@dataclass(slots=True)
class FileContents:
    """What one file holds."""

    fields: list[Field] = field(default_factory=list)  # usable winds and pressures
    # Distinct grid sections and their editions, in order of appearance.
    grids: list[tuple[int, bytes]] = field(default_factory=list)
    # What cannot be used and why, with counts.
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    messages: int = 0  # and fields, of any kind
    parts: int = 0
    _known: dict[tuple[int, bytes], int] = field(default_factory=dict)

    def grid_number(self, edition: int, section: bytes) -> int:
        """Number of a grid section, placing it once; `UnplaceableGridError` where it cannot be."""
        key = (edition, section)
        if key not in self._known:
            read_grid(edition, section)
            self._known[key] = len(self.grids)
            self.grids.append(key)
        return self._known[key]

    def table(self) -> NDArray[np.void]:
        """Fields as an array of `FIELD_DTYPE`."""
        return np.array(self.fields, dtype=FIELD_DTYPE)


class SkippedError(Exception):
    """One field or message that is not used: what, why."""

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(what, reason)
        self.what, self.reason = what, reason


class GarbageError(Exception):
    """Octets that are no whole message."""


class Window:
    """A file seen through small positioned reads.

    The last two are kept: a message's end and the next one's head lie in one of them.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.size = os.fstat(descriptor).st_size
        self.start, self.data = 0, b""
        self._before = 0, b""

    def get(self, start: int, length: int) -> bytes:
        """`length` octets from `start`; fewer at the end of the file."""
        at = start - self.start
        if at < 0 or at + length > len(self.data):
            self._before, (self.start, self.data) = (self.start, self.data), self._before
            at = start - self.start
            if at < 0 or at + length > len(self.data):
                read = os.pread(self.descriptor, max(length, HEAD), start)
                self.start, self.data, at = start, read, 0
        return self.data[at : at + length]


# messages of one file have a handful of times between them, and the calendar is slow
@lru_cache(maxsize=4096)
def _nanoseconds(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int:
    if not (1 <= month <= 12 and 1 <= day <= calendar.monthrange(year, month)[1]):
        raise ValueError
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError
    return calendar.timegm((year, month, day, hour, minute, second)) * 1_000_000_000


def reference_time(*parts: int) -> int:
    """Year, month, day, hour, minute, second to ns since 1970; `SkippedError` where impossible."""
    try:
        return _nanoseconds(*parts)
    except (ValueError, OverflowError):
        date = "{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}".format(*parts)
        raise SkippedError("message", f"damaged: impossible reference time {date}") from None


def off_levels(kind: int, surface: int) -> SkippedError:
    """What to say of a wind that is not on the levels of a profile (nothing of a pressure)."""
    if kind == PRESSURE:
        return SkippedError("", "")
    letter = "u" if kind == U else "v"
    return SkippedError("wind", f"{letter} not on pressure levels (level type {surface})")
