"""Kernels that compare two references on the same reports.

Assumes both references were sampled at the same reports. The difference of their heading errors
does not contain the report's own error, so it is regressed directly on the deviation's design:
the covariance of the difference then honours the shared observations. Errors of one day are
taken as correlated over the whole fleet, days as independent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Floats = NDArray[np.float64]
COEFFICIENTS = 5


def paired_design(
    magnetic_heading: Floats, heading: Floats, airspeed: Floats
) -> tuple[Floats, Floats]:
    """Design of the joint fit, cross and along the heading.

    Parameters
    ----------
    magnetic_heading, heading : arrays of float, shape (report,), radians
    airspeed : array of float, shape (report,), m/s

    Returns
    -------
    cross, along : arrays of float, shape (report, 8)
        Columns A, B, C, D, E (radians), airspeed scale, and the bias b_u, b_v (m/s); rows in
        m/s (DOMAIN: cross-track V psi_err, along-track |V_A| - |V'_A|).
    """
    m, v = magnetic_heading, airspeed
    zero = np.zeros_like(m)
    sine, cosine = np.sin(heading), np.cos(heading)
    basis = [np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)]
    cross = np.column_stack([*(v * column for column in basis), zero, cosine, -sine])
    along = np.column_stack([zero, zero, zero, zero, zero, v, sine, cosine])
    return cross, along


def clustered_difference(
    cross: Floats, along: Floats, y_cross: Floats, y_along: Floats, cluster: NDArray[np.int64]
) -> tuple[Floats, Floats, int]:
    """Least squares of a paired difference with a covariance clustered by day.

    Parameters
    ----------
    cross, along : arrays of float, shape (report, 8)
    y_cross, y_along : arrays of float, shape (report,), m/s
        Differences of the two references' cross- and along-track errors.
    cluster : array of int, shape (report,)

    Returns
    -------
    coefficients : array of float, shape (8,)
    influence : array of float, shape (cluster, 8)
        What each cluster moves the coefficients by; their outer products sum to the covariance.
    clusters : int
    """
    _, index = np.unique(cluster, return_inverse=True)
    clusters = int(index.max(initial=-1)) + 1
    normal = cross.T @ cross + along.T @ along
    inverse = np.linalg.pinv(normal, hermitian=True)
    coefficients = inverse @ (cross.T @ y_cross + along.T @ y_along)
    score = cross * (y_cross - cross @ coefficients)[:, np.newaxis]
    score += along * (y_along - along @ coefficients)[:, np.newaxis]
    summed = np.zeros((clusters, score.shape[1]))
    np.add.at(summed, index, score)
    influence = summed @ inverse * np.sqrt(clusters / max(clusters - 1.0, 1.0))
    return coefficients, influence, clusters


def wald(values: Floats, covariance: Floats, clusters: int) -> float:
    """P value that some values differ from zero, for a covariance from few clusters.

    Parameters
    ----------
    values : array of float, shape (q,)
    covariance : array of float, shape (q, q)
    clusters : int

    Returns
    -------
    float
        From Hotelling's T2 with ``clusters - 1`` degrees of freedom; NaN when there are not
        more clusters than values.
    """
    size = values.size
    if clusters <= size + 1 or not np.all(np.isfinite(covariance)):
        return float("nan")
    statistic = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    scaled = statistic * (clusters - size) / (size * (clusters - 1.0))
    return float(stats.f.sf(scaled, size, clusters - size))


def holm(p_values: list[float]) -> list[float]:
    """Holm's step-down adjustment (Holm 1979, Scand. J. Stat. 6, 65-70); NaN stay NaN.

    Parameters
    ----------
    p_values : list of float

    Returns
    -------
    list of float
    """
    values = np.array(p_values, dtype=float)
    adjusted = np.full(values.size, np.nan)
    good = np.flatnonzero(np.isfinite(values))
    order = good[np.argsort(values[good])]
    factors = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(values[order] * factors), 1.0)
    return [float(value) for value in adjusted]


def regional_bias(
    du: Floats,
    dv: Floats,
    region: NDArray[np.int64],
    day: NDArray[np.int64],
    *,
    min_days: int = 10,
) -> list[dict[str, Any]]:
    """Mean wind difference of two references by region, with errors clustered by day.

    Parameters
    ----------
    du, dv : arrays of float, shape (report,), m/s
    region : array of int, shape (report,)
    day : array of int, shape (report,)
    min_days : int, default 10
        Regions seen on fewer days say nothing.

    Returns
    -------
    list of dict
        ``region``, ``component``, ``difference``, ``standard_error`` (m/s), ``p_value``,
        ``days``.
    """
    found = []
    for number in np.unique(region):
        here = region == number
        _, index = np.unique(day[here], return_inverse=True)
        days = int(index.max()) + 1
        if days < min_days:
            continue
        for component, values in (("eastward", du[here]), ("northward", dv[here])):
            mean = float(values.mean())
            summed = np.bincount(index, weights=values - mean, minlength=days)
            # Days next to each other share some of the error: Newey-West with one lag.
            series = float((summed**2).sum() + (summed[1:] * summed[:-1]).sum())
            error = np.sqrt(max(series, float((summed**2).sum())) * days / (days - 1.0))
            error /= here.sum()
            found.append(
                {
                    "region": int(number),
                    "component": component,
                    "difference": mean,
                    "standard_error": float(error),
                    "p_value": float(2 * stats.t.sf(abs(mean / error), days - 1)),
                    "days": days,
                }
            )
    return found
