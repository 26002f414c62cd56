"""The header of a classic NetCDF file held against the file's size, before anything is read.

The library believes a header: one wrong octet in the count of records, and it gives millions of
records that are not there, as zeros.

Assumptions and validity
------------------------
* NetCDF classic, 64-bit offset and 64-bit data (CDF-1, 2 and 5), laid out as the NetCDF Classic
  Format Specification has it (Unidata, file format specifications, 2024).
* A last record may lack its padding of up to three octets, as some programs write it.
"""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import BinaryIO

from airswing.errors import InputError

# Octets of a value by type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
# Tags of the header's three lists (NetCDF classic format specification).
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_MOST = 100_000  # Entries of a list; no file has as many
# Octets: the last variable may stand without its padding to a multiple of four.
_PADDING = 3
# Number of records of a file whose writer did not come to say it.
_STREAMING = (0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF)


class _ShortError(Exception):
    """The header does not hold what it says."""


def require_whole(path: Path) -> None:
    """Refuse a classic NetCDF file whose header says more than the file holds; pass other kinds.

    Raises
    ------
    InputError
        Naming octets by the header and octets there.
    """
    size = os.stat(path).st_size
    with path.open("rb") as file:
        if file.read(3) != b"CDF":
            return
        try:
            needed, records = _extent(_Header(file))
        except (_ShortError, struct.error) as error:
            raise InputError(
                "cannot be opened: damaged, its NetCDF header does not hold together",
                file=path,
                found=error,
            ) from error
    if needed > size + _PADDING:
        raise InputError(
            "cannot be opened: damaged, "
            f"{needed:,} octets by its header, of which {size:,} are there",
            file=path,
            found=f"{records:,} records",
        )


class _Header:
    """Numbers and names of a header, one after the other."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.version = self._octets(1)[0]
        # classic, 64-bit offset, and CDF-5
        if self.version not in (1, 2, 5):
            raise _ShortError(f"format {self.version}")

    def _octets(self, count: int) -> bytes:
        found = self._file.read(count)
        if len(found) < count:
            raise _ShortError("it ends in its header")
        return found

    def word(self) -> int:
        return int(struct.unpack(">I", self._octets(4))[0])

    def count(self) -> int:
        """A count or a length: of eight octets from CDF-5 on."""
        return self._double() if self.version == 5 else self.word()

    def offset(self) -> int:
        """Place in the file: of eight octets from CDF-2 on."""
        return self._double() if self.version != 1 else self.word()

    def _double(self) -> int:
        return int(struct.unpack(">Q", self._octets(8))[0])

    def skip(self, octets: int) -> None:
        """Pass over a name or values, with their padding to four octets."""
        if octets > _MOST * 100:
            raise _ShortError(f"a text of {octets:,} octets")
        self._octets(octets + -octets % 4)

    def entries(self, tag: int) -> int:
        """How many entries a list has."""
        found, count = self.word(), self.count()
        if found not in (0, tag) or (found == 0 and count) or count > _MOST:
            raise _ShortError("a list of another kind than should follow")
        return count

    def attributes(self) -> None:
        for _ in range(self.entries(_ATTRIBUTE)):
            self.skip(self.count())
            kind, count = self.word(), self.count()
            if kind not in _SIZES:
                raise _ShortError(f"values of type {kind}")
            self.skip(_SIZES[kind] * count)


def _extent(header: _Header) -> tuple[int, int]:
    """Octets that the variables reach to, and the count of records."""
    records = header.count()
    sizes = []
    for _ in range(header.entries(_DIMENSION)):
        header.skip(header.count())
        sizes.append(header.count())
    header.attributes()
    end, record, first = 0, [], []
    for _ in range(header.entries(_VARIABLE)):
        header.skip(header.count())
        dims = [header.count() for _ in range(_few(header.count()))]
        header.attributes()
        kind, _, begin = header.word(), header.count(), header.offset()
        if kind not in _SIZES or any(number >= len(sizes) for number in dims):
            raise _ShortError("a variable of no known type or dimension")
        shape = [sizes[number] for number in dims]
        if shape and shape[0] == 0:  # the record dimension
            record.append(_SIZES[kind] * math.prod(shape[1:]))
            first.append(begin)
        else:
            end = max(end, begin + _SIZES[kind] * math.prod(shape))
    if record and records and records not in _STREAMING:
        # A single variable of records stands without padding between them.
        stride = record[0] if len(record) == 1 else sum(one + -one % 4 for one in record)
        last = max(begin + own for begin, own in zip(first, record, strict=True))
        end = max(end, last + (records - 1) * stride)
    return end, records


def _few(count: int) -> int:
    # NC_MAX_VAR_DIMS of the library: more is damage
    if count > 1024:
        raise _ShortError(f"a variable of {count:,} dimensions")
    return count
