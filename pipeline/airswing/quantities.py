"""Numbers with a unit, as configurations and files of effects write them.

Assumes a number and one unit ("3 h", "0.1 deg", "80 kt"), not an expression; inside they are plain
floats in SI units and radians.
"""

from __future__ import annotations

import functools
import math
import re
from typing import Annotated, Any

from pydantic import BeforeValidator

from airswing.errors import shortened


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry()
    registry.define("arcmin = arcminute")
    return registry


def quantity(text: object, unit: str) -> float:
    """Turn a unit-bearing string into a float in a given unit.

    Parameters
    ----------
    text : str
        Such as ``"3 h"`` or ``"0.1 arcmin"``.
    unit : str
        Unit of the result.

    Raises
    ------
    ValueError
        If there is no unit, or one of another kind.
    """
    if not isinstance(text, str):
        raise ValueError(f"needs a unit, such as '{text} {_EXAMPLE.get(unit, unit)}'")
    fault = f"{shortened(text, 80)!r} is not a quantity in units of {_EXAMPLE.get(unit, unit)}"
    # A number and a unit apart: pint reads a whole expression, where "5..2 h" is one hour.
    match = _QUANTITY.fullmatch(text)
    # An exponent of exponents, "m**9**9**9", would be computed before it is refused.
    if match is None or len(text) > _LONGEST_QUANTITY or _TOWER.search(text):
        raise ValueError(fault)
    import pint

    try:
        value = float(_registry().Quantity(float(match[1]), match[2]).to(unit).magnitude)
    except (pint.PintError, AssertionError, AttributeError, TypeError, ValueError) as err:
        raise ValueError(fault) from err
    if not math.isfinite(value):
        raise ValueError(fault)
    return value


# A number, then a unit such as ``deg`` or ``m/s``, or none.
_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\W\d][\w /*^-]*|°|)\s*", re.ASCII
)
# Powers of powers, or of three digits: pint would work them out before they could be refused.
_LONGEST_QUANTITY, _TOWER = 60, re.compile(r"(\*\*|\^).*(\*\*|\^)|(\*\*|\^)\s*-?\d{3}")
# Unit to show where one is missing.
_EXAMPLE = {"second": "min", "radian": "deg", "meter / second": "kt"}


Seconds = Annotated[float, BeforeValidator(lambda text: quantity(text, "second"))]
Radians = Annotated[float, BeforeValidator(lambda text: quantity(text, "radian"))]
MetresPerSecond = Annotated[float, BeforeValidator(lambda text: quantity(text, "meter / second"))]
