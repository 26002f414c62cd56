"""Flights and phases of flight where the source does not tell them.

Assumes reports in order of aircraft and time.

Flights
-------
Reports with a flight label are one flight while the label stays and no gap exceeds 6 hours, so
the same flight number on two days is two flights. Without a label a flight ends at a gap over
45 minutes, at a ground stop (10 minutes or more at a mean speed under 40 m/s, which no airliner
flies), or at a jump (over 50 km at more than 400 m/s). Midnight and the antimeridian end nothing.

Phases
------
The climb rate is the slope of pressure altitude between neighbours at least 30 s away on each
side in the same flight (up to 20 minutes away), so that altitudes rounded to 100 ft and times cut
to the minute do not pass for climbs. Over 300 ft/min is ascent or descent, and it lasts until the
rate falls under 150 ft/min (hysteresis). The rest is cruise at or above 2,000 ft pressure
altitude and unknown below (taxi, pattern), as is a report with no neighbour.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.flags import PHASE
from airswing.physics.great_circle import central_angle
from airswing.units import EARTH_RADIUS

Columns = dict[str, NDArray[Any]]  # times among numbers: a type of its own for each name
"""Columns of reports by name, all of one length."""

LABELLED_GAP = 6 * 3600.0  # s that one flight number may fall silent
UNLABELLED_GAP = 45 * 60.0  # s of silence that end a flight without a number
STOP_TIME, STOP_SPEED = 600.0, 40.0  # s and m/s: slower than this for longer is a ground stop
# m and m/s: farther and faster than this is another aircraft or a broken position.
JUMP_DISTANCE, JUMP_SPEED = 50_000.0, 400.0
# m/s: 300 ft/min begins an ascent or descent, 150 ft/min ends it.
ENTER_RATE, LEAVE_RATE = 1.524, 0.762
NEAREST, FARTHEST = 30.0, 1200.0  # s: how far the neighbours of a climb rate may be
LOWEST_CRUISE = 609.6  # m pressure altitude, 2,000 ft


def seconds_since_1970(time: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Times as float64 seconds since 1970-01-01 UTC."""
    return time.astype("datetime64[ns]").astype(np.int64) / 1e9


def step_distance(
    latitude: NDArray[np.float64], longitude: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Great-circle distance (m) from each position (degrees) to the next, (n - 1,)."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    return EARTH_RADIUS * central_angle(phi[:-1], lam[:-1], phi[1:], lam[1:])


def derive_flight(columns: Columns) -> NDArray[np.int32]:
    """Give every flight of an archive a number.

    Parameters
    ----------
    columns : dict of arrays, shape (report,)
        ``tail`` (int), ``time``, ``latitude``, ``longitude`` and ``flight`` (label as int, -1
        where there is none), in order of tail and time.

    Returns
    -------
    array of int32, shape (report,)
        Unique over the archive, from 0 in the order flights begin within each tail.
    """
    label, tail = columns["flight"], columns["tail"]
    if not tail.size:
        return np.zeros(0, dtype=np.int32)
    order = np.lexsort((label, tail))  # stable: time order stays within a label
    seconds = seconds_since_1970(columns["time"])[order]
    gap = np.diff(seconds)
    distance = step_distance(columns["latitude"][order], columns["longitude"][order])
    labelled = label[order][1:] >= 0
    stop = (gap >= STOP_TIME) & (distance < STOP_SPEED * gap)
    jump = (distance > JUMP_DISTANCE) & (distance > JUMP_SPEED * gap)
    begins = np.where(labelled, gap > LABELLED_GAP, (gap > UNLABELLED_GAP) | stop | jump)
    begins |= (np.diff(label[order]) != 0) | (np.diff(tail[order]) != 0)
    number = np.empty(tail.size, dtype=np.int64)
    number[order] = np.r_[0, np.cumsum(begins)]
    _, first, inverse = np.unique(number, return_index=True, return_inverse=True)
    rank = np.empty(first.size, dtype=np.int32)
    # Numbered by first report: interleaved labels of one tail would else be numbered by name.
    rank[np.argsort(first)] = np.arange(first.size, dtype=np.int32)
    return np.asarray(rank[inverse], dtype=np.int32)


def climb_rate(
    seconds: NDArray[np.float64], altitude: NDArray[np.float64], flight: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Slope of altitude over the neighbours of each report, m/s; NaN where it has none.

    Parameters
    ----------
    seconds : array, shape (n,)
        s, in order within each flight; flights stand together.
    altitude : array, shape (n,)
        m, not NaN.
    flight : array of int, shape (n,)
    """
    begins = np.r_[True, np.diff(flight) != 0] if flight.size else np.zeros(0, dtype=bool)
    block = np.cumsum(begins) - 1
    starts = np.flatnonzero(begins)
    first = starts[block]
    last = np.r_[starts[1:], flight.size].astype(np.int64)[block] - 1
    # Microseconds, flights laid end to end with wide gaps: whole numbers, so that what is found
    # does not depend on which other flights are looked at together with these.
    offset = np.round((seconds - seconds[first]) * 1e6).astype(np.int64)
    span = offset[last[starts]] + round(10.0 * FARTHEST * 1e6)
    key = offset + (np.cumsum(span) - span)[block]
    near = round(NEAREST * 1e6)
    here = np.arange(flight.size)
    left = np.maximum(np.searchsorted(key, key - near, side="right") - 1, first)
    right = np.minimum(np.searchsorted(key, key + near, side="left"), last)
    left = np.where(seconds - seconds[left] > FARTHEST, here, left)
    right = np.where(seconds[right] - seconds > FARTHEST, here, right)
    span = seconds[right] - seconds[left]
    rise = altitude[right] - altitude[left]
    rate = np.full(flight.size, np.nan)
    np.divide(rise, span, out=rate, where=span > 0.0)
    return rate


def derive_phase(columns: Columns, flight: NDArray[np.integer]) -> NDArray[np.int8]:
    """Tell ascent, cruise and descent from pressure altitude: codes of `airswing.flags.PHASE`.

    Parameters
    ----------
    columns : dict of arrays, shape (report,)
        ``time`` and ``pressure_altitude`` (m).
    flight : array of int, shape (report,)
    """
    phase = np.full(flight.size, PHASE["unknown"], dtype=np.int8)
    altitude = columns["pressure_altitude"].astype(np.float64)
    known = np.flatnonzero(np.isfinite(altitude))
    if not known.size:
        return phase
    known = known[np.argsort(flight[known], kind="stable")]
    rate = climb_rate(seconds_since_1970(columns["time"][known]), altitude[known], flight[known])
    found = np.where(np.isfinite(rate) & (altitude[known] >= LOWEST_CRUISE), PHASE["cruise"], 0)
    found[_lasting(rate, flight[known])] = PHASE["ascent"]
    found[_lasting(-rate, flight[known])] = PHASE["descent"]
    phase[known] = found
    return phase


def _lasting(rate: NDArray[np.float64], flight: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Find the runs of a flight over the leaving rate that reach the entering rate somewhere."""
    moving = rate > LEAVE_RATE
    begins = np.r_[True, (np.diff(moving.astype(np.int8)) != 0) | (np.diff(flight) != 0)]
    run = np.cumsum(begins) - 1
    highest = np.maximum.reduceat(np.where(moving, rate, -np.inf), np.flatnonzero(begins))
    return np.asarray(moving & (highest[run] > ENTER_RATE), dtype=bool)
