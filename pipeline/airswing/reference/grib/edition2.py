"""Wind fields of a GRIB2 message, of one or many fields, from its sections.

Validity: u and v are discipline 0, category 2, numbers 2 and 3; isobaric levels
(fixed surface 100), hybrid levels (105, 118) with pressure (0/3/0); product
templates 4.0, 4.1 and 4.2 (ensemble means). Octets count from 0.
"""

from __future__ import annotations

from typing import NamedTuple

from airswing.reference.geometry.grids import UnplaceableGridError
from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.grib.consistency import (
    check_count,
    check_level,
    check_lowest,
    check_order,
    check_room,
    check_template,
    damaged,
    has_scaling,
    valid_time,
)
from airswing.reference.grib.fields import (
    PRESSURE,
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
from airswing.reference.packing.octets import ieee_float, missing, signed, unsigned
from airswing.reference.packing.simple_packing import MAX_BITS, PADDING

# Seconds in a forecast time unit (code table 4.4).
_TIME_UNITS = {0: 60, 1: 3600, 2: 86400, 10: 10800, 11: 21600, 12: 43200, 13: 1}
_SHORTEST = {1: 21, 3: 14, 4: 34, 5: 11, 6: 6}  # Octets that every section of a number has
# Bits of a value under simple packing, and under those that compress.
_WIDEST, _WIDEST_PACKED = 64, 38
SMALLEST_NORMAL = 2.0**-126  # Smallest single-precision number with a full significand


class _Part(NamedTuple):
    """One field of a message: where the message is, and which of its fields."""

    start: int
    length: int
    part: int


def scan_grib2(window: Window, start: int, length: int, contents: FileContents) -> None:
    """Add the wind and pressure fields of a message to `contents`, or what was skipped and why."""
    discipline, end = window.get(start, 8)[6], start + length - 4
    sections: dict[int, int] = {}
    at, part, bitmap, before = start + 16, 0, -1, 0
    while at < end:
        head = window.get(at, 6)
        size, number = unsigned(head, 0, 4), head[4]
        if size < _SHORTEST.get(number, 5) or at + size > end or number not in range(1, 8):
            raise GarbageError
        check_order(before, number)
        sections[number], before = at, number
        # Indicator 0: a bitmap of its own, which 254 means again later.
        if number == 6 and head[5] == 0:
            bitmap = at
        if number == 7:
            contents.parts += 1
            _scan_part(window, _Part(start, length, part), discipline, sections, bitmap, contents)
            part += 1
        at += size
    if at != end or before != 7:
        raise GarbageError


def _scan_part(
    window: Window,
    place: _Part,
    discipline: int,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> None:
    product = window.get(sections[4], 37)
    # octets 10 and 11: category and number (table 4.2 of discipline 0)
    kind = {(2, 2): U, (2, 3): V, (3, 0): PRESSURE}.get((product[9], product[10]))
    if discipline != 0 or kind is None:
        # direction and speed, which some files hold in place of components
        if discipline == 0 and product[9] == 2 and product[10] in (0, 1):
            contents.skipped[SPEED_ALONE] += 1
        return
    try:
        contents.fields.append(
            _field_grib2(window, place, kind, product, sections, bitmap, contents)
        )
    except SkippedError as skip:
        if skip.what:
            contents.skipped[skip.what, skip.reason] += 1


def _level_grib2(product: bytes, kind: int) -> tuple[int, float]:
    # octets 23 and 29: kinds of the two fixed surfaces (table 4.5)
    surface, second = product[22], product[28]
    # A fixed surface is a scaled value and its decimal scale; 255 says that there is no
    # second.
    value = signed(product, 24, 4) * 10.0 ** -signed(product, 23, 1)
    if surface == 100 and second == 255 and kind != PRESSURE:
        return ISOBARIC, value
    if surface in (105, 118) and second == 255:
        return HYBRID, value
    raise off_levels(kind, surface)


def _lead_grib2(product: bytes) -> int:
    # octets 8-9 and 18; how far ahead stands in 19-22
    template, unit = unsigned(product, 7, 2), product[17]
    # Templates over a time interval: statistics, not a state.
    if template in range(8, 15) or template in (42, 43, 46, 47, 61, 91):
        raise SkippedError("wind", f"not instantaneous (product template 4.{template})")
    if template not in (0, 1, 2):
        raise SkippedError("wind", f"product template 4.{template}")
    check_template(4, unsigned(product, 0, 4), template)
    # octet 35, table 4.7: unweighted and weighted mean of all members
    if template == 2 and product[34] not in (0, 1):
        raise SkippedError("wind", f"ensemble statistic that is no mean (code {product[34]})")
    if unit not in _TIME_UNITS:
        raise SkippedError("wind", f"forecast time unit {unit}")
    return signed(product, 18, 4) * _TIME_UNITS[unit]


def _field_grib2(
    window: Window,
    place: _Part,
    kind: int,
    product: bytes,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> Field:
    level_kind, level = _level_grib2(product, kind)
    if level_kind == ISOBARIC:
        check_level(level)
    lead = _lead_grib2(product)
    # section 1 has year (octets 13-14), month, day, hour, minute and second
    stamp = window.get(sections[1], 19)
    valid = valid_time(reference_time(unsigned(stamp, 12, 2), *stamp[14:19]), lead)
    section = _section(window, sections[3])
    try:
        grid = contents.grid_number(2, section)
    except UnplaceableGridError as error:
        raise SkippedError("grid", str(error)) from None
    size = read_grid(2, section).size
    if unsigned(section, 6, 4) != size:
        raise damaged(f"{unsigned(section, 6, 4):,} data points on a grid of {size:,}")
    bitmap_at = _bitmap(window, sections[6], bitmap, size)
    # Perturbation number of an ensemble's template 4.1.
    member = product[35] if unsigned(product, 7, 2) == 1 and not missing(product, 35, 1) else 0
    return _packed(
        window,
        Field(
            offset=place.start,
            length=place.length,
            part=place.part,
            edition=2,
            kind=kind,
            level_kind=level_kind,
            level=level,
            valid=valid,
            lead=lead,
            member=member,
            grid=grid,
            data_start=sections[7] + 5,
            data_end=sections[7] + unsigned(window.get(sections[7], 4), 0, 4),
            section_grid=sections[3],
            section_product=sections[4],
            section_packing=sections[5],
            section_bitmap=bitmap_at,
            section_data=sections[7],
        ),
        size,
    )


def _section(window: Window, at: int) -> bytes:
    return window.get(at, unsigned(window.get(at, 4), 0, 4))


def _bitmap(window: Window, at: int, before: int, size: int) -> int:
    """Offset of the bitmap section that holds, -1 where there is none."""
    head = window.get(at, 6)
    octets, indicator = unsigned(head, 0, 4) - 6, head[5]
    bitmap_at = {255: -1, 0: at, 254: before}.get(indicator, -1)
    if indicator not in (0, 255) and bitmap_at < 0:
        raise SkippedError("wind", f"predefined bitmap {indicator}")
    if bitmap_at == before != at and bitmap_at >= 0:
        octets = unsigned(window.get(before, 4), 0, 4) - 6
    if bitmap_at >= 0 and not 0 <= octets - (size + 7) // 8 <= PADDING:
        raise damaged("bitmap that is not its grid's")
    return bitmap_at


def _packed(window: Window, field: Field, size: int) -> Field:
    """The field with what section 5 says of its packing."""
    section = window.get(field.section_packing, 21)
    length, packing = unsigned(section, 0, 4), unsigned(section, 9, 2)
    check_template(5, length, packing)
    # octets 6-9: values coded, fewer than points where a bitmap leaves some out
    coded, bitmap = unsigned(section, 5, 4), field.section_bitmap >= 0
    check_count(coded, size, bitmap=bitmap)
    field = field._replace(packing=packing, coded=coded)
    if not has_scaling(packing):
        return field
    # R in octets 12-15, E in 16-17, D in 18-19, bits a value in 20: Y 10^D = R + X 2^E
    reference, bits = ieee_float(section, 11), section[19]
    binary, decimal = signed(section, 15, 2), signed(section, 17, 2)
    check_lowest(field.kind, reference, binary, decimal)
    field = field._replace(reference_value=reference, binary_scale=binary, decimal_scale=decimal)
    if bits > (_WIDEST if packing == 0 else _WIDEST_PACKED):
        raise damaged(f"{bits} bits a value")
    if packing != 0:
        return field
    check_room(field.data_end - field.data_start, bits, coded)
    # eccodes reads subnormal references in a way of its own: those are left to it.
    usual = reference == 0.0 or abs(reference) >= SMALLEST_NORMAL
    return field._replace(sparse=usual and bits <= MAX_BITS, bits=bits)
