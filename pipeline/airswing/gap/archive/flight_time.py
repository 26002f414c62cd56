"""How long an aircraft has been flying: what warms up or drifts after departure goes by it.

Assumptions: a flight begins with its first report; what was flown before the first one received
is not known, so that where receivers miss climbs the time is short by as much.

Validity: reports of whole flights; of reports without flight numbers it is unknown.
Minutes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame

Floats = NDArray[np.float64]

MINUTE = 60.0  # s
#: Minutes beyond which reports of one number are not of one flight.
LONGEST = 1440.0


def flight_starts(flight: NDArray[np.integer], time: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Time of each flight's first report, (flights,), and the place of every report's in it, (n,).

    Parameters
    ----------
    flight : (n,) int
    time : (n,) float
        s.
    """
    numbers, own = np.unique(flight, return_inverse=True)
    start = np.full(numbers.size, np.inf)
    np.minimum.at(start, own, time)
    return start, own


def flight_time(frame: Frame) -> Floats:
    """Time since the first report of the flight, (n,) minutes; NaN beyond a day."""
    start, own = flight_starts(frame.flight, frame.time)
    flown = (frame.time - start[own]) / MINUTE
    return np.asarray(np.where(flown <= LONGEST, flown, np.nan))
