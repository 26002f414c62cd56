"""Flights, phases of flight and resolutions where the source does not report them.

Reports are in order of aircraft and time.

1. Paths. Where an aircraft's reports jump or its flight labels alternate, each report is added to
   the nearest path of the last 6 hours that has no other label and that it continues without a
   jump; otherwise it begins a new path.
2. Labels. A report without a flight label gets the common label of the labelled reports before and
   after it on its path, if these are less than 6 hours apart; else that of the nearer one not
   separated by a gap, stop or jump.
3. Flights. Reports with one label are one flight until a gap of more than 6 hours; without a label
   until a gap over 45 minutes, a ground stop or a jump.
4. Phases. The climb rate is the slope of pressure altitude between neighbours at least 30 s away on
   each side, so that rounded altitudes and times do not look like climbs. More than 300 ft/min is
   ascent or descent, until it falls below 150 ft/min. The rest is cruise at or above 2,000 ft.
5. Resolution of position, time and wind. The coarsest of a list of steps in use on which at least
   90 % of an aircraft's values lie; with fewer than 5 reports the most frequent step of the fleet.
   An aircraft that reports on whole minutes is assumed to truncate times to the minute, unless its
   ground speeds are far steadier than such a clock allows and no minute has two reports; then its
   clock is exact to a second.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.flags import PHASE
from airswing.physics.great_circle import central_angle
from airswing.physics.robust_spread import robust_sd
from airswing.reports.columns import Floats, Index, Integers, Mask, seconds_since_1970
from airswing.units import EARTH_RADIUS, KNOT

Columns = dict[str, NDArray[Any]]  # columns of reports by name, all of one length

LABELLED_GAP = 6 * 3600.0  # s without reports that end a flight with a label
UNLABELLED_GAP = 45 * 60.0  # s without reports that end a flight without a label
STOP_TIME, STOP_SPEED = 600.0, 40.0  # s and m/s: slower than this for longer is a ground stop
# m and m/s: farther and faster than this is another aircraft or a wrong position.
JUMP_DISTANCE, JUMP_SPEED = 50_000.0, 400.0
# m/s: 300 ft/min begins an ascent or descent, 150 ft/min ends it.
ENTER_RATE, LEAVE_RATE = 1.524, 0.762
NEAREST, FARTHEST = 30.0, 1200.0  # s: how far the neighbours of a climb rate may be
LOWEST_CRUISE = 609.6  # m pressure altitude, 2,000 ft


def step_distance(latitude: Floats, longitude: Floats) -> Floats:
    """Great-circle distance (m) from each position (degrees) to the next, shape (n - 1,)."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    return EARTH_RADIUS * central_angle(phi[:-1], lam[:-1], phi[1:], lam[1:])


def number_of_run(*keys: NDArray[Any]) -> NDArray[np.int32]:
    """Number, from 0, of the run of equal keys that each report is in."""
    new = np.zeros(keys[0].size, dtype=bool)
    for key in keys:
        new[1:] |= np.diff(key) != 0
    return np.cumsum(new).astype(np.int32)


def derive_flight(columns: Columns) -> NDArray[np.int32]:
    """Number the flights (report,), from 0 in the order in which they begin within each aircraft.

    Columns are ``tail`` (int), ``time``, ``latitude``, ``longitude`` and ``flight`` (label as int,
    -1 where there is none), in order of tail and time.
    """
    tail = columns["tail"]
    path = _paths(columns)
    label = _filled_labels(columns, path)
    order = np.lexsort((label, path, tail))  # stable: in order of time within each of these
    gap, _, breaks = _steps(columns, order)
    begins = np.where(label[order][1:] >= 0, gap > LABELLED_GAP, breaks)
    for values in (tail, path, label):
        begins |= np.diff(values[order]) != 0
    number = np.empty(tail.size, dtype=np.int64)
    number[order] = np.r_[0, np.cumsum(begins)]
    return pd.factorize(number)[0].astype(np.int32)  # in order of the first reports


def _steps(columns: Columns, order: Index) -> tuple[Floats, Floats, Mask]:
    """Time (s) and distance (m) between successive reports, and where an unlabelled flight ends."""
    gap = np.diff(seconds_since_1970(columns["time"])[order])
    distance = step_distance(columns["latitude"][order], columns["longitude"][order])
    stop = (gap >= STOP_TIME) & (distance < STOP_SPEED * gap)
    return gap, distance, (gap > UNLABELLED_GAP) | stop | _jumps(gap, distance)


