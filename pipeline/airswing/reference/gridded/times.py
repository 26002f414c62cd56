"""Valid time and lead of every field of a variable.

Times are known by `standard_name` (``time``, ``forecast_reference_time``, ``forecast_period``),
else by the usual names and by dimensions: a time that does not vary along the dimension of the
leads is a base time, also if the configuration names it as `time`. Any two give the third; a valid
time alone is an analysis, lead 0. A lead without units is in hours. Calendars without leap years
are taken by their dates.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.naming import Naming, factor_of

Ints = NDArray[np.int64]

_LEAD = re.compile(
    r"(step|lead(_?time)?|prediction_timedelta|forecast_(period|hour|time)|fhr|tau|time_offset)\w*$",
    re.I,
)
_RUN = re.compile(
    r"(reftime|reference_?time|forecast_reference_time|init(ial)?(ization)?_?time|time_run"
    r"|analysis_time|base_?time|run_?time)\w*$",
    re.I,
)
_TIME = re.compile(r"(valid_?|forecast_?|x)?(times?|dates?)$|jd$|julian\w*$", re.I)
_STANDARD = ("forecast_reference_time", "forecast_period", "time")
_JULIAN = 2_415_020.0, 2_488_070.0  # Julian dates of the years 1900 and 2100
_JULIAN_1970 = 2_440_587.5  # of 1970-01-01T00:00
_DIGITS = {8: "%Y%m%d", 10: "%Y%m%d%H", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}
MISSING = int(np.iinfo(np.int64).min)
"""Value of a time that is not known, as numpy's NaT."""


def times_of(ds: xr.Dataset, name: str, outer: dict[str, int], naming: Naming) -> tuple[Ints, Ints]:
    """Valid times (ns since 1970; `MISSING`) and leads (s) of a variable's fields.

    Fields are in the order of `outer`, its dimensions other than level, y and x with their sizes,
    the last varying first.
    """
    near = {str(key): one for key, one in ds[name].coords.items()}
    for key, variable in ds.variables.items():
        if variable.attrs.get("standard_name") in _STANDARD or _TIME.match(str(key)):
            near.setdefault(str(key), ds[key])
    near = {key: one for key, one in near.items() if set(map(str, one.dims)) <= set(outer)}
    stamps = {key: times for key, one in near.items() if (times := _stamps(one)) is not None}
    leads = [one for key, one in near.items() if key not in stamps and _is_lead(key, one)]
    valid, run, lead = _roles([near[key] for key in stamps], leads, naming, name)
    if valid is None and run is None:
        raise InputError(
            "no time axis",
            field=name,
            found="coordinates " + (", ".join(map(str, ds[name].coords)) or "none"),
            remedy="Each field needs a valid time; name its coordinate as time: NAME",
        )
    begun = None if run is None else spread(stamps[str(run.name)], run.dims, outer)
    after = None if lead is None else spread(_seconds(lead, naming), lead.dims, outer)
    if valid is not None:
        at = spread(stamps[str(valid.name)], valid.dims, outer)
    else:
        assert begun is not None
        at = begun if after is None else begun + after * 1_000_000_000
    if after is None:
        after = np.zeros_like(at) if begun is None else (at - begun) // 1_000_000_000
    return at, np.where(at == MISSING, 0, after)


def _stamps(one: xr.DataArray) -> Ints | None:
    """Times of a coordinate, ns since 1970; None if it holds no times."""
    values = np.asarray(one.values)
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64)
    if str(one.attrs.get("units", "")).startswith("day as %Y%m%d"):
        known = np.nan_to_num(values.ravel().astype(np.float64))
        days = pd.to_datetime(known.astype(int).astype(str), format="%Y%m%d", errors="coerce")
        return _nanoseconds(days + pd.to_timedelta(np.rint(known % 1 * 86400), unit="s"), values)
    if values.dtype.kind == "O" and values.size and hasattr(values.ravel()[0], "calendar"):
        calendar = str(values.ravel()[0].calendar)
        if calendar == "360_day":
            raise InputError(
                "times of a calendar of 360 days, which no observation has",
                field=str(one.name),
                found=calendar,
                remedy="Use winds of real dates",
            )
        dates = [np.datetime64(date.isoformat(), "ns") for date in values.ravel()]
        return np.array(dates).reshape(values.shape).astype(np.int64)
    return _written(one, values) if _TIME.match(str(one.name)) and values.size else None


def _nanoseconds(times: pd.DatetimeIndex, values: NDArray[np.generic]) -> Ints:
    return times.to_numpy().astype("datetime64[ns]").astype(np.int64).reshape(values.shape)


