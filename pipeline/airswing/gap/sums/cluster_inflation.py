"""How much more scores scatter from day to day and week to week than the noise model says.

Assumptions: the noise model whitens along flights and takes off what flights of a day share; what
remains is correlated within days and over some days, in an aircraft and across the fleet. The
factor is the scatter of block sums (one day, three days, a week) about a unit's own fit over what
independent errors would give; per aircraft it is pooled by the median over aircraft, for fleet-wide
columns the blocks hold all aircraft.

Validity: four blocks and more; at least 1 per aircraft and 1.5 for the fleet. Of one fleet longer
blocks are few: their factor is drawn towards that of shorter ones.

Source: two-way clustering after Cameron, Gelbach & Miller (2011); docs/gap.md sections 2 and 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.day_scores import day_scores, fleet_day_grams, fleet_day_scores
from airswing.gap.sums.elimination import Conditional

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Lengths of the blocks whose scatter is looked at, days.
BLOCKS = (1, 3, 7)
#: Blocks that the factor of the next shorter ones is worth.
PRIOR_BLOCKS = 8.0
#: Share of a column's energy that must be left, given the included columns, for its scores to tell:
#: days scatter by what was conditioned on as well, and over next to nothing that is any number.
LEAST_LEFT = 0.05
# Smallest eigenvalue used, relative to the largest, at unit diagonal.
LEAST_EIGENVALUE = 1e-3


def cluster_factor(
    gram_by_day: Floats,
    score_by_day: Floats,
    information: Floats,
    *,
    spent: int = 0,
) -> Floats:
    """Scatter of block scores about a unit's own fit, relative to the information.

    Parameters
    ----------
    gram_by_day : (..., D, k, k) float
        X'X by day of each unit; its sum is about ``information``.
    score_by_day : (..., D, k) float
    information : (..., k, k) float
    spent : int
        Blocks' worth of freedom that was fitted away before.

    Returns
    -------
    (..., len(BLOCKS)) float
        Mean squared scatter per degree of freedom; NaN for fewer than four blocks.
    """
    days = score_by_day.shape[-2]
    spread, rank = _truncated_inverse(information)
    fit = np.einsum("...ij,...j->...i", spread, score_by_day.sum(axis=-2))
    share = np.trace(gram_by_day.sum(axis=-3), axis1=-2, axis2=-1)
    # the days sum to about the information only: brought to it
    ratio = np.trace(information, axis1=-2, axis2=-1) / np.maximum(share, 1e-30)
    fitted = (gram_by_day @ fit[..., None, :, None])[..., 0]
    remains = score_by_day - ratio[..., None, None] * fitted
    busy = np.any(gram_by_day, axis=(-2, -1))
    out = np.full((*rank.shape, len(BLOCKS)), np.nan)
    for i, length in enumerate(BLOCKS):
        edges = np.arange(0, days, length)
        if edges.size < 4 + spent:
            continue
        sums = np.add.reduceat(remains, edges, axis=-2)
        active = np.logical_or.reduceat(busy, edges, axis=-1).sum(axis=-1)
        free = np.maximum(active - 1 - spent, 1)
        degrees = np.maximum(rank, 1) * free / np.maximum(active, 1)
        out[..., i] = ((sums @ spread) * sums).sum(axis=(-2, -1)) / degrees
    return out


def _truncated_inverse(matrix: Floats) -> tuple[Floats, Integers]:
    """Inverse of symmetric matrices on the directions that carry information; how many those are.

    Parameters
    ----------
    matrix : (..., k, k) float

    Returns
    -------
    inverse : (..., k, k) float
    rank : (...) int
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-30))
    values, vectors = np.linalg.eigh(matrix / (scale[..., :, None] * scale[..., None, :]))
    kept = values > LEAST_EIGENVALUE * np.maximum(values[..., -1:], 1e-30)
    part = vectors / scale[..., :, None]
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=kept)
    return (part * inverse[..., None, :]) @ np.swapaxes(part, -1, -2), kept.sum(axis=-1)


def aircraft_factor(
    stats: Statistics,
    given: Conditional,
    columns: Integers,
    *,
    score: Floats | None = None,
    spent: int = 0,
) -> float:
    """Cluster factor of a per-aircraft candidate, pooled over aircraft (median), at least 1.

    Parameters
    ----------
    columns : (k,) int
    score : (A, D, k) float, optional
        By day; what is given leaves by default.
    spent : int
        As for :func:`cluster_factor`.
    """
    score = day_scores(given, columns) if score is None else score
    return float(_of_aircraft(stats, given, columns[None], score[:, :, None], spent)[0])


