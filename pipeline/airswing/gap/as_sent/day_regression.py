"""Least squares whose error is told by how days scatter: what the kinds of wrong winds stand on.

Assumptions: days err independently of each other, reports of a day as they like.

Validity: some days more than columns; no correction for few of them is made, which the standard
errors asked for (six and more) leave room for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def regressed(x: Floats, y: Floats, day: NDArray[np.integer]) -> tuple[Floats, Floats]:
    """Regression of some values on some columns, and its standard errors over days.

    Parameters
    ----------
    x : (n, k) float
    y : (n, m) float
    day : (n,) int
        Day of each report.

    Returns
    -------
    value : (k, m) float
        Columns that copy each other share what they explain.
    error : (k, m) float
    """
    inverse = np.linalg.pinv(x.T @ x)
    value = inverse @ (x.T @ y)
    own = np.unique(day, return_inverse=True)[1]
    score = x[:, :, None] * (y - x @ value)[:, None]
    by_day = np.zeros((own.max(initial=-1) + 1, *score.shape[1:]))
    for i in range(x.shape[1]):
        for j in range(y.shape[1]):
            by_day[:, i, j] = np.bincount(own, score[:, i, j])
    moved = np.einsum("ij,djm->dim", inverse, by_day)
    return value, np.asarray(np.sqrt((moved**2).sum(axis=0)))
