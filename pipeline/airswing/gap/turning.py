"""How far the heading can be trusted at reports in a turn.

Assumptions: between two fixes a turn is seen as a chord, so at a report in a turn the heading that
stands in a design column is off by up to half the turn. For an aircraft without deviation that
does no harm. Where the deviation is large the column then misses its residual by about airspeed x
deviation x heading error, and whitening, which lives on differences between neighbouring reports,
would give just those reports most say: in trials amplitudes came out 8 % too large and a constant
deviation was taken for one that changes. That miss is added to the report's noise.

SI units and radians.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.context import wrap

Floats = NDArray[np.float64]

SHARE = 1.0
"""Part of the turn to the neighbouring report by which the heading may be off."""


def turn_at_reports(track: Floats, flight: NDArray[np.integer], time: Floats) -> Floats:
    """Largest change of track to the report before or after in the same flight.

    Parameters
    ----------
    track : (n,) float
        rad.
    flight : (n,) int
    time : (n,) float
        s.

    Returns
    -------
    (n,) float
        rad, 0 to pi; 0 where a flight has one report.
    """
    order = np.lexsort((time, flight))
    change = np.abs(wrap(np.diff(track[order])))
    change[np.diff(flight[order]) != 0] = 0.0
    change = np.nan_to_num(change)
    found = np.zeros(track.size)
    found[order] = np.maximum(np.r_[0.0, change], np.r_[change, 0.0])
    return found


def heading_doubt(frame: Any, columns_frame: Any) -> Floats:
    """Error of the deviation's columns at reports in a turn.

    Parameters
    ----------
    frame : Frame
        As reported.
    columns_frame : Frame
        With the heading that stands in the columns.

    Returns
    -------
    (n,) float
        Standard deviation per component, m s-1.
    """
    implied = np.arctan2(frame.ground_u - frame.u_ref, frame.ground_v - frame.v_ref)
    squared = wrap(columns_frame.heading - implied) ** 2
    count = np.maximum(np.bincount(frame.aircraft, minlength=len(frame.tails)), 1)
    deviation = np.sqrt(np.bincount(frame.aircraft, squared, minlength=len(frame.tails)) / count)
    turn = turn_at_reports(np.arctan2(frame.ground_u, frame.ground_v), frame.flight, frame.time)
    off = SHARE * np.minimum(turn, np.pi / 2)
    return np.asarray(columns_frame.airspeed * deviation[frame.aircraft] * off)
