"""Fields of a GRIB message that may hold several, each as a message of its own.

Assumptions: GRIB1 holds one field. In GRIB2 sections 2 to 7 may stand again (WMO FM 92, regulation
92.1.5): a field has the last section of each number before its data; bitmap indicator 254 stands
for the last bitmap that was given.
"""

from __future__ import annotations

from collections.abc import Iterator

from airswing.reference.grib.fields import GarbageError
from airswing.reference.packing.octets import unsigned

_NO_BITMAP = b"\x00\x00\x00\x06\x06\xff"
_NEEDED = {1, 3, 4, 5, 6}


def single_fields(message: bytes, edition: int) -> Iterator[tuple[bytes, dict[int, bytes]]]:
    """Each field of a message as a message that holds it alone, and its sections by number.

    Of GRIB1 these are the product's (1) and the grid's (2) where it has one.

    Raises
    ------
    GarbageError
        Where the lengths of the sections do not add up.
    """
    if edition == 1:
        product = message[8 : 8 + unsigned(message, 8, 3)]
        if len(product) < 28 or 8 + len(product) > len(message) - 4:
            raise GarbageError
        at = 8 + len(product)
        grid = {2: message[at : at + unsigned(message, at, 3)]} if product[7] & 0x80 else {}
        yield message, {1: product, **grid}
        return
    sections: dict[int, bytes] = {}
    bitmap, at, end = _NO_BITMAP, 16, len(message) - 4
    while at < end:
        size, number = unsigned(message, at, 4), message[at + 4]
        if size < 5 or at + size > end:
            raise GarbageError
        sections[number] = message[at : at + size]
        at += size
        if number == 6 and size > 5 and sections[6][5] == 0:
            bitmap = sections[6]
        if number == 7 and sections.keys() >= _NEEDED:
            yield _alone(message, sections, bitmap), dict(sections)


def _alone(message: bytes, sections: dict[int, bytes], bitmap: bytes) -> bytes:
    own = bitmap if sections[6][5:6] == b"\xfe" else sections[6]
    parts = [sections[number] for number in (1, 2, 3, 4, 5) if number in sections]
    body = b"".join([*parts, own, sections[7]])
    return message[:8] + (16 + len(body) + 4).to_bytes(8, "big") + body + b"7777"
