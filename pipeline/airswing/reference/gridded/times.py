"""Valid time and lead of every field of a variable.

Times are known by `standard_name`: ``time`` is the valid time, ``forecast_reference_time`` the base
time, ``forecast_period`` the lead; without it by the usual names and by dimensions: a time that
does not vary along the dimension of the leads is a base time, also if the configuration names it as
`time`. Any two give the third; a valid time alone is an analysis, lead 0. A lead without units is
in hours. CDO's absolute times (``day as %Y%m%d.%f``) are understood. Calendars without leap years
are taken by their dates; a year of 360 days is refused.
"""

from __future__ import annotations

import re

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.axes import LEAD_NAME
from airswing.reference.gridded.naming import Naming, factor_of

Ints = NDArray[np.int64]

_RUN = re.compile(
    r"(reftime|reference_?time|forecast_reference_time|init(ial)?(ization)?_?time|time_run"
    r"|analysis_time|base_?time|run_?time)\w*$",
    re.I,
)
_ABSOLUTE = "day as %Y%m%d"
_TIME = re.compile(r"(valid_?|forecast_?|x)?(times?|dates?)$|jd$|julian\w*$", re.I)
_JULIAN = 2_415_020.0, 2_488_070.0  # Julian dates of the years 1900 and 2100
MISSING = int(np.iinfo(np.int64).min)
"""Value of a time that is not known."""


def times_of(
    ds: xr.Dataset, name: str, outer: dict[str, int], naming: Naming, file: str
) -> tuple[Ints, Ints]:
    """Valid times (ns since 1970; `MISSING`) and leads (s) of a variable's fields.

    Parameters
    ----------
    outer : dict of str to int
        Its dimensions other than level, y and x, and their sizes; fields are in their order, the
        last varying first.
    """
    near = _candidates(ds, name, set(outer))
    stamps = {key: one for key, one in near.items() if _is_stamp(one)}
    leads = {key: one for key, one in near.items() if key not in stamps and _is_lead(key, one)}
    valid, run, lead = _roles(stamps, leads, naming, file, name)
    if valid is None and run is None:
        raise InputError(
            "no time axis",
            file=file,
            field=name,
            found="coordinates " + (", ".join(map(str, ds[name].coords)) or "none"),
            remedy="Each field needs a valid time; name its coordinate as time: NAME",
        )
    begun = None if run is None else _spread(stamps_of(run, file), run, outer)
    after = None if lead is None else _spread(_seconds(lead, naming), lead, outer)
    if valid is not None:
        at = _spread(stamps_of(valid, file), valid, outer)
    else:
        assert begun is not None
        at = begun if after is None else begun + after * 1_000_000_000
    if after is None:
        after = np.zeros_like(at) if begun is None else (at - begun) // 1_000_000_000
    return at, np.where(at == MISSING, 0, after)


def _candidates(ds: xr.Dataset, name: str, outer: set[str]) -> dict[str, xr.DataArray]:
    """Coordinates of a variable, and variables with the standard name of a time."""
    found = {str(key): one for key, one in ds[name].coords.items()}
    for key in ds.variables:
        standard = str(ds.variables[key].attrs.get("standard_name", ""))
        named = standard in ("forecast_reference_time", "forecast_period", "time")
        if named or _TIME.match(str(key)):
            found.setdefault(str(key), ds[key])
    return {key: one for key, one in found.items() if set(map(str, one.dims)) <= outer}


def _is_stamp(one: xr.DataArray) -> bool:
    if one.dtype.kind == "M" or _is_absolute(one):
        return True
    if one.dtype.kind == "O" and one.size and hasattr(one.values.ravel()[0], "calendar"):
        return True
    return bool(_TIME.match(str(one.name))) and bool(one.size) and _written(one) is not None


def _is_absolute(one: xr.DataArray) -> bool:
    return str(one.attrs.get("units", "")).startswith(_ABSOLUTE)


def _written(one: xr.DataArray) -> Ints | None:
    """Times written as text, as digits (yyyymmdd, yyyymmddHH ...) or as Julian dates, else None."""
    values = np.asarray(one.values)
    numeric = values.dtype.kind in "iuf"
    units = f"{one.attrs.get('units', '')} {one.attrs.get('long_name', '')}".lower()
    if values.dtype.kind not in "iufSUO" or (numeric and not np.isfinite(values).all()):
        return None
    if numeric and factor_of(one.attrs.get("units"), "time") is not None and "jul" not in units:
        return None  # a lead
    if numeric and _JULIAN[0] <= values.min() and values.max() <= _JULIAN[1]:
        # the Julian date of 1970-01-01T00:00 is 2440587.5
        seconds = np.rint((values.astype(np.float64) - 2_440_587.5) * 86400.0)
        return seconds.astype(np.int64) * 1_000_000_000
    return _parsed(values)


