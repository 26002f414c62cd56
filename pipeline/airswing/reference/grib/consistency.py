"""What the octets of one message say, held against each other before anything is decoded.

Assumptions and validity
------------------------
* Base times from 1900 to 2100; leads from a day before to four hundred days after the base time.
  What lies outside is a damaged header: no archive of winds holds it.
* Pressure levels up to 1,200 hPa; winds up to 150 m s-1 (the fastest jet streams measured reach
  110 to 120 m s-1); surface or level pressure up to 1,200 hPa.
* Under every packing that has a reference value, ``R 10^-D`` is the lowest value of the field
  (WMO FM 92 regulation 92.9.4): one that no field of its kind has condemns the message.
* A data section is as long as its values need, but for the few octets writers pad it by.
* Sections of GRIB2 follow each other as WMO FM 92 table 1 has them.

What is refused here is named under ``message``: damaged, not merely of no use.
"""

from __future__ import annotations

import math

from airswing.reference.geometry.winds import MAX_WIND
from airswing.reference.grib.fields import PRESSURE, GarbageError, SkippedError
from airswing.reference.packing.simple_packing import PADDING

MAX_PRESSURE = 120_000.0
"""Pa."""
_EARLIEST, _LATEST = -2_208_988_800, 4_102_444_800  # s since 1970: the years 1900 and 2100
# Seconds: from means that end before their base time to seasonal forecasts.
_SHORTEST_LEAD, _LONGEST_LEAD = -86_400, 400 * 86_400
# Beyond it a power of ten leaves the double precision numbers.
_LARGEST_SCALE = 300
_NEXT = {0: (1,), 1: (2, 3), 2: (3,), 3: (4,), 4: (5,), 5: (6,), 6: (7,), 7: (2, 3, 4)}
# Octets of sections 4 and 5 by template.
_LENGTHS = {
    4: {0: 34, 1: 37, 2: 36},
    5: {0: 21, 2: 47, 3: 49, 4: 12, 40: 23, 41: 21, 42: 25, 40000: 23, 40010: 21},
}
# Templates whose octets 12 to 19 are reference value, binary and decimal scale.
_SCALED = (0, 2, 3, 40, 41, 42, 40000, 40010)


def damaged(reason: str) -> SkippedError:
    """A message whose octets contradict each other or what can be."""
    return SkippedError("message", f"damaged: {reason}")


def valid_time(base: int, lead: int) -> int:
    """Valid time (ns since 1970) of a base time (ns since 1970) and a lead (s).

    Raises
    ------
    SkippedError
        Where no archive holds such a time.
    """
    seconds = base // 1_000_000_000
    if not _EARLIEST <= seconds < _LATEST:
        raise damaged("base time not of the years 1900 to 2100")
    if not _SHORTEST_LEAD <= lead <= _LONGEST_LEAD:
        raise damaged(f"lead time of {lead / 86_400:,.0f} days")
    return base + lead * 1_000_000_000


def check_level(pressure: float) -> None:
    """Refuse an isobaric level (Pa) that no atmosphere has."""
    if not 0.0 < pressure <= MAX_PRESSURE:
        raise damaged(f"pressure level of {pressure / 100.0:g} hPa")


def check_order(before: int, number: int) -> None:
    """Refuse a section of GRIB2 that may not follow the one before (0: the message's start)."""
    if number not in _NEXT[before]:
        raise GarbageError(f"garbage: section {number} after section {before}")


def check_template(number: int, length: int, template: int) -> None:
    """Refuse a section 4 or 5 of GRIB2 too short for its template."""
    if length < _LENGTHS[number].get(template, 0):
        raise damaged(f"section {number} of {length} octets for template {number}.{template}")


def has_scaling(template: int) -> bool:
    """Whether a data template of GRIB2 has reference value and scales where 5.0 has them."""
    return template in _SCALED


def check_count(coded: int, size: int, *, bitmap: bool) -> None:
    """Hold the count of values that section 5 of GRIB2 states against the grid's points."""
    if coded > size or (coded != size and not bitmap):
        raise damaged(f"{coded:,} values on a grid of {size:,} points")


def check_room(octets: int, bits: int, size: int) -> None:
    """Hold a simply packed data section without a bitmap against its grid."""
    needed = (bits * size + 7) // 8
    if octets < needed:
        raise damaged("data section too short for its grid")
    if octets > needed + PADDING and bits:
        raise damaged("data section longer than its grid and its bits a value need")


def limits(kind: int) -> tuple[float, float]:
    """Lowest and highest value of a field of a kind: m s-1, or Pa."""
    return (0.0, MAX_PRESSURE) if kind == PRESSURE else (-MAX_WIND, MAX_WIND)


def check_lowest(kind: int, reference: float, binary_scale: int, decimal_scale: int) -> None:
    """Refuse a field whose lowest value, R 10^-D by its header alone, none of its kind has."""
    if abs(binary_scale) > _LARGEST_SCALE or abs(decimal_scale) > _LARGEST_SCALE:
        raise damaged("scale factors no field has")
    lowest = reference * 10.0**-decimal_scale
    low, high = limits(kind)
    if not (math.isfinite(lowest) and low <= lowest <= high):
        unit = "Pa" if kind == PRESSURE else "m/s"
        raise damaged(f"lowest value of a field outside {low:g} to {high:g} {unit}")