def _paths(columns: Columns) -> Integers:
    """Number the paths flown under one identifier; 0 for all where nothing jumps or alternates."""
    tail = columns["tail"]
    path = np.zeros(tail.size, dtype=np.int64)
    gap, distance, _ = _steps(columns, np.arange(tail.size))
    jump = _jumps(gap, distance) & (np.diff(tail) == 0)
    for aircraft in np.union1d(tail[1:][jump], tail[_alternating(columns)]):
        start, stop = np.searchsorted(tail, (aircraft, aircraft + 1))
        path[start:stop] = _paths_of_one({name: columns[name][start:stop] for name in columns})
    return path


def _alternating(columns: Columns) -> Integers:
    """Reports whose label reappears within the gap of a flight after another label."""
    labelled = np.flatnonzero(columns["flight"] >= 0)
    tail, label = columns["tail"][labelled], columns["flight"][labelled]
    order = np.lexsort((label, tail))
    same = (np.diff(tail[order]) == 0) & (np.diff(label[order]) == 0) & (np.diff(order) > 1)
    gap = np.diff(seconds_since_1970(columns["time"])[labelled][order])
    return np.asarray(labelled[order[1:][same & (gap <= LABELLED_GAP)]])


def _paths_of_one(columns: Columns) -> Integers:
    seconds = seconds_since_1970(columns["time"])
    latitude, longitude = columns["latitude"], columns["longitude"]
    path, number = np.zeros(seconds.size, dtype=np.int64), 0
    recent: dict[int, tuple[int, int]] = {}  # of each path the last report and the label
    for report, label in enumerate(columns["flight"].tolist()):
        nearest = np.inf, number  # a new path
        for key, (last, last_label) in list(recent.items()):
            gap = seconds[report] - seconds[last]
            if gap > LABELLED_GAP:
                del recent[key]
            elif last_label < 0 or label < 0 or last_label == label:
                distance = step_distance(latitude[[last, report]], longitude[[last, report]])
                if not _jumps(gap, distance)[0]:
                    nearest = min(nearest, (float(distance[0]), key))
        joined = path[report] = nearest[1]
        number = max(number, joined + 1)
        recent[joined] = report, label if label >= 0 else recent.get(joined, (report, -1))[1]
    return path


def _jumps(gap: Floats | float, distance: Floats) -> Mask:
    return np.asarray(distance > np.maximum(JUMP_DISTANCE, JUMP_SPEED * gap))


def _filled_labels(columns: Columns, path: Integers) -> Integers:
    """Labels, with those of reports without one filled in from the reports around them."""
    label = columns["flight"].astype(np.int64)
    absent = label < 0
    if not absent.any() or absent.all():
        return label
    order = np.lexsort((path, columns["tail"]))
    new_path = (np.diff(columns["tail"][order]) != 0) | (np.diff(path[order]) != 0)
    rows = pd.DataFrame(
        {
            "label": label[order],
            "seconds": seconds_since_1970(columns["time"])[order],
            "leg": np.r_[0, np.cumsum(_steps(columns, order)[2] | new_path)],
        }
    )
    labelled = rows.where(rows["label"] >= 0).groupby(np.r_[0, np.cumsum(new_path)])
    before, after = labelled.ffill(), labelled.bfill()
    same = before["label"] == after["label"]
    same &= after["seconds"] - before["seconds"] <= LABELLED_GAP
    since = (rows["seconds"] - before["seconds"]).where(before["leg"] == rows["leg"], np.inf)
    until = (after["seconds"] - rows["seconds"]).where(after["leg"] == rows["leg"], np.inf)
    source = before["label"].where(same | (since <= until), after["label"])
    fill = (rows["label"] < 0) & (same | np.isfinite(np.minimum(since, until)))
    filled = label.copy()
    filled[order[fill]] = source[fill]
    return filled


