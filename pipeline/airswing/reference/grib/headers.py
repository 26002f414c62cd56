"""Headers of GRIB files: where each wind field is, its level, time, grid and packing.

Reads lengths and fixed bytes of the sections only, some ten times faster than ecCodes, and checks
them against each other: an inconsistent message is skipped and named. u and v are known by
parameter; levels are isobaric, or native with pressure as a third field on the same levels. The
lowest value of a field is R 10^-D (WMO FM 92 regulation 92.9.4). Offsets in bytes from the start of
the file, counted from 0 (WMO tables: from 1); times in ns since 1970, leads in s, pressure in Pa.
"""

from __future__ import annotations

import calendar
import contextlib
import hashlib
import json
import math
import os
import struct
import sys
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.products.whole_files import code_digest
from airswing.reference.files import SourceFile, local_path
from airswing.reference.grib.grid_sections import read_grid, signed, unsigned
from airswing.reference.grids import UnplaceableGridError
from airswing.reference.state import DERIVED, FORECAST, grib_statistic
from airswing.reference.winds import HYBRID, ISOBARIC, MAX_PRESSURE, PRESSURE, U, V, limits

MAX_BITS = 57  # widest packed integer that one unaligned 64-bit load holds at any bit offset
PADDING = 16  # bytes a section may have beyond its values
_READ_BYTES, _SEARCHED = 512, 1 << 16  # read at once where a message begins, and between messages
_SPEED = -1  # kind of a wind speed or direction, which is counted
#: Kinds by parameter: of GRIB1 in ECMWF's table 128 and in WMO's code table 2, and of GRIB2.
_ECMWF_1 = {131: U, 132: V, 54: PRESSURE}
_WMO_1 = {33: U, 34: V, 1: PRESSURE, 31: _SPEED, 32: _SPEED}
_KINDS_2 = {(0, 2, 2): U, (0, 2, 3): V, (0, 3, 0): PRESSURE, (0, 2, 0): _SPEED, (0, 2, 1): _SPEED}
LENGTHS = "garbage: section lengths do not add up"
#: GRIB1 lengths from here on count in units of `_LARGE_UNIT` bytes (see `_large_length`).
_LARGE, _LARGE_UNIT = 0x800000, 120

_EARLIEST, _LATEST = -2_208_988_800, 4_102_444_800  # s since 1970: the years 1900 and 2100
_SHORTEST_LEAD, _LONGEST_LEAD = -86_400, 400 * 86_400  # s
_LARGEST_SCALE = 300  # beyond it a power of ten leaves the range of double precision
#: Seconds in a unit of time: GRIB1 code table 4, GRIB2 code table 4.4.
_UNITS = {0: 60, 1: 3600, 2: 86400, 10: 10800, 11: 21600, 12: 43200}
_UNITS_1, _UNITS_2 = {**_UNITS, 13: 900, 14: 1800, 254: 1}, {**_UNITS, 13: 1}
#: Level types on which pressure may be given: GRIB1 code table 3, GRIB2 code table 4.5.
_ISOBARIC_TYPE = 100
_NATIVE_1 = (103, 104, 105, 106, 107, 108, 109, 110, 111, 113, 119)
_HYBRID_1, _HYBRID_2 = (109, 110, 119), (105, 111, 118, 119)
_NATIVE_2 = (102, 103, 104, 105, 107, 111, 113, 118, 119, 150)
#: GRIB2: sections that may follow a section (WMO FM 92 table 1).
_NEXT = {0: (1,), 1: (2, 3), 2: (3,), 3: (4,), 4: (5,), 5: (6,), 6: (7,), 7: (2, 3, 4)}
_SHORTEST = {1: 21, 3: 14, 4: 34, 5: 11, 6: 6}  # bytes of every section of a number
#: GRIB2: bytes of sections 4 and 5 by template; templates with R, E and D at bytes 12 to 19.
_LENGTHS_4 = {0: 34, 1: 37, 2: 36, 60: 37}
_LENGTHS_5 = {0: 21, 2: 47, 3: 49, 4: 12, 40: 23, 41: 21, 42: 25, 40000: 23, 40010: 21}
_SCALED = (0, 2, 3, 40, 41, 42, 40000, 40010)
_SMALLEST_NORMAL = 2.0**-126  # ecCodes reads smaller reference values in another way


