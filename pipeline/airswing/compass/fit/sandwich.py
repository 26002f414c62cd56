"""Covariance of a robust fit whose errors are correlated within flights and days.

Assumptions
-----------
Clusters are independent of each other; nothing is assumed inside one. The parameter error is
then the sum over clusters of M s_g with M the inverse of the slope matrix and s_g the cluster's
score, and the covariance the sum of the outer products (sandwich). With few clusters each score is
first divided by (I - N_g / N)^(1/2), which makes the estimate unbiased under the working model
(CR2), and the interval takes Student's t with 1 / sum p_g^2 degrees of freedom, p_g the cluster's
share of the information on that parameter.

References
----------
Bell & McCaffrey 2002 (Survey Methodology 28); Pustejovsky & Tipton 2018 (J. Bus. Econ. Stat. 36);
MacKinnon, Nielsen & Webb 2023 (J. Econometrics 232).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.units import NORMAL_95

Array = NDArray[np.float64]
Index = NDArray[np.int64]
MANY = 150
"""Number of clusters from which on one common factor accounts for the leverage."""


def group_sums(values: Array, group: Index, groups: int) -> Array:
    """Return the sums of rows (n, ...) by group, 0 to ``groups - 1``."""
    if not group.size:
        return np.zeros((groups, *values.shape[1:]))
    if np.any(group[1:] < group[:-1]):
        # a stable sort keeps the order within a group, so that sums are the same to the last bit
        order = np.argsort(group, kind="stable")
        values, group = values[order], group[order]
    first = np.flatnonzero(np.diff(group, prepend=-1))
    found = np.add.reduceat(values, first, axis=0)
    if first.size == groups:
        return np.asarray(found)
    total = np.zeros((groups, *values.shape[1:]))
    total[group[first]] = found
    return total


def inverse_root(normal: Array) -> Array:
    """Return a matrix whose product with its transpose is the inverse of a normal matrix."""
    values, vectors = np.linalg.eigh(normal)
    # rounding can make the smallest slightly negative, which means a very large error
    return np.asarray(vectors / np.sqrt(np.maximum(values, values[-1] * 1e-14)))


def influences(score: Array, inverse_root: Array, normals: Array | None, kappa: float) -> Array:
    """Return the share of every cluster in the error of the parameters, shape (g, p).

    The sum of their outer products is the covariance.

    Parameters
    ----------
    score : array, shape (g, p)
        Score of every cluster.
    inverse_root : array, shape (p, p)
        Of the weighted normal matrix of all.
    normals : array, shape (g, p, p), optional
        That of every cluster; without it the leverage is a common factor g / (g - p).
    kappa : float
        Slope of the robust score over the mean weight: M = (kappa N)^-1.
    """
    clusters, size = score.shape
    if normals is None:
        factor = clusters / max(clusters - size, 1)
        return np.asarray(score @ (inverse_root @ inverse_root.T * (np.sqrt(factor) / kappa)))
    whitened = score @ inverse_root
    part, axes = np.linalg.eigh(inverse_root.T @ normals @ inverse_root)
    # the leverage is one where a cluster alone determines a parameter: its residual is zero
    gain = 1.0 / np.sqrt(np.clip(1.0 - part, 0.05, 1.0))
    turned = (whitened[:, np.newaxis, :] @ axes)[:, 0, :] * gain
    whitened = (axes @ turned[..., np.newaxis])[..., 0]
    return np.asarray(whitened @ inverse_root.T / kappa)


def degrees_of_freedom(normal: Array, normals: Array | None, clusters: int) -> Array:
    """Return the degrees of freedom of the standard error of each parameter, shape (p,).

    Parameters
    ----------
    normal : array, shape (p, p)
        Weighted normal matrix of all clusters.
    normals : array, shape (g, p, p), optional
        As in `influences`.
    clusters : int
        Their number.
    """
    if normals is None:
        # flights have unequal weights: a third of their number is a cautious bound
        return np.full(normal.shape[0], max(clusters / 3.0, 1.0))
    inverse = np.linalg.pinv(normal, hermitian=True)
    part = ((inverse @ normals) * inverse.T).sum(axis=2)
    # a parameter that is held fixed has no information in any flight
    share = part / np.maximum(part.sum(axis=0), 1e-300)
    pieces = 1.0 / np.maximum((share**2).sum(axis=0), 1e-12)
    return np.asarray(np.maximum(pieces - 1.0, 1.0))


def t_inflation(freedom: Array) -> Array:
    """Return the factor of a standard error for +-1.96 of it to be Student's 95 % interval.

    Parameters
    ----------
    freedom : array
        Degrees of freedom; infinite ones give 1.
    """
    from scipy.special import stdtrit

    # scipy gives NaN at infinity
    finite = np.minimum(np.maximum(freedom, 1.0), 1e6)
    return np.asarray(stdtrit(finite, 0.975) / NORMAL_95)
