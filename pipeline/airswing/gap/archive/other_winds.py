"""Reports with other winds, and with what these say of heading and airspeed.

Assumptions: ground velocity is right, so that heading and airspeed follow from it and the wind.

Validity: that of the winds put in.

Units: m/s, rad.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame

Floats = NDArray[np.float64]


def without(frame: Frame, wind: Floats) -> Frame:
    """Frame whose reported winds are others, with the heading and airspeed they imply."""
    u, v = frame.u_ref + wind[:, 0], frame.v_ref + wind[:, 1]
    air_u, air_v = frame.ground_u - u, frame.ground_v - v
    heading = np.mod(np.arctan2(air_u, air_v), 2 * np.pi)
    declination = frame.heading - frame.magnetic_heading
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=heading,
        airspeed=np.hypot(air_u, air_v),
        magnetic_heading=np.mod(heading - declination, 2 * np.pi),
    )
