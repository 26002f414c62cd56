"""Levels of a variable: pressures, or native levels and the formula of their pressure.

Assumptions and validity
------------------------
* Isobaric: a coordinate in units of pressure, or the logarithm that CF defines
  (``atmosphere_ln_pressure_coordinate``). A coordinate with a name of pressure levels and without
  units is in hPa if its largest value is 200 to 1,100, in Pa if it is 20,000 to 110,000 (and the
  values are no consecutive numbers): the levels of aircraft cannot be anything else.
* Native: pressure is ``a + b ps``, by the CF formula terms of hybrid (``ap, b, ps``;
  ``a, p0, b, ps``) and sigma coordinates (``sigma, ps, ptop``: ``a = (1 - sigma) ptop``), or by the
  half levels a and b of a GRIB's pv section, of which a full level has the mean (Simmons and
  Burridge 1981; ECMWF IFS documentation, part III); or it is a variable on the same levels.
* A coordinate that is hybrid or sigma by its attributes is that, whatever its units: some models
  write ``hPa`` on a number that is no pressure.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.naming import Naming, factor_of, required_factor

Floats = NDArray[np.float64]

_NATIVE = ("hybrid", "sigma", "eta", "model_level", "generalvertical", "theta_level")
# a pressure that is not the level's own, such as that above the ground
_RELATIVE = re.compile(r"difference|above|from ?ground|potential ?vorticity|tropopause", re.I)
_NO_UNITS = ("", "1", "level", "levels", "layer", "dimensionless")
_LIKE_PRESSURE = ("lev", "plev", "pres", "isobar")
_LOWEST_PRESSURE = 5_000.0  # Pa: the lowest level of any model that aircraft can be compared with


class Levels(NamedTuple):
    """Levels of a variable."""

    values: Floats  # Pa if isobaric, else numbers in the order of the file
    native: bool
    a: Floats  # Pa; coefficients by level, NaN if pressure is a variable
    b: Floats
    surface: str = ""  # the surface pressure in the formula, empty if it is not named
    note: str = ""  # what was assumed


class OtherLevelsError(Exception):
    """Levels without a pressure; the text describes them."""


def levels_of(ds: xr.Dataset, name: str, level: xr.DataArray, naming: Naming, file: str) -> Levels:
    """Levels of a variable from their one-dimensional coordinate.

    Raises
    ------
    OtherLevelsError
        Heights, potential temperatures and others without a pressure.
    InputError
        Units missing, or no level below 50 hPa.
    """
    words = str(level.attrs.get("formula_terms", level.encoding.get("formula_terms", ""))).split()
    terms = {key.rstrip(":"): value for key, value in zip(words[::2], words[1::2], strict=False)}
    kind, key = str(level.attrs.get("standard_name", "")), str(level.name)
    units = naming.units.get(key, level.attrs.get("units"))
    values, unknown = _numbers(level), np.full(level.size, np.nan)
    if kind == "atmosphere_ln_pressure_coordinate":
        reference = _term(ds, terms, "p0", "pressure", file)
        return _isobaric(reference * np.exp(-values), key, file)
    formula = _formula(ds, kind, terms, level, file)
    if formula is not None:
        numbers = np.arange(level.size, dtype=np.float64)
        return Levels(numbers, True, *formula, surface=terms.get("ps", ""))
    native = any(word in kind or word in key.lower() for word in _NATIVE)
    described = f"{key} {level.attrs.get('long_name', '')}".replace("_", " ")
    if not native and not _RELATIVE.search(described):
        factor = factor_of(units, "pressure")
        if factor is None and str(units or "").strip() in _NO_UNITS and naming.pressure is None:
            factor = _factor_by_values(key, values)
            unit = "hPa" if factor == 100.0 else "Pa"
            if factor is not None:
                found = _isobaric(values * factor, key, file)
                return found._replace(note=f"{key} has no units: taken as {unit} from its values")
        if factor is not None:
            return _isobaric(values * factor, key, file)
    pv = ds[name].attrs.get("GRIB_pv", ())
    if np.size(pv) > 2:
        return Levels(values, True, *_half_levels(np.asarray(pv), values))
    if native or naming.pressure or pressure_on(ds, name):
        return Levels(np.arange(level.size, dtype=np.float64), True, unknown, unknown)
    if not units and any(word in key.lower() for word in _LIKE_PRESSURE):
        required_factor(units, "pressure", file=file, name=key)
    raise OtherLevelsError(f"levels of another kind ({key}{f', {units}' if units else ''})")


def _numbers(level: xr.DataArray) -> Floats:
    try:
        return np.asarray(level.values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.arange(level.size, dtype=np.float64)


def _isobaric(values: Floats, key: str, file: str) -> Levels:
    if values.size > 1 and float(np.nanmax(values)) < _LOWEST_PRESSURE:
        raise InputError(
            f"pressure levels end at {float(np.nanmax(values)) / 100:g} hPa, above all aircraft",
            file=file,
            field=key,
            remedy=f"Check their unit; if they are in hPa give units: {{{key}: hPa}}",
        )
    none = np.full(values.size, np.nan)
    return Levels(values, False, none, none)


def _factor_by_values(key: str, values: Floats) -> float | None:
    """Factor to Pa of levels without units, by name and values; None if they may be others."""
    if not any(word in key.lower() for word in _LIKE_PRESSURE) or values.size < 2:
        return None
    low, high = float(values.min()), float(values.max())
    numbers = np.array_equal(np.sort(values), np.arange(low, low + values.size))
    for factor in (100.0, 1.0):
        if low > 0.0 and 20_000.0 <= high * factor <= 110_000.0 and not numbers:
            return factor
    return None


def pressure_on(ds: xr.Dataset, name: str) -> str:
    """A pressure on the same dimensions as a variable, empty if there is none."""
    for key in ds.variables:
        one = ds.variables[key]
        pressure = one.attrs.get("standard_name") == "air_pressure"
        if pressure and one.dims == ds[name].dims and factor_of(one.attrs.get("units"), "pressure"):
            return str(key)
    return ""


def _formula(
    ds: xr.Dataset, kind: str, terms: dict[str, str], level: xr.DataArray, file: str
) -> tuple[Floats, Floats] | None:
    """Coefficients a (Pa) and b of each level; None without a formula of surface pressure."""
    if kind == "atmosphere_sigma_coordinate" or {"sigma", "ptop"} <= set(terms):
        top = _term(ds, terms, "ptop", "pressure", file)
        sigma = np.asarray(level.values, dtype=np.float64)
        if terms.get("sigma") in ds.variables:
            sigma = _term(ds, terms, "sigma", None, file)
        return (1.0 - sigma) * top, sigma  # p = ptop + sigma (ps - ptop)
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


def _half_levels(pv: Floats, numbers: Floats) -> tuple[Floats, Floats]:
    """Coefficients (n,) of full levels, 1 the topmost, from those of half levels (2 m,)."""
    a, b = np.asarray(pv, dtype=np.float64).reshape(2, -1)
    k = numbers.astype(np.int64)
    if k.size and (k.min() < 1 or k.max() >= a.size):
        raise OtherLevelsError(f"hybrid level {k.max()} of {a.size - 1} in the pv section")
    return (a[k - 1] + a[k]) / 2.0, (b[k - 1] + b[k]) / 2.0
