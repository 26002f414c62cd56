"""How long an aircraft has been flying: what warms up or drifts after departure goes by it.

Assumptions: a flight begins with its first report; what was flown before the first one received
is not known, so that where receivers miss climbs the time is short by as much.

Validity: reports of whole flights. Minutes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame

Floats = NDArray[np.float64]

MINUTE = 60.0  # s


def flight_time(frame: Frame) -> Floats:
    """Time since the first report of the flight, (n,) minutes."""
    _, own = np.unique(frame.flight, return_inverse=True)
    begin = np.full(own.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, own, frame.time)
    return np.asarray((frame.time - begin[own]) / MINUTE)
