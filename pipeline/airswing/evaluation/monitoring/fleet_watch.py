"""Test of a whole fleet, night by night: separates fleet-wide from single-aircraft changes.

The innovations that all aircraft have in common on a day are an error of the reference; each
aircraft is tested (:mod:`airswing.evaluation.monitoring.step_test`) after removal of the common
part, estimated from the *other* aircraft. The common part is a robust mean, shrunk towards the
level of the days before, and is tested like one more aircraft: its step is attributed to the
reference, as is a night on which half of a small fleet or more seem to step. The errors of a day
are estimated from the months before it. Radians; logarithms of the wind vector difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from airswing.compass.fit.kernel import group_sums
from airswing.evaluation.innovations import Floats, Ints
from airswing.evaluation.monitoring.step_test import Law, Noise, Step, StepTest

FEWEST = 5  # fewest aircraft of a day for a common part
FAR = 9.0  # squared distance from the common part at which an aircraft has half weight
_ROUNDS = 3  # iterations of the common part and of the weights of aircraft far from it
FEWEST_IN_BLOCK, FEWEST_BLOCKS = 7, 3
"""Fewest days of an aircraft in a block, and blocks; with fewer the default errors are used."""
BLOCK_DAYS = 21  # days over which a level is taken as constant when the errors are estimated
ENOUGH_ROWS, FEWEST_AIRCRAFT = 20_000, 20
"""Rows used to estimate the errors of a day, and the fewest aircraft among them."""
MONTH_BEFORE = 28
"""Days before a month from which its errors are estimated; with fewer, the month is used."""
LIKELY = 3.0
"""Log likelihood ratio above which another aircraft of a small fleet also seems to have stepped."""


def _of_compass(angles: list[float], scale: float = 0.0, winds: float = 0.0) -> Floats:
    """Values of the twelve unknowns: nine angles (degrees), airspeed scale, two winds (m/s)."""
    degrees = np.zeros(9)
    degrees[: len(angles)] = angles
    return np.concatenate([np.radians(degrees), [scale, winds, winds]])


@dataclass(frozen=True)
class Quantity:
    """A quantity to test, and the errors expected of it."""

    law: Law
    noise: Noise  # of a day, where there are too few days to estimate it
    common: Floats  # (p,): standard deviation of a day's common part


COMPASS = Quantity(
    Law(
        # an offset; A to C; A to E. A bias of the reference or the airspeed is no compass change.
        shapes=1.4
        * np.stack([_of_compass(s) for s in ([1.0], [1.0] * 3, [1.0, 1.0, 1.0, 0.5, 0.5])]),
        level=_of_compass([10.0, 10.0, 10.0, 5.0, 5.0, 1.0, 1.0, 0.5, 0.5], 0.05, 0.7),
        drift=_of_compass([0.13] * 9, 0.005, 0.15),
        farthest=30.0,
        threshold=7.0,
        student_from=4.0,
    ),
    Noise(4.0, _of_compass([0.2] * 9, 0.0, 0.5) ** 2),
    _of_compass([0.3] * 9, 0.005, 0.8),
)
"""Calibrated by ``python -m benchmarks.monitoring``."""
WIND = Quantity(
    # a step of 0.4 of the logarithm is a factor of 1.5
    Law(
        shapes=np.array([[0.4]]),
        level=np.array([1.0]),
        drift=np.array([0.07]),
        farthest=12.0,
        threshold=12.0,
    ),
    Noise(1.5, np.array([0.15**2])),
    np.array([0.15]),
)


@dataclass(frozen=True)
class Tested:
    """Result of a fleet's test."""

    alarms: list[Step]  # in order of the night; number -1: the fleet
    common: NDArray[np.float32]  # (row, p): common part removed from every row
    noise: dict[int, Noise]  # by month since 1970
    scale: Floats  # (aircraft,): error variance over that of the fleet, after the last day