class Field(NamedTuple):
    """One field of a file, a row of `FIELD_DTYPE`; -1 if an offset or a number is absent."""

    offset: int  # of the message
    length: int
    edition: int
    kind: int  # U, V or PRESSURE
    level_kind: int  # ISOBARIC, HYBRID, else the level type
    level: float
    valid: int
    lead: int
    grid: int  # number in `FileContents.grids`
    points: int  # set by the catalogue, and the file
    file: int
    subindex: int  # number of the field in its message
    member: int
    sparse: bool  # values can be read at single points
    bits: int  # of the packed integers X of ``Y 10^D = R + X 2^E``
    binary_scale: int  # E
    decimal_scale: int  # D
    reference_value: float  # R
    bitmap: int  # offset of its first byte
    data_start: int  # of the packed values
    data_end: int


_FORMATS = "i8 i8 i1 i1 i2 f8 i8 i8 i4 i4 i4 i2 i4 ? i2 i4 i4 f8 i8 i8 i8"
FIELD_DTYPE = np.dtype(list(zip(Field._fields, _FORMATS.split(), strict=True)))


@dataclass(slots=True)
class FileContents:
    """Content of one file."""

    fields: list[Field] = field(default_factory=list)  # usable winds and pressures
    grids: list[tuple[int, bytes]] = field(default_factory=list)  # edition, distinct section
    skipped: Counter[tuple[str, str]] = field(default_factory=Counter)
    messages: int = 0

    def grid_number(self, edition: int, section: bytes) -> int:
        """Number of a grid section."""
        key = edition, section
        if key not in self.grids:
            try:
                read_grid(edition, section)
            except UnplaceableGridError as error:
                raise SkippedError("grid", str(error)) from None
            self.grids.append(key)
        return self.grids.index(key)

    def table(self) -> NDArray[np.void]:
        """Fields as an array of `FIELD_DTYPE`."""
        return np.array(self.fields, dtype=FIELD_DTYPE)


class SkippedError(Exception):
    """One field or message that is not used: its kind and the reason."""

    def __init__(self, kind: str, reason: str) -> None:
        super().__init__(kind, reason)
        self.kind, self.reason = kind, reason


class GarbageError(Exception):
    """Bytes that are not a whole message."""


Get = Callable[[int, int], bytes]
"""Reads a number of bytes from a place in a file; fewer at its end."""
Parts = Iterator[tuple[int | None, Callable[[int], Field]]]
"""For each field of a message its kind (None: another variable) and a reader of its other keys."""


def scan_file(path: str) -> FileContents:
    """List the wind and pressure fields of a file."""
    contents = FileContents()
    for get, start, edition, length in whole_messages(path, contents.skipped):
        contents.messages += 1
        before = len(contents.fields)
        parts = _parts_of_1 if edition == 1 else _parts_of_2
        try:
            for kind, field_of in parts(get, start, length, contents):
                if kind == _SPEED:
                    contents.skipped["wind", "wind speed or direction, not u and v"] += 1
                elif kind is not None:
                    try:
                        contents.fields.append(field_of(kind))
                    except SkippedError as skip:
                        if kind != PRESSURE or skip.kind != "wind":
                            contents.skipped[skip.kind, skip.reason] += 1
        except (GarbageError, LookupError, ValueError, ArithmeticError, struct.error) as reason:
            # no part of an inconsistent message is used
            del contents.fields[before:]
            stated = str(reason) if isinstance(reason, GarbageError) else ""
            contents.skipped["message", stated or LENGTHS] += 1
    if contents.messages == 0:
        contents.skipped["file", "no whole GRIB message"] += 1
    return contents


def whole_messages(
    path: str, skipped: Counter[tuple[str, str]]
) -> Iterator[tuple[Get, int, int, int]]:
    """A reader of the file, and offset, edition and length of each whole message in it.

    Incomplete messages are counted in `skipped`.
    """
    # small reads, because most of a message is not needed
    with open(path, "rb", buffering=_READ_BYTES) as file:

        def get(start: int, length: int) -> bytes:
            file.seek(start)
            return file.read(length)

        size, at = os.fstat(file.fileno()).st_size, 0
        while at < size:
            head = get(at, 16)
            if head[:4] != b"GRIB":
                ahead = get(at, _SEARCHED + 3).find(b"GRIB")
                at += ahead if ahead >= 0 else _SEARCHED
                continue
            try:
                edition, length = _length(get, at, head, size)
            except GarbageError as reason:
                skipped["message", str(reason)] += 1
                at += 4
                continue
            yield get, at, edition, length
            at += length


