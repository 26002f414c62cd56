"""Linear B-splines on given knots: a piecewise-linear partition of unity.

Assumes increasing knots; values outside them take the nearest knot's function.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def hats(values: Floats, knots: Floats) -> Floats:
    """Hat functions (piecewise-linear partition of unity) at the knots.

    Parameters
    ----------
    values : (n,) float
    knots : (k,) float
        Increasing.

    Returns
    -------
    (k, n) float
        Rows sum to 1 over k; values outside the knots take the nearest; NaN gives zeros.
    """
    ramps = (values - knots[:-1, None]) / np.diff(knots)[:, None]
    np.clip(ramps, 0.0, 1.0, out=ramps)
    out = np.empty((knots.size, values.size))
    out[0], out[-1] = 1.0 - ramps[0], ramps[-1]
    out[1:-1] = ramps[:-1] - ramps[1:]
    out[:, np.isnan(values)] = 0.0
    return out
