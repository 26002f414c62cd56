"""Days drawn again in blocks: the bootstrap of anything that sums over days.

Assumes days in order, of which neighbours may be alike (weather lasts), and statistics that are
functions of sums over days. Blocks of n^(1/3) successive days are drawn with replacement from the
circle of all days (Politis & Romano 1992; Kuensch 1989, Ann. Stat. 17, 1217-1241), so that what
lasts less than a block is in the spread. Valid from about ten days; with one day there is no
spread and no interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

Floats = NDArray[np.float64]


def block_weights(days: int, *, draws: int, seed: int) -> Floats:
    """How often each day is drawn, spread out a little for the few blocks there are.

    Returns
    -------
    array, shape (draw, day)
        Mean 1; the distance from 1 is stretched by sqrt(m / (m - 1)), m the blocks of a draw, as
        drawing m of m again has too small a variance by that much.
    """
    length = _block_length(days)
    number = -(-days // length)
    first = np.random.default_rng(seed).integers(0, days, size=(draws, number))
    drawn = (first[..., None] + np.arange(length)).reshape(draws, -1)[:, :days] % days
    row = np.arange(draws)[:, None] * days
    weights = np.bincount((row + drawn).ravel(), minlength=draws * days).reshape(draws, days)
    return np.asarray(1.0 + (weights - 1.0) * np.sqrt(number / max(number - 1.0, 1.0)))


def _block_length(days: int) -> int:
    """Days of a block: the cube root of all."""
    length: int = round(days ** (1.0 / 3.0))
    return max(length, 1)


def widened(drawn: Floats, days: int) -> Floats:
    """Draws as far from what was found as few blocks call for: Student's t in place of the normal.

    Parameters
    ----------
    drawn : array, shape (1 + draw, ...)
        What was found, then the draws.

    Returns
    -------
    array, shape (1 + draw, ...)
    """
    blocks = -(-days // _block_length(days))
    # as far out as 95 % reach: there the interval is read
    factor = stdtrit(max(blocks - 1, 1), 0.975) / ndtri(0.975)
    return np.asarray(drawn[:1] + (drawn - drawn[:1]) * factor)


def interval(drawn: Floats) -> Floats:
    """Ends of the interval that holds 95 % of the draws.

    Parameters
    ----------
    drawn : array, shape (draw, ...)

    Returns
    -------
    array, shape (2, ...)
        NaN where a draw gave no value.
    """
    return np.asarray(np.percentile(drawn, [2.5, 97.5], axis=0))
