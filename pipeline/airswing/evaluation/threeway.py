"""Three-way error estimates: each reference's own error variance, where three exist.

Assumes the errors of the three references are uncorrelated with each other (the three-cornered
hat; Gray & Allan 1974, Proc. 28th Freq. Control Symp., 243-246). References that assimilate the
same aircraft break this and come out too good; a negative variance is told as such.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray


def three_cornered_hat(
    u: NDArray[np.float64], v: NDArray[np.float64], names: list[str], day: NDArray[np.int64]
) -> list[dict[str, Any]]:
    """Estimate the error of each of three references for every triple.

    Parameters
    ----------
    u, v : arrays of float, shape (reference, report), m/s
    names : list of str, length reference
    day : array of int, shape (report,)
        Unit of the jackknife behind the standard errors.

    Returns
    -------
    list of dict
        ``references`` and per reference ``component_rms`` (m/s; None where the variance came
        out negative), ``variance``, ``variance_standard_error``, and ``reports``.
    """
    found = []
    for triple in combinations(range(len(names)), 3):
        good = np.all(np.isfinite(u[list(triple)]), axis=0)
        if good.sum() < 100:
            continue
        variances, errors = _jackknifed(
            u[list(triple)][:, good], v[list(triple)][:, good], day[good]
        )
        found.append(
            {
                "references": [names[i] for i in triple],
                "reports": int(good.sum()),
                "errors": [
                    {
                        "reference": names[index],
                        "variance": float(variance),
                        "variance_standard_error": float(error),
                        "component_rms": float(np.sqrt(variance)) if variance > 0 else None,
                    }
                    for index, variance, error in zip(triple, variances, errors, strict=True)
                ],
            }
        )
    return found


def _jackknifed(
    u: NDArray[np.float64], v: NDArray[np.float64], day: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Error variance per component of each corner, with a delete-one-day standard error."""
    _, index = np.unique(day, return_inverse=True)
    days = int(index.max()) + 1
    pairs = [(0, 1), (0, 2), (1, 2)]
    square = [((u[i] - u[j]) ** 2 + (v[i] - v[j]) ** 2) / 2.0 for i, j in pairs]
    sums = np.array([np.bincount(index, weights=values, minlength=days) for values in square])
    count = np.bincount(index, minlength=days)
    corner = 0.5 * np.array([[1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
    whole = corner @ (sums.sum(1) / count.sum())
    if days < 2:
        return whole, np.full(3, np.nan)
    without = corner @ ((sums.sum(1, keepdims=True) - sums) / (count.sum() - count))
    spread = ((without - without.mean(1, keepdims=True)) ** 2).sum(1)
    return whole, np.sqrt(spread * (days - 1.0) / days)
