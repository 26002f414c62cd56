"""Resolution of position, time and wind, found in the values themselves.

Assumes that a unit codes a quantity on a lattice of equal steps (0.1 arc-minute, whole knots,
whole minutes) and that a few values may be off it (another source, a conversion). The step is
the coarsest of a list of steps in use on which at least 90 % of an aircraft's values lie,
allowing for values stored with fewer digits after the coding.

Validity: from 5 reports an aircraft; with fewer the archive's most frequent step stands in. At
most 2,000 reports an aircraft are looked at, spread evenly. An aircraft that truly reports on
whole minutes looks like one whose clock is cut to the minute, unless its ground speeds are far
steadier than such a clock allows and no minute holds two; then its clock is good to a second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.physics.robust_spread import robust_sd
from airswing.reports.derive import Columns, seconds_since_1970, step_distance
from airswing.units import KNOT

ARC_MINUTE = 1.0 / 60.0

Step = tuple[float, float]
"""Step of a lattice and how far off it a stored value may lie."""

POSITION_STEPS: tuple[Step, ...] = tuple(
    (step, float(min(0.1 * step, max(0.04 * step, 7e-6))))
    for step in (
        0.1,
        0.05,
        ARC_MINUTE,
        0.01,
        0.5 * ARC_MINUTE,
        0.005,
        0.1 * ARC_MINUTE,
        0.001,
        1.0 / 3600.0,
        0.01 * ARC_MINUTE,
        1e-4,
        0.1 / 3600.0,
        1e-5,
    )
)
"""degrees"""
TIME_STEPS: tuple[Step, ...] = tuple((step, 0.02 * step) for step in (60.0, 6.0, 1.0, 0.1, 0.01))
"""s; coarser ones are schedules, not codings"""
SPEED_STEPS: tuple[Step, ...] = (
    (5.0 * KNOT, 0.051),
    (1.0, 0.02),
    (KNOT, 0.051),
    (0.5, 0.01),
    (0.1, 0.005),
    (0.1 * KNOT, 0.0026),
    (0.01, 0.001),
)
"""m/s; knots may be stored to 0.1 m/s"""
DIRECTION_STEPS: tuple[Step, ...] = tuple(
    (step, 0.02 * step) for step in (10.0, 5.0, 1.0, 0.1, 0.01)
)
"""degrees"""

SHARE = 0.9  # Share of values that must lie on a lattice
FEWEST = 5
"""Values below which an aircraft's own lattice is not looked for."""
# Reports of an aircraft, evenly over its archive: a step shows in far fewer.
_LOOKED_AT = 2000


def lattice_step(
    values: NDArray[np.float64],
    group: NDArray[np.integer],
    groups: int,
    steps: tuple[Step, ...],
) -> NDArray[np.float64]:
    """Coarsest step on which the values of each group lie, (groups,).

    Parameters
    ----------
    values : array, shape (n,)
        NaN is left out.
    group : array of int, shape (n,)
        Group of each value, 0 to ``groups - 1``.
    steps : tuple of (step, tolerance)
        Coarse to fine, in the unit of ``values``; the last where none fits.
    """
    return _coarsest(_on_steps(values, group, groups, steps), steps, FEWEST)


# Steps looked for, and what stands in where no aircraft tells one.
_FIELDS: dict[str, tuple[tuple[Step, ...], float]] = {
    "position_resolution": (POSITION_STEPS, 0.01),
    "time_resolution": (TIME_STEPS, 60.0),
    "wind_speed_resolution": (SPEED_STEPS, KNOT),
    "wind_direction_resolution": (DIRECTION_STEPS, 1.0),
}


