"""What all aircraft of a day have alike, and how large the errors of a day are.

Assumes that most aircraft of a day are as they were: the common part is a robust mean of what the
day tells beyond each aircraft's own level (from the median on, aircraft far from it count the less
the farther they are), drawn towards the common level of the days before. Each aircraft is freed of
the common part that the others tell. Fewer aircraft than :data:`FEWEST` tell none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from airswing.evaluation.monitoring.sequential_test import Floats, Index, Noise

FEWEST = 5
"""Aircraft of a day that have a common part."""
FAR = 9.0
"""Squared distance from the common part at which an aircraft counts half."""
# The common part, and how little aircraft far from it count, in turn.
ROUNDS = 3
# Days of an aircraft in a block, and such blocks: of fewer the usual errors stand.
FEWEST_IN_BLOCK, FEWEST_BLOCKS = 7, 3
BLOCK_DAYS = 21
"""Days over which a level is taken to stand still when the errors are estimated."""


@dataclass(frozen=True)
class Common:
    """The common part of a day."""

    without: Floats  # (n, p): as the other aircraft tell it
    # weight, right: (p, p) and (p,): what all tell, for a level of its own
    weight: Floats
    right: Floats


def common_part(weight: Floats, score: Floats, level: Floats, prior: Floats) -> Common:
    """Common part of a day.

    Parameters
    ----------
    weight, score : array, shape (n, p, p) and (n, p)
        What the day tells beyond each aircraft's level.
    level : array, shape (p,)
        Common level of the days before.
    prior : array, shape (p,)
        Standard deviation of the common part about it.
    """
    n, p = score.shape
    if n < FEWEST:
        return Common(np.tile(level, (n, 1)), np.zeros((p, p)), np.zeros(p))
    precision = np.diag(prior**-2.0)
    # five times the prior's width: an aircraft's own day must not be drawn to the level
    own = np.linalg.solve(precision / 25.0 + weight, score[..., np.newaxis])[..., 0]
    middle = np.median(own, axis=0)
    for _ in range(ROUNDS):
        left = score - weight @ middle
        inside = np.linalg.solve(precision / 25.0 + weight, left[..., np.newaxis])[..., 0]
        distance = np.einsum("ni,ni->n", left, inside)
        # heavy tails: an aircraft that stepped itself must not move the level of all
        share = FAR / (FAR + distance**2 / FAR)
        total = (share[:, np.newaxis, np.newaxis] * weight).sum(0)
        told = (share[:, np.newaxis] * score).sum(0)
        middle = np.linalg.solve(precision + total, told + precision @ level)
    others = precision + total - share[:, np.newaxis, np.newaxis] * weight
    right = told + precision @ level - share[:, np.newaxis] * score
    without = np.linalg.solve(others, right[..., np.newaxis])[..., 0]
    return Common(without, total, told)


def estimated_noise(
    normal: Floats, right: Floats, aircraft: Index, day: Index, *, usual: Noise
) -> Noise:
    """Errors of the days of a fleet, from how its days scatter about three weeks' levels.

    What all aircraft of a day have alike is taken off first.

    Parameters
    ----------
    normal, right : array, shape (rows, p, p) and (rows, p)
        Sums of an aircraft's day each.
    aircraft, day : array of int, shape (rows,)
    usual : Noise
        Taken where there are too few days; components of one size there are of one size here.
    """
    # one number for both: days since 1970 have five digits
    block = aircraft * 100_000 + day // BLOCK_DAYS
    order = np.lexsort((day, block))
    first = np.unique(block[order], return_index=True)[1]
    groups = [own for own in np.split(order, first[1:]) if own.size >= FEWEST_IN_BLOCK]
    if len(groups) < FEWEST_BLOCKS:
        return usual
    left, inflation = np.zeros(right.shape), np.zeros(day.size)
    for own in groups:
        total, told = normal[own].sum(0), right[own].sum(0)
        # pseudo-inverse: what no report of these tells stays at zero and takes part in nothing
        left[own] = right[own] - normal[own] @ (np.linalg.pinv(total, hermitian=True) @ told)
        inflation[own] = own.size / (own.size - 1.0)
    rows = np.concatenate(groups)
    left = _without_common(normal, left, day, rows)
    sizes = np.unique(usual.between[usual.between > 0])
    moving = usual.between > 0
    terms = [np.diagonal(normal[rows], axis1=1, axis2=2)[:, moving]]
    terms += [(normal[rows] ** 2 @ (usual.between == size))[:, moving] for size in sizes]
    squares = inflation[rows, np.newaxis] * left[rows][:, moving] ** 2
    found = _sizes(np.stack(terms, axis=-1).reshape(-1, len(terms)), squares.ravel())
    between = np.zeros(usual.between.size)
    for size, value in zip(sizes, found[1:], strict=True):
        between[usual.between == size] = value
    noise = Noise(float(found[0]), between)
    return Noise(float(found[0]), between, _persistence(noise, normal, left, day, groups))


def _without_common(normal: Floats, left: Floats, day: Index, rows: Index) -> Floats:
    """Rest of every row less what the rows of its day have alike, with the freedom it took."""
    _, place = np.unique(day[rows], return_inverse=True)
    number = np.bincount(place)
    total = np.zeros((number.size, *normal.shape[1:]))
    told = np.zeros((number.size, left.shape[1]))
    np.add.at(total, place, normal[rows])
    np.add.at(told, place, left[rows])
    common = np.einsum("dij,dj->di", np.linalg.pinv(total, hermitian=True), told)
    common[number < 2 * FEWEST] = 0.0
    found = left.copy()
    found[rows] -= np.einsum("dij,dj->di", normal[rows], common[place])
    share = np.where(number < 2 * FEWEST, 1.0, number / np.maximum(number - 1.0, 1.0))
    found[rows] *= np.sqrt(share[place])[:, np.newaxis]
    return found


def _sizes(terms: Floats, squares: Floats) -> Floats:
    """Sizes s >= 0 with squares = terms s, gross ones held; terms' first is never without size."""
    # Moments, not a likelihood as in the fits: the days looked at hold the very steps and gross
    # days that are watched for, and a bound on each square is all that keeps them out.
    terms, squares = terms[terms[:, 0] > 0], squares[terms[:, 0] > 0]
    # the median of a chi-square of one degree of freedom is 0.455
    middle = float(np.median(squares / terms[:, 0]) / 0.455)
    size = np.eye(terms.shape[1])[0] * middle
    for _ in range(8):
        # sizes may come out as nil, and the next round divides by them
        expected = np.maximum(terms @ size, 1e-30)
        # three standard deviations: a step or a gross day counts as that much
        held = np.minimum(squares, 9.0 * expected)
        size = nnls(terms / expected[:, np.newaxis], held / expected)[0]
        # the scatter within days is never nothing: weights would be without bound
        size[0] = max(size[0], 0.05 * middle)
    return np.asarray(size, np.float64)


def _persistence(
    noise: Noise, normal: Floats, left: Floats, day: Index, groups: list[Index]
) -> float:
    """Correlation of an aircraft's days with its next, of what is left of them."""
    product = square = 0.0
    for own in groups:
        weight, score = noise.weights(normal[own], left[own])
        # a day may tell nothing of a parameter
        root = np.sqrt(np.maximum(np.diagonal(weight, axis1=1, axis2=2), 1e-30))
        z = np.clip(score / root, -3.0, 3.0)[:, noise.between > 0]
        next_day = np.diff(day[own]) == 1
        # a level fitted to the block makes the days of n look -1/n correlated
        product += float((z[1:] * z[:-1])[next_day].sum() + (z**2).sum() / own.size)
        square += float((z[1:] ** 2)[next_day].sum())
    # a level that drifts looks like persistence
    return float(np.clip(product / max(square, 1e-30), 0.0, 0.8))
