"""How long an aircraft has been flying: what warms up or drifts after departure goes by it.

Assumptions: a flight begins with its first report; what was flown before the first one received
is not known, so that where receivers miss climbs the time is short by as much.

Validity: reports of whole flights; of reports that are not told apart by flights it is not known.
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


def flight_time(frame: Frame) -> Floats:
    """Time since the first report of the flight, (n,) minutes; NaN beyond a day."""
    _, own = np.unique(frame.flight, return_inverse=True)
    begin = np.full(own.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, own, frame.time)
    flown = (frame.time - begin[own]) / MINUTE
    return np.asarray(np.where(flown <= LONGEST, flown, np.nan))
