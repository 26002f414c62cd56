"""How much more scores scatter from day to day and week to week than the noise model says.

Assumptions: the noise model whitens along flights and takes off what flights of a day share; what
remains is correlated within days and over some days, in an aircraft and across the fleet. The
factor is the scatter of block sums (one day, three days, a week) about a unit's own fit over what
independent errors would give; per aircraft it is pooled by the median over aircraft, for fleet-wide
columns the blocks hold all aircraft.

Validity: four blocks and more; at least 1 per aircraft and 1.5 for the fleet.

Source: two-way clustering after Cameron, Gelbach & Miller (2011); GAP.md sections 2 and 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.measure import Conditional
from airswing.gap.statistics import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def cluster_factor(
    gram_by_day: Floats,
    score_by_day: Floats,
    information: Floats,
    *,
    blocks: tuple[int, ...] = (1, 3, 7),
) -> Floats:
    """Scatter of block scores about a unit's own fit, relative to the information.

    Parameters
    ----------
    gram_by_day : (D, k, k) float
        X'X by day; its sum is about ``information``.
    score_by_day : (D, k) float
    information : (k, k) float
    blocks : tuple of int
        Lengths of the blocks, days.

    Returns
    -------
    (len(blocks),) float
        Mean squared scatter per degree of freedom; NaN for fewer than four blocks.
    """
    days, k = score_by_day.shape
    spread, rank = _truncated_inverse(information)
    k = max(rank, 1)
    fit = spread @ score_by_day.sum(axis=0)
    share = gram_by_day.sum(axis=0)
    ratio = float(np.trace(information) / max(float(np.trace(share)), 1e-30))
    remains = score_by_day - ratio * gram_by_day @ fit
    out = np.full(len(blocks), np.nan)
    for i, length in enumerate(blocks):
        edges = np.arange(0, days, length)
        if edges.size < 4:
            continue
        sums = np.add.reduceat(remains, edges, axis=0)
        active = np.any(np.add.reduceat(gram_by_day, edges, axis=0), axis=(1, 2)).sum()
        degrees = k * max(active - 1, 1) / max(active, 1)
        out[i] = float(np.einsum("di,ij,dj->", sums, spread, sums)) / degrees
    return out


def _truncated_inverse(matrix: Floats, *, bound: float = 1e-3) -> tuple[Floats, int]:
    """Inverse of a symmetric matrix on the directions that carry information, and their number."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-30))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    kept = values > bound * max(float(values[-1]), 1e-30)
    part = vectors[:, kept] / scale[:, None]
    return (part / values[kept]) @ part.T, int(kept.sum())


def aircraft_factor(stats: Statistics, given: Conditional, columns: Integers) -> float:
    """Cluster factor of a per-aircraft candidate, pooled over aircraft (median), at least 1."""
    values = []
    for a in range(len(stats.tails)):
        own = _day_grams(stats, a, columns)
        information = given.gram[a][np.ix_(columns, columns)]
        if np.trace(own.sum(axis=0)) <= 0:
            continue
        values.append(cluster_factor(own, given.score[a][:, columns], information))
    if not values:
        return 1.0
    columns_of = np.array(values).T
    known = [c[np.isfinite(c)] for c in columns_of]
    return _largest(np.array([np.median(c) for c in known if c.size]))


def fleet_factor(stats: Statistics, given: Conditional, columns: Integers) -> float:
    """Cluster factor of a fleet candidate: by day over all aircraft, at least 1.5."""
    own = sum(_day_grams(stats, a, columns) for a in range(len(stats.tails)))
    information = given.fleet_gram[np.ix_(columns, columns)]
    values = cluster_factor(np.asarray(own), given.fleet_score[:, columns], information)
    return max(1.5, _largest(values))


def _largest(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return max(1.0, float(finite.max())) if finite.size else 1.5


def _day_grams(stats: Statistics, aircraft: int, columns: Integers) -> Floats:
    """X'X by day (D, k, k); dictionary columns take the week's, shared out by reports."""
    if columns.max() < stats.layout.core:
        return np.asarray(stats.day_gram[aircraft][:, columns][:, :, columns], float)
    week = stats.week_of_day
    count = stats.day_count[aircraft]
    total = np.bincount(week, count, minlength=stats.weeks.size)[week]
    share = np.divide(count, total, out=np.zeros_like(count), where=total > 0)
    own = stats.week_gram[aircraft][:, columns][:, :, columns].astype(float)
    return np.asarray(share[:, None, None] * own[week])
