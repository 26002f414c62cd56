"""What a GRIB file holds, read from its octets: nothing is decoded.

Lengths and fixed octets of GRIB1 and GRIB2 say where each wind field is,
which level, time, grid and packing it has. eccodes is asked only for what
is unusual (the length of GRIB1 messages above 8 MB).

Assumptions and validity
------------------------
* u and v are known by parameter, never by file name: GRIB1 parameters 33/34
  of the international tables (1-3) and of NCEP's tables 130 and 131, 131/132
  of ECMWF's table 128; GRIB2 0/2/2 and 0/2/3.
* Levels: isobaric (GRIB1 100, GRIB2 100) and native hybrid (109; 105, 118), the
  latter with pressure as a third field (GRIB1 1 or 54; GRIB2 0/3/0).
* Instantaneous fields only: averages, accumulations and differences are no
  wind at a time and are named as skipped.
* Winds at other levels (10 m, tropopause ...) are not profiles: they are
  counted, not used.
* Offsets in bytes, times in ns since 1970, leads in s, pressure in Pa.
"""

from __future__ import annotations

import calendar
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from airswing.reference.grids import UnplaceableGrid
from airswing.reference.gridsections import read_grid
from airswing.reference.octets import missing, signed, unsigned
from airswing.reference.packing import MAX_BITS

#: Kinds of field: eastward (along x) wind, northward (along y) wind, pressure.
U, V, PRESSURE = 0, 1, 2
#: Kinds of level.
ISOBARIC, HYBRID = 0, 1

#: One row a field. `section_*` are offsets in the file of the sections needed to read it
#: (-1: none): grid, product, packing, bitmap, data; GRIB1 has its product section under
#: `section_packing`, as decimal scaling stands there.
FIELD_DTYPE = np.dtype(
    [
        ("file", "i4"),
        ("offset", "i8"),
        ("length", "i8"),
        ("part", "i2"),
        ("edition", "i1"),
        ("kind", "i1"),
        ("level_kind", "i1"),
        ("level", "f8"),
        ("valid", "i8"),
        ("lead", "i8"),
        ("member", "i4"),
        ("grid", "i4"),
        ("packing", "i4"),
        ("sparse", "?"),
        ("section_identification", "i8"),
        ("section_grid", "i8"),
        ("section_product", "i8"),
        ("section_packing", "i8"),
        ("section_bitmap", "i8"),
        ("section_data", "i8"),
    ]
)

_HEAD = 512
_GRIB1_UNITS = {
    0: 60,
    1: 3600,
    2: 86400,
    10: 10800,
    11: 21600,
    12: 43200,
    13: 900,
    14: 1800,
    254: 1,
}
_GRIB2_UNITS = {0: 60, 1: 3600, 2: 86400, 10: 10800, 11: 21600, 12: 43200, 13: 1}
_RANGES = {2: "range", 3: "average", 4: "accumulation", 5: "difference", 6: "average", 7: "average"}


class Field(NamedTuple):
    """One row of `FIELD_DTYPE`; `grid` numbers `FileContents.grids`."""

    file: int
    offset: int
    length: int
    part: int
    edition: int
    kind: int
    level_kind: int
    level: float
    valid: int
    lead: int
    member: int
    grid: int
    packing: int
    sparse: bool
    section_identification: int
    section_grid: int
    section_product: int
    section_packing: int
    section_bitmap: int
    section_data: int


@dataclass(slots=True)
class FileContents:
    """What one file holds.

    Parameters
    ----------
    fields : list of Field
        Usable wind and pressure fields.
    grids : list of (edition, section bytes)
        Distinct grid sections, in order of appearance.
    skipped : Counter of (what, reason)
        What cannot be used and why, with counts.
    messages, parts : int
        Messages and fields of any kind.
    """

    fields: list[Field] = field(default_factory=list)
    grids: list[tuple[int, bytes]] = field(default_factory=list)
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    messages: int = 0
    parts: int = 0
    _known: dict[tuple[int, bytes], int] = field(default_factory=dict)

    def grid_number(self, edition: int, section: bytes) -> int:
        """Number of a grid section, placing it once; `UnplaceableGrid` where it cannot be."""
        key = (edition, section)
        if key not in self._known:
            read_grid(edition, section)
            self._known[key] = len(self.grids)
            self.grids.append(key)
        return self._known[key]

    def table(self) -> np.ndarray:
        """Fields as an array of `FIELD_DTYPE`."""
        return np.array([tuple(row) for row in self.fields], dtype=FIELD_DTYPE)