def climb_rate(seconds: Floats, altitude: Floats, flight: Index) -> Floats:
    """Slope (m s-1) of altitude (m) over the neighbours of each report; NaN without a neighbour.

    Flights are contiguous, and times (s) are in order within each; all arrays have shape (n,).
    """
    block = number_of_run(flight)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    first = starts[block]
    last = np.r_[starts[1:], flight.size].astype(np.int64)[block] - 1
    # Whole microseconds, flights one after the other with wide gaps: the result does not depend on
    # which other flights are computed together with these.
    offset = np.round((seconds - seconds[first]) * 1e6).astype(np.int64)
    span = offset[last[starts]] + round(10.0 * FARTHEST * 1e6)
    key = offset + (np.cumsum(span) - span)[block]
    near = round(NEAREST * 1e6)
    index = np.arange(flight.size)
    earlier = np.maximum(np.searchsorted(key, key - near, side="right") - 1, first)
    later = np.minimum(np.searchsorted(key, key + near, side="left"), last)
    earlier = np.where(seconds - seconds[earlier] > FARTHEST, index, earlier)
    later = np.where(seconds[later] - seconds > FARTHEST, index, later)
    span = seconds[later] - seconds[earlier]
    rise = altitude[later] - altitude[earlier]
    rate = np.full(flight.size, np.nan)
    np.divide(rise, span, out=rate, where=span > 0.0)
    return rate


def derive_phase(columns: Columns, flight: Index) -> NDArray[np.int8]:
    """Codes of `airswing.flags.PHASE` (report,) from ``time`` and ``pressure_altitude`` (m).

    Flights are contiguous.
    """
    phase = np.full(flight.size, PHASE["unknown"], dtype=np.int8)
    altitude = columns["pressure_altitude"].astype(np.float64)
    valid = np.flatnonzero(np.isfinite(altitude))
    rate = climb_rate(seconds_since_1970(columns["time"][valid]), altitude[valid], flight[valid])
    derived = np.where(np.isfinite(rate) & (altitude[valid] >= LOWEST_CRUISE), PHASE["cruise"], 0)
    derived[_lasting(rate, flight[valid])] = PHASE["ascent"]
    derived[_lasting(-rate, flight[valid])] = PHASE["descent"]
    phase[valid] = derived
    return phase


def _lasting(rate: Floats, flight: Index) -> Mask:
    """Runs of a flight above the leaving rate that reach the entering rate somewhere."""
    moving = rate > LEAVE_RATE
    highest = pd.Series(rate).groupby(number_of_run(moving, flight)).transform("max").to_numpy()
    return np.asarray(moving & (highest > ENTER_RATE), dtype=bool)


# --- resolution ----------------------------------------------------------------------------------

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
    used = np.flatnonzero(place % stride == 0)
    group = columns["tail"][used]
    # Time of day: every step in use divides a day.
    day = columns["time"] - columns["time"].astype("datetime64[D]")
    seconds = day[used].astype("timedelta64[ns]").astype(np.int64) / 1e9
    positions = np.concatenate([columns[name][used] for name in ("latitude", "longitude")])
    by_quantity: dict[str, Floats] = {}
    # Values, steps looked for, and the step of a fleet in which no aircraft has enough reports.
    for name, values, steps, usual in (
        ("position", positions, POSITION_STEPS, 0.01),
        ("time", seconds, TIME_STEPS, 60.0),
        ("wind_speed", columns["wind_speed"][used], SPEED_STEPS, KNOT),
        ("wind_direction", columns["wind_direction"][used], DIRECTION_STEPS, 1.0),
    ):
        counts = _on_steps(values.astype(np.float64), np.resize(group, values.size), number, steps)
        step = _coarsest(counts, steps, FEWEST)
        if (absent := np.isnan(step)).any():
            # Where an aircraft has few reports, the most frequent step of the fleet is used.
            frequent = pd.Series(step).mode()
            pooled = _coarsest(counts.sum(axis=0, keepdims=True), steps, 1)[0]
            step[absent] = frequent[0] if frequent.size else min(pooled, usual)
        by_quantity[f"{name}_resolution"] = step
    clock = by_quantity["time_resolution"]
    clock[_exact_clock(columns, clock, number)] = 1.0
    return by_quantity


def _on_steps(values: Floats, group: Index, groups: int, steps: Steps) -> Integers:
    """Number of values of each group, and of those that lie on each step, (groups, 1 + steps)."""
    finite = np.isfinite(values)
    values, group = values[finite], group[finite]
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
