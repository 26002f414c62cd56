"""Values of one catalogued field at chosen points, by the cheapest way that is exact.

Simple packing is read in place (`airswing.reference.grib.packing`); everything
else is decoded whole by eccodes. Both give the same doubles, bit for bit.

A field of a multi-field GRIB2 message is handed to eccodes as a message of
its own, put together from its sections, so that nothing depends on eccodes'
global multi-field switch, which is not safe between threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.reference.grib.octets import unsigned
from airswing.reference.grib.packing import (
    SimplePacking,
    UnreadableMessageError,
    read_bytes,
    sparse_values,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: What eccodes is asked to put where a point is missing; no field holds it.
ABSENT = 1e300


def field_values(
    descriptor: int, row: Any, size: int, points: Ints, *, sparse: bool = True
) -> Floats:
    """Values of a field at chosen points.

    Parameters
    ----------
    descriptor : int
        The open file that holds the field.
    row : record of `airswing.reference.grib.fields.FIELD_DTYPE`
    size : int
        Points of the field's grid.
    points : int array
        Places in the message's list of grid points.
    sparse : bool
        Read simple packing in place; otherwise decode every field whole.

    Returns
    -------
    values : float array of the shape of `points`
        NaN at missing points.

    Raises
    ------
    UnreadableMessageError
        Where the octets are not the message the catalogue saw, or cannot be decoded.
    """
    if sparse and row["sparse"]:
        return sparse_values(descriptor, simple_packing(row, size), points)
    values = decode(message_bytes(descriptor, row))
    if values.size != size:
        raise UnreadableMessageError(f"{values.size} values on a grid of {size} points")
    taken: Floats = values[points]
    taken[taken == ABSENT] = np.nan
    return taken


def simple_packing(row: Any, size: int) -> SimplePacking:
    """Packing parameters of a simply packed field, as its catalogue row has them."""
    bitmap = int(row["section_bitmap"])
    return SimplePacking(
        reference=float(row["reference_value"]),
        binary_scale=int(row["binary_scale"]),
        decimal_scale=int(row["decimal_scale"]),
        bits=int(row["bits"]),
        start=int(row["data_start"]),
        end=int(row["data_end"]),
        bitmap=bitmap + 6 if bitmap >= 0 else -1,
        size=size,
    )


def message_bytes(descriptor: int, row: Any) -> bytes:
    """The field as a complete GRIB message that holds nothing else."""
    offset, length = int(row["offset"]), int(row["length"])
    if row["edition"] == 1:
        return read_bytes(descriptor, offset, length)
    head = read_bytes(descriptor, offset, 16)
    if head[:4] != b"GRIB":
        raise UnreadableMessageError("no GRIB message where the catalogue saw one")
    starts = [row[f"section_{name}"] for name in ("identification", "grid", "product", "packing")]
    body = [_section(descriptor, int(start)) for start in starts]
    bitmap = int(row["section_bitmap"])
    body.append(_section(descriptor, bitmap) if bitmap >= 0 else b"\x00\x00\x00\x06\x06\xff")
    body.append(_section(descriptor, int(row["section_data"])))
    total = 16 + sum(map(len, body)) + 4
    return b"".join([head[:8], total.to_bytes(8, "big"), *body, b"7777"])


def _section(descriptor: int, start: int) -> bytes:
    length = unsigned(read_bytes(descriptor, start, 4), 0, 4)
    return read_bytes(descriptor, start, length)


def decode(message: bytes) -> Floats:
    """Decode a single-field message by eccodes.

    Parameters
    ----------
    message : bytes

    Returns
    -------
    values : (size,) float array
        In the order of the message; `ABSENT` at missing points.

    Raises
    ------
    UnreadableMessageError
    """
    import eccodes

    try:
        handle = eccodes.codes_new_from_message(message)
    except eccodes.CodesInternalError as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    try:
        eccodes.codes_set(handle, "missingValue", ABSENT)
        values = np.asarray(eccodes.codes_get_values(handle), dtype=np.float64)
    except eccodes.CodesInternalError as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    finally:
        eccodes.codes_release(handle)
    return values
