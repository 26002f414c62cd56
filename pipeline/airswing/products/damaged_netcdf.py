"""Refuses damaged NetCDF files before their library reads them.

The NetCDF library believes the header of a classic file: a wrong count of records gives records
that are not there, as zeros. The HDF5 library follows whatever the bytes of a damaged NetCDF-4 file
say: it may never end, or end the process; such files are opened in a worker process first
(:mod:`airswing.guarded`).

Assumptions and validity
------------------------
* NetCDF classic, 64-bit offset and 64-bit data (CDF-1, 2 and 5), laid out as in the NetCDF Classic
  Format Specification (Unidata, file format specifications, 2024).
* A last record may lack its padding of up to three bytes, as some programs write it.
* A NetCDF-4 file that the worker process has described without fault can be opened here. A file
  this process wrote, and has not been changed since, is sound.
* Data are not read: each packed chunk carries a checksum that the HDF5 library checks.
"""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import BinaryIO

from airswing.errors import InputError
from airswing.guarded import WorkerEndedError, guarded

DAMAGE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What the libraries raise on a file whose bytes contradict each other."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SOUND: set[tuple[str, int, int]] = set()
# Bytes of a value by type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
# Tags of the header's three lists (NetCDF classic format specification).
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_MOST = 100_000  # Entries of a list; no file has as many
# Bytes: the last variable may lack its padding to a multiple of four.
_PADDING = 3
# Number of records where the writer did not state it.
_STREAMING = (0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF)


class _ShortError(Exception):
    """The header does not hold what it says."""


def require_sound(path: Path) -> None:
    """Refuse a damaged NetCDF file; files of other kinds pass.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        Saying what is damaged.
    """
    with path.open("rb") as file:
        start = file.read(len(_HDF5))
    if start.startswith(b"CDF"):
        _require_whole(path)
    elif start == _HDF5 and _identity(path) not in _SOUND:
        try:
            wrong = guarded(_described, str(path.absolute()))
        except WorkerEndedError:
            wrong = "opening it ends the process, or does not end"
        if wrong:
            raise InputError("cannot be opened: a damaged NetCDF file", file=path, found=wrong)
        _SOUND.add(_identity(path))


def written_here(path: Path) -> None:
    """Note that this process has written a file, whole."""
    _SOUND.add(_identity(path))


def _identity(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.absolute()), status.st_size, status.st_mtime_ns


def _described(path: str) -> str:
    """Open a NetCDF-4 file and look at every description in it; what is wrong, or nothing."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            groups = [file]
            for group in groups:
                groups += group.groups.values()
                for name in group.ncattrs():
                    group.getncattr(name)
                for variable in group.variables.values():
                    _ = (variable.shape, variable.dtype, variable.chunking(), variable.filters())
                    for name in variable.ncattrs():
                        variable.getncattr(name)
    except DAMAGE as error:
        return f"{type(error).__name__}: {error}"[:300]
    return ""


def _require_whole(path: Path) -> None:
    """Refuse a classic file whose header describes more than the file holds."""
    size = os.stat(path).st_size
    with path.open("rb") as file:
        file.seek(3)
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
            f"cannot be opened: damaged, {needed:,} bytes by its header, of which {size:,} are "
            "there",
            file=path,
            found=f"{records:,} records",
        )


class _Header:
    """Numbers and names of a header, one after the other."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.version = self._read(1)[0]
        # classic, 64-bit offset, and CDF-5
        if self.version not in (1, 2, 5):
            raise _ShortError(f"format {self.version}")

    def _read(self, count: int) -> bytes:
        found = self._file.read(count)
        if len(found) < count:
            raise _ShortError("it ends in its header")
        return found

    def word(self) -> int:
        return int(struct.unpack(">I", self._read(4))[0])

    def count(self) -> int:
        """A count or a length: of eight bytes from CDF-5 on."""
        return self._double() if self.version == 5 else self.word()

    def offset(self) -> int:
        """Place in the file: of eight bytes from CDF-2 on."""
        return self._double() if self.version != 1 else self.word()

    def _double(self) -> int:
        return int(struct.unpack(">Q", self._read(8))[0])

    def skip(self, length: int) -> None:
        """Pass over a name or values, with their padding to four bytes."""
        if length > _MOST * 100:
            raise _ShortError(f"a text of {length:,} bytes")
        self._read(length + -length % 4)

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
    """Bytes that the variables reach to, and the count of records."""
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
        # A single variable of records has no padding between them.
        stride = record[0] if len(record) == 1 else sum(one + -one % 4 for one in record)
        last = max(begin + length for begin, length in zip(first, record, strict=True))
        end = max(end, last + (records - 1) * stride)
    return end, records


def _few(count: int) -> int:
    # NC_MAX_VAR_DIMS of the library: more is damage
    if count > 1024:
        raise _ShortError(f"a variable of {count:,} dimensions")
    return count
