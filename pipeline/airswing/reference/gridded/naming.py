"""Variables of a Dataset that are wind components, their units, and names in the configuration.

A component is known by its `standard_name`, else by the parameter that a GRIB decoder noted, else
by its name or long name, and then it must be a velocity. Its direction is that of the
configuration, of the GRIB flag (decoders write ``eastward_wind`` for winds along a grid), or of the
standard name; without any, components on a projected grid are taken to point along it. Units are
read by MetPy's pint registry; ``mb`` is a millibar, which pint takes for a millibarn.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import xarray as xr

from airswing.config import Naming
from airswing.errors import InputError

EARTH = ({"eastward_wind"}, {"northward_wind"})
ALONG = ({"x_wind", "grid_eastward_wind"}, {"y_wind", "grid_northward_wind"})
_PARAMETERS = ({131, "131", "u"}, {132, "132", "v"})
_NAMES = tuple(
    re.compile(
        rf"({c}|{c}{a}|{c}{c}|{c}_?wi?nd(_\w+)?|{c}_?grd\w*|{c}[-_]component_of_wind\w*|{x}_wind\w*"
        rf"|{c}_(std|sd|spread|mean|es|em)|{way}ward_wind\w*)$",
        re.I,
    )
    for c, a, x, way in (("u", "a", "x", "east"), ("v", "a", "y", "north"))
)
_LONG = tuple(
    re.compile(rf"\b({words})[- ]*(component)?[ -]*(of)?[ -]*(the )?wind", re.I)
    for words in ("u|x|zonal|eastward", "v|y|meridional|northward")
)
_ALIASES = {"mb": "millibar", "mbar": "millibar", "mbars": "millibar", "hpascal": "hPa"}
_KINDS = {"wind": "m/s", "pressure": "Pa", "length": "m", "angle": "degree", "time": "s"}


class Component(NamedTuple):
    """A variable that is a wind component: `number` 0 for u, 1 for v.

    `tier` is how it was recognised, from 0 (by the configuration) to 4 (by its name).
    """

    name: str
    number: int
    tier: int


def components(ds: xr.Dataset, naming: Naming) -> list[Component]:
    """Variables that are wind components, best known first."""
    candidates = []
    for number, configured in enumerate((naming.u, naming.v)):
        if configured:
            if configured in ds.variables:
                candidates.append(Component(configured, number, 0))
            continue
        for key in ds.data_vars:
            tier = _tier(str(key), ds[key], number)
            if tier is not None:
                candidates.append(Component(str(key), number, tier))
    return sorted(candidates, key=lambda component: component.tier)


def _tier(name: str, variable: xr.DataArray, number: int) -> int | None:
    standard = str(variable.attrs.get("standard_name", "")).split(" ")[0]
    if standard in EARTH[number] | ALONG[number]:
        return 1
    if standard and standard != "unknown":
        return None
    grib = {variable.attrs.get(f"GRIB_{key}") for key in ("paramId", "shortName")}
    if grib & _PARAMETERS[number]:
        return 2
    described = _LONG[number].search(str(variable.attrs.get("long_name", "")))
    if not (_NAMES[number].match(name) or described) or variable.ndim < 2:
        return None
    units = variable.attrs.get("units")
    if units and factor_of(units, "wind") is None:
        return None
    return 3 if described else 4


def along_grid(variable: xr.DataArray, naming: Naming) -> tuple[bool | None, str]:
    """Whether a component points along the grid (None if unknown), and the evidence."""
    if naming.winds:
        return naming.winds == "grid", "the configuration"
    flag = variable.attrs.get("GRIB_uvRelativeToGrid")
    if flag is not None:
        return bool(int(flag)), "the GRIB flag"
    standard, along = str(variable.attrs.get("standard_name", "")), ALONG[0] | ALONG[1]
    # the standard_name of a GRIB decoder gives the parameter, not the direction
    decoded = any(str(key).startswith("GRIB_") for key in variable.attrs)
    if decoded or standard not in EARTH[0] | EARTH[1] | along:
        return None, ""
    return standard in along, f"standard_name {standard}"


def factor_of(text: object, kind: str) -> float | None:
    """Factor from a unit to the SI unit (angles: degrees) of a kind of quantity.

    Kinds are wind, pressure, length, angle and time; None if the unit is absent, unknown or of
    another kind.
    """
    written = str(text or "").strip()
    return _factor(written, kind) if written else None


@lru_cache(maxsize=256)
def _factor(written: str, kind: str) -> float | None:
    import pint
    from metpy.units import units

    try:
        unit = units(_ALIASES.get(written.lower(), written))
        return float((1.0 * unit).to(_KINDS[kind]).magnitude)
    # exceptions of pint's parser for strings that are not units
    except (pint.PintError, AssertionError, AttributeError, TypeError, ValueError, SyntaxError):
        return None


def written_units(attrs: Mapping[object, object]) -> str | None:
    """Units by a variable's attributes, else in brackets at the end of its long name (GrADS)."""
    units = attrs.get("units")
    if units is not None:
        return str(units)
    match = re.search(r"\[([^\[\]]+)\]\s*$", str(attrs.get("long_name", "")))
    return match.group(1) if match else None


def required_factor(text: object, kind: str, *, name: str) -> float:
    """Same as :func:`factor_of`, but units must be known."""
    factor = factor_of(text, kind)
    if factor is None:
        absent = not str(text or "").strip()
        raise InputError(
            "units missing" if absent else f"units of another quantity than {kind}",
            field=name,
            found=None if absent else text,
            remedy=f"Give them in the configuration as units: {{{name}: {_KINDS[kind]}}}",
        )
    return factor
