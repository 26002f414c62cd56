"""One model time of GRIB messages in, winds at its reports out.

The winds are put together by :mod:`airswing.reference.geometry.winds`; this module reads the
messages they need, one after another.

Assumptions and validity
------------------------
* A file is the one that was catalogued where its size and modification time are the same;
  else, and where a message cannot be read, its reports get no value and the problem is noted.
"""

from __future__ import annotations

import os
import time

import numpy as np
from numpy.typing import NDArray

from airswing.reference.geometry.model_time import (
    NOT_OPENED,
    REPLACED,
    ModelTime,
    Sample,
    SourceFile,
)
from airswing.reference.geometry.winds import winds_at
from airswing.reference.grib.credible import probes, require_credible, without_absurd
from airswing.reference.grib.values import field_values
from airswing.reference.packing.simple_packing import UnreadableMessageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class _Reader:
    """Values of fields at corner points, with unreadable files and messages noted once."""

    def __init__(self, model: ModelTime, *, sparse: bool) -> None:
        self.model, self.sparse = model, sparse
        self.problems: dict[tuple[str, str], None] = {}
        self.descriptors: dict[int, int] = {}
        self.decoded = self.octets = 0
        self.seconds = 0.0

    def close(self) -> None:
        for descriptor in self.descriptors.values():
            if descriptor >= 0:
                os.close(descriptor)

    def _descriptor(self, number: int) -> int:
        if number not in self.descriptors:
            self.descriptors[number] = self._open(self.model.files[number])
        return self.descriptors[number]

    def _open(self, file: SourceFile) -> int:
        try:
            descriptor = os.open(file.path, os.O_RDONLY)
        except OSError as error:
            self.problems[file.path, f"{NOT_OPENED}: {error.strerror}"] = None
            return -1
        status = os.fstat(descriptor)
        if (status.st_size, status.st_mtime_ns) != (file.size, file.mtime_ns):
            os.close(descriptor)
            self.problems[file.path, REPLACED] = None
            return -1
        return descriptor

    def values(self, row: np.void, points: Ints) -> Floats:
        """(4, n) values at corner points, NaN where the field cannot be read."""
        number = int(row["file"])
        descriptor = self._descriptor(number)
        if descriptor < 0:
            return np.full(points.shape, np.nan)
        began = time.perf_counter()
        try:
            values = self._credible(descriptor, row, points)
        except (UnreadableMessageError, OSError, MemoryError) as error:
            self._note(row, str(error) or "not enough memory to decode it")
            return np.full(points.shape, np.nan)
        self.seconds += time.perf_counter() - began
        self.decoded += 1
        self.octets += int(row["length"])
        return values

    def _credible(self, descriptor: int, row: np.void, points: Ints) -> Floats:
        """Values of a field that an atmosphere can have."""
        size, kind = self.model.grid.size, int(row["kind"])
        judged = probes(row, size)
        if not judged.size:  # its header allows none but such values
            return field_values(descriptor, row, size, points, sparse=self.sparse)
        looked_at = np.concatenate([points.ravel(), judged])
        found = field_values(descriptor, row, size, looked_at, sparse=self.sparse)
        require_credible(kind, found[points.size :])
        values = found[: points.size].reshape(points.shape)
        values, absurd = without_absurd(kind, values)
        if absurd:
            self._note(row, "values that no atmosphere has left out")
        return values

    def _note(self, row: np.void, reason: str) -> None:
        path = self.model.files[int(row["file"])].path
        self.problems[path, f"message at {int(row['offset'])}: {reason}"] = None


def sample_model_time(
    model: ModelTime,
    latitude: Floats,
    longitude: Floats,
    pressure: Floats,
    *,
    sparse: bool = True,
    derivatives: bool = False,
) -> Sample:
    """Winds of one model time at reports (degrees, Pa).

    Parameters
    ----------
    sparse : bool
        Read simply packed fields in place instead of decoding them whole.
    derivatives : bool
        Also give derivatives by ln p, eastward and northward distance, and the grid's convergence.
    """
    reader = _Reader(model, sparse=sparse)
    work = winds_at(model, latitude, longitude, pressure, derivatives=derivatives)
    try:
        # the kernel asks for octets it needs and is given values: it reads no file itself
        asked = next(work)
        while True:
            asked = work.send([reader.values(row, points) for row, points in asked])
    except StopIteration as done:
        table: Floats = done.value
    finally:
        reader.close()
    return Sample(table, tuple(reader.problems), reader.decoded, reader.octets, reader.seconds)
