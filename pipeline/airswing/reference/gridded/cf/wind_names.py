"""Which variables of a Dataset are wind components, and whether they point along the grid.

Assumptions and validity
------------------------
* A component is known by its `standard_name`; without one by the parameter a GRIB decoder noted;
  without both by its name or long name, and then it must be a velocity.
* ``x_wind`` and ``grid_eastward_wind`` point along the grid, ``eastward_wind`` to true east,
  whatever the long name says. The GRIB flag (`GRIB_uvRelativeToGrid`), where it was noted, goes
  before: decoders write ``eastward_wind`` of winds along a grid. Without any of them components
  on a projected grid are taken to point along it, as models write them, and that is said.
* Averages over time (`cell_methods`, `GRIB_stepType`) are no winds at a time.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import xarray as xr

from airswing.reference.gridded.cf.cf_units import factor_of
from airswing.reference.gridded.cf.naming import Naming

EARTH = ({"eastward_wind"}, {"northward_wind"})
ALONG = ({"x_wind", "grid_eastward_wind"}, {"y_wind", "grid_northward_wind"})
_PARAMETERS = ({131, "131", "u"}, {132, "132", "v"})
_NAMES = tuple(
    re.compile(
        rf"({c}|{c}{a}|{c}{c}|{c}_?wi?nd(_\w+)?|{c}_?grd\w*|{c}[-_]component_of_wind\w*|{x}_wind\w*"
        rf"|{way}ward_wind\w*)$",
        re.I,
    )
    for c, a, x, way in (("u", "a", "x", "east"), ("v", "a", "y", "north"))
)
_LONG = tuple(
    re.compile(rf"\b({words})[- ]*(component)?[ -]*(of)?[ -]*(the )?wind", re.I)
    for words in ("u|x|zonal|eastward", "v|y|meridional|northward")
)
_AVERAGED = re.compile(r"\btime\w*: *(mean|maximum|minimum|sum|variance)", re.I)
_INSTANT = ("instant", "point", "")


class Component(NamedTuple):
    """A variable that is a wind component: `number` 0 for u, 1 for v; `tier` how it is known."""

    name: str
    number: int
    tier: int


def components(ds: xr.Dataset, naming: Naming) -> list[Component]:
    """Variables that are wind components, best known first."""
    found = []
    for number, configured in enumerate((naming.u, naming.v)):
        if configured:
            if configured in ds.variables:
                found.append(Component(configured, number, 0))
            continue
        for key in ds.data_vars:
            tier = _tier(str(key), ds[key], number)
            if tier is not None:
                found.append(Component(str(key), number, tier))
    return sorted(found, key=lambda one: one.tier)


def _tier(name: str, one: xr.DataArray, number: int) -> int | None:
    """How surely a variable is a component; None where it is not."""
    standard = str(one.attrs.get("standard_name", ""))
    if standard in EARTH[number] | ALONG[number]:
        return 1
    if standard and standard != "unknown":
        return None
    grib = {one.attrs.get("GRIB_paramId"), one.attrs.get("GRIB_shortName")}
    if grib & _PARAMETERS[number]:
        return 2
    named = bool(_NAMES[number].match(name))
    described = _LONG[number].search(str(one.attrs.get("long_name", "")))
    if not (named or described) or one.ndim < 2:
        return None
    units = one.attrs.get("units")
    if units and factor_of(units, "wind") is None:
        return None
    return 3 if described else 4


def averaged(one: xr.DataArray) -> str:
    """What a variable says of averaging over time, empty where it holds winds at a time."""
    methods = _AVERAGED.search(str(one.attrs.get("cell_methods", "")))
    if methods:
        return methods[0]
    step = str(one.attrs.get("GRIB_stepType", ""))
    return "" if step in _INSTANT else step


def along_grid(one: xr.DataArray, naming: Naming) -> tuple[bool | None, str]:
    """Whether a component points along the grid, None where nothing says, and what says so."""
    if naming.winds:
        return naming.winds == "grid", "the configuration"
    flag = one.attrs.get("GRIB_uvRelativeToGrid")
    if flag is not None:
        return bool(int(flag)), "the GRIB flag"
    if any(str(key).startswith("GRIB_") for key in one.attrs):
        return None, ""  # a decoder's standard_name stands for the parameter alone
    standard = str(one.attrs.get("standard_name", ""))
    if standard in ALONG[0] | ALONG[1]:
        return True, f"standard_name {standard}"
    if standard in EARTH[0] | EARTH[1]:
        return False, f"standard_name {standard}"
    return None, ""


def speed_only(ds: xr.Dataset) -> str:
    """A wind speed in a Dataset without components, empty without."""
    for key in ds.data_vars:
        standard = str(ds[key].attrs.get("standard_name", ""))
        name = f"{key} {ds[key].attrs.get('long_name', '')}".lower()
        if standard == "wind_speed" or ("wind" in name and "speed" in name):
            return str(key)
    return ""
