"""How much of an error that names make the residual holds, every report alike.

Assumptions: blocks of three days err independently of each other, about one share that all of them
hold: of what acts for a week its own two or three blocks tell, not the many on which nothing is
asked.

Validity: single reports count to a bound; gross ones hold nothing.

Units: m/s; energies in m2 s-2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Days of a block.
BLOCK = 3
#: Bound on single residuals, m/s: of a gross error nothing is explained.
BOUND = 12.0


@dataclass(frozen=True)
class ShareHeld:
    """Share of an error held, its standard error between blocks, and the error's energy."""

    share: float
    error: float
    energy: float  # m2 s-2, sum over reports


def share_held(residual: Floats, error: Floats, day: Integers) -> ShareHeld:
    """Share r'e / e'e of an error, (n, 2), in a residual, (n, 2), m/s.

    Parameters
    ----------
    day : (n,) int
        Number of each report's day.

    Returns
    -------
    ShareHeld
        0 with no error known, of an error that is nothing.
    """
    own = np.where((np.abs(residual).max(axis=1) < BOUND)[:, None], error, 0.0)
    held = np.bincount(day // BLOCK, (residual * own).sum(axis=1))
    size = np.bincount(day // BLOCK, (own**2).sum(axis=1))
    energy = float(size.sum())
    if energy <= 0.0:
        return ShareHeld(0.0, np.inf, 0.0)
    share = float(held.sum()) / energy
    number = energy**2 / float((size**2).sum())  # blocks that it acts in
    few = float(np.sqrt(number / max(number - 1.0, 0.5)))
    return ShareHeld(share, few * float(np.hypot.reduce(held - share * size)) / energy, energy)
