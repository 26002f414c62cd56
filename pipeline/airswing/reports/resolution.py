"""Resolution of position, time and wind, found in the values themselves.

The coarsest of a list of steps in use on which at least 90 % of an aircraft's values lie; with
fewer than 5 reports the most frequent step of the fleet. An aircraft that reports on whole minutes
is assumed to truncate times to the minute, unless its ground speeds are far steadier than such a
clock allows and no minute has two reports; then its clock is exact to a second.
"""

from __future__ import annotations

import numpy as np

from airswing.physics.robust_spread import robust_sd
from airswing.reports.columns import Floats, Index, Integers, Mask, seconds_since_1970
from airswing.reports.flights import Columns, step_distance
from airswing.units import KNOT

ARC_MINUTE = 1.0 / 60.0

Steps = tuple[tuple[float, float], ...]
"""Steps of a lattice, from coarse to fine, and the tolerance of a stored value."""

POSITION_STEPS: Steps = tuple(  # degrees
    (step, float(min(0.1 * step, max(0.04 * step, 7e-6))))
    for step in (
        *(0.1, 0.05, ARC_MINUTE, 0.01, 0.5 * ARC_MINUTE, 0.005, 0.1 * ARC_MINUTE, 0.001),
        *(1.0 / 3600.0, 0.01 * ARC_MINUTE, 1e-4, 0.1 / 3600.0, 1e-5),
    )
)
TIME_STEPS: Steps = tuple((step, 0.02 * step) for step in (60.0, 6.0, 1.0, 0.1, 0.01))
"""s; coarser ones are schedules, not codings"""
SPEED_STEPS: Steps = (
    *((5.0 * KNOT, 0.051), (1.0, 0.02), (KNOT, 0.051), (0.5, 0.01), (0.1, 0.005)),
    *((0.1 * KNOT, 0.0026), (0.01, 0.001)),
)
"""m/s; knots may be stored to 0.1 m/s"""
DIRECTION_STEPS: Steps = tuple((step, 0.02 * step) for step in (10.0, 5.0, 1.0, 0.1, 0.01))
"""degrees"""
SHARE = 0.9  # least share of values on a lattice
FEWEST = 5  # fewest values for a search of the step
_MOST_REPORTS = 2000  # of an aircraft, evenly spread: far fewer suffice to find a step


def lattice_step(values: Floats, group: Index, groups: int, steps: Steps) -> Floats:
    """Coarsest step (of coarse to fine) on which the values (n,) of each group lie, (groups,)."""
    return _coarsest(_on_steps(values, group, groups, steps), steps, FEWEST)


def resolutions(columns: Columns, row_size: Index) -> dict[str, Floats]:
    """Resolution of position, time, wind speed and direction (degree, s, m/s) by aircraft."""
    number = int(row_size.size)
    stride = np.repeat(np.maximum(row_size // _MOST_REPORTS, 1), row_size)
    place = np.arange(stride.size) - np.repeat(np.cumsum(row_size) - row_size, row_size)
    used = np.flatnonzero(place % np.maximum(stride, 1) == 0)
    group = columns["tail"][used]
    # Time of day: every step in use divides a day.
    day = columns["time"] - columns["time"].astype("datetime64[D]")
    seconds = day[used].astype("timedelta64[ns]").astype(np.int64) / 1e9
    positions = np.concatenate([columns[name][used] for name in ("latitude", "longitude")])
    found: dict[str, Floats] = {}
    # Values, steps looked for, and the step of a fleet in which no aircraft has enough reports.
    for name, values, steps, usual in (
        ("position", positions, POSITION_STEPS, 0.01),
        ("time", seconds, TIME_STEPS, 60.0),
        ("wind_speed", columns["wind_speed"][used], SPEED_STEPS, KNOT),
        ("wind_direction", columns["wind_direction"][used], DIRECTION_STEPS, 1.0),
    ):
        aircraft = np.resize(group, values.size)
        counts = _on_steps(values.astype(np.float64), aircraft, number, steps)
        step = _coarsest(counts, steps, FEWEST)
        if name == "time":
            exact = _exact_clock(columns, step, number)
        if (absent := np.isnan(step)).any():
            # Where an aircraft has few reports, the most frequent step of the fleet is used.
            frequent, times = np.unique(step[~absent], return_counts=True)
            pooled = _coarsest(counts.sum(axis=0, keepdims=True), steps, 1)[0]
            step[absent] = frequent[np.argmax(times)] if frequent.size else min(pooled, usual)
        found[f"{name}_resolution"] = step
    found["time_resolution"] = np.where(exact, 1.0, found["time_resolution"])
    return found


def _on_steps(values: Floats, group: Index, groups: int, steps: Steps) -> Integers:
    """Number of values of each group, and of those that lie on each step, (groups, 1 + steps)."""
    known = np.isfinite(values)
    values, group = values[known], group[known]
    counts = [np.bincount(group, minlength=groups)]
    for step, tolerance in steps:
        off = np.abs(values - step * np.round(values / step))
        counts.append(np.bincount(group[off <= tolerance], minlength=groups))
    return np.stack(counts, axis=1).astype(np.int64)


def _coarsest(counts: Integers, steps: Steps, fewest: int) -> Floats:
    """First step on which enough values lie, otherwise the last; NaN with too few values."""
    total, on = counts[:, 0], counts[:, 1:]
    hit = on >= SHARE * total[:, np.newaxis]
    # argmax gives the first hit: steps are in order from coarse to fine.
    number = np.where(hit.any(axis=1), hit.argmax(axis=1), len(steps) - 1)
    return np.where(total >= fewest, np.array([step for step, _ in steps])[number], np.nan)


def _exact_clock(columns: Columns, clock: Floats, number: int) -> Mask:
    """Aircraft on whole minutes whose ground speeds are too steady for truncated times.

    Times truncated to c seconds have an error of variance c^2/12, so that the difference of the
    logarithms of two consecutive ground speeds over legs of t seconds has the standard deviation
    c/t sqrt(6/12). Below a third of that the times are exact.
    """
    exact = np.zeros(number, dtype=bool)
    if not (clock >= 10.0).any() or columns["tail"].size < 3:
        return exact
    tail = columns["tail"]
    gap = np.diff(seconds_since_1970(columns["time"]))
    speed = step_distance(columns["latitude"], columns["longitude"]) / np.where(gap > 0, gap, 1.0)
    twice = np.bincount(tail[1:][(gap == 0) & (np.diff(tail) == 0)], minlength=number)
    # Within one flight: a mean speed that includes a landing is meaningless.
    leg = (gap > 0) & (gap < 1800.0) & (np.diff(tail) == 0) & (speed > 60.0)
    pair = np.flatnonzero(leg[1:] & leg[:-1])
    change = np.abs(np.log(speed[pair + 1] / speed[pair]))
    expected = clock[tail[pair]] / np.minimum(gap[pair], gap[pair + 1]) * np.sqrt(0.5)
    pairs = np.bincount(tail[pair], minlength=number)
    for aircraft in np.flatnonzero((clock >= 10.0) & (pairs >= 10) & (twice == 0)):
        start, stop = np.searchsorted(tail[pair], (aircraft, aircraft + 1))
        exact[aircraft] = robust_sd((change / expected)[start:stop], 0.0) < 1.0 / 3.0
    return exact
