"""Wind as formats want it: speed and the direction it blows from.

Assumes components towards east and north, m/s. North is 360 degrees: to a reader 0 may mean that
there is no direction. A calm has none; formats hold a number there all the same, and have north's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import direction_in_degrees

Array = NDArray[np.float64]


def speed_and_direction(u: ArrayLike, v: ArrayLike, *, least: float = 0.0) -> tuple[Array, Array]:
    """Speed (m/s) and direction a wind comes from (degrees, in (0, 360]) of components (m/s).

    A direction no larger than ``least`` degrees is north.
    """
    east, north = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    speed = np.hypot(east, north)
    direction = direction_in_degrees(east, north)
    return speed, np.where((speed == 0.0) | (direction <= least), 360.0, direction)