def count_on_steps(columns: Columns, row_size: NDArray[np.integer]) -> dict[str, NDArray[np.int64]]:
    """Count how many values of each aircraft lie on each step.

    Parameters
    ----------
    columns : dict of arrays, shape (report,)
        ``tail`` (int), ``time``, ``latitude``, ``longitude`` (degrees), ``wind_speed`` (m/s)
        and ``wind_direction`` (degrees, NaN in calm), in order of tail and time.
    row_size : array of int, shape (aircraft,)

    Returns
    -------
    dict
        For each resolution an array (aircraft, 1 + steps): values looked at, and of those the
        ones on each step; and ``steady`` (aircraft,), 1 where a clock on whole minutes is exact.
        Aircraft may be counted in parts of the fleet: rows do not depend on each other.
    """
    number = int(row_size.size)
    stride = np.repeat(np.maximum(row_size // _LOOKED_AT, 1), row_size)
    place = np.arange(stride.size) - np.repeat(np.cumsum(row_size) - row_size, row_size)
    seen = np.flatnonzero(place % np.maximum(stride, 1) == 0)
    group = columns["tail"][seen]
    latitude, longitude = columns["latitude"][seen], columns["longitude"][seen]
    # Time of day: counted from a day's begin every step in use is a whole number of steps.
    day = columns["time"] - columns["time"].astype("datetime64[D]")
    values = {
        "position_resolution": (np.concatenate([latitude, longitude]), np.tile(group, 2)),
        "time_resolution": (day[seen].astype("timedelta64[ns]").astype(np.int64) / 1e9, group),
        "wind_speed_resolution": (columns["wind_speed"][seen].astype(np.float64), group),
        "wind_direction_resolution": (columns["wind_direction"][seen].astype(np.float64), group),
    }
    found = {name: _on_steps(*values[name], number, steps) for name, (steps, _) in _FIELDS.items()}
    clock = _coarsest(found["time_resolution"], TIME_STEPS, FEWEST)
    return found | {"steady": _steady(columns, clock, number).astype(np.int64)}


def resolutions(counts: dict[str, NDArray[np.int64]]) -> dict[str, NDArray[np.float64]]:
    """Resolution of each aircraft's reports, from `count_on_steps` of a whole fleet.

    Returns
    -------
    dict
        ``position_resolution`` (degree), ``time_resolution`` (s), ``wind_speed_resolution``
        (m/s), ``wind_direction_resolution`` (degree), each of shape (aircraft,).
    """
    found = {name: _filled(counts[name], steps, usual) for name, (steps, usual) in _FIELDS.items()}
    found["time_resolution"] = np.where(counts["steady"] > 0, 1.0, found["time_resolution"])
    return found


def _on_steps(
    values: NDArray[np.float64], group: NDArray[np.integer], groups: int, steps: tuple[Step, ...]
) -> NDArray[np.int64]:
    """Values of each group, and those of them that lie on each step."""
    known = np.isfinite(values)
    values, group = values[known], group[known]
    columns = [np.bincount(group, minlength=groups)]
    for step, tolerance in steps:
        off = np.abs(values - step * np.round(values / step))
        columns.append(np.bincount(group[off <= tolerance], minlength=groups))
    return np.stack(columns, axis=1).astype(np.int64)


def _coarsest(
    counts: NDArray[np.int64], steps: tuple[Step, ...], fewest: int
) -> NDArray[np.float64]:
    """First step on which enough values lie, the last where none; NaN with too few values."""
    size, on = counts[:, 0], counts[:, 1:]
    hit = on >= SHARE * size[:, np.newaxis]
    # argmax gives the first hit: steps stand coarse to fine.
    number = np.where(hit.any(axis=1), hit.argmax(axis=1), len(steps) - 1)
    return np.where(size >= fewest, np.array([step for step, _ in steps])[number], np.nan)


def _filled(
    counts: NDArray[np.int64], steps: tuple[Step, ...], usual: float
) -> NDArray[np.float64]:
    """Steps per aircraft; the most frequent one, at most the usual, where reports are too few."""
    found = _coarsest(counts, steps, FEWEST)
    absent = np.isnan(found)
    if absent.any():
        own, times_met = np.unique(found[~absent], return_counts=True)
        pooled = _coarsest(counts.sum(axis=0, keepdims=True), steps, 1)[0]
        found[absent] = own[np.argmax(times_met)] if own.size else min(pooled, usual)
    return found


def _steady(columns: Columns, clock: NDArray[np.float64], number: int) -> NDArray[np.bool_]:
    """Aircraft on whole minutes whose ground speeds are too steady for a cut clock.

    Times cut to c seconds have an error of variance c^2/12, so that the difference of the
    logarithms of two consecutive ground speeds over legs of t seconds has the standard
    deviation c/t sqrt(6/12). Under a third of that the times are exact.
    """
    steady = np.zeros(number, dtype=bool)
    if not (clock >= 10.0).any() or columns["tail"].size < 3:
        return steady
    tail = columns["tail"]
    gap = np.diff(seconds_since_1970(columns["time"]))
    speed = step_distance(columns["latitude"], columns["longitude"]) / np.where(gap > 0, gap, 1.0)
    twice = np.bincount(tail[1:][(gap == 0) & (np.diff(tail) == 0)], minlength=number)
    # one flight in the air: not over a landing, where the mean speed is nobody's
    leg = (gap > 0) & (gap < 1800.0) & (np.diff(tail) == 0) & (speed > 60.0)
    pair = np.flatnonzero(leg[1:] & leg[:-1])
    change = np.abs(np.log(speed[pair + 1] / speed[pair]))
    expected = clock[tail[pair]] / np.minimum(gap[pair], gap[pair + 1]) * np.sqrt(0.5)
    ratio = change / expected
    size = np.bincount(tail[pair], minlength=number)
    for aircraft in np.flatnonzero((clock >= 10.0) & (size >= 10) & (twice == 0)):
        start, stop = np.searchsorted(tail[pair], (aircraft, aircraft + 1))
        steady[aircraft] = robust_sd(ratio[start:stop], 0.0) < 1.0 / 3.0
    return steady
