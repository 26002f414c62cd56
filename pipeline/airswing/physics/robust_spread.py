"""Standard deviation from the median absolute deviation, robust against gross errors.

Assumes that most values are normal about their median; relative standard error 1.2 / sqrt(n).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Standard deviations in the median absolute deviation of a normal: one over its upper quartile.
SD_OF_MAD = 1.4826


def robust_sd(values: Floats, middle: float | None = None) -> float:
    """Return the standard deviation of values (n,) about the median, or another `middle`.

    0 where there is no value.
    """
    if not values.size:
        return 0.0
    about = np.median(values) if middle is None else middle
    return float(SD_OF_MAD * np.median(np.abs(values - about)))