def aircraft_factors(stats: Statistics, given: Conditional, columns: Integers) -> Floats:
    """Cluster factors (N,) of per-aircraft candidates of these columns (N, k)."""
    each, where = np.unique(columns, return_inverse=True)
    score = day_scores(given, each)[:, :, where.reshape(columns.shape)]
    return _of_aircraft(stats, given, columns, score, 0)


def _of_aircraft(
    stats: Statistics, given: Conditional, columns: Integers, by_day: Floats, spent: int
) -> Floats:
    """Cluster factors (N,) from scores by day (A, D, N, k)."""
    own = _day_grams(stats, columns)
    information = given.gram[:, columns[:, :, None], columns[:, None]].swapaxes(0, 1)
    whole, left = np.einsum("nadii->na", own), np.einsum("naii->na", information)
    flown = (whole > 0) & (left > LEAST_LEFT * whole)
    score = by_day.transpose(2, 0, 1, 3)[flown]
    values = np.full((*flown.shape, len(BLOCKS)), np.nan)
    values[flown] = cluster_factor(own[flown], score, information[flown], spent=spent)
    middle = [_largest(each) for each in _median(values)]
    # none tells a factor, nearly all being explained: that of a fleet at the least
    nobody = np.where((whole > 0).any(axis=1), 1.5, 1.0)
    return np.where(flown.any(axis=1), middle, nobody)


def _median(values: Floats) -> Floats:
    """Median (N, b) of those of the values (N, A, b) that are finite; NaN of none.

    `numpy.nanmedian` goes through such arrays row by row in Python.
    """
    finite = np.isfinite(values)
    ordered = np.sort(np.where(finite, values, np.inf), axis=1)
    count = finite.sum(axis=1, keepdims=True)
    ends = [np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[1] - 1)]
    low, high = (np.take_along_axis(ordered, end, axis=1)[:, 0] for end in ends)
    return np.where(count[:, 0] > 0, 0.5 * (low + high), np.nan)


def fleet_factor(stats: Statistics, given: Conditional, columns: Integers) -> float:
    """Cluster factor of a fleet candidate: by day over all aircraft, at least 1.5."""
    return float(fleet_factors(stats, given, columns[None])[0])


def fleet_factors(stats: Statistics, given: Conditional, columns: Integers) -> Floats:
    """Cluster factors (N,) of fleet candidates of these columns (N, k)."""
    if columns.max() < stats.layout.core:
        own = fleet_day_grams(given, columns)
    else:
        own = _day_grams(stats, columns).sum(axis=1)
    information = given.fleet_gram[columns[:, :, None], columns[:, None]]
    each, where = np.unique(columns, return_inverse=True)
    score = fleet_day_scores(given, each)[:, where.reshape(columns.shape)]
    values = cluster_factor(own, score.swapaxes(0, 1), information)
    days = stats.days.size
    return np.array([max(1.5, _largest(_steadied(each, days))) for each in values])


def _steadied(values: Floats, days: int) -> Floats:
    """Factors of longer blocks drawn towards those of shorter ones as far as they are few.

    Of one fleet there are six weeks in 45 days: their scatter alone says little, and the largest of
    three such figures is too large.
    """
    out = values.copy()
    for i in range(1, out.size):
        own = days / BLOCKS[i] - 1
        if np.isfinite(out[i]) and np.isfinite(out[i - 1]):
            out[i] = (own * out[i] + PRIOR_BLOCKS * out[i - 1]) / (own + PRIOR_BLOCKS)
    return out


def _largest(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return max(1.0, float(finite.max())) if finite.size else 1.5


def _day_grams(stats: Statistics, columns: Integers) -> Floats:
    """X'X of columns (N, k) by aircraft and day (N, A, D, k, k).

    Dictionary columns share their week's by reports.
    """
    rows, along = columns[:, :, None], columns[:, None]
    if columns.max() < stats.layout.core:
        return np.moveaxis(stats.day_gram[:, :, rows, along].astype(float), 2, 0)
    own = np.moveaxis(stats.week_gram[:, :, rows, along].astype(float), 2, 0)
    return np.asarray(stats.day_share[:, :, None, None] * own[:, :, stats.week_of_day])