def _length(get: Get, at: int, head: bytes, size: int) -> tuple[int, int]:
    if len(head) < 16:
        raise GarbageError("truncated message")
    edition = head[7]
    if edition == 1:
        length = unsigned(head, 4, 3)
        if length & _LARGE:
            length = _large_length(get, at, length)
    elif edition == 2:
        length = unsigned(head, 8, 8)
    else:
        raise GarbageError(f"garbage: GRIB edition {edition}")
    if at + length > size:
        raise GarbageError("truncated message")
    if length < 16 or get(at + length - 4, 4) != b"7777":
        raise GarbageError("garbage: no 7777 at the message's end")
    return edition, length


def _large_length(get: Get, at: int, stated: int) -> int:
    """Length of a GRIB1 message above 8 MB, by ECMWF's convention.

    The message's length counts in units of 120 bytes, and the length of section 4 holds the excess,
    less than a unit. If section 4 states its length, that of the message is in bytes.
    """
    place, flags = at + 8, get(at + 15, 1)[0]
    for present in (0xFF, flags & 0x80, flags & 0x40):
        place += unsigned(get(place, 3), 0, 3) if present else 0
    rest = unsigned(get(place, 3), 0, 3)
    return stated if rest >= _LARGE_UNIT else (stated & ~_LARGE) * _LARGE_UNIT - rest + 4


def single_fields(message: bytes, edition: int) -> Iterator[tuple[bytes, dict[int, bytes]]]:
    """Each field of a message as a separate message, and its sections by number.

    GRIB1 holds one field; its sections are the product's (1) and the grid's (2), if present. In
    GRIB2 sections 2 to 7 may be repeated (regulation 92.1.5): a field has the last section of
    each number before its data; bitmap indicator 254 refers to the last bitmap that was given.
    """
    if edition == 1:
        product = message[8 : 8 + unsigned(message, 8, 3)]
        at = 8 + len(product)
        if len(product) < 28 or at > len(message) - 4:
            raise GarbageError
        grid = {2: message[at : at + unsigned(message, at, 3)]} if product[7] & 0x80 else {}
        yield message, {1: product, **grid}
        return
    for sections, bitmap in _sections_2(lambda at, n: message[at : at + n], 0, len(message)):
        content = {n: message[at : at + unsigned(message, at, 4)] for n, at in sections.items()}
        used = {**content}
        if content[6][5:6] == b"\xfe":
            shared = message[bitmap : bitmap + unsigned(message, bitmap, 4)]
            used[6] = shared if bitmap >= 0 else b"\x00\x00\x00\x06\x06\xff"
        body = b"".join([*(used[number] for number in sorted(used)), b"7777"])
        yield message[:8] + (16 + len(body)).to_bytes(8, "big") + body, content


def _sections_2(get: Get, start: int, length: int) -> Iterator[tuple[dict[int, int], int]]:
    """Offsets of the sections of each field by number, and of the last bitmap (-1: none)."""
    sections: dict[int, int] = {}
    at, end, bitmap, before = start + 16, start + length - 4, -1, 0
    while at < end:
        head = get(at, 6)
        size, number = unsigned(head, 0, 4), head[4]
        if size < _SHORTEST.get(number, 5) or at + size > end or number not in range(1, 8):
            raise GarbageError
        if number not in _NEXT[before]:
            raise GarbageError(f"garbage: section {number} after section {before}")
        sections[number], before = at, number
        if number == 6 and head[5] == 0:  # a bitmap, which 254 refers to later
            bitmap = at
        if number == 7:
            yield sections, bitmap
        at += size
    if at != end or before != 7:
        raise GarbageError


# GRIB edition 1


def _parts_of_1(get: Get, start: int, length: int, contents: FileContents) -> Parts:
    product = get(start + 8, max(28, min(unsigned(get(start + 8, 3), 0, 3), 80)))
    # bytes 4, 5 and 9; NCEP (centre 7) has another table 128
    table, centre, parameter = product[3], product[4], product[8]
    kind = None
    if table == 128 and centre != 7:
        kind = _ECMWF_1.get(parameter)
    elif table in (1, 2, 3) or (table in (130, 131) and centre == 7 and parameter not in (31, 32)):
        kind = _WMO_1.get(parameter)
    yield kind, lambda kind: _field_1(get, start, length, kind, product, contents)


