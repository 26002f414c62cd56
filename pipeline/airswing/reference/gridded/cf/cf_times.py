"""Valid time and lead of every field of a variable.

Assumptions and validity
------------------------
* Times are told by `standard_name`: ``time`` is when the winds blow, ``forecast_reference_time``
  when the run began, ``forecast_period`` the lead between them; without, by the usual names and
  by dimensions (a time that does not vary along the dimension of the leads is a run's).
* Any two give the third; a valid time alone is an analysis, lead 0.
* Calendars without leap years are taken by their dates; a year of 360 days is refused.
"""

from __future__ import annotations

import re

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.cf.cf_units import factor_of
from airswing.reference.gridded.cf.naming import Naming

Ints = NDArray[np.int64]

_RUN = re.compile(
    r"(reftime|reference_?time|forecast_reference_time|init(ial)?(ization)?_?time|time_run"
    r"|analysis_time|base_?time|run_?time)\w*$",
    re.I,
)
_LEAD = re.compile(
    r"(step|lead(_?time)?|prediction_timedelta|forecast_(period|hour|time)|fhr|time_offset)\w*$",
    re.I,
)


def times_of(
    ds: xr.Dataset, name: str, outer: dict[str, int], naming: Naming, file: str
) -> tuple[Ints, Ints]:
    """Valid times (ns since 1970) and leads (s) of a variable's fields.

    In order of `outer`, its dimensions beside level, y and x with their sizes, the last varying
    first; a time that is missing is the least integer.

    Raises
    ------
    InputError
        Without a time axis, or with times that cannot be told apart.
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
            remedy="Each field needs a valid time; say which coordinate holds it as time: NAME",
        )
    begun = None if run is None else _spread(_stamps(run, file), run, outer)
    after = None if lead is None else _spread(_seconds(lead, file), lead, outer)
    if valid is not None:
        blown = _spread(_stamps(valid, file), valid, outer)
    else:
        assert begun is not None
        blown = begun if after is None else begun + after * 1_000_000_000
    if after is None:
        after = np.zeros_like(blown) if begun is None else (blown - begun) // 1_000_000_000
    unknown = blown == np.iinfo(np.int64).min
    return blown, np.where(unknown, 0, after)


def _candidates(ds: xr.Dataset, name: str, outer: set[str]) -> dict[str, xr.DataArray]:
    """Coordinates of a variable, and variables that say they are a run's time or a lead."""
    found = {str(key): one for key, one in ds[name].coords.items()}
    for key in ds.variables:
        standard = str(ds.variables[key].attrs.get("standard_name", ""))
        if standard in ("forecast_reference_time", "forecast_period", "time"):
            found.setdefault(str(key), ds[key])
    return {key: one for key, one in found.items() if set(map(str, one.dims)) <= outer}


def _is_stamp(one: xr.DataArray) -> bool:
    if one.dtype.kind == "M":
        return True
    return one.dtype == object and one.size > 0 and hasattr(one.values.ravel()[0], "calendar")


def _is_lead(key: str, one: xr.DataArray) -> bool:
    if one.attrs.get("standard_name") == "forecast_period" or one.dtype.kind == "m":
        return True
    return bool(_LEAD.match(key)) and factor_of(one.attrs.get("units"), "time") is not None


def _roles(
    stamps: dict[str, xr.DataArray],
    leads: dict[str, xr.DataArray],
    naming: Naming,
    file: str,
    name: str,
) -> tuple[xr.DataArray | None, xr.DataArray | None, xr.DataArray | None]:
    """Which coordinate is the valid time, which the run's, which the lead."""
    # A lead that varies goes before one that is the same for all.
    lead = next((one for one in leads.values() if one.ndim), next(iter(leads.values()), None))
    runs: list[xr.DataArray] = []
    valids: list[xr.DataArray] = []
    for key, one in stamps.items():
        named = one.attrs.get("standard_name")
        of_run = named == "forecast_reference_time" or (named != "time" and bool(_RUN.match(key)))
        if not of_run and named != "time" and key != "valid_time" and lead is not None:
            of_run = bool(set(lead.dims) - set(one.dims))  # the same for every lead: the run's
        (runs if of_run else valids).append(one)
    if naming.time:
        if naming.time not in stamps:
            raise InputError(
                "no such time",
                file=file,
                field=f"time: {naming.time}",
                found="times " + (", ".join(stamps) or "none"),
            )
        valids = [stamps[naming.time]]
        runs = [one for one in runs if one.name != naming.time]
    valid = _one_of(valids, file, name)
    return valid, (_most(runs) if runs else None), lead


def _one_of(found: list[xr.DataArray], file: str, name: str) -> xr.DataArray | None:
    """The valid time among the candidates: a dimension's own coordinate, or the only one."""
    if len(found) < 2:
        return found[0] if found else None
    for test in (
        lambda one: one.attrs.get("standard_name") == "time" or one.name == "valid_time",
        lambda one: one.name in one.dims,
    ):
        chosen = [one for one in found if test(one)]
        found = chosen or found
        if len(found) == 1:
            return found[0]
    largest = max(one.ndim for one in found)
    found = [one for one in found if one.ndim == largest]
    if len(found) == 1:
        return found[0]
    raise InputError(
        "two candidates for the valid time",
        file=file,
        field=name,
        found=", ".join(str(one.name) for one in found),
        remedy="Say which in the configuration as time: NAME",
    )


def _most(found: list[xr.DataArray]) -> xr.DataArray:
    return max(found, key=lambda one: one.ndim)


def _stamps(one: xr.DataArray, file: str) -> Ints:
    values = np.asarray(one.values)
    if values.dtype.kind != "M":
        values = _from_dates(values, str(one.name), file)
    return values.astype("datetime64[ns]").astype(np.int64)


def _from_dates(values: NDArray[np.object_], name: str, file: str) -> NDArray[np.generic]:
    """Dates of another calendar as dates of ours."""
    calendar = str(values.ravel()[0].calendar)
    if calendar == "360_day":
        raise InputError(
            "a calendar of 360 days holds no observations' times",
            file=file,
            field=name,
            found=calendar,
            remedy="Use winds of dates that were",
        )
    flat = [np.datetime64(date.isoformat(), "ns") for date in values.ravel()]
    return np.array(flat).reshape(values.shape)


def _seconds(one: xr.DataArray, file: str) -> Ints:
    values = np.asarray(one.values)
    if values.dtype.kind == "m":
        return values.astype("timedelta64[s]").astype(np.int64)
    factor = factor_of(one.attrs.get("units"), "time")
    if factor is None:
        raise InputError("units of the lead missing", file=file, field=str(one.name))
    return np.rint(np.asarray(values, dtype=np.float64) * factor).astype(np.int64)


def _spread(values: Ints, one: xr.DataArray, outer: dict[str, int]) -> Ints:
    """Values of a coordinate for every field."""
    dims = [str(d) for d in one.dims]
    order = [d for d in outer if d in dims]
    values = values.transpose([dims.index(d) for d in order])
    shape = [outer[d] if d in order else 1 for d in outer]
    # a copy: a view of one value seen many times cannot be written to
    return np.broadcast_to(values.reshape(shape), tuple(outer.values())).ravel().copy()
