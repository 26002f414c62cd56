"""Whether the PNG stream of a GRIB2 message is whole and of the field's size; nothing is decoded.

Every chunk of a PNG stream carries a checksum (ISO/IEC 15948, 5.3), so that a damaged one is told
for certain. eccodes ends the process where the stream's depth is not the one the message states.

Validity: data template 5.41; one image of the field's points, of the depth that the bits of a value
ask for: 1, 2, 4 grey, or 8, 16, 24, 32 of which the last two are colours of 8.
"""

from __future__ import annotations

import zlib

from airswing.reference.packing.octets import sections_of, unsigned
from airswing.reference.packing.simple_packing import UnreadableMessageError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Depth and colour type by the bits a value is stored in.
_DEPTHS = {1: (1, 0), 2: (2, 0), 4: (4, 0), 8: (8, 0), 16: (16, 0), 24: (8, 2), 32: (8, 6)}


def require_whole_png(message: bytes, count: int) -> bool:
    """Hold the PNG stream of a message of one field against its count of values.

    True where decoding can go wrong in no way; False where that cannot be told.

    Raises
    ------
    UnreadableMessageError
        Where the stream is damaged or of another size.
    """
    sections = sections_of(message)
    bits, stream = sections[5][19], sections[7][5:]
    if bits == 0:
        return False
    header = _whole(stream)
    width, height = unsigned(header, 0, 4), unsigned(header, 4, 4)
    if width * height != count:
        raise UnreadableMessageError(f"PNG stream of {width * height} values for {count}")
    stored = next((one for one in _DEPTHS if one >= bits), 0)
    if (header[8], header[9]) != _DEPTHS.get(stored):
        raise UnreadableMessageError("PNG stream of another depth than its message states")
    return header[10:13] == bytes(3)


def _whole(stream: bytes) -> bytes:
    """Header of a stream whose chunks are as their checksums say."""
    if not stream.startswith(_SIGNATURE) or stream[12:16] != b"IHDR":
        raise UnreadableMessageError("no PNG stream in its data section")
    at, kind = len(_SIGNATURE), b""
    while kind != b"IEND":
        length, kind = unsigned(stream, at, 4), stream[at + 4 : at + 8]
        end = at + 12 + length
        if end > len(stream) or zlib.crc32(stream[at + 4 : end - 4]) != unsigned(
            stream, end - 4, 4
        ):
            raise UnreadableMessageError("damaged PNG stream")
        at = end
    return stream[16:29]
