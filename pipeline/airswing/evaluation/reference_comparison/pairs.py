"""Kernels that compare two references on the same reports.

Assumes both references were sampled at the same reports. The difference of their heading errors
does not contain the report's own error, so it is regressed directly on the deviation's design:
the covariance of the difference then honours the shared observations. Errors of one day are
taken as correlated over the whole fleet, days as independent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special  # not scipy.stats, whose import takes longer than a small fit

from airswing.evaluation.results import Content

Floats = NDArray[np.float64]
# A to E; airspeed scale and bias are each fit's own affair.
COEFFICIENTS = 5
COMPONENTS = ("eastward", "northward")
# Days a weather situation, and with it a model's error, lasts.
_LAG = 3
# Regions seen on fewer days say nothing.
_MIN_DAYS = 10


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
        m/s (docs/method.md: cross-track V psi_err, along-track |V_A| - |V'_A|).
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
    # pseudo-inverse of it: on few headings some coefficients cannot be told, and stay at zero
    normal = cross.T @ cross + along.T @ along
    inverse = np.linalg.pinv(normal, hermitian=True)
    coefficients = inverse @ (cross.T @ y_cross + along.T @ y_along)
    score = cross * (y_cross - cross @ coefficients)[:, np.newaxis]
    score += along * (y_along - along @ coefficients)[:, np.newaxis]
    summed = np.zeros((clusters, score.shape[1]))
    np.add.at(summed, index, score)
    influence = summed @ inverse * np.sqrt(clusters / max(clusters - 1.0, 1.0))
    return coefficients, influence, clusters


def common_equations(
    cross: Floats, along: Floats, y_cross: Floats, y_along: Floats, cluster: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Floats]:
    """Equations of one aircraft for a difference of A to E that a fleet has in common.

    The aircraft's own airspeed scale and bias are taken out. Those of all aircraft add up, cluster
    by cluster: what an aircraft does not tell (few reports, few headings) has no weight in the sum.

    Parameters
    ----------
    cross, along : arrays of float, shape (report, 8)
    y_cross, y_along : arrays of float, shape (report,), m/s
    cluster : array of int, shape (report,)

    Returns
    -------
    clusters : array of int, shape (cluster,)
    equations : array of float, shape (cluster, 5, 6)
        Normal matrix and, last, right side.
    """
    # stable: rows of one group keep their order, so that their sums are the same bit for bit
    order = np.argsort(cluster, kind="stable")
    clusters, start = np.unique(cluster[order], return_index=True)
    stop = np.append(start[1:], order.size)
    parts = [np.column_stack(part)[order] for part in ((cross, y_cross), (along, y_along))]
    sums = np.array(
        [
            sum(part[i:j, :-1].T @ part[i:j] for part in parts)
            for i, j in zip(start, stop, strict=True)
        ]
    )
    own = np.linalg.pinv(sums[:, COEFFICIENTS:, COEFFICIENTS:-1].sum(axis=0), hermitian=True)
    rest = own @ sums[:, COEFFICIENTS:].sum(axis=0)
    keep = np.vstack([np.eye(COEFFICIENTS), -rest[:, :COEFFICIENTS]])
    right = sums[:, :, -1] - sums[:, :, COEFFICIENTS:-1] @ rest[:, -1]
    square = keep.T @ sums[:, :, :-1] @ keep
    return clusters, np.concatenate([square, (right @ keep)[:, :, np.newaxis]], axis=2)


def common_difference(equations: Floats) -> tuple[Floats, Floats]:
    """Difference of A to E that a fleet has in common, by least squares.

    Parameters
    ----------
    equations : array of float, shape (cluster, 5, 6)
        Of :func:`common_equations`, added up over the fleet.

    Returns
    -------
    coefficients : array of float, shape (5,)
    influence : array of float, shape (cluster, 5)
        What each cluster moves the coefficients by.
    """
    clusters = equations.shape[0]
    inverse = np.linalg.pinv(equations[:, :, :-1].sum(axis=0), hermitian=True)
    coefficients = inverse @ equations[:, :, -1].sum(axis=0)
    score = equations[:, :, -1] - equations[:, :, :-1] @ coefficients
    return coefficients, score @ inverse * np.sqrt(clusters / max(clusters - 1.0, 1.0))


def wald(values: Floats, covariance: Floats, clusters: int) -> float:
    """P value that some values differ from zero, for a covariance from few clusters.

    Parameters
    ----------
    values : array of float, shape (q,)
    covariance : array of float, shape (q, q)

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
    return float(special.fdtrc(size, clusters - size, scaled))


def holm(p_values: list[float]) -> list[float]:
    """Holm's step-down adjustment (Holm 1979, Scand. J. Stat. 6, 65-70); NaN stay NaN."""
    values = np.array(p_values, dtype=float)
    adjusted = np.full(values.size, np.nan)
    good = np.flatnonzero(np.isfinite(values))
    order = good[np.argsort(values[good])]
    factors = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(values[order] * factors), 1.0)
    return [float(value) for value in adjusted]


