"""The blocks of a Blosc chunk that hold what is wanted, and no others.

Blosc cuts a chunk into blocks and compresses each alone. Each block that is wanted is made a Blosc
chunk of its own, which the library expands as it does any: whatever its compressors and shuffles do
stays its own matter. No more than two blocks are in memory at a time.

Source: README_CHUNK_FORMAT.rst of c-blosc 1.21 (format version 2): sixteen octets of header, then
where each block begins, then the blocks in any order.

Assumptions and validity
------------------------
* Chunks of Blosc 1 (format version 2), which Zarr has; one that is stored plainly is given to the
  library whole.
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
_STORED = 0x2  # Flag of a chunk that is not compressed


def octets_of_blocks(file: io.FileIO, size: int, wanted: Ints) -> Octets:
    """Some octets of a Blosc chunk of so many octets when expanded, in the order they are wanted.

    Raises
    ------
    ValueError, RuntimeError
        The chunk is damaged.
    """
    there = os.fstat(file.fileno()).st_size
    start = _part(file, 0, _HEADER.size)
    if len(start) < _HEADER.size:
        raise ValueError(f"a Blosc chunk of {len(start)} octets")
    *marks, expanded, block, stored = _HEADER.unpack(start)
    if expanded != size or stored > there or not block:
        raise ValueError(f"a Blosc chunk of {there} octets that says {stored} and {expanded}")
    if marks[2] & _STORED:
        whole = blosc.decompress(_part(file, 0, stored))
        return np.frombuffer(whole, dtype=np.uint8)[wanted]
    count = -(-size // block)
    begins = np.frombuffer(_part(file, _HEADER.size, 4 * count), "<u4").astype(np.int64)
    if begins.min() < _HEADER.size + 4 * count or begins.max() >= stored:
        raise ValueError("a Blosc chunk whose blocks do not lie in it")
    # Blocks may lie in any order: one ends where the next in the file begins.
    ends = np.append(np.sort(begins), stored)
    ends = ends[np.searchsorted(ends, begins, side="right")]
    found = np.empty(wanted.size, dtype=np.uint8)
    number = wanted // block
    # block by block: each is unpacked once, whatever is wanted of it
    order = np.argsort(number, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        last = int(number[own[0]])
        first = last - (last == count - 1 > 0 and size % block > 0)
        blocks = range(first, last + 1)
        parts = [_part(file, int(begins[n]), int(ends[n] - begins[n])) for n in blocks]
        length = min((last + 1) * block, size) - first * block
        plain = blosc.decompress(_chunk(marks, length, block, parts))
        found[own] = np.frombuffer(plain, dtype=np.uint8)[wanted[own] - first * block]
    return found


def _part(file: io.FileIO, begin: int, length: int) -> bytes:
    file.seek(begin)
    return file.read(length)


def _chunk(marks: list[int], expanded: int, block: int, parts: list[bytes]) -> bytes:
    """A Blosc chunk of some blocks."""
    first = _HEADER.size + 4 * len(parts)
    begins = first + np.cumsum([0, *map(len, parts)])
    header = _HEADER.pack(*marks, expanded, block, int(begins[-1]))
    return b"".join([header, begins[:-1].astype("<u4").tobytes(), *parts])
