"""How much likelier a step makes a few days, where days may be gross.

Assumes days that each tell a quantity x by a weight W and a score W x, with errors of Student's t:
a day at the squared distance d from what it should tell has the density of a multivariate t of
six degrees of freedom and of as many dimensions as W has. x is normal about zero: with
the level's own error where nothing stepped, and with the step's beside it where it did. The
integral over x is Laplace's at its maximum, which is reweighted least squares (Lange, Little &
Taylor 1989, J. Am. Stat. Assoc. 84, 881-896).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FREEDOM = 6.0
"""A day is the mean of a few flights, each of them heavy-tailed."""
SINGLE_DAY = 5.5
"""Logarithm of the likelihood ratio that the day farthest off may add to the others'."""
_ROUNDS = 8
# a weight is known to about this share: directions below are rounding
_SINGULAR = 1e-9


def corroborated_ratio(weight: Floats, score: Floats, level: Floats, shapes: Floats) -> float:
    """Logarithm of the likelihood ratio of a step before the days over none.

    Parameters
    ----------
    weight, score : array, shape (n, p, p) and (n, p)
        What each day tells about the level before.
    level : array, shape (p, p)
        Covariance of that level's error.
    shapes : array, shape (shape, p)
        Standard deviations of the step, by shape; all are as likely.

    Returns
    -------
    float
        At most :data:`SINGLE_DAY` more than without the day that is farthest from the level.
    """
    ratio, farthest = _ratio(weight, score, level, shapes)
    if ratio <= SINGLE_DAY:
        return ratio
    others = np.arange(score.shape[0]) != farthest
    rest = _ratio(weight[others], score[others], level, shapes)[0] if others.any() else 0.0
    return min(ratio, max(rest, 0.0) + SINGLE_DAY)


def _ratio(weight: Floats, score: Floats, level: Floats, shapes: Floats) -> tuple[float, int]:
    """Logarithm of the likelihood ratio, and the day farthest from the level."""
    stepped = level + np.einsum("si,ij->sij", shapes**2, np.eye(level.shape[0]))
    law, distance = _marginals(weight, score, np.concatenate([level[np.newaxis], stepped]))
    mixed = np.logaddexp.reduce(law[1:]) - np.log(shapes.shape[0])
    return float(mixed - law[0]), int(np.argmax(distance))


def _marginals(weight: Floats, score: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Logarithm of the days' density for covariances (m, p, p) of x, up to what all share.

    The second is every day's squared distance from what the first covariance's x tells.
    """
    unit = np.sqrt(np.diagonal(covariance[-1]))
    weight, score = unit[:, np.newaxis] * weight * unit, score * unit
    covariance = covariance / unit[:, np.newaxis] / unit
    value, vector = np.linalg.eigh(weight)
    told = value > _SINGULAR * value[:, -1:]
    projected = np.einsum("nji,nj->ni", vector, score)
    square = (np.where(told, projected, 0.0) ** 2 / np.where(told, value, 1.0)).sum(1)
    size = told.sum(1)
    flat = weight.reshape(size.size, -1)
    eye, best = np.eye(unit.size), np.full(covariance.shape[0], -np.inf)
    first = np.zeros(size.size)
    # from all days alike and from the days near the level: gross days may make two maxima
    for start in (np.ones(size.size), (FREEDOM + size) / (FREEDOM + square)):
        share = np.tile(start, (best.size, 1))
        for _ in range(_ROUNDS):
            total, right = (share @ flat).reshape(covariance.shape), share @ score
            inside = eye + covariance @ total
            pulled = np.einsum("mij,mj->mi", covariance, right)[..., np.newaxis]
            x = np.linalg.solve(inside, pulled)[..., 0]
            quadratic = np.einsum("mi,nij,mj->mn", x, weight, x, optimize=True)
            distance = np.maximum(square - 2.0 * x @ score.T + quadratic, 0.0)
            share = (FREEDOM + size) / (FREEDOM + distance)
        # x = V (right - total x), so that the prior's x' V^-1 x needs no inverse of V
        prior = ((right - np.einsum("mij,mj->mi", total, x)) * x).sum(1)
        density = -0.5 * ((FREEDOM + size) * np.log1p(distance / FREEDOM)).sum(1)
        found = density - 0.5 * prior - 0.5 * np.linalg.slogdet(inside)[1]
        first = np.where(found[0] > best[0], distance[0], first)
        best = np.maximum(best, found)
    return best, first