def _field_1(
    get: Get, start: int, length: int, kind: int, product: bytes, contents: FileContents
) -> Field:
    # bytes 10 to 12: level; 18 to 21: unit, P1, P2 and time range (code table 5)
    surface, level = product[9], float(unsigned(product, 10, 2))
    level_kind = _level_kind(kind, surface, _NATIVE_1, _HYBRID_1)
    if surface in (104, 106, 108, 110):  # layers: the value of the upper boundary
        level = float(product[10])
    if surface == _ISOBARIC_TYPE:
        level *= 100.0
        _check_level(level)
    if reason := grib_statistic(1, {1: product}):
        raise SkippedError("wind", reason)
    unit, first, second, indicator = product[17:21]
    lead = {0: first, 1: 0, 10: first * 256 + second}[indicator] * _seconds(unit, _UNITS_1)
    # bytes 25 and 13 to 17: year 100 of a century is its last
    valid = _valid_time(lead, (product[24] - 1) * 100 + product[12], *product[13:17], 0)
    # ECMWF's local section: number of the ensemble member
    member = product[49] if product[4] == 98 and len(product) >= 50 and product[40] == 1 else 0
    end = start + length - 4
    at = start + 8 + _section_length(get, start + 8, end, 28)
    if not product[7] & 0x80:
        raise SkippedError("grid", f"no grid section (predefined grid {product[6]})")
    section = get(at, _section_length(get, at, end, 28))
    at += len(section)
    grid = contents.grid_number(1, section)
    size, bitmap = read_grid(1, section).size, -1
    if product[7] & 0x40:
        n_bytes, predefined = _section_length(get, at, end, 6), unsigned(get(at, 6), 4, 2)
        if predefined:
            raise SkippedError("message", f"predefined bitmap {predefined}")
        _check_bitmap(n_bytes - 6, size)
        bitmap, at = at + 6, at + n_bytes
    # section 4: length in bytes 1-3, flags in the upper half of 4, E in 5-6, R in 7-10, bits in 11
    data = get(at, 11)
    if len(data) < 11 or at + 11 > end:
        raise GarbageError
    n_bytes, packing, bits = unsigned(data, 0, 3), data[3] >> 4, data[10]
    stop = end if length >= _LARGE and n_bytes < _LARGE_UNIT else at + n_bytes
    if not at + 11 <= stop <= end:
        raise GarbageError
    if packing & 0x8:
        raise _damaged("spherical harmonics on a grid of points")
    if bits > 64:
        raise _damaged(f"{bits} bits a value")
    scale = bits, signed(data, 4, 2), signed(product, 26, 2), _ibm_float(unsigned(data, 6, 4))
    _check_lowest(kind, *scale[1:])
    if packing == 0 and bitmap < 0:
        _check_length(stop - at - 11, bits, size)
    leading = start, length, 1, kind, level_kind, level, valid, lead, grid
    place = -1, 0, 0, member  # points, file and subindex
    sparse = packing == 0 and bits <= MAX_BITS
    return Field(*leading, *place, sparse, *scale, bitmap, at + 11, stop)


def _section_length(get: Get, at: int, end: int, least: int) -> int:
    length = unsigned(get(at, 3), 0, 3)
    if length < least or at + length > end:
        raise GarbageError
    return length


# GRIB edition 2


def _parts_of_2(get: Get, start: int, length: int, contents: FileContents) -> Parts:
    discipline = get(start, 8)[6]
    for subindex, (sections, bitmap) in enumerate(_sections_2(get, start, length)):
        product = get(sections[4], 37)
        # bytes 10 and 11: category and number (code table 4.2 of discipline 0)
        kind, place = _KINDS_2.get((discipline, product[9], product[10])), (start, length, subindex)
        yield kind, partial(_field_2, get, product, sections, bitmap, contents, place)


