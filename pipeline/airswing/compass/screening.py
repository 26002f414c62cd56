"""Screening: which reports the fit may use, as flag bits, and what each rule removed.

Headings of `airswing.compass.headings`. Every rule is applied independently and sets one bit; a
report without any bit is kept. A missing value violates only the rule about missing values: a
missing roll flag is not a bad one unless the policy says so, and the end of a flight, where no turn
can be computed, is not a turn.

Screening on the residual itself attenuates every deviation that is fitted afterwards. The gross
error rule is therefore loose: 40 m/s or a third of the airspeed (a deviation of 19 degrees),
whichever is larger, or an airspeed that no aircraft flies. Smaller errors are weighted by the
robust fit. A report is tested against every reference it has: a gross difference from one would
bias its fits and those of every pool that contains it.

Keywords in SI and radians, like the configuration; the Dataset in degrees, like every Dataset.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import ConfigError
from airswing.flags import PHASE, QC, ROLL, SCREENING
from airswing.products.ragged import aircraft_of_report
from airswing.units import KNOT
from airswing.vocabulary import describe

MAX_INNOVATION, MAX_INNOVATION_SHARE = 40.0, 1.0 / 3.0  # m s-1; share of the airspeed
AIRSPEEDS = (25.0, 350.0)  # m s-1: the range of aircraft that report winds
# Share of the ground speed: a single chord of two whole minutes has 0.27, of three 0.15.
MAX_GROUND_VELOCITY_ERROR = 0.15


def screen(
    headings: xr.Dataset,
    *,
    phases: Collection[str] = ("cruise",),
    roll: Literal["reject_bad", "require_good", "ignore"] = "reject_bad",
    temperature_qc: Literal["reject_fail", "require_pass", "ignore"] = "reject_fail",
    wind_qc: Literal["reject_fail", "require_pass", "ignore"] = "reject_fail",
    max_turn: float = float(np.radians(10.0)),
    min_ground_speed: float = 80.0 * KNOT,
) -> xr.Dataset:
    """Mark the reports that the fit should not use, with the reasons.

    Parameters
    ----------
    headings : Dataset
        From `airswing.compass.headings.derive_headings`.
    phases : collection of str
        Phases of flight to use: ``ascent``, ``cruise``, ``descent``, ``unknown``.
    roll : {"reject_bad", "require_good", "ignore"}
        Roll flag. Requiring "good" drops every carrier that reports no roll.
    temperature_qc, wind_qc : {"reject_fail", "require_pass", "ignore"}
        The quality flags of the source.
    max_turn : float
        Largest change of track at the report, radians.
    min_ground_speed : float
        m s-1.

    Returns
    -------
    Dataset
        The headings with ``screening`` (report), int32 bits of `airswing.flags.SCREENING`; dask
        arrays stay lazy.

    Raises
    ------
    ConfigError
        On an unknown phase or policy.

    Examples
    --------
    >>> cruise = airswing.screen(headings, phases=["cruise"])
    >>> everywhere = airswing.screen(headings, phases=["ascent", "cruise", "descent"])
    >>> int((cruise["screening"] == 0).sum()) < int((everywhere["screening"] == 0).sum())
    True
    """
    for name in phases:
        if name not in PHASE:
            raise ConfigError(
                "no such phase of flight",
                field="screening.phases",
                found=name,
                remedy=f"Known: {', '.join(PHASE)}",
            )
    wind = headings["eastward_wind"], headings["northward_wind"]
    reference = headings["reference_eastward_wind"], headings["reference_northward_wind"]
    speed, error, airspeed = (
        headings[name] for name in ("ground_speed", "ground_velocity_error", "airspeed")
    )
    # missing references are ignored by the maximum
    farthest = ((wind[0] - reference[0]) ** 2 + (wind[1] - reference[1]) ** 2).max("reference")
    allowed = (MAX_INNOVATION_SHARE * airspeed.fillna(0.0)).clip(min=MAX_INNOVATION)
    slow, fast = AIRSPEEDS
    rules = {
        "phase": ~headings["phase"].isin([PHASE[name] for name in phases]),
        "roll": rejected(headings, "roll_flag", ROLL, roll),
        "temperature_qc": rejected(headings, "temperature_qc", QC, temperature_qc),
        "wind_qc": rejected(headings, "wind_qc", QC, wind_qc),
        "turn": np.abs(headings["turn"]) > np.degrees(max_turn),
        "ground_speed": speed < min_ground_speed,
        "no_ground_vector": speed.isnull()
        | error.isnull()
        | (error > MAX_GROUND_VELOCITY_ERROR * speed),
        "no_reference": (reference[0].isnull() | reference[1].isnull()).all("reference"),
        "missing_wind": wind[0].isnull() | wind[1].isnull(),
        "gross_error": (farthest > allowed**2) | (airspeed < slow) | (airspeed > fast),
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

    Sets the bit ``field_test`` of ``screening`` for the reports of some aircraft from ``start`` to
    before ``end`` (None: the end of the archive); dask arrays stay lazy.
    """
    read = headings[["time", "row_size"]]
    flags = map_aircraft(_field_test, read, aircraft=list(aircraft), start=start, end=end)
    bits = headings["screening"] | flags["screening"]
    # xarray drops attributes in arithmetic
    return headings.assign(screening=bits.assign_attrs(headings["screening"].attrs))


def _field_test(
    headings: xr.Dataset, *, aircraft: list[str], start: np.datetime64, end: np.datetime64 | None
) -> xr.Dataset:
    corrected = np.isin(headings["aircraft"].to_numpy().astype(str), aircraft)
    time = headings["time"].to_numpy()
    marked = corrected[aircraft_of_report(headings)] & (time >= start)
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
        those that no other rule marked, which would be kept without the rule; ``reports`` before
        screening and ``kept`` (aircraft). Dask-backed where the headings are.

    Examples
    --------
    >>> airswing.audit(headings)["together"].sum("aircraft").dims
    ('rule',)
    """
    counts = map_aircraft(_counts, headings[["screening", "row_size"]])
    return counts.assign_coords(rule=list(SCREENING), aircraft=headings["aircraft"].to_numpy())


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


def rejected(
    headings: xr.Dataset, name: str, codes: dict[str, int], policy: str, section: str = "screening"
) -> xr.DataArray:
    """Reports that a flag rejects under a policy; an absent variable is missing everywhere.

    ConfigError, with a field of the configuration's ``section``, on an unknown policy.
    """
    flag = headings.get(name)
    if flag is None:
        # 0 is "missing" in every table of codes
        flag = xr.zeros_like(headings["eastward_wind"], dtype=np.int8)
    action, _, word = policy.partition("_")
    if policy == "ignore":
        return xr.zeros_like(flag, dtype=bool)
    # roll flags are "good" or "bad", quality flags "pass" or "fail"
    good, bad = ("good", "bad") if "good" in codes else ("pass", "fail")
    if (action, word) == ("reject", bad):
        return flag == codes[bad]
    if (action, word) == ("require", good):
        return flag != codes[good]
    raise ConfigError(
        "no such screening policy",
        field=f"{section}.{name.removesuffix('_flag')}",
        found=policy,
        remedy=f"Known: reject_{bad}, require_{good}, ignore",
    )
