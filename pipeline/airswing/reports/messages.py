"""Reports from tables of single Mode-S messages.

A transponder sends position, ground vector (ADS-B or register 5,0), and heading and airspeed
(register 6,0) in messages of their own. A report is made of each message with a heading: what it
lacks is interpolated linearly in time between the messages of the same aircraft that have it,
angles the short way round. Both must be within 10 s, or one within 1 s. Tables whose rows are
complete pass unchanged; where no row has a heading every row with a position is a report.

Validity: aircraft in straight flight, whose speeds change slowly; turns are found by screening.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.physics.triangle import wrap_degrees
from airswing.reports.audit import Audit

FARTHEST, NEAR = 10.0, 1.0  # s
_FILLED = (
    "latitude",
    "longitude",
    "pressure_altitude",
    "ground_speed",
    "track",
    "reported_airspeed",
    "indicated_airspeed",
    "mach",
    "air_temperature",
)
_ANGLES = ("longitude", "track")
_HEADINGS = ("magnetic_heading", "reported_heading")


def merged(raw: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    """Make reports of messages.

    Parameters
    ----------
    raw : DataFrame
        Raw columns in SI, one row a message, in any order.
    audit : Audit
        Messages that are no reports are added to it as ``merged_message``.

    Returns
    -------
    DataFrame
        One row a report.
    """
    raw = raw.sort_values(["tail", "time"], kind="stable", ignore_index=True)
    heading = raw[raw.columns.intersection(list(_HEADINGS))].notna().any(axis=1)
    position = raw[["latitude", "longitude"]].notna().all(axis=1)
    wanted = (heading if heading.any() else position).to_numpy()
    audit.drop("merged_message", int(np.count_nonzero(~wanted)), unread=True)
    seconds = raw["time"].to_numpy(dtype="datetime64[ns]").astype(np.int64) / 1e9
    tail = pd.factorize(raw["tail"])[0]
    reports = raw.loc[wanted].copy()
    for name in raw.columns.intersection(list(_FILLED)):
        values = raw[name].to_numpy(dtype=np.float64)
        reports[name] = _filled(values, seconds, tail, name in _ANGLES)[wanted]
    if "flight" in raw:
        # A callsign is sent every few seconds and holds until another is.
        label = raw["flight"].where(raw["flight"].str.strip() != "")
        reports["flight"] = label.groupby(raw["tail"]).ffill(limit=500)[wanted].fillna("")
    return reports.reset_index(drop=True)


def _filled(
    values: NDArray[np.float64],
    seconds: NDArray[np.float64],
    tail: NDArray[np.integer],
    angle: bool,
) -> NDArray[np.float64]:
    known = np.isfinite(values) & np.isfinite(seconds)
    place = np.arange(values.size)
    before = np.maximum.accumulate(np.where(known, place, -1))
    after = np.minimum.accumulate(np.where(known, place, values.size)[::-1])[::-1]
    has_before = (before >= 0) & (tail[before] == tail)
    after = np.minimum(after, values.size - 1)
    has_after = known[after] & (tail[after] == tail)
    since = np.where(has_before, seconds - seconds[before], np.inf)
    until = np.where(has_after, seconds[after] - seconds, np.inf)
    step = values[after] - values[before]
    step = wrap_degrees(step) if angle else step
    with np.errstate(invalid="ignore", divide="ignore"):
        between = values[before] + step * since / (since + until)
    nearest = np.where(since <= until, values[before], values[after])
    filled = np.where(np.minimum(since, until) <= NEAR, nearest, np.nan)
    both = (since <= FARTHEST) & (until <= FARTHEST) & (since + until > 0.0)
    filled = np.where(both, between, filled)
    return np.where(known, values, filled)
