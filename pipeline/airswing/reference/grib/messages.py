"""What a GRIB file holds, read from its octets: nothing is decoded.

Lengths and fixed octets of GRIB1 and GRIB2 say where each wind field is,
which level, time, grid and packing it has, and are held against each other
(`airswing.reference.grib.consistency`): what contradicts itself is skipped and named.

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

import errno
import os
import struct
from collections import Counter
from collections.abc import Iterator

from airswing.reference.grib.edition1 import LARGE, LARGE_UNIT, scan_grib1
from airswing.reference.grib.edition2 import scan_grib2
from airswing.reference.grib.fields import FileContents, GarbageError, Window
from airswing.reference.packing.octets import unsigned

# What octets that contradict each other lead to.
_LYING = (GarbageError, LookupError, ValueError, ArithmeticError, struct.error)


def scan_file(path: str) -> FileContents:
    """List the wind fields of a file.

    Raises
    ------
    OSError
        Where the file cannot be opened or read.
    """
    contents = FileContents()
    descriptor = os.open(path, os.O_RDONLY)
    try:
        window = Window(descriptor)
        for start, edition, length in whole_messages(window, contents.skipped):
            contents.messages += 1
            before = len(contents.fields)
            try:
                if edition == 1:
                    contents.parts += 1
                    scan_grib1(window, start, length, contents)
                else:
                    scan_grib2(window, start, length, contents)
            except _LYING as reason:
                # All or nothing: of a message that contradicts itself no part is used.
                del contents.fields[before:]
                told = str(reason) if isinstance(reason, GarbageError) else ""
                told = told or "garbage: section lengths do not add up"
                contents.skipped["message", told] += 1
    finally:
        os.close(descriptor)
    if contents.messages == 0:
        contents.skipped["file", "no whole GRIB message"] += 1
    return contents


def whole_messages(
    window: Window, skipped: Counter[tuple[str, str]]
) -> Iterator[tuple[int, int, int]]:
    """Offset, edition and length of each whole message, over any garbage between.

    What was passed over goes into ``skipped``.
    """
    at = 0
    while at < window.size:
        head = window.get(at, 16)
        if head[:4] != b"GRIB":
            at = _next_mark(window, at)
            if at < 0:
                return
            continue
        try:
            edition, length = _length(window, at, head)
        except GarbageError as reason:
            skipped["message", str(reason)] += 1
            at += 4
            continue
        yield at, edition, length
        at += length


def _next_mark(window: Window, at: int) -> int:
    block = 1 << 16
    while at < window.size:
        at = _data(window, at)
        # Three octets more than a block: the mark may lie across its end.
        data = os.pread(window.descriptor, block + 3, at)
        found = data.find(b"GRIB")
        if found >= 0:
            return at + found
        at += block
    return -1


def _data(window: Window, at: int) -> int:
    """First octet from a place on that is no hole of a sparse file."""
    if not hasattr(os, "SEEK_DATA"):
        return at
    try:
        # over holes of a sparse file in one step: a copy that broke off may be gigabytes of
        # nothing
        return os.lseek(window.descriptor, at, os.SEEK_DATA)
    except OSError as error:
        # no data to the end; any other error is a file system that does not know of holes
        return window.size if error.errno == errno.ENXIO else at


def _length(window: Window, at: int, head: bytes) -> tuple[int, int]:
    if len(head) < 16:
        raise GarbageError("truncated message")
    edition = head[7]
    if edition == 1:
        length = unsigned(head, 4, 3)
        if length & LARGE:
            length = _large(window, at, length)
    elif edition == 2:
        length = unsigned(head, 8, 8)
    else:
        raise GarbageError(f"garbage: GRIB edition {edition}")
    if at + length > window.size:
        raise GarbageError("truncated message")
    if length < 16 or window.get(at + length - 4, 4) != b"7777":
        raise GarbageError("garbage: no 7777 at the message's end")
    return edition, length


def _large(window: Window, at: int, stated: int) -> int:
    """Length of a GRIB1 message above 8 MB.

    The European centre's custom: the message's length counts in units of 120 octets, and the
    length of section 4 holds what is too much in that, less than a unit. Where section 4 states
    a length of its own, the message's is meant as it stands.
    """
    place, flags = at + 8, window.get(at + 15, 1)[0]
    for present in (0xFF, flags & 0x80, flags & 0x40):
        place += unsigned(window.get(place, 3), 0, 3) if present else 0
    rest = unsigned(window.get(place, 3), 0, 3)
    if rest >= LARGE_UNIT:
        return stated
    return (stated & ~LARGE) * LARGE_UNIT - rest + 4
