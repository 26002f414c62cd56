"""Resampling of days, standard errors of clusters, and the permutation test.

*Bootstrap* of functions of sums over days, which may be correlated with their neighbours: blocks of
successive days are drawn with replacement from the circle of all days (Politis & Romano 1992;
Kuensch 1989, Ann. Stat. 17, 1217-1241). Valid from about ten days; one day has no spread.

*Clustered mean* of clusters (flights, days) that are independent of each other (Liang & Zeger 1986,
Biometrika 73; Cameron & Miller 2015, J. Hum. Resour. 50, 317-372), from sums that add up over parts
of an archive.

*Permutation test* of aircraft that are exchangeable without an effect, given a covariate such as
the level before (Freedman & Lane 1983, J. Bus. Econ. Stat. 1, 292-298).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth
from scipy.special import ndtri, stdtrit

from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SUMS = 6  # reports, their sum, clusters; and over clusters of sum S and size n: S^2, S n, n^2
FEWEST_PERMUTED = 5
"""Fewest aircraft for a permutation test: two of four can be chosen in only six ways, so that no p
value would be below 0.16."""


def day_weights(days: int, *, draws: int, seed: int, length: int | None = None) -> Floats:
    """How often each day is drawn by a bootstrap over blocks of days, (draw, day), mean 1.

    A block has the cube root of the number of days by default, 1 for independent days. The distance
    from 1 is stretched by sqrt(m / (m - 1)), m the blocks of a draw, because drawing m of m with
    replacement has a variance smaller by that factor squared.
    """
    length = block_length(days) if length is None else length
    number = -(-days // length)
    first = np.random.default_rng(seed).integers(0, days, size=(draws, number))
    drawn = (first[..., None] + np.arange(length)).reshape(draws, -1)[:, :days] % days
    row = np.arange(draws)[:, None] * days
    weights = np.bincount((row + drawn).ravel(), minlength=draws * days).reshape(draws, days)
    return np.asarray(1.0 + (weights - 1.0) * np.sqrt(number / max(number - 1.0, 1.0)))


def block_length(days: int) -> int:
    """Days of a block: the cube root of their number, at least 1."""
    return max(int(np.rint(np.cbrt(days))), 1)


def widened(drawn: Floats, days: int) -> Floats:
    """Draws, (1 + draw, ...) with the estimate first, widened for few blocks by Student's t."""
    blocks = -(-days // block_length(days))
    # at the ends of a 95 % interval
    factor = stdtrit(max(blocks - 1, 1), 0.975) / ndtri(0.975)
    return np.asarray(drawn[:1] + (drawn - drawn[:1]) * factor)


def interval(drawn: Floats) -> Floats:
    """Ends (2, ...) of the central 95 % of the draws (draw, ...); NaN where a draw has no value."""
    return np.asarray(np.percentile(drawn, [2.5, 97.5], axis=0))


def normal_interval(value: float, error: float) -> list[float]:
    """Ends of the 95 % interval of a normal estimate with a standard error."""
    return [value - NORMAL_95 * error, value + NORMAL_95 * error]


def ratio(total: Floats, number: Floats) -> Floats:
    """Mean ``total / number``, NaN where the number is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(number > 0, total / number, np.nan))


def cluster_sums(values: Floats, group: Ints, cluster: Ints, groups: int) -> Floats:
    """Sums behind the means of groups, (6, groups): see :data:`SUMS`.

    Values, groups and clusters (flights) are (report,); a cluster may take part in several groups.
    Sums of parts of an archive add up where no cluster is in two parts.
    """
    keys, pair = np.unique(np.int64(groups) * cluster + group, return_inverse=True)
    total = np.bincount(pair, weights=values, minlength=keys.size)
    count = np.bincount(pair, minlength=keys.size).astype(np.float64)
    owner = keys % groups
    terms = (count, total, np.ones_like(total), total**2, total * count, count**2)
    return np.array([np.bincount(owner, weights=term, minlength=groups) for term in terms])


def clustered_mean(sums: Floats) -> tuple[Floats, Floats]:
    """Mean of each group and its standard error, clusters being independent, from sums (6, ...).

    NaN for an empty group; the error is NaN with fewer than two clusters. With residual sums s of
    the m clusters of a group of n values: se^2 = m / (m - 1) sum s^2 / n^2.
    """
    number, total, clusters, squares, products, sizes = np.asarray(sums, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / number
        spread = np.maximum(squares - 2.0 * mean * products + mean**2 * sizes, 0.0)
        error = np.sqrt(clusters / (clusters - 1.0) * spread) / number
    return mean, np.where(clusters > 1, error, np.nan)


def permutation_test(
    outcome: Floats,
    treated: NDArray[np.bool_],
    *,
    covariate: Floats | None = None,
    draws: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """Effect of a treatment on an outcome (unit,), and its two-sided p value.

    The outcome is regressed on the covariate and the treatment; the residuals of the regression
    without the treatment are permuted over the units and the t value of the treatment computed
    again. Conditioning on the covariate keeps the size of the test when the treated were chosen by
    it. NaN with fewer than :data:`FEWEST_PERMUTED` units, an empty group, or where the covariate
    determines the group.
    """
    undefined = float("nan"), float("nan")
    number = outcome.size
    if number < FEWEST_PERMUTED or treated.all() or not treated.any():
        return undefined
    columns = [np.ones(number), *([] if covariate is None else [covariate])]
    # an orthonormal basis replaces the hat matrix
    span = orth(np.column_stack(columns), rcond=1e-12)
    fitted = span @ (span.T @ outcome)
    group = treated.astype(float)
    group = group - span @ (span.T @ group)
    information = float(group @ group)
    if information < 1e-9 * number:
        return undefined

    shuffled = np.random.default_rng(seed).permuted(np.tile(outcome - fitted, (draws, 1)), axis=1)
    values = np.vstack([outcome, fitted + shuffled])
    residual = values - (values @ span) @ span.T
    effects = (residual @ group) / information
    residual = residual - effects[:, np.newaxis] * group
    error = np.sqrt((residual**2).sum(1) / max(number - len(columns) - 1, 1) / information)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(effects / error)
    # draws that change nothing count as large, irrespective of rounding
    p_value = (1.0 + (t[1:] >= t[0] * (1 - 1e-12)).sum()) / (draws + 1.0)
    return float(effects[0]), float(p_value)
