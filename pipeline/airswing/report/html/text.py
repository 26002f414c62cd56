"""Numbers, counts and lists in text; units of speed. Intervals are 95 %."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, SupportsFloat

import numpy as np

from airswing.units import KNOT

#: Unit of every speed that is shown; the configuration's ``units``.
Units = Literal["kt", "m/s"]
#: Ends of an interval; null in JSON where they are not known.
Ends = Sequence[float | None]


def shown_per_m_s(units: Units) -> float:
    """Return the factor from m/s to the unit that is shown."""
    return 1.0 / KNOT if units == "kt" else 1.0


def shown_per_kt(units: Units) -> float:
    """Return the factor from knots to the unit that is shown."""
    return 1.0 if units == "kt" else KNOT


def plural(number: int, noun: str) -> str:
    """Return ``1 flight``, ``12,345 flights`` or ``2 aircraft``."""
    return f"{int(number):,} {noun}{'' if number == 1 or noun == 'aircraft' else 's'}"


def joined(words: Sequence[object], *, most: int = 6) -> str:
    """Return ``a, b and c``, cut after `most` with the number of the rest."""
    shown = [str(word) for word in words[:most]]
    if len(words) > most:
        shown.append(f"{len(words) - most} more")
    return f"{', '.join(shown[:-1])} and {shown[-1]}" if len(shown) > 1 else "".join(shown)


def number_text(value: SupportsFloat | None, *, digits: int = 2, factor: float = 1.0) -> str:
    """Return `factor` times a number with fixed digits, or a dash where there is none."""
    number = float("nan") if value is None else factor * float(value)
    return f"{round(number, digits) + 0.0:.{digits}f}" if np.isfinite(number) else "-"


def interval_text(value: float, half: float, *, digits: int = 2, sign: bool = False) -> str:
    """Return ``value ± half width``, only the number without an interval, or a dash."""
    if not np.isfinite(value):
        return "-"
    number = f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"
    return number + (f" ± {half:.{digits}f}" if np.isfinite(half) else "")


def scaled(interval: Ends | None, factor: float) -> list[float]:
    """Return `factor` times an interval; NaN where JSON has null."""
    return [float("nan") if end is None else factor * end for end in interval or (None, None)]


def range_text(interval: Ends | None, *, digits: int = 2, factor: float = 1.0) -> str:
    """Return `factor` times an interval, `` (low to high)``; empty where it is not known."""
    low, high = scaled(interval, factor)
    return f" ({low:.{digits}f} to {high:.{digits}f})" if np.isfinite(low + high) else ""


def amount(
    value: SupportsFloat | None, ends: Ends | None = None, *, factor: float = 1.0, unit: str = ""
) -> str:
    """Return `factor` times a value with unit and interval: ``1.20 kt (1.05 to 1.34)``."""
    text = number_text(value, factor=factor) + (f" {unit}" if unit else "")
    return text + range_text(ends, factor=factor)
