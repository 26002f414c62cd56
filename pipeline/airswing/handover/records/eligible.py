"""Which reports are handed over, and why the others are not.

Assumes screened reports with their correction (``corrected.nc``). Handed over is what every rule of
the screening let pass, but for two rules: ``phase`` only says which legs the fit was made from, and
``field_test`` marks units that apply their own correction, whose winds are corrected as they come.
A report no model wind could be held against (``no_reference``) is not screened for gross errors and
stays out too, unless the configuration accepts it (``handover: {accept: [...]}``). Of corrected
winds, those that could not be corrected stay out, and so do those of aircraft that got one constant
(``offset_only``: a deviation that turns with the heading is still in them), unless accepted.

Limits of what a value can be are those of the reading (:mod:`airswing.reports.canonical.cleaning`):
WRF and WRFDA take whatever number stands in a column, NaN included.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import CORRECTION, SCREENING
from airswing.handover.records.registry import Request
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.physics.triangle import wrap_degrees

if TYPE_CHECKING:
    import xarray as xr

ROW = np.dtype(
    [("time", "i8"), ("report", "i8")]
    + [(name, "f8") for name in ("pressure", "latitude", "longitude", "temperature", "u", "v")]
    + [("error", "f4"), ("aircraft", "i4"), ("phase", "i1")]
)
"""One wind as it is handed over: whole seconds since 1970, Pa, degrees, K, m/s; ``report`` is equal
for the levels of one sounding, ``error`` the standard error the correction left in the vector."""
NEEDED = (
    "time",
    "latitude",
    "longitude",
    "pressure",
    "pressure_altitude",
    "air_temperature",
    "eastward_wind",
    "northward_wind",
    "corrected_eastward_wind",
    "corrected_northward_wind",
    "corrected_wind_standard_error",
    "correction_applied",
    "screening",
    "phase",
    "flight",
)
"""Variables looked at, where they are there."""
_REQUIRED = ("time", "latitude", "longitude", "screening", "phase", "flight")
_POLE = 89.999  # Degrees: nearer to a pole a wind has no direction a reader could turn
# s since 1970: OBSPROC knows years that begin with 19 or 20.
_CENTURIES = tuple(int(np.datetime64(year, "s").astype(np.int64)) for year in ("1900", "2100"))
_AS_CORRECTED = (CORRECTION["corrected"], CORRECTION["already_corrected"])


def winds_of(request: Request) -> tuple[str, str]:
    """Names of the wind components to hand over.

    Raises
    ------
    InputError
        If the Dataset lacks them or anything else that is needed.
    """
    prefix = "corrected_" if request.winds == "corrected" else ""
    names = f"{prefix}eastward_wind", f"{prefix}northward_wind"
    applied = ("correction_applied",) if prefix else ()
    for name in (*names, *applied, *_REQUIRED):
        if name not in request.corrected.variables:
            raise InputError(
                "the reports lack a variable that the hand-over needs",
                field=name,
                remedy="Hand over `corrected.nc` of a run, or what airswing.correct gives for "
                "screened headings",
            )
    if not {"pressure", "pressure_altitude"} & set(request.corrected.variables):
        raise InputError("the reports have no level", field="pressure")
    return names


def eligible_rows(
    block: xr.Dataset, request: Request, *, first_aircraft: int, left_out: Counter[str]
) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Reports of a block of whole aircraft, in memory, that are handed over.

    Parameters
    ----------
    first_aircraft : int
        Number of the block's first aircraft in the archive.
    left_out : Counter
        Takes the counts by reason; a report is counted under the first that holds.

    Returns
    -------
    rows : array of `ROW`
        In the order of the block; ``report`` counts within it.
    chosen : array of int64
        Their places in the block.
    """
    from airswing.products.ragged import aircraft_of_report
    from airswing.reports.canonical.cleaning import LIMITS

    rows = _all_rows(block, request)
    reasons = _reasons(rows, block, request)
    # The first reason that holds: one report is one count.
    code = np.select([bad for _, bad in reasons], list(range(1, len(reasons) + 1)), 0)
    for number, count in enumerate(np.bincount(code, minlength=len(reasons) + 1)[1:]):
        if count:
            left_out[reasons[number][0]] += int(count)
    chosen = np.flatnonzero(code == 0)
    rows = rows[chosen]
    rows["aircraft"] = aircraft_of_report(block)[chosen] + first_aircraft
    rows["report"] = np.arange(rows.size)
    low, high = LIMITS["air_temperature"]
    # Negated, so that NaN is unlikely too; the wind beside it stays.
    unlikely = ~((rows["temperature"] >= low) & (rows["temperature"] <= high))
    rows["temperature"][unlikely] = np.nan
    return rows, chosen


