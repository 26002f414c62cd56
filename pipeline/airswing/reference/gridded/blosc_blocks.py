"""The blocks of a Blosc chunk that hold what is wanted, and no others.

Blosc cuts a chunk into blocks and compresses each alone. Blocks that are wanted are put together
to shorter Blosc chunks, which the library expands as it does any: whatever its compressors and
shuffles do stays its own matter.

Source: README_CHUNK_FORMAT.rst of c-blosc 1.21 (format version 2): sixteen octets of header, then
where each block begins, then the blocks in any order.

Assumptions and validity
------------------------
* Chunks of Blosc 1 (format version 2), which Zarr has; what is stored plainly, and what needs all
  its blocks, is given to the library whole.
* The last block of a chunk may be shorter and is then packed otherwise: it is expanded with the
  one before it.
"""

from __future__ import annotations

import io
import os
import struct

import numpy as np
from numcodecs import blosc  # type: ignore[import-untyped]
from numpy.typing import NDArray

Octets = NDArray[np.uint8]
Ints = NDArray[np.int64]

_HEADER = struct.Struct("<4B3I")
_STORED = 0x2
"""Flag of a chunk that is not compressed."""


def expand_blocks(file: io.FileIO, size: int, wanted: Ints) -> Octets:
    """Expand what holds some octets of a Blosc chunk.

    Parameters
    ----------
    file : raw binary file
        The chunk.
    size : int
        Octets of the expanded chunk.
    wanted : (n,) int array, n > 0
        Which of them are wanted.

    Returns
    -------
    (size,) uint8 array
        The other blocks hold anything.

    Raises
    ------
    ValueError, RuntimeError
        The chunk is damaged.
    """
    length = os.fstat(file.fileno()).st_size
    start = _part(file, 0, _HEADER.size)
    if len(start) < _HEADER.size:
        raise ValueError(f"a Blosc chunk of {len(start)} octets")
    *marks, expanded, block, stored = _HEADER.unpack(start)
    if expanded != size or stored > length or not block:
        raise ValueError(f"a Blosc chunk of {length} octets that says {stored} and {expanded}")
    count = -(-size // block)
    needed = np.unique(wanted // block)
    if size % block and needed[-1] == count - 1 > 0:
        needed = np.union1d(needed, count - 2)
    out = np.empty(size, dtype=np.uint8)
    if marks[2] & _STORED or needed.size == count:
        return blosc.decompress(_part(file, 0, stored), out)  # type: ignore[no-any-return]
    begins = np.frombuffer(_part(file, _HEADER.size, 4 * count), "<u4").astype(np.int64)
    if begins.min() < _HEADER.size + 4 * count or begins.max() >= stored:
        raise ValueError("a Blosc chunk whose blocks do not lie in it")
    ends = np.append(np.sort(begins), stored)
    ends = ends[np.searchsorted(ends, begins, side="right")]
    for run in np.split(needed, np.flatnonzero(np.diff(needed) > 1) + 1):
        parts = [_part(file, int(begins[n]), int(ends[n] - begins[n])) for n in run]
        into = out[run[0] * block : (run[-1] + 1) * block]
        blosc.decompress(_chunk(marks, into.size, block, parts), into)
    return out


def _part(file: io.FileIO, begin: int, length: int) -> bytes:
    file.seek(begin)
    return file.read(length)


def _chunk(marks: list[int], expanded: int, block: int, parts: list[bytes]) -> bytes:
    """A Blosc chunk of some blocks."""
    first = _HEADER.size + 4 * len(parts)
    begins = first + np.cumsum([0, *map(len, parts)])
    header = _HEADER.pack(*marks, expanded, block, int(begins[-1]))
    return b"".join([header, begins[:-1].astype("<u4").tobytes(), *parts])
