"""What the levels of a variable are: pressures, or native levels and how pressure follows.

Assumptions and validity
------------------------
* Isobaric: a coordinate in units of pressure, or the logarithm CF defines
  (``atmosphere_ln_pressure_coordinate``).
* Native: pressure is ``a + b ps``, by the CF formula terms of hybrid (``ap, b, ps``;
  ``a, p0, b, ps``) and sigma coordinates (``sigma, ps, ptop``: ``a = (1 - sigma) ptop``), or by
  the half levels a and b of a GRIB's pv section, of which a full level has the mean; or it is a
  variable on the same levels.
* A coordinate that says it is hybrid or sigma is that, whatever its units: some models write
  ``hPa`` on a number that is no pressure.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.cf.cf_units import factor_of, required_factor
from airswing.reference.gridded.cf.naming import Naming

Floats = NDArray[np.float64]

_NATIVE = ("hybrid", "sigma", "eta", "model_level", "generalvertical", "theta_level")
# A pressure that is not the level's own, such as that above the ground.
_RELATIVE = re.compile(r"difference|above|from ?ground|potential ?vorticity|tropopause", re.I)
_LIKE_PRESSURE = ("lev", "plev", "pres", "isobar")


class Levels(NamedTuple):
    """Levels of a variable."""

    values: Floats  # Pa of isobaric levels, else numbers in the order of the file
    native: bool
    a: Floats  # Pa; coefficients by level, NaN where pressure is a variable
    b: Floats
    surface: str = ""  # the surface pressure in the formula, empty where it is to be found


class OtherLevelsError(Exception):
    """Levels on which no pressure is known: the text says which."""


def levels_of(ds: xr.Dataset, name: str, level: xr.DataArray, naming: Naming, file: str) -> Levels:
    """Tell the levels of a variable from their one-dimensional coordinate.

    Raises
    ------
    OtherLevelsError
        Heights, potential temperatures and whatever has no pressure.
    InputError
        Units missing.
    """
    terms = _terms(level)
    kind = str(level.attrs.get("standard_name", ""))
    units = naming.units.get(str(level.name), level.attrs.get("units"))
    numbers = np.arange(level.size, dtype=np.float64)
    unknown = np.full(level.size, np.nan)
    if kind == "atmosphere_ln_pressure_coordinate":
        reference = _term(ds, terms, "p0", "pressure", file)
        return _isobaric(reference * np.exp(-np.asarray(level.values, dtype=np.float64)))
    formula = _formula(ds, kind, terms, level, file)
    if formula is not None:
        return Levels(numbers, True, *formula, surface=terms.get("ps", ""))
    native = any(word in kind or word in str(level.name).lower() for word in _NATIVE)
    described = f"{level.name} {level.attrs.get('long_name', '')}".replace("_", " ")
    if not native and not _RELATIVE.search(described):
        factor = factor_of(units, "pressure")
        if factor is not None:
            return _isobaric(np.asarray(level.values, dtype=np.float64) * factor)
    if "GRIB_pv" in ds[name].attrs and np.size(ds[name].attrs["GRIB_pv"]) > 2:
        a, b = _half_levels(np.asarray(ds[name].attrs["GRIB_pv"]), np.asarray(level.values))
        return Levels(np.asarray(level.values, dtype=np.float64), True, a, b)
    if native or naming.pressure or _same_levels(ds, name):
        return Levels(numbers, True, unknown, unknown)
    if not units and any(word in str(level.name).lower() for word in _LIKE_PRESSURE):
        required_factor(units, "pressure", file=file, name=str(level.name))
    said = f", {units}" if units else ""
    raise OtherLevelsError(f"levels of another kind ({level.name}{said})")


def _isobaric(values: Floats) -> Levels:
    none = np.full(values.size, np.nan)
    return Levels(values, False, none, none)


def _same_levels(ds: xr.Dataset, name: str) -> str:
    """A pressure on the same dimensions as the variable, empty without."""
    for key in ds.variables:
        one = ds.variables[key]
        pressure = one.attrs.get("standard_name") == "air_pressure"
        if pressure and one.dims == ds[name].dims and factor_of(one.attrs.get("units"), "pressure"):
            return str(key)
    return ""


def _terms(level: xr.DataArray) -> dict[str, str]:
    words = str(level.attrs.get("formula_terms", level.encoding.get("formula_terms", ""))).split()
    return {key.rstrip(":"): value for key, value in zip(words[::2], words[1::2], strict=False)}


def _formula(
    ds: xr.Dataset, kind: str, terms: dict[str, str], level: xr.DataArray, file: str
) -> tuple[Floats, Floats] | None:
    """A (Pa) and b of each level, None where no formula with surface pressure is given."""
    if kind == "atmosphere_sigma_coordinate" or {"sigma", "ptop"} <= set(terms):
        top = _term(ds, terms, "ptop", "pressure", file)
        sigma = np.asarray(level.values, dtype=np.float64)
        if terms.get("sigma") in ds.variables:
            sigma = _term(ds, terms, "sigma", None, file)
        # p = ptop + sigma (ps - ptop), as a + b ps.
        return (1.0 - sigma) * top, sigma
    if "b" not in terms or not {"a", "ap"} & set(terms):
        return None
    b = _term(ds, terms, "b", None, file)
    if "ap" in terms:
        a = _term(ds, terms, "ap", "pressure", file)
    else:
        a = _term(ds, terms, "a", None, file) * _term(ds, terms, "p0", "pressure", file)
    if a.shape != b.shape or b.shape != level.shape:
        raise InputError(
            "formula terms do not fit the levels",
            file=file,
            field=str(level.name),
            found=f"{a.size} and {b.size} coefficients of {level.size} levels",
        )
    return a, b


def _term(ds: xr.Dataset, terms: dict[str, str], term: str, kind: str | None, file: str) -> Floats:
    """Values of a formula term, in SI units."""
    name = terms.get(term, "")
    if name not in ds.variables:
        raise InputError(
            f"formula term {term} of the hybrid levels is missing",
            file=file,
            field=name or term,
            found="terms " + (", ".join(f"{k}: {v}" for k, v in terms.items()) or "none"),
        )
    values = np.asarray(ds[name].values, dtype=np.float64)
    if kind is not None:
        values = values * required_factor(ds[name].attrs.get("units"), kind, file=file, name=name)
    return values


def _half_levels(pv: Floats, numbers: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """A and b (n,) of full levels, 1 the topmost, from a GRIB's coefficients of half levels (2 m,).

    Simmons and Burridge (1981), ECMWF IFS documentation part III: the pressure of a full level is
    the mean of those of the half levels above and below it.
    """
    a, b = np.asarray(pv, dtype=np.float64).reshape(2, -1)
    k = numbers.astype(np.int64)
    if k.size and (k.min() < 1 or k.max() >= a.size):
        raise OtherLevelsError(f"hybrid level {k.max()} of {a.size - 1} in the pv section")
    return (a[k - 1] + a[k]) / 2.0, (b[k - 1] + b[k]) / 2.0
