"""The value at a grid point of one message, without decoding the others.

Under simple packing (GRIB1 grid-point simple packing; GRIB2 data template
5.0) the value of a present point is ``(R + X 2^E) 10^-D`` with X an unsigned
integer of fixed width at a known bit: a few thousand points cost a few
gathers from the octets. Points under a bitmap are found by their rank, the
count of present points before them.

Assumptions and validity
------------------------
* Widths 0 to 57 bits (an unaligned 64-bit load holds the integer); wider
  fields, every other packing and predefined bitmaps go to eccodes.
* Sums and products are taken in double precision in the order eccodes takes
  them, ``(X s + R) d`` with s and d built by repeated multiplication or
  division, so that both paths agree to the last bit.
* The file is read with positioned reads, never mapped: a file cut short while
  it is being read gives an error, not a killed process.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Octets a data section may have beyond its values.
PADDING = 16
#: Widest packed integer that one unaligned 64-bit load holds at any bit offset.
MAX_BITS = 57


class UnreadableMessageError(Exception):
    """A message whose values cannot be had; the text says why."""


@dataclass(frozen=True, slots=True)
class SimplePacking:
    """Where and how the values of one simply packed field lie in a file."""

    reference: float  # R, as stored (IBM or IEEE single precision)
    binary_scale: int  # E
    decimal_scale: int  # D
    bits: int  # width of a packed integer
    start: int  # offset in the file of the first octet of packed integers
    end: int  # offset of the end of the data section
    bitmap: int  # offset of the first octet of the bitmap, -1 where every point is present
    size: int  # number of grid points


def power(base: int, exponent: int) -> float:
    """Integer power by repeated products or quotients, rounded at each step as eccodes does."""
    value = 1.0
    for _ in range(abs(exponent)):
        value = value * base if exponent > 0 else value / base
    return value


def read_bytes(descriptor: int, start: int, length: int, *, spare: int = 0) -> bytes:
    """Octets of a file, and `spare` octets of no meaning after them.

    Raises
    ------
    UnreadableMessageError
        Where the file ends before.
    """
    octets = os.pread(descriptor, length + spare, start)
    if len(octets) < length:
        raise UnreadableMessageError(f"file ends {length - len(octets)} octets early")
    lacking = length + spare - len(octets)
    return octets + bytes(lacking) if lacking else octets


def sparse_values(descriptor: int, packing: SimplePacking, points: Ints) -> Floats:
    """Values at chosen places of a simply packed field's list, NaN where the bitmap says missing.

    Raises
    ------
    UnreadableMessageError
        Where the file or the data section ends before the points' octets.
    """
    flat = points.ravel()
    if packing.bitmap < 0:
        values = _unpack(descriptor, packing, flat)
        return values.reshape(points.shape)
    bitmap = _bitmap(descriptor, packing)
    needed = (packing.bits * _present(bitmap, packing.size) + 7) // 8
    if not needed <= packing.end - packing.start <= needed + PADDING and packing.bits:
        raise UnreadableMessageError("data section that is not as long as its bitmap promises")
    present, rank = _rank(bitmap, flat)
    values = np.full(flat.shape, np.nan)
    values[present] = _unpack(descriptor, packing, rank[present])
    return values.reshape(points.shape)


def _unpack(descriptor: int, packing: SimplePacking, order: Ints) -> Floats:
    """Values of the given places in the list of packed integers."""
    if packing.bits == 0:
        return np.full(order.shape, _constant(packing))
    if order.size == 0:
        return np.empty(0)
    bit = order * packing.bits
    first, last = int(bit.min()) >> 3, (int(bit.max()) + packing.bits + 7) >> 3
    if packing.start + last > packing.end:
        raise UnreadableMessageError("data section shorter than its grid and bitmap promise")
    window = read_bytes(descriptor, packing.start + first, last - first, spare=8)
    # At every octet the eight that follow as one number, without copying; the spare octets let
    # the last begin.
    words: NDArray[np.uint64] = np.ndarray(
        shape=(last - first,), dtype=">u8", buffer=window, strides=(1,)
    )
    word = words[(bit >> 3) - first].astype(np.uint64)
    integers = (word << (bit & 7).astype(np.uint64)) >> np.uint64(64 - packing.bits)
    scale, factor = power(2, packing.binary_scale), power(10, -packing.decimal_scale)
    values: Floats = (integers.astype(np.float64) * scale + packing.reference) * factor
    return values


def _constant(packing: SimplePacking) -> float:
    """Value of a field without packed integers; like eccodes' never a negative zero."""
    return packing.reference + 0.0


def present_points(descriptor: int, packing: SimplePacking) -> int:
    """Points that a field's bitmap says are there."""
    return _present(_bitmap(descriptor, packing), packing.size)


def _bitmap(descriptor: int, packing: SimplePacking) -> bytes:
    return read_bytes(descriptor, packing.bitmap, (packing.size + 7) // 8)


def _present(bitmap: bytes, size: int) -> int:
    """Points present among the first `size`: the last octet may have bits to spare."""
    last, before = _rank(bitmap, np.array([size - 1]))
    return int(before[0]) + bool(last[0])


@lru_cache(maxsize=16)
def _counts(bitmap: bytes) -> tuple[NDArray[np.uint8], Ints]:
    """Octets of a bitmap and the count of present points before each."""
    octets = np.frombuffer(bitmap, dtype=np.uint8)
    before = np.zeros(octets.size + 1, dtype=np.int64)
    np.cumsum(np.bitwise_count(octets), out=before[1:])
    return octets, before


def _rank(bitmap: bytes, points: Ints) -> tuple[NDArray[np.bool_], Ints]:
    """Whether points are present, and how many present points stand before each."""
    octets, before = _counts(bitmap)
    place, bit = points >> 3, (points & 7).astype(np.uint8)
    octet = octets[place]
    present = (octet >> (np.uint8(7) - bit)) & np.uint8(1)
    # Bits of the octet before this one: the first point is the highest bit.
    earlier = octet & ~(np.uint8(0xFF) >> bit)
    return present.astype(bool), before[place] + np.bitwise_count(earlier)
