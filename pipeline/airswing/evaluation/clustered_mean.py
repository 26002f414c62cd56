"""Means with standard errors clustered by flight, from sums that aircraft are added up by.

Assumes clusters (flights) that lie within one aircraft. What a mean and its error need of an
aircraft are six sums, so that an archive of any size is summed aircraft by aircraft; the sums over
the aircraft do not depend on how many were looked at together.

References
----------
Liang & Zeger 1986 (Biometrika 73); Cameron & Miller 2015 (J. Hum. Resour. 50, 317-372).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SUMS = 6  # Reports, their sum, clusters; and over clusters of sum S and size n: S^2, S n, n^2


def cluster_sums(values: Floats, group: Ints, cluster: Ints, groups: int) -> Floats:
    """Sums behind the means of groups.

    Parameters
    ----------
    values : array, shape (report,)
    group : array of int, shape (report,)
        Below ``groups``.
    cluster : array of int, shape (report,)
        Flight of each report; it may take part in several groups.

    Returns
    -------
    array, shape (6, groups)
        See `SUMS`.
    """
    _, number = np.unique(cluster, return_inverse=True)
    keys, pair = np.unique(number * groups + group, return_inverse=True)
    total = np.bincount(pair, weights=values, minlength=keys.size)
    size = np.bincount(pair, minlength=keys.size).astype(np.float64)
    owner = keys % groups
    parts = (size, total, np.ones_like(total), total**2, total * size, size**2)
    return np.array([np.bincount(owner, weights=part, minlength=groups) for part in parts])


def clustered_mean(sums: Floats) -> tuple[Floats, Floats]:
    """Mean of each group and its standard error with clusters as the independent units.

    Parameters
    ----------
    sums : array, shape (6, ...)
        Of :func:`cluster_sums`, added up.

    Returns
    -------
    mean, standard_error : arrays, shape (...)
        NaN for an empty group; the error is NaN with fewer than two clusters. With residual sums
        s of the m clusters of a group of n values: se^2 = m / (m - 1) sum s^2 / n^2.
    """
    number, total, clusters, squares, products, sizes = np.asarray(sums, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / number
        spread = np.maximum(squares - 2.0 * mean * products + mean**2 * sizes, 0.0)
        error = np.sqrt(clusters / (clusters - 1.0) * spread) / number
    return mean, np.where(clusters > 1, error, np.nan)
