"""Chunks of NetCDF-4 variables compressed beside the HDF5 library, and copied as they are stored.

Assumes variables whose last dimension is ``report``, one index of the others a chunk, stored with
the byte shuffle and deflate (:func:`airswing.products.netcdf.storage_of`): any reader of NetCDF-4
reads them. The library compresses with zlib, one variable after the other; ISA-L makes deflate
streams of 4 % more octets in a sixth of the time or less (``benchmarks/storage.py``), and most of
the time of writing a product went there. What a product carries on unchanged from the one it is
made from is not even decompressed.
"""

from __future__ import annotations

import itertools

import h5py
import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

# Of ISA-L: 4 % more octets than level 1 of zlib, in a sixth of its time.
_LEVEL = 2


class GrowingColumn:
    """A variable of a file, written from its first report to its last.

    Parameters
    ----------
    dataset : h5py.Dataset, shape (..., report)
        As the file was opened to be written; empty.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset, self._length = dataset, (dataset.chunks or (1,))[-1]
        self._waiting: list[NDArray[np.generic]] = []
        self._count = self._written = 0

    def append(self, values: NDArray[np.generic]) -> None:
        """Add the next reports, (..., report)."""
        self._waiting.append(np.asarray(values, dtype=self._dataset.dtype))
        self._count += values.shape[-1]
        last = self._written + self._count == self._dataset.shape[-1]
        if self._count >= self._length or last:
            self._write(last=last)

    def _write(self, *, last: bool) -> None:
        """Write all whole chunks, and at the end the rest."""
        values = np.concatenate(self._waiting, axis=-1)
        whole = self._count if last else self._count - self._count % self._length
        if self._dataset.chunks is None:  # a single number is not cut into chunks
            self._dataset[...] = values
        else:
            for begin in range(0, whole, self._length):
                self._write_chunks(values[..., begin : begin + self._length], begin)
        # A copy: a view would hold all that was written until the chunk is full.
        self._waiting = [values[..., whole:].copy()]
        self._written += whole
        self._count -= whole

    def _write_chunks(self, values: NDArray[np.generic], begin: int) -> None:
        """Write one chunk for every index of the other dimensions."""
        missing = self._length - values.shape[-1]
        if missing:  # a chunk at the end is as long as the others in the file
            values = np.pad(values, [*((0, 0) for _ in values.shape[:-1]), (0, missing)])
        for index in itertools.product(*(range(size) for size in values.shape[:-1])):
            place = (*index, self._written + begin)
            self._dataset.id.write_direct_chunk(place, _deflated(_shuffled(values[index])))


def _shuffled(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Octets of numbers (n,) in the order of HDF5's shuffle: all first ones, all second, ..."""
    # octets of one rank are alike, and beside each other they pack smaller
    octets = np.ascontiguousarray(values).view(np.uint8).reshape(values.size, values.itemsize)
    return np.ascontiguousarray(octets.T)


def _deflated(octets: NDArray[np.uint8]) -> bytes:
    """Octets as a deflate stream, as ``zlib.decompress`` takes it."""
    return bytes(isal_zlib.compress(octets, _LEVEL))


def copy_column(source: h5py.Dataset, target: h5py.Dataset) -> None:
    """Copy a variable (..., report) as it is stored, where it is stored alike in both files."""
    if target.chunks is None or _storage(source) != _storage(target):
        target[...] = source[...]
        return
    for number in range(source.id.get_num_chunks()):
        place = source.id.get_chunk_info(number).chunk_offset
        left_out, stored = source.id.read_direct_chunk(place)
        target.id.write_direct_chunk(place, stored, left_out)


def _storage(dataset: h5py.Dataset) -> tuple[object, ...]:
    """All that the octets of a chunk depend on."""
    return (
        dataset.dtype,
        dataset.shape,
        dataset.chunks,
        dataset.shuffle,
        dataset.compression,
        dataset.fletcher32,
        dataset.scaleoffset,
    )
