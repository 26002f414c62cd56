"""Screening: which reports the fit may use, as flag bits, and what each rule removed.

Assumptions
-----------
Headings of `airswing.compass.headings`. Every rule is applied by itself and sets one bit: a
report may carry several and is kept where it carries none. An absent value breaks only the rule
about its absence: a missing roll flag is no bad roll flag unless the policy says so, and the end of
a flight, where no turn can be computed, is no turn.

Size of residuals
-----------------
Screening on the residual itself attenuates every deviation that is fitted afterwards. The gross
error rule is therefore loose: 40 m/s or a third of the airspeed (a deviation of 19 degrees),
whichever is larger, or an airspeed that no aircraft flies. Smaller errors are weighted by the
robust fit. A report is tested against every reference it has, because it is used with all of them:
one reference it is far from would bend the fits of that reference and of every pool that holds it.

Units
-----
Keywords in SI and radians, like the configuration; the Dataset in degrees, like every Dataset.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, TypedDict, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import ConfigError
from airswing.flags import PHASE, ROLL, SCREENING, TEMPERATURE_QC, WIND_QC
from airswing.products.ragged import aircraft_of_report
from airswing.units import KNOT
from airswing.vocabulary import describe

MAX_INNOVATION = 40.0  # m s-1
MAX_INNOVATION_SHARE = 1.0 / 3.0  # Of the airspeed
AIRSPEEDS = (25.0, 350.0)  # m s-1: outside it no aircraft that reports winds flies
# Of the ground speed: a single chord of two whole minutes has 0.27, of three 0.15.
MAX_GROUND_VELOCITY_ERROR = 0.15


class Limits(TypedDict, total=False):
    """Numbers a report must keep to; `LIMITS` where not given."""

    max_turn: float  # largest change of track at the report, radians
    min_ground_speed: float  # m s-1
    # largest standard error of the ground velocity, as a share of the ground speed
    max_ground_velocity_error: float
    # gross errors: vector difference, m s-1, from any reference a report has (a third of its
    # airspeed where that is more)
    max_innovation: float


LIMITS: Limits = {
    "max_turn": float(np.radians(10.0)),
    "min_ground_speed": 80.0 * KNOT,
    "max_ground_velocity_error": MAX_GROUND_VELOCITY_ERROR,
    "max_innovation": MAX_INNOVATION,
}


def screen(
    headings: xr.Dataset,
    *,
    phases: Collection[str] = ("cruise",),
    roll: Literal["reject_bad", "require_good", "ignore"] = "reject_bad",
    temperature_qc: Literal["reject_fail", "require_pass", "ignore"] = "reject_fail",
    wind_qc: Literal["reject_fail", "require_pass", "ignore"] = "reject_fail",
    **limits: Unpack[Limits],
) -> xr.Dataset:
    """Mark the reports that the fit should not use, and why.

    Parameters
    ----------
    headings : Dataset
        Of `airswing.compass.headings.derive_headings`.
    phases : collection of str
        Phases of flight to use: ``ascent``, ``cruise``, ``descent``, ``unknown``.
    roll : {"reject_bad", "require_good", "ignore"}
        Roll flag. Requiring "good" drops every carrier that reports no roll.
    temperature_qc, wind_qc : {"reject_fail", "require_pass", "ignore"}
        The quality flags of the source.
    **limits
        Numbers a report must keep to, as in :class:`Limits`.

    Returns
    -------
    Dataset
        The headings with ``screening`` (report), int32 bits of `airswing.flags.SCREENING`; dask
        arrays stay lazy.

    Raises
    ------
    ConfigError
        On an unknown phase or policy.
    """
    bounds = Limits(**{**LIMITS, **limits})
    rules = {
        "phase": ~headings["phase"].isin(_phase_codes(phases)),
        "roll": _judged(headings, "roll_flag", ROLL, roll, {"reject_bad": "bad"}),
        "temperature_qc": _judged(
            headings, "temperature_qc", TEMPERATURE_QC, temperature_qc, {"reject_fail": "fail"}
        ),
        "wind_qc": _judged(headings, "wind_qc", WIND_QC, wind_qc, {"reject_fail": "fail"}),
        "turn": np.abs(headings["turn"]) > np.degrees(bounds["max_turn"]),
        "ground_speed": headings["ground_speed"] < bounds["min_ground_speed"],
        "no_ground_vector": _no_ground_vector(headings, bounds["max_ground_velocity_error"]),
        "no_reference": _no_reference(headings),
        "missing_wind": headings["eastward_wind"].isnull() | headings["northward_wind"].isnull(),
        "gross_error": _gross_error(headings, bounds["max_innovation"]),
    }
    bits = xr.zeros_like(headings["phase"], dtype=np.int32)
    for name, broken in rules.items():
        bits = bits + broken.astype(np.int32) * np.int32(SCREENING[name])
    return describe(headings.assign(screening=bits.drop_attrs()))


def mark_corrected_units(
    headings: xr.Dataset,
    *,
    aircraft: Collection[str],
    start: np.datetime64,
    end: np.datetime64 | None = None,
) -> xr.Dataset:
    """Mark the reports of units that applied a correction themselves, so that they are not fitted.

    Parameters
    ----------
    headings : Dataset
        Screened.
    aircraft : collection of str
    start, end : datetime64
        First time, and the time before which the marking ends; None: the end of the archive.

    Returns
    -------
    Dataset
        With the bit ``field_test`` of ``screening`` set; dask arrays stay lazy.
    """
    read = headings[["time", "row_size"]]
    found = map_aircraft(_field_test, read, aircraft=list(aircraft), start=start, end=end)
    bits = headings["screening"] | found["screening"]
    # xarray drops attributes in arithmetic
    return headings.assign(screening=bits.assign_attrs(headings["screening"].attrs))


def _field_test(
    headings: xr.Dataset, *, aircraft: list[str], start: np.datetime64, end: np.datetime64 | None
) -> xr.Dataset:
    chosen = np.isin(headings["aircraft"].to_numpy().astype(str), aircraft)
    time = headings["time"].to_numpy()
    marked = chosen[aircraft_of_report(headings)] & (time >= start)
    if end is not None:
        marked &= time < end
    bits = marked.astype(np.int32) * np.int32(SCREENING["field_test"])
    return xr.Dataset({"screening": ("report", bits)})


def audit(headings: xr.Dataset) -> xr.Dataset:
    """Count what each screening rule removed.

    Parameters
    ----------
    headings : Dataset
        Screened.

    Returns
    -------
    Dataset
        ``together`` (rule, aircraft): reports that the rule marked; ``alone`` (rule, aircraft):
        those that no other rule marked, which would be kept without the rule; ``reports``, ``kept``
        (aircraft); and over the fleet ``together_total``, ``alone_total`` (rule),
        ``reports_total``, ``kept_total``. Dask-backed where the headings are.
    """
    found = map_aircraft(_counts, headings[["screening", "row_size"]])
    found = found.assign_coords(rule=list(SCREENING), aircraft=headings["aircraft"].to_numpy())
    totals = {f"{name}_total": found[name].sum("aircraft") for name in found}
    found = found.assign(totals)
    for name, meaning in _MEANINGS.items():
        found[name].attrs["long_name"] = meaning
        found[f"{name}_total"].attrs["long_name"] = f"{meaning}, all aircraft"
    return found


def _counts(headings: xr.Dataset) -> xr.Dataset:
    bits = np.asarray(headings["screening"].to_numpy(), dtype=np.int64)
    aircraft, number = aircraft_of_report(headings), headings.sizes["aircraft"]

    def counted(marked: NDArray[np.bool_]) -> NDArray[np.int64]:
        return np.bincount(aircraft[marked], minlength=number)

    codes = SCREENING.values()
    return xr.Dataset(
        {
            "together": (("rule", "aircraft"), np.stack([counted(bits & b > 0) for b in codes])),
            "alone": (("rule", "aircraft"), np.stack([counted(bits == b) for b in codes])),
            "reports": ("aircraft", counted(np.ones(bits.size, dtype=bool))),
            "kept": ("aircraft", counted(bits == 0)),
        }
    )


_MEANINGS = {
    "together": "reports the rule marked",
    "alone": "reports only this rule marked",
    "reports": "reports before screening",
    "kept": "reports no rule marked",
}


def _phase_codes(phases: Collection[str]) -> list[int]:
    for name in phases:
        if name not in PHASE:
            raise ConfigError(
                "no such phase of flight",
                field="screening.phases",
                found=name,
                remedy=f"Known: {', '.join(PHASE)}",
            )
    return [PHASE[name] for name in phases]


def _judged(
    headings: xr.Dataset,
    name: str,
    codes: dict[str, int],
    policy: str,
    rejecting: dict[str, str],
) -> xr.DataArray:
    """Reports that a flag leaves out under a policy; an absent flag variable is all missing."""
    requiring = {"require_good": "good", "require_pass": "pass"}
    flag = headings.get(name)
    if flag is None:
        flag = xr.zeros_like(headings["phase"])  # 0 is "missing" in every table of codes
    if policy == "ignore":
        return xr.zeros_like(flag, dtype=bool)
    if policy in rejecting:
        return flag == codes[rejecting[policy]]
    if policy in requiring and requiring[policy] in codes:
        return flag != codes[requiring[policy]]
    raise ConfigError(
        "no such screening policy",
        field=f"screening.{name.removesuffix('_flag')}",
        found=policy,
        remedy=f"Known: {', '.join([*rejecting, *requiring, 'ignore'])}",
    )


def _no_ground_vector(headings: xr.Dataset, largest: float) -> xr.DataArray:
    speed = headings["ground_speed"]
    absent = speed.isnull() | headings["ground_velocity_error"].isnull()
    return absent | (headings["ground_velocity_error"] > largest * speed)


def _no_reference(headings: xr.Dataset) -> xr.DataArray:
    east, north = headings["reference_eastward_wind"], headings["reference_northward_wind"]
    return (east.isnull() | north.isnull()).all("reference")


def _gross_error(headings: xr.Dataset, largest: float) -> xr.DataArray:
    east = headings["eastward_wind"] - headings["reference_eastward_wind"]
    north = headings["northward_wind"] - headings["reference_northward_wind"]
    airspeed = headings["airspeed"]
    allowed = (MAX_INNOVATION_SHARE * airspeed.fillna(0.0)).clip(min=largest)
    # missing references are ignored by the maximum
    farthest = (east**2 + north**2).max("reference")
    slow, fast = AIRSPEEDS
    return (farthest > allowed**2) | (airspeed < slow) | (airspeed > fast)
