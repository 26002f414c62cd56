"""Wind fields of a GRIB1 message from its fixed octets.

Validity: u and v are parameters 33/34 of the international tables (1-3) and of
NCEP's tables 130 and 131, or 131/132 of ECMWF's table 128; isobaric levels
(100), hybrid levels (109) with pressure (parameter 1, ECMWF 54); time range
indicators 0, 1 and 10. Octets count from 0.
"""

from __future__ import annotations

from airswing.reference.geometry.grids import UnplaceableGridError
from airswing.reference.geometry.model_time import HYBRID, ISOBARIC
from airswing.reference.grib.fields import (
    PRESSURE,
    RANGES,
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
from airswing.reference.grib.octets import ibm_float, signed, unsigned
from airswing.reference.grib.packing import MAX_BITS

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
    table, centre, parameter = product[3], product[4], product[8]
    if table == 128 and centre != 7:
        return {131: U, 132: V, 54: PRESSURE}.get(parameter)
    if table in (1, 2, 3) or (table in (130, 131) and centre == 7):
        return {33: U, 34: V, 1: PRESSURE}.get(parameter)
    return None


def _level_grib1(product: bytes, kind: int) -> tuple[int, float]:
    surface, value = product[9], unsigned(product, 10, 2)
    if surface == 100 and kind != PRESSURE:
        return ISOBARIC, value * 100.0
    if surface == 109:
        return HYBRID, float(value)
    raise off_levels(kind, surface)


def _lead_grib1(product: bytes) -> int:
    unit, first, second, indicator = product[17], product[18], product[19], product[20]
    if indicator not in (0, 1, 10):
        name = RANGES.get(indicator, "time range")
        raise SkippedError("wind", f"not instantaneous: {name} (indicator {indicator})")
    if unit not in _TIME_UNITS:
        raise SkippedError("wind", f"forecast time unit {unit}")
    steps = {0: first, 1: 0, 10: first * 256 + second}[indicator]
    return steps * _TIME_UNITS[unit]


def scan_grib1(window: Window, start: int, length: int, contents: FileContents) -> None:
    """Add a message's wind or pressure field to `contents`, or what was skipped and why."""
    product = window.get(start + 8, 28)
    kind = _kind_grib1(product)
    if kind is None:
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
    lead = _lead_grib1(product)
    century, year = product[24], product[12]
    base = reference_time((century - 1) * 100 + year, *product[13:17], 0)
    flags = product[7]
    at = start + 8 + unsigned(product, 0, 3)
    if not flags & 0x80:
        number = product[6]
        raise SkippedError("grid", f"no grid section (predefined grid {number})")
    grid_at, grid_section = at, _section1(window, at, start + length)
    at += len(grid_section)
    try:
        grid = contents.grid_number(1, grid_section)
    except UnplaceableGridError as error:
        raise SkippedError("grid", str(error)) from None
    bitmap_at = -1
    if flags & 0x40:
        head, bitmap_at = window.get(at, 6), at
        if unsigned(head, 4, 2):
            raise SkippedError("wind", f"predefined bitmap {unsigned(head, 4, 2)}")
        at += unsigned(head, 0, 3)
    data = window.get(at, 11)
    if len(data) < 11 or at + 11 > start + length:
        raise GarbageError
    packing = data[3] >> 4
    size = read_grid(1, grid_section).size
    whole = fits(unsigned(data, 0, 3) - 11, data[10], size, bitmap_at)
    sparse = packing == 0 and data[10] <= MAX_BITS and whole
    return Field(
        file=0, offset=start, length=length, part=0, edition=1, kind=kind, level_kind=level_kind,
        level=level, valid=base + lead * 1_000_000_000, lead=lead, member=0, grid=grid,
        packing=packing, sparse=sparse, bits=data[10], binary_scale=signed(data, 4, 2),
        decimal_scale=signed(product, 26, 2), reference_value=ibm_float(data, 6),
        data_start=at + 11, data_end=at + unsigned(data, 0, 3),
        section_identification=-1, section_grid=grid_at,
        section_product=start + 8, section_packing=start + 8, section_bitmap=bitmap_at,
        section_data=at,
    )  # fmt: skip


def _section1(window: Window, at: int, end: int) -> bytes:
    length = unsigned(window.get(at, 3), 0, 3)
    if length < 28 or at + length > end:
        raise GarbageError
    return window.get(at, length)