def watch_fleet(
    aircraft: Ints,
    day: Ints,
    normal: NDArray[np.floating],
    right: NDArray[np.floating],
    quantity: Quantity,
    number: int,
) -> Tested:
    """Test one quantity of a fleet of ``number`` aircraft, night by night.

    ``normal`` (row, p, p) and ``right`` (row, p) are sums of an aircraft and day each.
    """
    law, sigma = quantity.law, quantity.common
    single = StepTest(law, quantity.noise, number)
    shared = StepTest(replace(law, level=3.0 * sigma), Noise(1.0, sigma**2), 1)
    result = Tested([], np.zeros(right.shape, np.float32), {}, np.ones(number))
    months = month_of(day)
    first = int(day.min(initial=0))
    for month in np.unique(months).tolist():
        begin, end = np.array([month, month + 1], "M8[M]").astype("M8[D]").astype(np.int64)
        past = day < (begin if begin - first >= MONTH_BEFORE else end)
        # large fleets are thinned by aircraft
        every = max(min(int(past.sum()) // ENOUGH_ROWS, number // FEWEST_AIRCRAFT), 1)
        past &= aircraft % every == 0
        sums = normal[past].astype(np.float64), right[past].astype(np.float64)
        single.noise = estimated_noise(*sums, aircraft[past], day[past], usual=quantity.noise)
        shared.noise = replace(shared.noise, persistence=single.noise.persistence)
        result.noise[month] = single.noise
        in_month = np.flatnonzero(months == month)
        order = in_month[np.argsort(day[in_month], kind="stable")]
        nights, start = np.unique(day[order], return_index=True)
        for night, rows in zip(nights.tolist(), np.split(order, start[1:]), strict=True):
            sums = normal[rows].astype(np.float64), right[rows].astype(np.float64)
            steps, result.common[rows] = _night(single, shared, sigma, night, aircraft[rows], *sums)
            result.alarms.extend(replace(step, night=night, reporting=rows.size) for step in steps)
    return replace(result, scale=single.scale(np.arange(number)))


def month_of(day: Ints) -> Ints:
    """Months since 1970 of days since then."""
    return day.astype("M8[D]").astype("M8[M]").astype(np.int64)


def _night(
    single: StepTest,
    shared: StepTest,
    sigma: Floats,
    night: int,
    craft: Ints,
    normal: Floats,
    right: Floats,
) -> tuple[list[Step], Floats]:
    """Process a day: its steps (number -1: the fleet), and the common part for each aircraft."""
    weight, right = single.noise.weights(normal, right)
    level = shared.level(np.array([0]))[0][0]
    without, total, shown = common_part(*single.innovation(craft, weight, right), level, sigma)
    single.add(night, craft, weight, right - np.einsum("nij,nj->ni", weight, without))
    fleet = np.arange(int(total.any()))
    shared.add(night, fleet, *shared.noise.weights(total[None], shown[None]))
    reference, steps = shared.steps(fleet), single.steps(craft)
    for step in reference:
        shared.restart(step)
    if steps and craft.size < 2 * FEWEST:
        likely = single.likely(craft, LIKELY)
        if len(likely) >= max(2.0, craft.size / 2.0):
            for step in likely:
                single.restart(step)
            strongest = max(likely, key=lambda step: step.statistic)
            return [replace(step, number=-1) for step in [*reference, strongest]], without
    for step in steps:
        single.restart(step)
    return [*(replace(step, number=-1) for step in reference), *steps], without


def common_part(
    weight: Floats, score: Floats, level: Floats, sigma: Floats
) -> tuple[Floats, Floats, Floats]:
    """Common innovation of a day, for each aircraft estimated from the others.

    ``weight`` (n, p, p) and ``score`` (n, p) are the innovations of the aircraft; ``level`` and
    ``sigma`` (p,) the common level of the days before and the standard deviation about it. Returns
    the common part (n, p) as all aircraft but one show it (the level with fewer than
    :data:`FEWEST`), and weight (p, p) and right side (p,) of the common part from all aircraft.
    """
    n, p = score.shape
    if n < FEWEST:
        return np.tile(level, (n, 1)), np.zeros((p, p)), np.zeros(p)
    precision = np.diag(sigma**-2.0)
    # a prior five times as wide, so that an aircraft's day is not shrunk to the level
    singles = np.linalg.solve(precision / 25.0 + weight, score[..., np.newaxis])[..., 0]
    middle = np.median(singles, axis=0)
    for _ in range(_ROUNDS):
        rest = score - weight @ middle
        inside = np.linalg.solve(precision / 25.0 + weight, rest[..., np.newaxis])[..., 0]
        distance = np.einsum("ni,ni->n", rest, inside)
        # a step of an aircraft must not change the common part
        share = FAR / (FAR + distance**2 / FAR)
        total = (share[:, np.newaxis, np.newaxis] * weight).sum(0)
        right = (share[:, np.newaxis] * score).sum(0)
        middle = np.linalg.solve(precision + total, right + precision @ level)
    without = precision + total - share[:, np.newaxis, np.newaxis] * weight
    remaining = right + precision @ level - share[:, np.newaxis] * score
    return np.linalg.solve(without, remaining[..., np.newaxis])[..., 0], total, right


def estimated_noise(
    normal: Floats, right: Floats, aircraft: Ints, day: Ints, *, usual: Noise
) -> Noise:
    """Errors of the days of a fleet, from their scatter about levels of three weeks.

    ``normal`` (row, p, p), ``right`` (row, p), ``aircraft`` and ``day`` (row,) as in
    :func:`watch_fleet`. ``usual`` is used with too few days; its components of equal size keep
    equal sizes.
    """
    # one number for both: days since 1970 have five digits
    block = aircraft * 100_000 + day // BLOCK_DAYS
    order = np.lexsort((day, block))
    first = np.unique(block[order], return_index=True)[1]
    groups = [rows for rows in np.split(order, first[1:]) if rows.size >= FEWEST_IN_BLOCK]
    if len(groups) < FEWEST_BLOCKS:
        return usual
    rest, inflation = np.zeros(right.shape), np.zeros(day.size)
    for rows in groups:
        # pseudo-inverse: a component without information stays zero
        level = np.linalg.pinv(normal[rows].sum(0), hermitian=True) @ right[rows].sum(0)
        rest[rows] = right[rows] - normal[rows] @ level
        inflation[rows] = rows.size / (rows.size - 1.0)
    rows = np.concatenate(groups)
    rest = _without_common(normal, rest, day, rows)
    sizes, moving = np.unique(usual.between[usual.between > 0]), usual.between > 0
    terms = [np.diagonal(normal[rows], axis1=1, axis2=2)[:, moving]]
    terms += [(normal[rows] ** 2 @ (usual.between == value))[:, moving] for value in sizes]
    squares = inflation[rows, np.newaxis] * rest[rows][:, moving] ** 2
    variances = _variances(np.stack(terms, axis=-1).reshape(-1, len(terms)), squares.ravel())
    between = np.zeros(usual.between.size)
    for value, variance in zip(sizes, variances[1:], strict=True):
        between[usual.between == value] = variance
    noise = Noise(float(variances[0]), between)
    return replace(noise, persistence=_persistence(noise, normal, rest, day, groups))


def _without_common(normal: Floats, rest: Floats, day: Ints, rows: Ints) -> Floats:
    """Residuals minus the common part of the rows of a day, scaled for its degrees of freedom."""
    _, place = np.unique(day[rows], return_inverse=True)
    number = np.bincount(place)
    total, right = (group_sums(sums[rows], place, number.size) for sums in (normal, rest))
    common = np.einsum("dij,dj->di", np.linalg.pinv(total, hermitian=True), right)
    few = number < 2 * FEWEST
    common[few] = 0.0
    residual = rest.copy()
    residual[rows] -= np.einsum("dij,dj->di", normal[rows], common[place])
    share = np.where(few, 1.0, number / np.maximum(number - 1.0, 1.0))
    residual[rows] *= np.sqrt(share[place])[:, np.newaxis]
    return residual


def _variances(terms: Floats, squares: Floats) -> Floats:
    """Non-negative variances s with E(squares) = terms s, large squares limited."""
    # Moments, not a likelihood: the days contain the steps and gross errors to be detected, and the
    # limit on each square reduces their effect.
    terms, squares = terms[terms[:, 0] > 0], squares[terms[:, 0] > 0]
    # the median of a chi-square of one degree of freedom is 0.455
    middle = float(np.median(squares / terms[:, 0]) / 0.455)
    variances = np.eye(terms.shape[1])[0] * middle
    for _ in range(8):
        expected = np.maximum(terms @ variances, 1e-30)
        # three standard deviations: the most that a step or a gross error contributes
        limited = np.minimum(squares, 9.0 * expected)
        variances = nnls(terms / expected[:, np.newaxis], limited / expected)[0]
        # the scatter within days is never zero, which would make weights infinite
        variances[0] = max(variances[0], 0.05 * middle)
    return np.asarray(variances, np.float64)


def _persistence(
    noise: Noise, normal: Floats, rest: Floats, day: Ints, groups: list[Ints]
) -> float:
    product = square = 0.0
    for rows in groups:
        weight, score = noise.weights(normal[rows], rest[rows])
        # a day may have no information on a component
        root = np.sqrt(np.maximum(np.diagonal(weight, axis1=1, axis2=2), 1e-30))
        z = np.clip(score / root, -3.0, 3.0)[:, noise.between > 0]
        next_day = np.diff(day[rows]) == 1
        # a level fitted to n days gives them an apparent correlation of -1/n
        product += float((z[1:] * z[:-1])[next_day].sum() + (z**2).sum() / rows.size)
        square += float((z[1:] ** 2)[next_day].sum())
    # a level that drifts looks like persistence
    return float(np.clip(product / max(square, 1e-30), 0.0, 0.8))
