"""Units of a Dataset's variables, by MetPy's pint registry, to SI.

Assumes unit strings as UDUNITS and GRIB decoders write them (``m s-1``, ``m s**-1``, ``Pa``,
``millibars``, ``degrees_north``); ``mb`` is a millibar here, which pint takes for a millibarn.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from airswing.errors import InputError

_ALIASES = {"mb": "millibar", "mbar": "millibar", "mbars": "millibar", "hpascal": "hPa"}
_KINDS = {"wind": "m/s", "pressure": "Pa", "length": "m", "angle": "degree", "time": "s"}


def factor_of(text: str | None, kind: str) -> float | None:
    """Factor from a unit to the SI unit (angles: degrees) of a kind of quantity.

    Kinds are wind, pressure, length, angle and time; None where the unit is absent, unknown or of
    another kind.
    """
    if not text or not str(text).strip():
        return None
    import pint
    from metpy.units import units

    written = str(text).strip()
    try:
        unit = units(_ALIASES.get(written.lower(), written))
        return float((1.0 * unit).to(_KINDS[kind]).magnitude)
    # What pint's parser raises on strings that are no units.
    except (pint.PintError, AssertionError, AttributeError, TypeError, ValueError, SyntaxError):
        return None


def written_units(attrs: Mapping[object, object]) -> str | None:
    """Units by a variable's attributes, else in brackets at the end of its long name (GrADS)."""
    units = attrs.get("units")
    if units is not None:
        return str(units)
    told = re.search(r"\[([^\[\]]+)\]\s*$", str(attrs.get("long_name", "")))
    return told.group(1) if told else None


def required_factor(text: str | None, kind: str, *, file: str, name: str) -> float:
    """As :func:`factor_of`, but refused where it cannot be told.

    Raises
    ------
    InputError
        Units missing, unknown or of another kind.
    """
    factor = factor_of(text, kind)
    if factor is None:
        absent = not text or not str(text).strip()
        raise InputError(
            "units missing" if absent else f"units are none of {kind}",
            file=file,
            field=name,
            found=None if absent else text,
            remedy=f"Say them in the configuration as units: {{{name}: {_KINDS[kind]}}}",
        )
    return factor