class _Skip(Exception):
    """One field or message that is not used: what, why."""

    def __init__(self, what: str, reason: str) -> None:
        super().__init__(what, reason)
        self.what, self.reason = what, reason


class _Garbage(Exception):
    """Octets that are no whole message."""


class _Window:
    """A file seen through small positioned reads."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.size = os.fstat(descriptor).st_size
        self.start, self.data = 0, b""

    def get(self, start: int, length: int) -> bytes:
        """`length` octets from `start`; fewer at the end of the file."""
        at = start - self.start
        if at < 0 or at + length > len(self.data):
            self.start, self.data = start, os.pread(self.descriptor, max(length, _HEAD), start)
            at = 0
        return self.data[at : at + length]


def scan_file(path: str) -> FileContents:
    """List the wind fields of a file.

    Parameters
    ----------
    path : str

    Returns
    -------
    FileContents

    Raises
    ------
    OSError
        Where the file cannot be opened or read.
    """
    contents = FileContents()
    descriptor = os.open(path, os.O_RDONLY)
    try:
        window = _Window(descriptor)
        for start, edition, length in _messages(window, path, contents.skipped):
            contents.messages += 1
            try:
                if edition == 1:
                    contents.parts += 1
                    _scan_grib1(window, start, length, contents)
                else:
                    _scan_grib2(window, start, length, contents)
            except (_Garbage, IndexError):
                contents.skipped["message", "garbage: section lengths do not add up"] += 1
    finally:
        os.close(descriptor)
    if contents.messages == 0:
        contents.skipped["file", "no whole GRIB message"] += 1
    return contents


def _messages(
    window: _Window, path: str, skipped: Counter[tuple[str, str]]
) -> Iterator[tuple[int, int, int]]:
    """Offset, edition and length of each whole message, over any garbage between."""
    at = 0
    while at < window.size:
        head = window.get(at, 16)
        if head[:4] != b"GRIB":
            at = _next_mark(window, at)
            if at < 0:
                return
            continue
        try:
            edition, length = _length(window, path, at, head)
        except _Garbage as reason:
            skipped["message", str(reason)] += 1
            at += 4
            continue
        yield at, edition, length
        at += length


def _next_mark(window: _Window, at: int) -> int:
    block = 1 << 16
    while at < window.size:
        data = os.pread(window.descriptor, block + 3, at)
        found = data.find(b"GRIB")
        if found >= 0:
            return at + found
        at += block
    return -1


def _length(window: _Window, path: str, at: int, head: bytes) -> tuple[int, int]:
    if len(head) < 16:
        raise _Garbage("truncated message")
    edition = head[7]
    if edition == 1:
        length = unsigned(head, 4, 3)
        if length & 0x800000:
            length = _length_by_eccodes(path, at)
    elif edition == 2:
        length = unsigned(head, 8, 8)
    else:
        raise _Garbage(f"garbage: GRIB edition {edition}")
    if at + length > window.size:
        raise _Garbage("truncated message")
    if length < 16 or os.pread(window.descriptor, 4, at + length - 4) != b"7777":
        raise _Garbage("garbage: no 7777 at the message's end")
    return edition, length


def _length_by_eccodes(path: str, at: int) -> int:
    """Length of a GRIB1 message above 8 MB, which counts in units of 120 octets."""
    import eccodes

    with open(path, "rb") as file:
        file.seek(at)
        try:
            handle = eccodes.codes_grib_new_from_file(file, headers_only=True)
        except eccodes.CodesInternalError as error:
            raise _Garbage(f"garbage: {error}") from error
        if handle is None:
            raise _Garbage("truncated message")
        try:
            return int(eccodes.codes_get(handle, "totalLength"))
        finally:
            eccodes.codes_release(handle)


@lru_cache(maxsize=4096)
def _nanoseconds(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int:
    if not (1 <= month <= 12 and 1 <= day <= calendar.monthrange(year, month)[1]):
        raise ValueError
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError
    return calendar.timegm((year, month, day, hour, minute, second)) * 1_000_000_000


def _reference_time(*parts: int) -> int:
    try:
        return _nanoseconds(*parts)
    except (ValueError, OverflowError):
        date = "{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}".format(*parts)
        raise _Skip("wind", f"impossible reference time {date}") from None


def _off_levels(kind: int, surface: int) -> _Skip:
    if kind == PRESSURE:
        return _Skip("", "")
    letter = "u" if kind == U else "v"
    return _Skip("wind", f"{letter} not on pressure levels (level type {surface})")


# ---------------------------------------------------------------- edition 1


def _kind_grib1(product: bytes) -> int | None:
    table, centre, parameter = product[3], product[4], product[8]
    if table == 128 and centre != 7:
        return {131: U, 132: V, 54: PRESSURE}.get(parameter)
    if table in (1, 2, 3) or (table in (130, 131) and centre == 7):
        return {33: U, 34: V, 1: PRESSURE}.get(parameter)
    return None


def _level_grib1(product: bytes, kind: int) -> tuple[int, float]:
    surface, value = product[9], unsigned(product, 10, 2)
    if surface == 100 and kind != PRESSURE:
        return ISOBARIC, value * 100.0
    if surface == 109:
        return HYBRID, float(value)
    raise _off_levels(kind, surface)


def _lead_grib1(product: bytes) -> int:
    unit, first, second, indicator = product[17], product[18], product[19], product[20]
    if indicator not in (0, 1, 10):
        name = _RANGES.get(indicator, "time range")
        raise _Skip("wind", f"not instantaneous: {name} (indicator {indicator})")
    if unit not in _GRIB1_UNITS:
        raise _Skip("wind", f"forecast time unit {unit}")
    steps = {0: first, 1: 0, 10: first * 256 + second}[indicator]
    return steps * _GRIB1_UNITS[unit]


def _scan_grib1(window: _Window, start: int, length: int, contents: FileContents) -> None:
    product = window.get(start + 8, 28)
    kind = _kind_grib1(product)
    if kind is None:
        return
    try:
        contents.fields.append(_field_grib1(window, start, length, kind, product, contents))
    except _Skip as skip:
        if skip.what:
            contents.skipped[skip.what, skip.reason] += 1


def _field_grib1(
    window: _Window, start: int, length: int, kind: int, product: bytes, contents: FileContents
) -> Field:
    level_kind, level = _level_grib1(product, kind)
    lead = _lead_grib1(product)
    century, year = product[24], product[12]
    base = _reference_time((century - 1) * 100 + year, *product[13:17], 0)
    flags = product[7]
    at = start + 8 + unsigned(product, 0, 3)
    if not flags & 0x80:
        number = product[6]
        raise _Skip("grid", f"no grid section (predefined grid {number})")
    grid_at, grid_section = at, _section1(window, at, start + length)
    at += len(grid_section)
    try:
        grid = contents.grid_number(1, grid_section)
    except UnplaceableGrid as error:
        raise _Skip("grid", str(error)) from None
    bitmap_at = -1
    if flags & 0x40:
        head, bitmap_at = window.get(at, 6), at
        if unsigned(head, 4, 2):
            raise _Skip("wind", f"predefined bitmap {unsigned(head, 4, 2)}")
        at += unsigned(head, 0, 3)
    data = window.get(at, 11)
    if len(data) < 11 or at + 11 > start + length:
        raise _Garbage
    packing = data[3] >> 4
    size = read_grid(1, grid_section).size
    whole = _fits(unsigned(data, 0, 3) - 11, data[10], size, bitmap_at)
    sparse = packing == 0 and data[10] <= MAX_BITS and whole
    return Field(
        file=0, offset=start, length=length, part=0, edition=1, kind=kind, level_kind=level_kind,
        level=level, valid=base + lead * 1_000_000_000, lead=lead, member=0, grid=grid,
        packing=packing, sparse=sparse, section_identification=-1, section_grid=grid_at,
        section_product=start + 8, section_packing=start + 8, section_bitmap=bitmap_at,
        section_data=at,
    )  # fmt: skip


def _section1(window: _Window, at: int, end: int) -> bytes:
    length = unsigned(window.get(at, 3), 0, 3)
    if length < 28 or at + length > end:
        raise _Garbage
    return window.get(at, length)


def _fits(octets: int, bits: int, size: int, bitmap_at: int) -> bool:
    """Whether a data section without a bitmap has room for every point."""
    return bitmap_at >= 0 or octets * 8 >= bits * size


# ---------------------------------------------------------------- edition 2


def _scan_grib2(window: _Window, start: int, length: int, contents: FileContents) -> None:
    discipline, end = window.get(start, 8)[6], start + length - 4
    sections: dict[int, int] = {}
    at, part, bitmap = start + 16, 0, -1
    while at < end:
        head = window.get(at, 6)
        size, number = unsigned(head, 0, 4), head[4]
        if size < 5 or at + size > end or number not in range(1, 8):
            raise _Garbage
        sections[number] = at
        if number == 6 and head[5] == 0:
            bitmap = at
        if number == 7:
            contents.parts += 1
            _scan_part(window, start, length, part, discipline, sections, bitmap, contents)
            part += 1
        at += size


def _scan_part(
    window: _Window,
    start: int,
    length: int,
    part: int,
    discipline: int,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> None:
    if not {1, 3, 4, 5, 6} <= sections.keys():
        raise _Garbage
    product = window.get(sections[4], 37)
    kind = {(2, 2): U, (2, 3): V, (3, 0): PRESSURE}.get((product[9], product[10]))
    if discipline != 0 or kind is None:
        return
    try:
        contents.fields.append(
            _field_grib2(window, start, length, part, kind, product, sections, bitmap, contents)
        )
    except _Skip as skip:
        if skip.what:
            contents.skipped[skip.what, skip.reason] += 1


def _level_grib2(product: bytes, kind: int) -> tuple[int, float]:
    surface, second = product[22], product[28]
    value = signed(product, 24, 4) * 10.0 ** -signed(product, 23, 1)
    if surface == 100 and second == 255 and kind != PRESSURE:
        return ISOBARIC, value
    if surface in (105, 118) and second == 255:
        return HYBRID, value
    raise _off_levels(kind, surface)


def _lead_grib2(product: bytes) -> int:
    template, unit = unsigned(product, 7, 2), product[17]
    if template in range(8, 15) or template in (42, 43, 46, 47, 61, 91):
        raise _Skip("wind", f"not instantaneous (product template 4.{template})")
    if template not in (0, 1, 2):
        raise _Skip("wind", f"product template 4.{template}")
    if template == 2 and product[34] not in (0, 1):
        raise _Skip("wind", f"ensemble statistic that is no mean (code {product[34]})")
    if unit not in _GRIB2_UNITS:
        raise _Skip("wind", f"forecast time unit {unit}")
    return signed(product, 18, 4) * _GRIB2_UNITS[unit]


def _field_grib2(
    window: _Window,
    start: int,
    length: int,
    part: int,
    kind: int,
    product: bytes,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> Field:
    level_kind, level = _level_grib2(product, kind)
    lead = _lead_grib2(product)
    stamp = window.get(sections[1], 19)
    base = _reference_time(unsigned(stamp, 12, 2), *stamp[14:19])
    grid_length = unsigned(window.get(sections[3], 4), 0, 4)
    section = window.get(sections[3], grid_length)
    try:
        grid = contents.grid_number(2, section)
    except UnplaceableGrid as error:
        raise _Skip("grid", str(error)) from None
    representation = window.get(sections[5], 21)
    packing, bits = unsigned(representation, 9, 2), representation[19]
    indicator = window.get(sections[6], 6)[5]
    bitmap_at = {255: -1, 0: sections[6], 254: bitmap}.get(indicator, -1)
    if indicator not in (0, 255) and bitmap_at < 0:
        raise _Skip("wind", f"predefined bitmap {indicator}")
    room = unsigned(window.get(sections[7], 4), 0, 4) - 5
    size = read_grid(2, section).size
    sparse = packing == 0 and bits <= MAX_BITS and _fits(room, bits, size, bitmap_at)
    member = product[35] if unsigned(product, 7, 2) == 1 and not missing(product, 35, 1) else 0
    return Field(
        file=0, offset=start, length=length, part=part, edition=2, kind=kind,
        level_kind=level_kind, level=level, valid=base + lead * 1_000_000_000, lead=lead,
        member=member, grid=grid, packing=packing, sparse=sparse,
        section_identification=sections[1], section_grid=sections[3],
        section_product=sections[4], section_packing=sections[5],
        section_bitmap=bitmap_at,
        section_data=sections[7],
    )  # fmt: skip
