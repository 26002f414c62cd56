"""Refuses damaged NetCDF files before their library reads them.

The NetCDF library does not check the header of a classic file: a wrong count of records gives
absent records as zeros. The HDF5 library may hang, or end the process, on a damaged file; such
files are opened in a worker process first, if this process has not written them. Classic files
(CDF-1, 2 and 5) are laid out as in the NetCDF Classic Format Specification (Unidata, 2024).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import BinaryIO

from airswing.errors import InputError
from airswing.guarded import WorkerEndedError, guarded

DAMAGE = (
    *(ArithmeticError, AttributeError, LookupError, OSError),
    *(RuntimeError, TypeError, ValueError),
)
"""Exceptions that the libraries raise on a damaged file."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SOUND: set[tuple[str, int, int]] = set()
# Bytes of a value by the type's code in the header, and tags of the header's three lists.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_MOST = 10_000_000  # entries of a list or values of an attribute, more than any file has
_PADDING = 3  # bytes: the last variable may lack its padding to a multiple of four
# Number of records where the writer did not state it.
_STREAMING = (0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF)


def require_sound(path: Path) -> None:
    """Refuse a damaged NetCDF file with the reason; files of other kinds pass."""
    with path.open("rb") as file:
        start = file.read(len(_HDF5))
        if start.startswith(b"CDF"):
            file.seek(0)
            try:
                needed, records = _extent(file)
            except (LookupError, ValueError) as error:
                raise InputError(
                    "cannot be opened: damaged, its NetCDF header is inconsistent",
                    file=path,
                    found=error,
                ) from error
            if needed > path.stat().st_size + _PADDING:
                raise InputError(
                    f"cannot be opened: damaged, {needed:,} bytes by its header, of which "
                    f"{path.stat().st_size:,} are there",
                    file=path,
                    found=f"{records:,} records",
                )
    if start == _HDF5 and _identity(path) not in _SOUND:
        try:
            fault = guarded(_fault, str(path.absolute()))
        except WorkerEndedError:
            fault = "opening it ends the process, or never returns"
        if fault:
            raise InputError("cannot be opened: a damaged NetCDF file", file=path, found=fault)
        written_here(path)


def written_here(path: Path) -> None:
    """Record that this process has written or checked a file, which is then not checked again."""
    _SOUND.add(_identity(path))


def _identity(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.absolute()), status.st_size, status.st_mtime_ns


def _fault(path: str) -> str:
    """Open a NetCDF-4 file and read every description in it; message of the first error."""
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


def _extent(file: BinaryIO) -> tuple[int, int]:
    """End of the variables of a classic file in bytes, and the number of records.

    A ValueError or LookupError is raised where the header is inconsistent or ends early.
    """

    def number(length: int = 4) -> int:
        content = file.read(length)
        if len(content) < length:
            raise ValueError("it ends in its header")
        return int.from_bytes(content, "big")

    def length() -> int:
        size = number(wide)
        if size > _MOST:
            raise ValueError(f"a list of {size:,} entries")
        return size

    def skip(bytes_of_each: int = 1) -> None:  # names and values are padded to four bytes
        size = bytes_of_each * length()
        number(size + -size % 4)

    def entries(tag: int) -> range:
        kind, size = number(), length()
        if kind not in (0, tag) or (kind == 0 and size):
            raise ValueError("a list of an unexpected kind")
        return range(size)

    def attributes() -> None:
        for _ in entries(_ATTRIBUTE):
            skip()
            skip(_SIZES[number()])

    version = number() & 0xFF
    if version not in (1, 2, 5):  # classic, 64-bit offset, CDF-5
        raise ValueError(f"format {version}")
    wide = 8 if version == 5 else 4
    records, sizes = number(wide), []
    for _ in entries(_DIMENSION):
        skip()
        sizes.append(number(wide))
    attributes()
    end, rows = 0, []
    for _ in entries(_VARIABLE):
        skip()
        dims = [number(wide) for _ in range(length())]
        attributes()
        value_bytes, _, begin = _SIZES[number()], number(wide), number(4 if version == 1 else 8)
        shape = [sizes[dim] for dim in dims]
        if shape and shape[0] == 0:  # the record dimension
            rows.append((begin, value_bytes * math.prod(shape[1:])))
        else:
            end = max(end, begin + value_bytes * math.prod(shape))
    if rows and records and records not in _STREAMING:
        # A single variable of records has no padding between them.
        step = sum(size + -size % 4 * (len(rows) > 1) for _, size in rows)
        end = max(end, max(begin + size for begin, size in rows) + (records - 1) * step)
    return end, records
