"""Wind fields of a GRIB2 message, of one or many fields, from its sections.

Validity: u and v are discipline 0, category 2, numbers 2 and 3; isobaric levels
(fixed surface 100), hybrid levels (105, 118) with pressure (0/3/0); product
templates 4.0, 4.1 and 4.2 (ensemble means). Octets count from 0.
"""

from __future__ import annotations

from airswing.reference.geometry.grids import UnplaceableGridError
from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.grib.fields import (
    PRESSURE,
    Field,
    FileContents,
    GarbageError,
    SkippedError,
    U,
    V,
    Window,
    fits,
    off_levels,
    reference_time,
)
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.grib.octets import ieee_float, missing, signed, unsigned
from airswing.reference.grib.packing import MAX_BITS

_TIME_UNITS = {0: 60, 1: 3600, 2: 86400, 10: 10800, 11: 21600, 12: 43200, 13: 1}


SMALLEST_NORMAL = 2.0**-126
"""Smallest single-precision number with a full significand."""


def scan_grib2(window: Window, start: int, length: int, contents: FileContents) -> None:
    """Add the wind and pressure fields of a message to `contents`, or what was skipped and why."""
    discipline, end = window.get(start, 8)[6], start + length - 4
    sections: dict[int, int] = {}
    at, part, bitmap = start + 16, 0, -1
    while at < end:
        head = window.get(at, 6)
        size, number = unsigned(head, 0, 4), head[4]
        if size < 5 or at + size > end or number not in range(1, 8):
            raise GarbageError
        sections[number] = at
        if number == 6 and head[5] == 0:
            bitmap = at
        if number == 7:
            contents.parts += 1
            _scan_part(window, start, length, part, discipline, sections, bitmap, contents)
            part += 1
        at += size


def _scan_part(
    window: Window,
    start: int,
    length: int,
    part: int,
    discipline: int,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> None:
    if not {1, 3, 4, 5, 6} <= sections.keys():
        raise GarbageError
    product = window.get(sections[4], 37)
    kind = {(2, 2): U, (2, 3): V, (3, 0): PRESSURE}.get((product[9], product[10]))
    if discipline != 0 or kind is None:
        return
    try:
        contents.fields.append(
            _field_grib2(window, start, length, part, kind, product, sections, bitmap, contents)
        )
    except SkippedError as skip:
        if skip.what:
            contents.skipped[skip.what, skip.reason] += 1


def _level_grib2(product: bytes, kind: int) -> tuple[int, float]:
    surface, second = product[22], product[28]
    value = signed(product, 24, 4) * 10.0 ** -signed(product, 23, 1)
    if surface == 100 and second == 255 and kind != PRESSURE:
        return ISOBARIC, value
    if surface in (105, 118) and second == 255:
        return HYBRID, value
    raise off_levels(kind, surface)


def _lead_grib2(product: bytes) -> int:
    template, unit = unsigned(product, 7, 2), product[17]
    if template in range(8, 15) or template in (42, 43, 46, 47, 61, 91):
        raise SkippedError("wind", f"not instantaneous (product template 4.{template})")
    if template not in (0, 1, 2):
        raise SkippedError("wind", f"product template 4.{template}")
    if template == 2 and product[34] not in (0, 1):
        raise SkippedError("wind", f"ensemble statistic that is no mean (code {product[34]})")
    if unit not in _TIME_UNITS:
        raise SkippedError("wind", f"forecast time unit {unit}")
    return signed(product, 18, 4) * _TIME_UNITS[unit]


def _field_grib2(
    window: Window,
    start: int,
    length: int,
    part: int,
    kind: int,
    product: bytes,
    sections: dict[int, int],
    bitmap: int,
    contents: FileContents,
) -> Field:
    level_kind, level = _level_grib2(product, kind)
    lead = _lead_grib2(product)
    stamp = window.get(sections[1], 19)
    base = reference_time(unsigned(stamp, 12, 2), *stamp[14:19])
    grid_length = unsigned(window.get(sections[3], 4), 0, 4)
    section = window.get(sections[3], grid_length)
    try:
        grid = contents.grid_number(2, section)
    except UnplaceableGridError as error:
        raise SkippedError("grid", str(error)) from None
    representation = window.get(sections[5], 21)
    packing = unsigned(representation, 9, 2)
    simple = packing == 0 and len(representation) >= 21
    bits = representation[19] if simple else 0
    indicator = window.get(sections[6], 6)[5]
    bitmap_at = {255: -1, 0: sections[6], 254: bitmap}.get(indicator, -1)
    if indicator not in (0, 255) and bitmap_at < 0:
        raise SkippedError("wind", f"predefined bitmap {indicator}")
    room = unsigned(window.get(sections[7], 4), 0, 4) - 5
    size = read_grid(2, section).size
    reference_value = ieee_float(representation, 11) if simple else 0.0
    # eccodes reads subnormal references in a way of its own: those are left to it.
    usual = reference_value == 0.0 or abs(reference_value) >= SMALLEST_NORMAL
    sparse = simple and usual and bits <= MAX_BITS and fits(room, bits, size, bitmap_at)
    member = product[35] if unsigned(product, 7, 2) == 1 and not missing(product, 35, 1) else 0
    return Field(
        file=0, offset=start, length=length, part=part, edition=2, kind=kind,
        level_kind=level_kind, level=level, valid=base + lead * 1_000_000_000, lead=lead,
        member=member, grid=grid, packing=packing, sparse=sparse, bits=bits,
        binary_scale=signed(representation, 15, 2) if simple else 0,
        decimal_scale=signed(representation, 17, 2) if simple else 0,
        reference_value=reference_value,
        data_start=sections[7] + 5, data_end=sections[7] + 5 + room,
        section_identification=sections[1], section_grid=sections[3],
        section_product=sections[4], section_packing=sections[5],
        section_bitmap=bitmap_at,
        section_data=sections[7],
    )  # fmt: skip