def _written(one: xr.DataArray, values: NDArray[np.generic]) -> Ints | None:
    """Times written as text, as digits (yyyymmdd, yyyymmddHH ...) or as Julian dates, else None."""
    if values.dtype.kind not in "iufSUO":
        return None
    if values.dtype.kind in "iuf":
        numbers = values.astype(np.float64)
        units = f"{one.attrs.get('units', '')} {one.attrs.get('long_name', '')}".lower()
        lead = factor_of(one.attrs.get("units"), "time") is not None and "jul" not in units
        if lead or not np.isfinite(numbers).all():
            return None
        if _JULIAN[0] <= numbers.min() and numbers.max() <= _JULIAN[1]:
            seconds = np.rint((numbers - _JULIAN_1970) * 86400.0)
            return seconds.astype(np.int64) * 1_000_000_000
    texts = [v.decode() if isinstance(v, bytes) else str(v) for v in values.ravel().tolist()]
    texts = [text.strip().removesuffix("Z").removesuffix(".0") for text in texts]
    digits = all(text.isdigit() for text in texts)
    written = _DIGITS.get(len(texts[0])) if digits else "ISO8601"
    if written is None or (values.dtype.kind in "iuf" and not digits):
        return None
    texts = [text.replace("_", "T").replace(" ", "T") for text in texts]
    times = pd.to_datetime(texts, format=written, errors="coerce")
    if times.isna().any() or times.year.min() < 1900 or times.year.max() >= 2100:
        return None
    return _nanoseconds(times, values)


def _is_lead(key: str, one: xr.DataArray) -> bool:
    if one.attrs.get("standard_name") == "forecast_period" or one.dtype.kind == "m":
        return True
    units = one.attrs.get("units")
    known = factor_of(units, "time") is not None or (not units and one.dtype.kind in "iuf")
    return bool(_LEAD.match(key)) and known


def is_time_dimension(key: str, one: xr.DataArray) -> bool:
    """Whether a dimension is one of valid times, base times or leads by its name or coordinate."""
    named = one.attrs.get("standard_name") in _STANDARD or one.dtype.kind == "m"
    return bool(_LEAD.match(key)) or named or _stamps(one) is not None


def _roles(
    stamps: Iterable[xr.DataArray],
    leads: list[xr.DataArray],
    naming: Naming,
    name: str,
) -> tuple[xr.DataArray | None, xr.DataArray | None, xr.DataArray | None]:
    """Coordinates of the valid time, the base time and the lead."""
    # a lead that varies takes precedence over one that is the same for all
    lead = max(leads, key=lambda one: one.ndim > 0, default=None)
    runs: list[xr.DataArray] = []
    valids: list[xr.DataArray] = []
    by_name = {str(one.name): one for one in stamps}
    for key, one in by_name.items():
        named = one.attrs.get("standard_name")
        of_run = named == "forecast_reference_time" or (named != "time" and bool(_RUN.match(key)))
        if not of_run and key != "valid_time" and lead is not None:
            same_for_all = bool(set(lead.dims) - set(one.dims))
            of_run = same_for_all and (named != "time" or "valid_time" not in by_name)
        (runs if of_run else valids).append(one)
    if naming.time:
        if naming.time not in by_name:
            raise InputError(
                "no such time",
                field=f"time: {naming.time}",
                found="times " + (", ".join(by_name) or "none"),
            )
        chosen = by_name[naming.time]
        if lead is not None and set(lead.dims) - set(chosen.dims):
            return None, chosen, lead
        valids, runs = [chosen], [one for one in runs if one.name != naming.time]
    valid = _one_of(valids, name)
    return valid, max(runs, key=lambda one: one.ndim, default=None), lead


def _one_of(found: list[xr.DataArray], name: str) -> xr.DataArray | None:
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
            field=name,
            found=", ".join(str(one.name) for one in found),
            remedy="Name one in the configuration as time: NAME",
        )
    return found[0] if found else None


def _seconds(one: xr.DataArray, naming: Naming) -> Ints:
    values = np.asarray(one.values)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[s]").astype(np.int64)
    units = naming.units.get(str(one.name), one.attrs.get("units"))
    factor = factor_of(units, "time") or 3600.0
    return np.rint(np.asarray(values, dtype=np.float64) * factor).astype(np.int64)


def spread(values: Ints, dims: Sequence[Hashable], outer: dict[str, int]) -> Ints:
    """Values of a coordinate for every field, in the order of `outer`."""
    fields = xr.DataArray(np.empty(tuple(outer.values()), dtype=np.int8), dims=tuple(outer))
    found = xr.DataArray(values, dims=dims).broadcast_like(fields).transpose(*outer)
    return np.asarray(found.values).ravel()
