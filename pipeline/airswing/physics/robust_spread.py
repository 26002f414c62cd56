"""Standard deviation of the many, which no few wild values move.

Assumes that the many are normal about their middle; good to 1.2 / sqrt(n) of itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Standard deviations in the median absolute deviation of a normal: one over its upper quartile.
SD_OF_MAD = 1.4826


def robust_sd(values: Floats, middle: float | None = None) -> float:
    """Standard deviation by the median absolute deviation from the middle; 0 of no values.

    The middle is the median where none is given.
    """
    if not values.size:
        return 0.0
    about = np.median(values) if middle is None else middle
    return float(SD_OF_MAD * np.median(np.abs(values - about)))