def _all_rows(block: xr.Dataset, request: Request) -> NDArray[np.void]:
    east, north = winds_of(request)
    rows = np.zeros(block.sizes["report"], dtype=ROW)
    time = block["time"].to_numpy().astype("datetime64[ms]").astype(np.int64)
    unknown = time == np.iinfo(np.int64).min
    # To the nearest second: no format holds parts of one.
    rows["time"] = np.where(unknown, time, (time + 500) // 1000)
    columns = {
        "latitude": "latitude",
        "longitude": "longitude",
        "temperature": "air_temperature",
        "u": east,
        "v": north,
        "pressure": "pressure",
        "error": "corrected_wind_standard_error",
        "phase": "phase",
    }
    for name, variable in columns.items():
        rows[name] = block[variable].to_numpy() if variable in block else np.nan
    if "pressure_altitude" in block:
        unknown = np.isnan(rows["pressure"])
        altitude = block["pressure_altitude"].to_numpy()[unknown]
        rows["pressure"][unknown] = pressure_from_altitude(altitude)
    with np.errstate(invalid="ignore"):  # an infinite longitude becomes none
        rows["longitude"] = wrap_degrees(rows["longitude"])
    return rows


def _reasons(
    rows: NDArray[np.void], block: xr.Dataset, request: Request
) -> list[tuple[str, NDArray[np.bool_]]]:
    """Why a report may stay out, in the order the reasons are asked for."""
    from airswing.reports.canonical.cleaning import LIMITS

    speed = np.hypot(rows["u"], rows["v"])
    low, high = LIMITS["pressure"]
    start, end = request.settings.start, request.settings.end
    found = [
        ("no_time", rows["time"] == np.iinfo(np.int64).min),
        ("impossible_time", (rows["time"] < _CENTURIES[0]) | (rows["time"] >= _CENTURIES[1])),
    ]
    if start is not None:
        found.append(("before_the_period", rows["time"] < start.timestamp()))
    if end is not None:
        found.append(("after_the_period", rows["time"] >= end.timestamp()))
    with np.errstate(invalid="ignore"):
        found += [
            ("no_position", ~(np.abs(rows["latitude"]) <= 90.0) | np.isnan(rows["longitude"])),
            ("at_a_pole", np.abs(rows["latitude"]) > _POLE),
            ("no_wind", np.isnan(speed)),
            ("impossible_wind", speed > LIMITS["wind_speed"][1]),
            ("no_level", np.isnan(rows["pressure"])),
            ("impossible_level", (rows["pressure"] < low) | (rows["pressure"] > high)),
        ]
    if request.winds == "corrected":
        found += _uncorrected(block["correction_applied"].to_numpy(), request.settings.accept)
    found += _rejected(block["screening"].to_numpy(), request.settings.accept)
    return found


def _uncorrected(
    applied: NDArray[np.int8], accepted: Sequence[str]
) -> list[tuple[str, NDArray[np.bool_]]]:
    why = {
        name: code
        for name, code in CORRECTION.items()
        if code not in _AS_CORRECTED and name not in accepted
    }
    return [(f"not_corrected_{name}", applied == code) for name, code in why.items()]


def _rejected(
    screening: NDArray[np.int32], accepted: Sequence[str]
) -> list[tuple[str, NDArray[np.bool_]]]:
    rules = {name: bit for name, bit in SCREENING.items() if name not in accepted}
    return [(f"screened_out_{name}", (screening & bit) > 0) for name, bit in rules.items()]
