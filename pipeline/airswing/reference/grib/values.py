"""Values of one catalogued field at chosen points, by the cheapest way that is exact.

Simple packing is read in place; everything else is decoded whole by eccodes. Both give the same
doubles, bit for bit.

Assumptions and validity
------------------------
* eccodes is given a message of one field, put together from the sections that values depend on,
  bitmap and data as they stand, and sections of our own that say what was read of the grid and
  the product. So nothing depends on eccodes' multi-field switch, which is not safe between
  threads, and nothing that those sections hold can lead it astray.
* eccodes ends the process where one of its assertions fails. Simple packing and IEEE floats whose
  lengths fit their grid, complex packing whose groups do and PNG streams that are whole leave it
  nothing to assert: they are decoded here. All else is decoded where an end is survived
  (`airswing.reference.packing.decoder`).
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from airswing.reference.grib.edition1 import LARGE
from airswing.reference.packing.complex_packing import require_sound_groups
from airswing.reference.packing.decoder import decode_beside
from airswing.reference.packing.decoder_process import ABSENT
from airswing.reference.packing.image_packing import require_whole_png
from airswing.reference.packing.octets import unsigned
from airswing.reference.packing.simple_packing import (
    SimplePacking,
    UnreadableMessageError,
    present_points,
    read_bytes,
    sparse_values,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Sections of a message of our own, octet by octet. Values depend on none of them but the counts and
# the scanning mode of the grid, which are those of the field's.
# Section 1 of GRIB2: an analysis of 2009-08-01.
_IDENTIFICATION = bytes.fromhex("00000015 01 0007 0000 02 01 01 07d9 08 01 00 00 00 00 01")
# Section 4 of GRIB2: u at 500 hPa.
_PRODUCT = bytes.fromhex(
    "00000022 04 0000 0000 02 02 02 00 60 0000 00 01 00000000 64 00 0000c350 ff 00 00000000"
)
# Section 1 of GRIB1: the same.
_PRODUCT_1 = bytes.fromhex(
    "00001c 02 07 00 ff 80 21 64 01f4 09 08 01 00 00 01 00 00 00 0000 00 15 00 0000"
)
# Section 3 of GRIB2: a grid in longitude and latitude.
_GRID = bytes.fromhex(
    "00000048 03 00 00000000 00 00 0000 06" + 23 * " 00" + "00000000 ffffffff 02625a00 00000000 30"
    "02625a00 00000000 000f4240 000f4240 00"
)
# Section 2 of GRIB1: the same.
_GRID_1 = bytes.fromhex(
    "000020 00 ff 00 0000 0000 009c40 000000 80 009c40 009c40 03e8 03e8 00 00000000"
)
# Place of the scanning mode in section 3 of GRIB2, by template.
_SCANNING = {0: 71, 1: 71, 10: 59, 20: 64, 30: 64}
_NO_BITMAP = bytes([0, 0, 0, 6, 6, 255])
_BEGINNING = b"GRIB"
_CHANGED = "not the message the catalogue saw"
# Data representation templates; 40010 is PNG as it was before it had a number.
_IEEE, _PNG = 4, (41, 40010)


def field_values(
    descriptor: int, row: np.void, size: int, points: Ints, *, sparse: bool = True
) -> Floats:
    """Values of a field at chosen points, NaN where missing.

    Parameters
    ----------
    descriptor : int
        The open file that holds the field.
    size : int
        Points of the field's grid.
    points : int array
        Places in the message's list of grid points.
    sparse : bool
        Read simple packing in place; otherwise decode every field whole.

    Raises
    ------
    UnreadableMessageError
        Where the octets are not the message the catalogue saw, or cannot be decoded.
    """
    packed = simple_packing(row, size)
    if sparse and row["sparse"]:
        if os.pread(descriptor, 4, int(row["offset"])) != _BEGINNING:
            raise UnreadableMessageError(_CHANGED)
        return sparse_values(descriptor, packed, points)
    message = _message_bytes(descriptor, row)
    if _certain(row, message, packed, descriptor):
        # Setting the value of missing points takes 9 us, and most messages have none.
        complete = int(row["packing"]) == 0 and packed.bitmap < 0
        values = decode(message, complete=complete)
        if values.size != size:
            raise UnreadableMessageError(f"{values.size} values on a grid of {size} points")
        taken: Floats = values[points]
    else:
        taken = decode_beside(message, size, points)
    taken[taken == ABSENT] = np.nan
    return taken


def _certain(row: np.void, message: bytes, packed: SimplePacking, descriptor: int) -> bool:
    """Whether eccodes can find nothing to assert in a message; refuses where it certainly would."""
    edition, packing = int(row["edition"]), int(row["packing"])
    present = packed.size if packed.bitmap < 0 else present_points(descriptor, packed)
    if edition == 2 and int(row["coded"]) != present:
        raise UnreadableMessageError(f"{int(row['coded'])} values, {present} in the bitmap")
    octets = packed.end - packed.start
    if edition == 1 and len(message) >= LARGE:
        return False
    if packing == 0:
        if octets * 8 < packed.bits * present:
            raise UnreadableMessageError("data section shorter than its grid and bitmap promise")
        return packed.bits <= 32
    if edition == 1:
        return False
    if packing == _IEEE:
        return octets in (4 * present, 8 * present)
    if packing in (2, 3):
        return require_sound_groups(message, present)
    return packing in _PNG and require_whole_png(message, present)


def simple_packing(row: np.void, size: int) -> SimplePacking:
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


def _message_bytes(descriptor: int, row: np.void) -> bytes:
    """The field as a complete GRIB message that holds nothing else, on a grid of our own.

    Its grid has the counts and the scanning mode of the field's, by which eccodes orders values.
    """
    if row["edition"] == 1:
        return _message_1(descriptor, row)
    if os.pread(descriptor, 4, int(row["offset"])) != _BEGINNING:
        raise UnreadableMessageError(_CHANGED)
    own = _section(descriptor, row, "grid", 3)
    grid = bytearray(_GRID)
    # Number of data points; Ni and Nj.
    grid[6:10], grid[30:38] = own[6:10], own[30:38]
    scanning = _SCANNING.get(unsigned(own, 12, 2), len(own))
    if scanning >= len(own):
        raise UnreadableMessageError(_CHANGED)
    grid[71] = own[scanning]
    body = [_IDENTIFICATION, bytes(grid), _PRODUCT, _section(descriptor, row, "packing", 5)]
    bitmap = row["section_bitmap"] >= 0
    body.append(_section(descriptor, row, "bitmap", 6) if bitmap else _NO_BITMAP)
    data = int(row["section_data"])
    body.append(read_bytes(descriptor, data, int(row["data_end"]) - data))
    total = 16 + sum(map(len, body)) + 4
    head = b"GRIB\x00\x00\x00\x02"
    return b"".join([head, total.to_bytes(8, "big"), *body, b"7777"])


def _message_1(descriptor: int, row: np.void) -> bytes:
    offset, bitmap = int(row["offset"]), int(row["section_bitmap"])
    length = int(row["data_end"]) - offset
    message = memoryview(read_bytes(descriptor, offset, length))
    if message[:4] != _BEGINNING:
        raise UnreadableMessageError(_CHANGED)
    own, said = int(row["section_grid"]) - offset, int(row["section_product"]) - offset
    product, grid = bytearray(_PRODUCT_1), bytearray(_GRID_1)
    # Flag that a bitmap section follows; below, the decimal scale factor.
    product[7] |= 0x40 if bitmap >= 0 else 0
    product[26:28] = message[said + 26 : said + 28]
    grid[6:10], grid[27] = message[own + 6 : own + 10], message[own + 27]
    body = message[(bitmap if bitmap >= 0 else int(row["section_data"])) - offset :]
    total = 8 + len(product) + len(grid) + len(body) + 4
    if total >= LARGE:
        # Above 8 MB the length is written in another unit: the message as it stands.
        return read_bytes(descriptor, offset, int(row["length"]))
    return b"".join([_BEGINNING, total.to_bytes(3, "big"), b"\x01", product, grid, body, b"7777"])


def _section(descriptor: int, row: np.void, name: str, number: int) -> bytes:
    """A section of GRIB2, which must still be what the catalogue saw."""
    start, end = int(row[f"section_{name}"]), int(row["offset"]) + int(row["length"])
    head = read_bytes(descriptor, start, 5)
    length = unsigned(head, 0, 4)
    if head[4] != number or not 5 < length <= end - start:
        raise UnreadableMessageError(_CHANGED)
    return read_bytes(descriptor, start, length)


def decode(message: bytes, *, complete: bool = False) -> Floats:
    """Values of a single-field message by eccodes, in this process and in the order of the message.

    `ABSENT` at missing points; ``complete``: there are none.
    """
    import eccodes

    try:
        handle = eccodes.codes_new_from_message(message)
    except eccodes.CodesInternalError as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    try:
        if not complete:
            eccodes.codes_set(handle, "missingValue", ABSENT)
        values = np.asarray(eccodes.codes_get_values(handle), dtype=np.float64)
    except (eccodes.CodesInternalError, MemoryError, ValueError) as error:
        raise UnreadableMessageError(f"not decodable: {error}") from error
    finally:
        eccodes.codes_release(handle)
    return values
