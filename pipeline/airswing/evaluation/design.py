"""Design of the joint fit of the compass deviation, the airspeed scale and the reference's bias.

Assumes the equations of docs/method.md. Radians and m/s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.physics.compass_deviation import deviation_basis

Floats = NDArray[np.float64]


def paired_design(
    magnetic_heading: Floats, heading: Floats, airspeed: Floats
) -> tuple[Floats, Floats]:
    """Design of the joint fit, across and along the heading.

    Parameters
    ----------
    magnetic_heading, heading : arrays of float, shape (report,), radians
    airspeed : array of float, shape (report,), m/s

    Returns
    -------
    cross, along : arrays of float, shape (report, 8)
        Columns A, B, C, D, E (radians), airspeed scale, and the bias b_u, b_v (m/s); rows in
        m/s (docs/method.md: cross-track V psi_err, along-track |V_A| - |V'_A|).
    """
    zero, sine, cosine = np.zeros_like(heading), np.sin(heading), np.cos(heading)
    cross = [*(airspeed * deviation_basis(magnetic_heading)), zero, cosine, -sine]
    along = [zero, zero, zero, zero, zero, airspeed, sine, cosine]
    return np.column_stack(cross), np.column_stack(along)