def persistent_covariance(influence: Floats, day: NDArray[np.int64]) -> Floats:
    """Covariance of a sum over days whose errors outlast a day.

    The correlation over `_LAG` days is given weights that fall to nothing (Newey & West 1987,
    Econometrica 55, 703-708).

    Parameters
    ----------
    influence : array of float, shape (day, p)
    day : array of int, shape (day,)
        Calendar days, increasing; gaps count.

    Returns
    -------
    array of float, shape (p, p)
        Not smaller than without the lags, variance by variance.
    """
    filled = np.zeros((int(day[-1] - day[0]) + 1, influence.shape[1]))
    filled[day - day[0]] = influence
    plain = filled.T @ filled
    total = plain.copy()
    for shift in range(1, min(_LAG, filled.shape[0] - 1) + 1):
        product = filled[shift:].T @ filled[:-shift]
        total += (1.0 - shift / (_LAG + 1.0)) * (product + product.T)
    # never narrower: correlations of few days come out negative by chance
    wider = np.sqrt(np.maximum(np.diag(total) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(wider, wider))


def region_sums(
    du: Floats,
    dv: Floats,
    region: NDArray[np.int64],
    day: NDArray[np.int64],
    regions: int,
    days: int,
) -> Floats:
    """Sums behind :func:`regional_bias`; those of parts of an archive add up.

    Parameters
    ----------
    du, dv : arrays of float, shape (report,), m/s
    region, day : arrays of int, shape (report,)
        From 0.

    Returns
    -------
    array, shape (3, regions, days)
        Reports, and their summed differences eastward and northward.
    """
    cell = region * days + day
    found = [np.bincount(cell, weights=part, minlength=regions * days) for part in (None, du, dv)]
    return np.array(found, dtype=np.float64).reshape(3, regions, days)


def regional_bias(sums: Floats) -> list[Content]:
    """Mean wind difference of two references by region, and against the other regions.

    The two models' errors are shared by regions and last for days. So each region is also held
    against the others on the same days (``contrast``: what is common to all drops out), and the
    errors are clustered by blocks of five days or more, with Student's t for their number
    (Ibragimov & Mueller 2010, J. Bus. Econ. Stat. 28, 453-468).

    Parameters
    ----------
    sums : array, shape (3, regions, days)
        Of :func:`region_sums`, added up.

    Returns
    -------
    list of Region
        ``region``, ``component``, ``days``; ``difference`` and ``contrast``, each with
        ``*_standard_error`` (m/s) and ``*_p_value`` (the contrast None with one region).
    """
    number = sums[0]
    seen = np.flatnonzero(number.any(axis=0))
    block = np.zeros(number.shape[1], dtype=np.int64)
    if seen.size:
        block[seen] = day_blocks(seen)
    found: list[Content] = []
    for region in np.flatnonzero(number.any(axis=1)):
        own = number[region]
        days = int(np.count_nonzero(own))
        if days < _MIN_DAYS:
            continue
        others = number.sum(axis=0) - own
        for component, values in zip(COMPONENTS, sums[1:], strict=True):
            mean, error, p_value = _block_mean(values[region], own, block)
            entry: Content = {
                "region": int(region),
                "component": component,
                "days": days,
                "difference": mean,
                "difference_standard_error": error,
                "difference_p_value": p_value,
                "contrast": None,
                "contrast_p_value": None,
            }
            both = (own > 0) & (others > 0)
            if np.unique(block[both]).size >= 4:
                rest = values.sum(axis=0) - values[region]
                less = values[region][both] - own[both] * rest[both] / others[both]
                mean, error, p_value = _block_mean(less, own[both], block[both])
                entry["contrast"], entry["contrast_p_value"] = mean, p_value
                entry["contrast_standard_error"] = error
            found.append(entry)
    return found


def day_blocks(day: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the stretches of days that are taken as independent of each other.

    Parameters
    ----------
    day : array of int, shape (n,)

    Returns
    -------
    array of int, shape (n,)
        6 to 12 stretches of equal length, of five days where that many fit.
    """
    first, length = int(day.min()), int(np.ptp(day)) + 1
    # five days outlast the weather's memory; under six blocks Student's quantile is wide, and
    # beyond twelve it is hardly narrower
    blocks = int(np.clip(length // 5, 6, 12))
    return np.asarray((day - first) * blocks // length)


def _block_mean(
    total: Floats, number: Floats, block: NDArray[np.int64]
) -> tuple[float, float, float]:
    """Mean, standard error clustered by block and two-sided p value, from sums by day."""
    some = number > 0
    total, number = total[some], number[some]
    _, index = np.unique(block[some], return_inverse=True)
    blocks = int(index.max()) + 1
    mean = float(total.sum() / number.sum())
    if blocks < 2:
        return mean, float("nan"), float("nan")
    summed = np.bincount(index, weights=total - mean * number, minlength=blocks)
    error = float(np.sqrt((summed**2).sum() * blocks / (blocks - 1.0)) / number.sum())
    # two references with one and the same wind differ by nothing, exactly
    return mean, error, float(2 * special.stdtr(blocks - 1, -abs(mean) / max(error, 1e-12)))