def _field_2(
    get: Get,
    product: bytes,
    sections: dict[int, int],
    last_bitmap: int,
    contents: FileContents,
    place: tuple[int, int, int],
    kind: int,
) -> Field:
    # bytes 23 to 28 and 29: the first fixed surface, its scaled value; type of the second
    surface, second = product[22], product[28]
    level_kind = _level_kind(kind, surface, _NATIVE_2, _HYBRID_2)
    level = signed(product, 24, 4) * 10.0 ** -signed(product, 23, 1)
    if second not in (255, surface if surface != _ISOBARIC_TYPE else 255):
        raise SkippedError("wind", f"{'uvp'[kind]} of a layer (level types {surface}, {second})")
    if surface == _ISOBARIC_TYPE:
        _check_level(level)
    identification = get(sections[1], 21)
    local = get(sections[2], 13) if 2 in sections else b""
    if reason := grib_statistic(2, {1: identification, 2: local, 4: product}):
        raise SkippedError("wind", reason)
    template, n_bytes = unsigned(product, 7, 2), unsigned(product, 0, 4)
    if n_bytes < _LENGTHS_4[template]:
        raise _damaged(f"section 4 of {n_bytes} bytes for template 4.{template}")
    lead = signed(product, 18, 4) * _seconds(product[17], _UNITS_2)
    # bytes 13-14 year, then month, day, hour, minute, second
    valid = _valid_time(lead, unsigned(identification, 12, 2), *identification[14:19])
    section = get(sections[3], unsigned(get(sections[3], 4), 0, 4))
    grid, size = contents.grid_number(2, section), read_grid(2, section).size
    if unsigned(section, 6, 4) != size:
        raise _damaged(f"{unsigned(section, 6, 4):,} data points on a grid of {size:,}")
    indicator = get(sections[6], 6)[5]
    bitmap = {255: -1, 0: sections[6], 254: last_bitmap}.get(indicator, -1)
    if indicator != 255 and bitmap < 0:
        raise SkippedError("message", f"predefined bitmap {indicator}")
    if bitmap >= 0:
        _check_bitmap(unsigned(get(bitmap, 4), 0, 4) - 6, size)
    numbered = template not in (FORECAST, DERIVED) and product[35] != 255
    start, end = sections[7] + 5, sections[7] + unsigned(get(sections[7], 4), 0, 4)
    packed = get(sections[5], 21)
    n_bytes, packing, coded = unsigned(packed, 0, 4), unsigned(packed, 9, 2), unsigned(packed, 5, 4)
    if n_bytes < _LENGTHS_5.get(packing, 0):
        raise _damaged(f"section 5 of {n_bytes} bytes for template 5.{packing}")
    # fewer values than points if a bitmap leaves some out
    if coded > size or (coded != size and bitmap < 0):
        raise _damaged(f"{coded:,} values on a grid of {size:,} points")
    scale, sparse = (0, 0, 0, 0.0), False
    if packing in _SCALED:
        reference, bits = float(struct.unpack_from(">f", packed, 11)[0]), packed[19]
        scale = bits, signed(packed, 15, 2), signed(packed, 17, 2), reference
        _check_lowest(kind, *scale[1:])
        if bits > (64 if packing == 0 else 38):
            raise _damaged(f"{bits} bits a value")
        if packing == 0:
            _check_length(end - start, bits, coded)
            usual = reference == 0.0 or abs(reference) >= _SMALLEST_NORMAL
            sparse = usual and bits <= MAX_BITS
    member = product[35] if numbered else 0
    bitmap = bitmap + 6 if bitmap >= 0 else -1
    first, length, subindex = place
    leading = first, length, 2, kind, level_kind, level, valid, lead, grid
    at = -1, 0, subindex, member  # points, file and subindex
    return Field(*leading, *at, sparse, *scale, bitmap, start, end)


# both editions


def _ibm_float(word: int) -> float:
    """IBM single-precision float: sign, exponent of 16 (excess 64), 24-bit fraction."""
    value = float(word & 0xFFFFFF) * 16.0 ** (((word >> 24) & 0x7F) - 70)
    return -value if word >> 31 else value


def _damaged(reason: str) -> SkippedError:
    return SkippedError("message", f"damaged: {reason}")


def _level_kind(kind: int, surface: int, native: tuple[int, ...], hybrid: tuple[int, ...]) -> int:
    if surface == _ISOBARIC_TYPE and kind != PRESSURE:
        return ISOBARIC
    if surface in native:
        return HYBRID if surface in hybrid else surface
    raise SkippedError("wind", off_levels(kind, surface))


def off_levels(kind: int, surface: int) -> str:
    """Reason why a wind on levels of a type is not used."""
    return f"{'uvp'[kind]} not on pressure levels (level type {surface})"


def _check_level(pressure: float) -> None:
    if not 0.0 < pressure <= MAX_PRESSURE:
        raise _damaged(f"pressure level of {pressure / 100.0:g} hPa")