def _parsed(values: NDArray[np.generic]) -> Ints | None:
    """Dates of text or digits; None if one is none of the years 1900 to 2100."""
    found = []
    for value in values.ravel().tolist():
        text = value.decode() if isinstance(value, bytes) else str(value)
        text = text.strip().removesuffix("Z").replace("_", "T").replace(" ", "T")
        if not isinstance(value, bytes | str) or text.isdigit():
            digits = text.removesuffix(".0")
            if not digits.isdigit() or len(digits) not in (8, 10, 12, 14):
                return None
            year, *rest = digits[:4], *(digits[n : n + 2] for n in range(4, len(digits), 2))
            rest += ["00"] * (5 - len(rest))
            text = f"{year}-{rest[0]}-{rest[1]}T{rest[2]}:{rest[3]}:{rest[4]}"
        try:
            stamp = np.datetime64(text, "ns")
        except ValueError:
            return None
        if not np.datetime64("1900") <= stamp < np.datetime64("2100"):
            return None
        found.append(stamp.astype(np.int64))
    return np.array(found, dtype=np.int64).reshape(values.shape)


def _is_lead(key: str, one: xr.DataArray) -> bool:
    if one.attrs.get("standard_name") == "forecast_period" or one.dtype.kind == "m":
        return True
    units = one.attrs.get("units")
    known = factor_of(units, "time") is not None or (not units and one.dtype.kind in "iuf")
    return bool(LEAD_NAME.match(key)) and known


def _roles(
    stamps: dict[str, xr.DataArray],
    leads: dict[str, xr.DataArray],
    naming: Naming,
    file: str,
    name: str,
) -> tuple[xr.DataArray | None, xr.DataArray | None, xr.DataArray | None]:
    """Coordinates of the valid time, the base time and the lead."""
    # a lead that varies takes precedence over one that is the same for all
    lead = next((one for one in leads.values() if one.ndim), next(iter(leads.values()), None))
    runs: list[xr.DataArray] = []
    valids: list[xr.DataArray] = []
    for key, one in stamps.items():
        named = one.attrs.get("standard_name")
        of_run = named == "forecast_reference_time" or (named != "time" and bool(_RUN.match(key)))
        if not of_run and key != "valid_time" and lead is not None:
            same_for_all = bool(set(lead.dims) - set(one.dims))
            of_run = same_for_all and (named != "time" or "valid_time" not in stamps)
        (runs if of_run else valids).append(one)
    if naming.time:
        if naming.time not in stamps:
            raise InputError(
                "no such time",
                file=file,
                field=f"time: {naming.time}",
                found="times " + (", ".join(stamps) or "none"),
            )
        chosen = stamps[naming.time]
        if lead is not None and set(lead.dims) - set(chosen.dims):
            return None, chosen, lead
        valids, runs = [chosen], [one for one in runs if one.name != naming.time]
    valid = _one_of(valids, file, name)
    return valid, max(runs, key=lambda one: one.ndim, default=None), lead


def _one_of(found: list[xr.DataArray], file: str, name: str) -> xr.DataArray | None:
    """The valid time among the candidates: a dimension's own coordinate, or the only one."""
    most = max((one.ndim for one in found), default=0)
    for test in (
        lambda one: one.attrs.get("standard_name") == "time" or one.name == "valid_time",
        lambda one: one.name in one.dims,
        lambda one: one.ndim == most,
    ):
        if len(found) > 1:
            found = [one for one in found if test(one)] or found
    if len(found) > 1:
        raise InputError(
            "two candidates for the valid time",
            file=file,
            field=name,
            found=", ".join(str(one.name) for one in found),
            remedy="Name one in the configuration as time: NAME",
        )
    return found[0] if found else None


def stamps_of(one: xr.DataArray, file: str) -> Ints:
    """Times of a coordinate, ns since 1970."""
    values = np.asarray(one.values)
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)
    if _is_absolute(one):
        return _absolute(values.astype(np.float64))
    if (written := _written(one)) is not None:
        return written
    calendar = str(values.ravel()[0].calendar)
    if calendar == "360_day":
        raise InputError(
            "times of a calendar of 360 days, which no observation has",
            file=file,
            field=str(one.name),
            found=calendar,
            remedy="Use winds of real dates",
        )
    flat = [np.datetime64(date.isoformat(), "ns") for date in values.ravel()]
    return np.array(flat).reshape(values.shape).astype(np.int64)


def _absolute(values: NDArray[np.float64]) -> Ints:
    """Times written as yyyymmdd and a fraction of the day, to the second."""
    day = np.floor(values).astype(np.int64)
    found = np.full(values.shape, MISSING)
    for index in np.ndindex(values.shape):
        year, month, date = day[index] // 10000, day[index] // 100 % 100, day[index] % 100
        try:
            start = np.datetime64(f"{year:04d}-{month:02d}-{date:02d}", "ns")
        except ValueError:
            continue
        seconds = round(float(values[index] - day[index]) * 86400.0)
        found[index] = start.astype(np.int64) + seconds * 1_000_000_000
    return found


def _seconds(one: xr.DataArray, naming: Naming) -> Ints:
    values = np.asarray(one.values)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[s]").astype(np.int64)
    units = naming.units.get(str(one.name), one.attrs.get("units"))
    factor = factor_of(units, "time") or 3600.0
    return np.rint(np.asarray(values, dtype=np.float64) * factor).astype(np.int64)


def _spread(values: Ints, one: xr.DataArray, outer: dict[str, int]) -> Ints:
    """Values of a coordinate for every field."""
    dims = [str(d) for d in one.dims]
    order = [d for d in outer if d in dims]
    values = values.transpose([dims.index(d) for d in order])
    shape = [outer[d] if d in order else 1 for d in outer]
    return np.broadcast_to(values.reshape(shape), tuple(outer.values())).ravel().copy()
