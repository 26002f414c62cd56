"""Numbers with a unit, times and conditions on lead times, as configurations write them.

Assumes a number and one unit ("3 h", "0.1 deg", "80 kt"), not an expression; inside they are plain
floats in SI units and radians. A time of digits only is year, month, day and so on, as in names of
model files, not seconds since 1970.
"""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from airswing.errors import InputError, shortened
from airswing.units import DAY

if TYPE_CHECKING:  # imported at the first quantity
    import pint


@functools.cache
def registry() -> pint.UnitRegistry[float]:
    """The units of pint, with flight levels (hundreds of feet)."""
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry()
    registry.define("arcmin = arcminute")
    registry.define("hectofoot = 100 * foot = hft")
    return registry


def quantity(text: object, unit: str) -> float:
    """Turn a string such as ``"3 h"`` into a float in a given unit.

    A ValueError is raised without a unit, or with one of another kind.
    """
    # A number without a unit would be read as radians, of 57 degrees.
    if not isinstance(text, str) or _NUMBER.fullmatch(text):
        bare = "10" if text is None else shortened(str(text).strip(), 80)
        raise ValueError(f"needs a unit, such as '{bare} {_EXAMPLE.get(unit, unit)}'")
    fault = f"{shortened(text, 80)!r} is not a quantity in units of {_EXAMPLE.get(unit, unit)}"
    # A number and a unit apart: pint reads a whole expression, where "5..2 h" is one hour.
    match = _QUANTITY.fullmatch(text)
    # An exponent of exponents, "m**9**9**9", would be computed before it is refused.
    if match is None or len(text) > _LONGEST_QUANTITY or _TOWER.search(text):
        raise ValueError(fault)
    import pint

    try:
        value = float(registry().Quantity(float(match[1]), match[2]).to(unit).magnitude)
    except (pint.PintError, AssertionError, AttributeError, TypeError, ValueError) as err:
        raise ValueError(fault) from err
    if not math.isfinite(value):
        raise ValueError(fault)
    return value


# A number, then a unit such as ``deg`` or ``m/s``.
_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\W\d][\w /*^-]*|°)\s*", re.ASCII
)
_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*", re.ASCII)
# Powers of powers, or of three digits: pint would compute them before they could be refused.
_LONGEST_QUANTITY, _TOWER = 60, re.compile(r"(\*\*|\^).*(\*\*|\^)|(\*\*|\^)\s*-?\d{3}")
# Unit to show where one is missing.
_EXAMPLE = {"second": "min", "radian": "deg", "meter / second": "kt"}


Seconds = Annotated[float, BeforeValidator(lambda text: quantity(text, "second"))]
Radians = Annotated[float, BeforeValidator(lambda text: quantity(text, "radian"))]
MetresPerSecond = Annotated[float, BeforeValidator(lambda text: quantity(text, "meter / second"))]


# Digits of a time that is written without separators: to the day, hour, minute, second.
COMPACT = {8: "%Y%m%d", 10: "%Y%m%d%H", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}


def spelt_out(value: object) -> object:
    """Insert separators into a time of digits only; other text is unchanged."""
    digits = str(value).strip()
    # pydantic takes numbers, also in strings, for seconds since 1970: 2009102006 is in 2033.
    if not isinstance(value, int | float) and not _NUMBER.fullmatch(digits):
        return value
    try:
        return datetime.strptime(digits, COMPACT.get(len(digits), "no time has so many"))
    except ValueError:
        raise ValueError("is not a time; write 2009-10-20T06:00, or yyyymmddHHMM") from None


_OPERATORS: dict[str, Callable[[NDArray[np.float64], float], NDArray[np.bool_]]] = {
    ">=": operator.ge,
    ">": operator.gt,
    "<=": operator.le,
    "<": operator.lt,
    "==": operator.eq,
}
_TIME_UNITS = {"h": 3600.0, "hour": 3600.0, "hours": 3600.0, "min": 60.0, "s": 1.0, "d": DAY}


def lead_condition(text: str) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
    """Turn ``any``, ``analysis`` or a comparison such as ``>= 1 h`` into a test of leads (s)."""
    words = text.strip().lower()
    if words == "any":
        return lambda lead: np.ones(np.shape(lead), dtype=bool)
    if words == "analysis":
        return lambda lead: np.asarray(lead) == 0
    match = re.fullmatch(r"(>=|<=|==|>|<)\s*(\d+\.?\d*|\.\d+)\s*([a-z]+)", words)
    if match is None or match[3] not in _TIME_UNITS:
        raise InputError(
            "lead condition not understood",
            field="lead",
            found=text,
            remedy='Write any, analysis, or a comparison such as ">= 1 h"',
        )
    compare, limit = _OPERATORS[match[1]], float(match[2]) * _TIME_UNITS[match[3]]
    return lambda lead: np.asarray(compare(lead, limit))
