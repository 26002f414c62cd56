"""How an aircraft turned before a report: what a compass that lags or sticks goes by.

Assumptions: the track turns as the heading does, but for the drift; between two reports it turns
the shorter way. Before the first report of a flight there was no turn.

Validity: reports along flights; turns of less than half a circle between reports. Degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Time over which what turned is recent, s, and the least change of track that is a turn, degrees.
RECENT, LEAST = 120.0, 10.0


def turn(frame: Frame) -> Floats:
    """Angle by which the track has turned in the last two minutes, (n,) degrees."""
    order, begins, track = _tracks(frame)
    if not order.size:
        return np.zeros(0)
    time = frame.time[order] - frame.time.min()
    apart = np.cumsum(begins) * (float(np.ptp(frame.time)) + 2 * RECENT)
    place = time + apart
    start = place[np.maximum.accumulate(np.where(begins, np.arange(order.size), 0))]
    before = np.interp(np.maximum(place - RECENT, start), place, track)
    return _given_back(order, track - before)


def last_turn(frame: Frame) -> Floats:
    """Angle of the last turn between two reports of a flight, (n,) degrees; 0 before the first."""
    order, begins, track = _tracks(frame)
    step = np.r_[0.0, np.diff(track)][: order.size]
    turns = begins | (np.abs(step) >= LEAST)
    last = np.maximum.accumulate(np.where(turns, np.arange(order.size), 0))
    return _given_back(order, np.where(begins, 0.0, step)[last] if order.size else step)


def _tracks(frame: Frame) -> tuple[Integers, NDArray[np.bool_], Floats]:
    """Rows by flight and time, where flights begin, and tracks unwrapped, degrees."""
    order = np.lexsort((frame.time, frame.flight))
    begins = np.r_[True, np.diff(frame.flight[order]) != 0][: order.size]
    track = np.arctan2(frame.ground_u, frame.ground_v)[order]
    return order, begins, np.degrees(np.unwrap(track))


def _given_back(order: Integers, values: Floats) -> Floats:
    """Values in the order of the reports."""
    out = np.empty(order.size)
    out[order] = values
    return out
