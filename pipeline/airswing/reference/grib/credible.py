"""Which model winds no atmosphere has: refused before they reach a report, message by message.

A damaged scale factor, or a stream of octets shifted by one, gives winds of hundreds of metres a
second, or of infinity, in a message that looks sound. One such value condemns its message, for no
field of the atmosphere holds one; whether it holds any is judged at places of the grid that depend
on the grid alone, so that the verdict does not depend on which reports are looked at.

Assumptions and validity
------------------------
* Wind components up to 150 m s-1 (the fastest jet streams measured reach 110 to 120 m s-1), level
  pressures up to 1,200 hPa; a missing value (NaN) is none.
* The standard deviation of a component over a whole grid up to 60 m s-1: the widest spread of the
  atmosphere, from easterlies to a winter jet over the globe, is a third of it.
* A simply packed field whose header allows no value beyond these limits is not looked at.
* What slips between the places looked at gives no value at the reports it reaches.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from airswing.reference.grib.consistency import limits
from airswing.reference.grib.fields import PRESSURE
from airswing.reference.packing.simple_packing import UnreadableMessageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_SPREAD = 60.0  # m s-1, standard deviation
# Enough to see a damaged field, nothing beside decoding it.
_PROBES = 256
_NONE: Ints = np.empty(0, dtype=np.int64)


def probes(row: np.void, size: int) -> Ints:
    """Places of a grid of so many points at which to judge a field.

    None where its header allows no value that would be refused.
    """
    if row["sparse"]:
        step = 2.0 ** int(row["binary_scale"]) * 10.0 ** -int(row["decimal_scale"])
        lowest = float(row["reference_value"]) * 10.0 ** -int(row["decimal_scale"])
        highest = lowest + (2.0 ** int(row["bits"]) - 1.0) * step
        if highest <= limits(int(row["kind"]))[1] and highest - lowest <= 2.0 * MAX_SPREAD:
            return _NONE
    return _spread(size)


# fields of an archive have few sizes
@lru_cache(maxsize=64)
def _spread(size: int) -> Ints:
    """Places evenly apart, never a whole number of rows."""
    return np.unique(np.linspace(0, size - 1, min(size, _PROBES)).astype(np.int64))


def require_credible(kind: int, values: Floats) -> None:
    """Refuse a message by its values at :func:`probes`, NaN where missing."""
    known = values[~np.isnan(values)]
    if not known.size:
        return
    low, high = limits(kind)
    worst = float(known[np.argmax(np.abs(known))])
    if not low <= worst <= high:
        what = f"pressure of {worst:.4g} Pa" if kind == PRESSURE else f"wind of {worst:.4g} m/s"
        raise UnreadableMessageError(f"refused: a {what}, which no atmosphere has")
    if kind != PRESSURE and float(known.std()) > MAX_SPREAD:
        raise UnreadableMessageError(
            f"refused: winds spread by {known.std():.3g} m/s, as no atmosphere's are"
        )


def without_absurd(kind: int, values: Floats) -> tuple[Floats, bool]:
    """Values with those no field of a kind has set missing, and whether there were any."""
    low, high = limits(kind)
    with np.errstate(invalid="ignore"):
        absurd = (values < low) | (values > high)
    if not absurd.any():
        return values, False
    return np.where(absurd, np.nan, values), True
