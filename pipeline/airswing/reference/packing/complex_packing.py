"""Whether the groups of a complex-packed message hold what its grid needs; nothing is decoded.

Under data templates 5.2 and 5.3 the values stand in groups of their own length and width, which are
themselves packed (WMO FM 92 data templates 7.2 and 7.3). eccodes trusts them: lengths that do not
add up to the count of values, or groups that reach past the section, end the process or read what
is not there.

Validity: general group splitting (code table 5.4, 1), missing value management 0 to 2 (table 5.5),
spatial differencing of first and second order; other messages are neither proved nor refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.reference.packing.octets import sections_of, unsigned
from airswing.reference.packing.simple_packing import UnreadableMessageError

_WIDEST = 32  # Bits of a group's reference or of a value's difference from it


def require_sound_groups(message: bytes, count: int) -> bool:
    """Hold the groups of a message of one field (template 5.2 or 5.3) against its count of values.

    True where decoding can go wrong in no way; False where that cannot be told.

    Raises
    ------
    UnreadableMessageError
        Where the groups do not hold so many values, or reach past the section.
    """
    sections = sections_of(message)
    about, data = sections[5], sections[7]
    template = unsigned(about, 9, 2)
    # octets 32-35 and 20 of section 5: groups, and bits of their reference values
    groups, bits = unsigned(about, 31, 4), about[19]
    # octet 22: groups split in the general way; 23: missing values of two kinds at most
    usual = about[21] == 1 and about[22] <= 2 and bits <= _WIDEST and 0 < groups <= count
    extra = 0
    if template == 3:
        # octets 48 and 49
        order, octets = about[47], about[48]
        usual &= order in (1, 2) and 1 <= octets <= 4 and count > order
        # Spatial differencing: first values and the least difference stand before the
        # groups.
        extra = (order + 1) * octets
    if not usual:
        return False
    # octets 37 and 47; least width and length of a group in 36 and 38-41, increment in 42
    width_bits, length_bits = about[36], about[46]
    if max(width_bits, length_bits) > _WIDEST:
        raise UnreadableMessageError("group widths or lengths of more bits than a field can need")
    at = 5 + extra + (groups * bits + 7) // 8
    widths = _integers(data, at, groups, width_bits) + about[35]
    at += (groups * width_bits + 7) // 8
    lengths = _integers(data, at, groups, length_bits) * about[41] + unsigned(about, 37, 4)
    at += (groups * length_bits + 7) // 8
    # The last group's length is stated by itself.
    lengths[-1] = unsigned(about, 42, 4)
    if int(lengths.sum()) != count:
        raise UnreadableMessageError(f"groups of {int(lengths.sum())} values for {count}")
    if int(widths.max()) > _WIDEST:
        raise UnreadableMessageError("a group wider than a field can need")
    if at + (int((widths * lengths).sum()) + 7) // 8 > len(data):
        raise UnreadableMessageError("groups that reach past the data section")
    return True


def _integers(data: bytes, start: int, count: int, bits: int) -> NDArray[np.int64]:
    """Unsigned integers of a fixed width (0 to 32 bits) from the octets that begin at a place.

    Raises
    ------
    UnreadableMessageError
        Where the octets end before.
    """
    if bits == 0:
        return np.zeros(count, dtype=np.int64)
    octets = (count * bits + 7) // 8
    if start + octets > len(data):
        raise UnreadableMessageError("groups that reach past the data section")
    window = data[start : start + octets] + bytes(8)
    # At every octet the eight that follow, as one number: any field of 32 bits lies in it.
    words: NDArray[np.uint64] = np.ndarray((octets,), dtype=">u8", buffer=window, strides=(1,))
    place = np.arange(count, dtype=np.int64) * bits
    word = words[place >> 3].astype(np.uint64) << (place & 7).astype(np.uint64)
    return np.asarray(word >> np.uint64(64 - bits), dtype=np.int64)