def _check_length(n_bytes: int, bits: int, values: int) -> None:
    needed = (bits * values + 7) // 8
    if n_bytes < needed:
        raise _damaged("data section too short for its grid")
    if n_bytes > needed + PADDING and bits:
        raise _damaged("data section longer than its grid and its bits a value need")


def _check_lowest(kind: int, binary: int, decimal: int, reference: float) -> None:
    if max(abs(binary), abs(decimal)) > _LARGEST_SCALE:
        raise _damaged("impossible scale factors")
    lowest, (low, high) = reference * 10.0**-decimal, limits(kind)
    if not (math.isfinite(lowest) and low <= lowest <= high):
        unit = "Pa" if kind == PRESSURE else "m/s"
        raise _damaged(f"lowest value of a field outside {low:g} to {high:g} {unit}")


def _check_bitmap(n_bytes: int, points: int) -> None:
    if not 0 <= n_bytes - (points + 7) // 8 <= PADDING:
        raise _damaged("a bitmap of another size than its grid")


def _seconds(unit: int, units: dict[int, int]) -> int:
    if unit not in units:
        raise SkippedError("wind", f"forecast time unit {unit}")
    return units[unit]


@lru_cache(maxsize=4096)  # the messages of a file share a few times, and the calendar is slow
def _valid_time(
    lead: int, year: int, month: int, day: int, hour: int, minute: int, second: int
) -> int:
    """Valid time (ns since 1970) of a lead (s) and a base time."""
    parts = year, month, day, hour, minute, second
    try:
        if not 1 <= day <= calendar.monthrange(year, month)[1]:
            raise ValueError
        if hour > 24 or minute > 59 or second > 60:
            raise ValueError
        base = calendar.timegm(parts)
    except (ValueError, OverflowError):
        date = "{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}".format(*parts)
        raise _damaged(f"impossible reference time {date}") from None
    if not _EARLIEST <= base < _LATEST:
        raise _damaged("base time not of the years 1900 to 2100")
    if not _SHORTEST_LEAD <= lead <= _LONGEST_LEAD:
        raise _damaged(f"lead time of {lead / 86_400:,.0f} days")
    return (base + lead) * 1_000_000_000


# cache


def contents_of(
    files: Sequence[SourceFile], folder: str | os.PathLike[str] | None = None
) -> Iterator[FileContents | OSError | InputError]:
    """Contents of files in turn, from a cache or a scan; the error if a file is unreadable.

    The cache is by default in ``AIRSWING_CACHE``, else the system's cache folder; one entry for
    each file, valid for its path, size, modification time and a sample of its bytes, and for the
    code that read it. A damaged entry is replaced; a folder that cannot be written causes one
    warning and a longer run.
    """
    cache = (Path(folder) if folder is not None else _default_folder()) / "grib-headers"
    cached, writable = set[str](), False
    with contextlib.suppress(OSError):
        cache.mkdir(parents=True, exist_ok=True)
        cached, writable = set(os.listdir(cache)), os.access(cache, os.W_OK)
    if not writable:
        text = f"cache folder {cache} cannot be written: GRIB headers are read again"
        warnings.warn(text, stacklevel=2)
    for file in files:
        key = "\0".join([*map(str, file), code_digest()]).encode()
        entry, contents = cache / hashlib.blake2b(key, digest_size=16).hexdigest(), None
        if entry.name in cached:
            with contextlib.suppress(OSError, zlib.error, ValueError, TypeError):
                fields, grids, skipped, messages = json.loads(zlib.decompress(entry.read_bytes()))
                contents = FileContents(
                    [Field(*row) for row in fields],
                    [(edition, bytes.fromhex(section)) for edition, section in grids],
                    Counter({(kind, why): count for kind, why, count in skipped}),
                    messages,
                )
        if contents is None:
            try:
                contents = scan_file(local_path(file.path))
            except (OSError, InputError) as error:
                yield error
                continue
            grids = [(edition, section.hex()) for edition, section in contents.grids]
            skipped = [(*reason, count) for reason, count in contents.skipped.items()]
            content = contents.fields, grids, skipped, contents.messages
            if writable:
                with contextlib.suppress(OSError):
                    entry.write_bytes(zlib.compress(json.dumps(content).encode(), 1))
        yield contents


def _default_folder() -> Path:
    named = os.environ.get("AIRSWING_CACHE")
    if named:
        return Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "airswing"
    root = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    return Path(root or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "airswing"
