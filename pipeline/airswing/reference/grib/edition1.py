"""Wind fields of a GRIB1 message from its fixed octets.

Validity: u and v are parameters 33/34 of the international tables (1-3) and of
NCEP's tables 130 and 131, or 131/132 of ECMWF's table 128; isobaric levels
(100), hybrid levels (109) with pressure (parameter 1, ECMWF 54); time range
indicators 0, 1 and 10. Octets count from 0.
"""

from __future__ import annotations

from airswing.reference.geometry.grids import UnplaceableGridError
from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.grib.consistency import (
    check_level,
    check_lowest,
    check_room,
    damaged,
    valid_time,
)
from airswing.reference.grib.fields import (
    PRESSURE,
    RANGES,
    SPEED_ALONE,
    Field,
    FileContents,
    GarbageError,
    SkippedError,
    U,
    V,
    Window,
    off_levels,
    reference_time,
)
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.packing.octets import ibm_float, signed, unsigned
from airswing.reference.packing.simple_packing import MAX_BITS, PADDING

LARGE = 0x800000
"""Octets from which on a message's length is written in another unit."""
# Octets of that unit; bits of a value at most.
LARGE_UNIT, _WIDEST = 120, 64
# Seconds in a unit of time (code table 4).
_TIME_UNITS = {
    0: 60,
    1: 3600,
    2: 86400,
    10: 10800,
    11: 21600,
    12: 43200,
    13: 900,
    14: 1800,
    254: 1,
}


def _kind_grib1(product: bytes) -> int | None:
    # octets 4, 5 and 9 of the product definition: counted from 1, as the tables of WMO do
    table, centre, parameter = product[3], product[4], product[8]
    # ECMWF's own table; NCEP (centre 7) has another of that number
    if table == 128 and centre != 7:
        return {131: U, 132: V, 54: PRESSURE}.get(parameter)
    # versions of the international table, and two of NCEP's with the winds in the same places
    if table in (1, 2, 3) or (table in (130, 131) and centre == 7):
        return {33: U, 34: V, 1: PRESSURE}.get(parameter)
    return None


def _level_grib1(product: bytes, kind: int) -> tuple[int, float]:
    # octets 10 and 11-12
    surface, value = product[9], unsigned(product, 10, 2)
    if surface == 100 and kind != PRESSURE:
        # hPa in edition 1.
        return ISOBARIC, value * 100.0
    if surface == 109:
        return HYBRID, float(value)
    raise off_levels(kind, surface)


def _lead_grib1(product: bytes) -> int:
    # octets 18 to 21: unit, P1, P2 and what they mean (code table 5)
    unit, first, second, indicator = product[17], product[18], product[19], product[20]
    if indicator not in (0, 1, 10):
        name = RANGES.get(indicator, "time range")
        raise SkippedError("wind", f"not instantaneous: {name} (indicator {indicator})")
    if unit not in _TIME_UNITS:
        raise SkippedError("wind", f"forecast time unit {unit}")
    # Time range 10 takes both octets for one number.
    steps = {0: first, 1: 0, 10: first * 256 + second}[indicator]
    return steps * _TIME_UNITS[unit]


def scan_grib1(window: Window, start: int, length: int, contents: FileContents) -> None:
    """Add a message's wind or pressure field to `contents`, or what was skipped and why."""
    product = window.get(start + 8, 28)
    kind = _kind_grib1(product)
    if kind is None:
        # direction and speed, which some files hold in place of components
        if product[3] in (1, 2, 3) and product[8] in (31, 32):
            contents.skipped[SPEED_ALONE] += 1
        return
    try:
        contents.fields.append(_field_grib1(window, start, length, kind, product, contents))
    except SkippedError as skip:
        if skip.what:
            contents.skipped[skip.what, skip.reason] += 1


def _field_grib1(
    window: Window, start: int, length: int, kind: int, product: bytes, contents: FileContents
) -> Field:
    level_kind, level = _level_grib1(product, kind)
    if level_kind == ISOBARIC:
        check_level(level)
    lead = _lead_grib1(product)
    # octets 25 and 13; month to minute are 14 to 17
    century, year = product[24], product[12]
    # Year 100 of a century is its last: 2000 is year 100 of the twentieth.
    valid = valid_time(reference_time((century - 1) * 100 + year, *product[13:17], 0), lead)
    at, end = start + 8, start + length - 4
    at += len(_section(window, at, end, 28))
    # octet 8: bit 1 a grid section follows, bit 2 a bitmap
    if not product[7] & 0x80:
        raise SkippedError("grid", f"no grid section (predefined grid {product[6]})")
    grid_at, grid_section = at, _section(window, at, end, 28)
    at += len(grid_section)
    try:
        grid = contents.grid_number(1, grid_section)
    except UnplaceableGridError as error:
        raise SkippedError("grid", str(error)) from None
    size, bitmap_at = read_grid(1, grid_section).size, -1
    if product[7] & 0x40:
        bitmap_at = at
        at += _bitmap(window, at, end, size)
    return _packed(
        window,
        at,
        end,
        Field(
            offset=start,
            length=length,
            edition=1,
            kind=kind,
            level_kind=level_kind,
            level=level,
            valid=valid,
            lead=lead,
            grid=grid,
            decimal_scale=signed(product, 26, 2),
            section_grid=grid_at,
            section_product=start + 8,
            section_packing=start + 8,
            section_bitmap=bitmap_at,
            section_data=at,
        ),
        size,
    )


def _packed(window: Window, at: int, end: int, field: Field, size: int) -> Field:
    """The field with what its data section says of its packing."""
    data = window.get(at, 11)
    if len(data) < 11 or at + 11 > end:
        raise GarbageError
    # octets 1-3, the upper half of 4, and 11; E stands in 5-6, the reference value in 7-10
    octets, packing, bits = unsigned(data, 0, 3), data[3] >> 4, data[10]
    # The length says something else in a message above 8 MB (see messages).
    stop = end if field.length >= LARGE and octets < LARGE_UNIT else at + octets
    if not at + 11 <= stop <= end:
        raise GarbageError
    if packing & 0x8:
        raise damaged("spherical harmonics on a grid of points")
    reference, scale = ibm_float(data, 6), signed(data, 4, 2)
    check_lowest(field.kind, reference, scale, field.decimal_scale)
    simple = packing == 0
    if bits > _WIDEST:
        raise damaged(f"{bits} bits a value")
    if simple and field.section_bitmap < 0:
        check_room(stop - at - 11, bits, size)
    return field._replace(
        packing=packing,
        sparse=simple and bits <= MAX_BITS,
        bits=bits,
        binary_scale=scale,
        reference_value=reference,
        data_start=at + 11,
        data_end=stop,
    )


def _section(window: Window, at: int, end: int, least: int) -> bytes:
    length = unsigned(window.get(at, 3), 0, 3)
    if length < least or at + length > end:
        raise GarbageError
    return window.get(at, length)


def _bitmap(window: Window, at: int, end: int, size: int) -> int:
    """Length of the bitmap section, which is as long as the grid needs."""
    head = window.get(at, 6)
    length, predefined = unsigned(head, 0, 3), unsigned(head, 4, 2)
    if len(head) < 6 or length < 6 or at + length > end:
        raise GarbageError
    if predefined:
        raise SkippedError("wind", f"predefined bitmap {predefined}")
    if not 0 <= length - 6 - (size + 7) // 8 <= PADDING:
        raise damaged("bitmap that is not its grid's")
    return length
