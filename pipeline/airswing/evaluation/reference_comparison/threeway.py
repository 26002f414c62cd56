"""Three-way error estimates: each reference's own error variance, where three exist.

Assumes the errors of the three references are uncorrelated with each other (the three-cornered
hat; Gray & Allan 1974, Proc. 28th Freq. Control Symp., 243-246). References that assimilate the
same aircraft break this and come out too good; a negative variance is told as such.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.results import Content

# Corners of the hat that each difference lies between.
_PAIRS = ((0, 1), (0, 2), (1, 2))


def hat_sums(
    u: NDArray[np.float64], v: NDArray[np.float64], day: NDArray[np.int64], days: int
) -> NDArray[np.float64]:
    """Sums behind :func:`hats_of`; those of parts of an archive add up.

    Parameters
    ----------
    u, v : arrays of float, shape (reference, report), m/s
    day : array of int, shape (report,)
        From 0.

    Returns
    -------
    array, shape (triple, 4, day)
        Reports, and the summed halved squares of the three pairs' differences.
    """
    found = []
    for triple in combinations(range(len(u)), 3):
        good = np.all(np.isfinite(u[list(triple)]), axis=0)
        parts = [np.bincount(day[good], minlength=days).astype(np.float64)]
        for i, j in _PAIRS:
            one, two = triple[i], triple[j]
            square = ((u[one] - u[two]) ** 2 + (v[one] - v[two]) ** 2)[good] / 2.0
            summed = np.bincount(day[good], weights=square, minlength=days)
            parts.append(summed.astype(np.float64))
        found.append(parts)
    return np.array(found).reshape(-1, 4, days)


def hats_of(sums: NDArray[np.float64], names: list[str]) -> list[Content]:
    """Estimate the error of each of three references for every triple, from their sums.

    Parameters
    ----------
    sums : array, shape (triple, 4, day)
        Of :func:`hat_sums`, added up.

    Returns
    -------
    list of Hat
        ``references`` and per reference ``component_rms`` (m/s; None where the variance came
        out negative), ``variance``, ``variance_standard_error`` (of a jackknife over days), and
        ``reports``.
    """
    found: list[Content] = []
    for triple, own in zip(combinations(range(len(names)), 3), sums, strict=True):
        count, squares = own[0], own[1:]
        if count.sum() < 100:
            continue
        variances, errors = _jackknifed(squares[:, count > 0], count[count > 0])
        found.append(
            {
                "references": [names[i] for i in triple],
                "reports": int(count.sum()),
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
    sums: NDArray[np.float64], count: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Error variance per component of each corner, with a delete-one-day standard error."""
    days = count.size
    corner = 0.5 * np.array([[1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
    whole = corner @ (sums.sum(1) / count.sum())
    if days < 2:
        return whole, np.full(3, np.nan)
    without = corner @ ((sums.sum(1, keepdims=True) - sums) / (count.sum() - count))
    spread = ((without - without.mean(1, keepdims=True)) ** 2).sum(1)
    return whole, np.sqrt(spread * (days - 1.0) / days)
