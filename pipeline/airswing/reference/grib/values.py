"""Values of catalogued GRIB fields at grid points.

Simple packing is read at single points: ``(R + X 2^E) 10^-D`` with X an unsigned integer of fixed
width (GRIB1 grid-point simple packing, GRIB2 data template 5.0), computed as ecCodes does, so that
both give the same doubles. Everything else is decoded whole by ecCodes in a worker process
(`airswing.guarded`), because a damaged message may end the process.

A message with one impossible value is refused: a damaged scale factor or a shifted bit stream gives
impossible winds in a message that looks valid. It is tested at points of the grid, so that the
result does not depend on the reports, and by the standard deviation of a component. Impossible
values between these points become missing.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from airswing.guarded import WorkerEndedError, guarded
from airswing.reference.files import Reader, local_path
from airswing.reference.grib.headers import MAX_BITS, PADDING, GarbageError, single_fields
from airswing.reference.grids import Floats, Ints
from airswing.reference.winds import PRESSURE, ModelTime, Request, limits

MAX_SPREAD = 60.0  # m/s, standard deviation
_PROBES = 256
_CHANGED = "not the message the catalogue saw"
_ABSENT = 1e300  # value that ecCodes returns for missing points; it does not occur in fields
Job = tuple[bytes, int, Ints | None]
"""A message of one field, number of points of its grid, and places in its list of values."""
KeyValue = int | float | str


class UnreadableMessageError(Exception):
    """A message without usable values; the text gives the reason."""


class GribReader(Reader):
    """Values of the fields of model times at grid points."""

    def __init__(self, *, sparse: bool = True) -> None:
        super().__init__()
        self.sparse = sparse  # read simply packed fields at single points, not whole

    def close(self) -> None:
        """Close the files."""
        for descriptor in self._opened.values():
            if descriptor is not None:
                os.close(descriptor)
        self._opened.clear()

    def answer(self, models: Sequence[ModelTime], asked: Sequence[Request]) -> list[list[Floats]]:
        """Values of all requests of some model times; NaN if a field cannot be read."""
        return [self._values(model, wanted) for model, wanted in zip(models, asked, strict=True)]

    def _values(self, model: ModelTime, wanted: Request) -> list[Floats]:
        arrays: list[Floats] = [np.full(points.shape, np.nan) for _, points in wanted]
        results: dict[int, Floats | str] = {}  # by number of a field: values or a reason
        jobs: dict[int, Job] = {}
        for number, (row, points) in enumerate(wanted):
            file = model.files[int(row["file"])]
            descriptor = self.open(file, lambda f: os.open(local_path(f.path), os.O_RDONLY))
            if descriptor is None:
                continue
            size = model.grids[int(row["kind"])].size
            probes = _probes(row, size)
            places = np.concatenate([points.ravel(), probes]) if probes.size else points.ravel()
            try:
                if self.sparse and row["sparse"]:
                    results[number] = sparse_values(descriptor, row, size, places)
                else:
                    jobs[number] = field_message(descriptor, row), size, places
            except (UnreadableMessageError, OSError, MemoryError) as error:
                results[number] = str(error) or "not enough memory to decode it"
        if jobs:
            results |= zip(jobs, decode_guarded(list(jobs.values())), strict=True)
        for number, values in results.items():
            row, points = wanted[number]
            if isinstance(values, str):
                problem = values
            else:
                self.decoded += 1
                at_points, probed = values[: points.size], values[points.size :]
                problem = ""
                if probed.size:  # otherwise its header allows only possible values
                    low, high = limits(int(row["kind"]))
                    problem = _impossible(int(row["kind"]), probed)
                    with np.errstate(invalid="ignore"):
                        beyond = (at_points < low) | (at_points > high)
                    at_points = np.where(beyond | bool(problem), np.nan, at_points)
                    if not problem and beyond.any():
                        problem = "impossible values left out"
                arrays[number] = at_points.reshape(points.shape)
            if problem:
                at = f"message at {int(row['offset'])}: {problem}"
                self.problems[model.files[int(row["file"])].path, at] = None
        return arrays


def _impossible(kind: int, values: Floats) -> str:
    """Reason why a field with these values at its probes is no wind or pressure; empty if it is."""
    low, high = limits(kind)
    values = values[~np.isnan(values)]
    if not values.size:
        return ""
    worst = float(values[np.argmax(np.abs(values))])
    if not low <= worst <= high:
        text = f"pressure of {worst:.4g} Pa" if kind == PRESSURE else f"{worst:.4g} m/s"
        return f"refused: impossible values ({text})"
    if kind != PRESSURE and float(values.std()) > MAX_SPREAD:
        return f"refused: winds with a standard deviation of {values.std():.3g} m/s"
    return ""


def field_message(descriptor: int, row: np.void) -> bytes:
    """A field as a separate message."""
    message = _read_bytes(descriptor, int(row["offset"]), int(row["length"]))
    if message[:4] != b"GRIB" or message[7] != row["edition"]:
        raise UnreadableMessageError(_CHANGED)
    if row["edition"] == 1:
        return message
    try:
        return [single for single, _ in single_fields(message, 2)][int(row["subindex"])]
    except (GarbageError, LookupError) as error:
        raise UnreadableMessageError(_CHANGED) from error


def decode_guarded(jobs: Sequence[Job]) -> list[Floats | str]:
    """Values of several messages by ecCodes in a worker process, or the reason for none."""
    try:
        return guarded(_decoded, list(jobs))
    except WorkerEndedError as error:
        if len(jobs) == 1:
            return [f"not decodable: {error}"]
    return [decode_guarded([job])[0] for job in jobs]


def _decoded(jobs: list[Job]) -> list[Floats | str]:
    import eccodes

    results: list[Floats | str] = []
    for message, size, points in jobs:
        try:
            handle = eccodes.codes_new_from_message(message)
            try:
                if eccodes.codes_get_long(handle, "bitmapPresent"):
                    eccodes.codes_set(handle, "missingValue", _ABSENT)
                count = eccodes.codes_get_size(handle, "values")
                if count != size:
                    results.append(f"{count} values on a grid of {size} points")
                    continue
                values = np.asarray(eccodes.codes_get_values(handle), dtype=np.float64)
            finally:
                eccodes.codes_release(handle)
        except (eccodes.CodesInternalError, MemoryError, ValueError) as error:
            results.append(f"not decodable: {error}")
            continue
        values = values if points is None else values[points]
        values[values == _ABSENT] = np.nan
        results.append(values)
    return results


def read_keys(message: bytes, names: Sequence[str]) -> dict[str, KeyValue]:
    """Values of keys of a message by ecCodes in a worker process, without those it has not."""
    try:
        return guarded(_keys_of, message, list(names))
    except (WorkerEndedError, ValueError) as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error


def _keys_of(message: bytes, names: list[str]) -> dict[str, KeyValue]:
    import eccodes

    values: dict[str, KeyValue] = {}
    try:
        handle = eccodes.codes_new_from_message(message)
    except eccodes.CodesInternalError as error:
        raise ValueError(str(error)) from None
    try:
        for name in names:
            with contextlib.suppress(eccodes.CodesInternalError):
                values[name] = eccodes.codes_get(handle, name)
    finally:
        eccodes.codes_release(handle)
    return values


def _probes(row: np.void, size: int) -> Ints:
    """Points at which a field is tested; none if its header excludes impossible values."""
    if row["sparse"]:
        scale = 10.0 ** -int(row["decimal_scale"])
        lowest = float(row["reference_value"]) * scale
        width = (2.0 ** int(row["bits"]) - 1.0) * 2.0 ** int(row["binary_scale"]) * scale
        if lowest + width <= limits(int(row["kind"]))[1] and width <= 2.0 * MAX_SPREAD:
            return np.empty(0, dtype=np.int64)
    return probes_of(size)


@lru_cache(maxsize=64)  # the fields of an archive have a few sizes
def probes_of(size: int) -> Ints:
    """Places evenly spread over a grid of ``size`` points."""
    return np.unique(np.linspace(0, size - 1, min(size, _PROBES)).astype(np.int64))


def _read_bytes(descriptor: int, start: int, length: int, *, spare: int = 0) -> bytes:
    content = os.pread(descriptor, length + spare, start)
    if len(content) < length:
        raise UnreadableMessageError(f"file ends {length - len(content)} bytes early")
    return content + bytes(length + spare - len(content))


def sparse_values(descriptor: int, row: np.void, size: int, points: Ints) -> Floats:
    """Values (n,) of a simply packed field at places (n,) of its list, NaN where missing."""
    if os.pread(descriptor, 4, int(row["offset"])) != b"GRIB":
        raise UnreadableMessageError(_CHANGED)
    if row["bitmap"] < 0:
        return _unpack(descriptor, row, points)
    bitmap = _read_bytes(descriptor, int(row["bitmap"]), (size + 7) // 8)
    last, earlier = _rank(bitmap, np.array([size - 1]))  # the last byte may have unused bits
    needed = (int(row["bits"]) * (int(earlier[0]) + bool(last[0])) + 7) // 8
    if not needed <= row["data_end"] - row["data_start"] <= needed + PADDING and row["bits"]:
        raise UnreadableMessageError("data section of another length than its bitmap needs")
    present, before = _rank(bitmap, points)
    values = np.full(points.shape, np.nan)
    values[present] = _unpack(descriptor, row, before[present])
    return values


def _unpack(descriptor: int, row: np.void, order: Ints) -> Floats:
    bits, reference = int(row["bits"]), float(row["reference_value"])
    assert bits <= MAX_BITS
    if bits == 0:
        return np.full(order.shape, reference + 0.0)  # like ecCodes never a negative zero
    if order.size == 0:
        return np.empty(0)
    bit, start = order * bits, int(row["data_start"])
    first, last = int(bit.min()) >> 3, (int(bit.max()) + bits + 7) >> 3
    if start + last > row["data_end"]:
        raise UnreadableMessageError("data section shorter than its grid and bitmap need")
    window = _read_bytes(descriptor, start + first, last - first, spare=8)
    # at every byte the eight that follow as one number, without copying
    words: NDArray[np.uint64] = np.ndarray((last - first,), ">u8", window, strides=(1,))
    word = words[(bit >> 3) - first].astype(np.uint64)
    integers = (word << (bit & 7).astype(np.uint64)) >> np.uint64(64 - bits)
    scale, factor = _power(2, int(row["binary_scale"])), _power(10, -int(row["decimal_scale"]))
    values: Floats = (integers.astype(np.float64) * scale + reference) * factor
    return values


def _power(base: int, exponent: int) -> float:
    value = 1.0
    for _ in range(abs(exponent)):
        value = value * base if exponent > 0 else value / base
    return value


@lru_cache(maxsize=16)
def _counts(bitmap: bytes) -> tuple[NDArray[np.uint8], Ints]:
    """Bytes of a bitmap and the number of present points before each."""
    n_bytes = np.frombuffer(bitmap, dtype=np.uint8)
    before = np.zeros(n_bytes.size + 1, dtype=np.int64)
    np.cumsum(np.bitwise_count(n_bytes), out=before[1:])
    return n_bytes, before


def _rank(bitmap: bytes, points: Ints) -> tuple[NDArray[np.bool_], Ints]:
    """Whether points are present, and the number of present points before each."""
    n_bytes, before = _counts(bitmap)
    place, bit = points >> 3, (points & 7).astype(np.uint8)
    selected = n_bytes[place]
    present = (selected >> (np.uint8(7) - bit)) & np.uint8(1)
    earlier = selected & ~(np.uint8(0xFF) >> bit)  # bits of the byte before this one
    return present.astype(bool), before[place] + np.bitwise_count(earlier)
