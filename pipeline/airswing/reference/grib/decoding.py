"""Decoding of single GRIB messages by ecCodes, called in worker processes too.

Imports little, so that workers (`airswing.guarded`) start quickly.
"""

from __future__ import annotations

import contextlib

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Job = tuple[bytes, int, Ints | None]
"""Arguments of :func:`decode`."""
KeyValue = int | float | str

ABSENT = 1e300
"""Value that ecCodes is asked to put where a point is missing; no field holds it."""


class UnreadableMessageError(Exception):
    """A message without usable values; the text gives the reason."""


def decode(message: bytes, size: int, points: Ints | None = None) -> Floats:
    """Values of a message of one field by ecCodes in this process, NaN where missing.

    Parameters
    ----------
    size : int
        Number of points of its grid.
    points : (n,) int array, optional
        Places in the list of values; by default all.

    Raises
    ------
    UnreadableMessageError
        If it cannot be decoded, or has another number of values.
    """
    import eccodes

    try:
        handle = eccodes.codes_new_from_message(message)
    except eccodes.CodesInternalError as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    try:
        if eccodes.codes_get_long(handle, "bitmapPresent"):
            eccodes.codes_set(handle, "missingValue", ABSENT)
        if (stated := eccodes.codes_get_size(handle, "values")) != size:
            raise UnreadableMessageError(f"{stated} values on a grid of {size} points")
        values = np.asarray(eccodes.codes_get_values(handle), dtype=np.float64)
    except (eccodes.CodesInternalError, MemoryError, ValueError) as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    finally:
        eccodes.codes_release(handle)
    if values.size != size:
        raise UnreadableMessageError(f"{values.size} values on a grid of {size} points")
    if points is not None:
        values = values[points]
    values[values == ABSENT] = np.nan
    return values


def decode_all(jobs: list[Job]) -> list[Floats | str]:
    """Values of several messages, or the reason for none."""
    found: list[Floats | str] = []
    for job in jobs:
        try:
            found.append(decode(*job))
        except UnreadableMessageError as error:
            found.append(str(error))
    return found


def keys_of(message: bytes, names: list[str]) -> dict[str, KeyValue]:
    """Values of keys of a message, without those it has not; `ValueError` if it is none."""
    import eccodes

    found: dict[str, KeyValue] = {}
    try:
        handle = eccodes.codes_new_from_message(message)
    except eccodes.CodesInternalError as error:
        raise ValueError(str(error)) from None
    try:
        for name in names:
            with contextlib.suppress(eccodes.CodesInternalError):
                found[name] = eccodes.codes_get(handle, name)
    finally:
        eccodes.codes_release(handle)
    return found
