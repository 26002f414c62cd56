"""Numbers as GRIB writes them: big-endian, signs in the top bit, IBM floats.

Validity: WMO FM 92 GRIB, regulations 92.1.5 (edition 2) and the edition 1
guide; octets are counted from 0 here, from 1 in the WMO tables.
"""

from __future__ import annotations

import struct


def unsigned(data: bytes, start: int, width: int) -> int:
    """Unsigned integer of `width` octets from octet `start` (0-based)."""
    return int.from_bytes(data[start : start + width], "big")


def signed(data: bytes, start: int, width: int) -> int:
    """Integer of `width` octets whose first bit is the sign."""
    value = unsigned(data, start, width)
    top = 1 << (8 * width - 1)
    return top - value if value >= top else value


def missing(data: bytes, start: int, width: int) -> bool:
    """Whether every bit of the octets is set, GRIB's mark of absence."""
    return data[start : start + width] == b"\xff" * width


def sections_of(message: bytes) -> dict[int, bytes]:
    """Sections of a GRIB2 message of one field, by number."""
    found, at = {}, 16
    while at < len(message) - 4:
        length = unsigned(message, at, 4)
        found[message[at + 4]] = message[at : at + length]
        at += max(length, 5)  # a section of no length would never end
    return found


def ibm_float(data: bytes, start: int) -> float:
    """IBM single-precision float: sign, exponent of 16 (excess 64), 24-bit fraction."""
    word = unsigned(data, start, 4)
    value = float(word & 0xFFFFFF) * 16.0 ** (((word >> 24) & 0x7F) - 70)
    return -value if word >> 31 else value


def ieee_float(data: bytes, start: int) -> float:
    """IEEE single-precision float."""
    return float(struct.unpack_from(">f", data, start)[0])
