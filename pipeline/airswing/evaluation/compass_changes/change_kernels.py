"""Kernels that find the day a compass changed, from daily sums of one aircraft's reports.

Assumes days are independent but for blocks of a few neighbours, and that a change acts from one
day to the next on A, B and C of the deviation (a recalibrated flux valve, a unit exchanged). A
day's model error, common to its reports, is a random bias of the reference wind with its own two
columns; it is eliminated day by day, so the along-track errors, which no compass touches, tell it
from the compass. Whether there is a change: the largest score statistic over dates (Andrews 1993,
Econometrica 61, 821-856), judged by permuting blocks of days over the whole fleet at once, so the
probability of any false alarm in the fleet is what it says (Westfall & Young 1993); changes beyond
doubt are taken out of what is permuted, so that they do not pass for noise. When it was:
the dates the likelihood ratio does not reject (Bai 1997, Rev. Econ. Stat. 79, 551-563; Eo &
Morley 2015, Quant. Econ. 6, 463-497), the errors' variance as the days show it.

Radians and m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.reference_comparison.pairs import paired_design

Floats = NDArray[np.float64]

ANGLES = 5  # A, B, C, D, E
# A to E, sine and cosine of a third and a fourth harmonic, and the airspeed scale come before the
# day's own bias b_u, b_v
FREE = 10
CHANGING = 3  # A, B, C may change
# Report's error variance over the variance of a day's model bias, a component.
DAY_BIAS_PRECISION = 2.0
# As that, of a flight's bias: errors of a flight's reports correlated by a half.
FLIGHT_BIAS_PRECISION = 1.0
# Robust standard deviations beyond which a report is left out.
_CUT = 8.0
# -2 ln(1 - sqrt(0.95)): 95 % point of the likelihood ratio of a date (Eo & Morley 2015).
LIKELIHOOD_RATIO_95 = 7.35
# Days of all orders that are worked at once: their sums stay in a core's own cache.
_TOGETHER = 32_768


@dataclass(frozen=True)
class DaySums:
    """What the days of one aircraft know of its deviation, the days' own biases eliminated."""

    day: NDArray[np.int64]  # (d,): days with reports, increasing
    normal: Floats  # (d, 10, 10): of A to E, two higher harmonics and the airspeed scale
    right: Floats  # (d, 10)
    count: Floats  # (d,): reports

    def take(self, chosen: NDArray[np.bool_]) -> DaySums:
        """Some of the days."""
        return DaySums(
            self.day[chosen], self.normal[chosen], self.right[chosen], self.count[chosen]
        )


def day_sums(
    magnetic: Floats,
    heading: Floats,
    airspeed: Floats,
    cross: Floats,
    along: Floats,
    day: NDArray[np.int64],
    *,
    flight: NDArray[np.int64] | None = None,
) -> DaySums:
    """Sum one aircraft's reports by day.

    Parameters
    ----------
    magnetic, heading : array, shape (n,), radians
        Argument of the deviation and indicated true heading.
    airspeed : array, shape (n,), m/s
    cross, along : array, shape (n,), m/s
        Airspeed times heading error, and airspeed error.
    day : array of int, shape (n,)
    flight : array of int, shape (n,), optional
        Eliminate each flight's own bias of the reference; the days' biases b_u, b_v (m/s) are then
        unknowns too.
    """
    rows_cross, rows_along = design_of_days(magnetic, heading, airspeed)
    kept = np.flatnonzero(_not_gross(rows_cross, rows_along, cross, along))
    flown = np.zeros_like(day) if flight is None else flight
    order = kept[np.lexsort((flown[kept], day[kept]))]
    # a flight past midnight is one of each day
    new = (np.diff(day[order]) != 0) | (np.diff(flown[order]) != 0)
    start = np.flatnonzero(np.append(True, new))
    one, two = rows_cross[order], rows_along[order]
    normal, right = _sums_from(one, two, cross[order], along[order], start)
    days, first, count = np.unique(day[order], return_index=True, return_counts=True)
    if flight is None:
        sums = without_day_bias(normal, right)
    else:
        freed = without_flight_bias(normal, right)
        whole = np.searchsorted(start, first)
        sums = np.add.reduceat(freed[0], whole), np.add.reduceat(freed[1], whole)
    return DaySums(days.astype(np.int64), *sums, count.astype(np.float64))


def design_of_days(magnetic: Floats, heading: Floats, airspeed: Floats) -> tuple[Floats, Floats]:
    """As ``paired_design``, with a third and a fourth harmonic of the deviation after A to E.

    Parameters
    ----------
    magnetic, heading : array, shape (n,), radians
    airspeed : array, shape (n,), m/s

    Returns
    -------
    cross, along : array, shape (n, 12)
        sin 3m, cos 3m, sin 4m, cos 4m of the magnetic heading m are columns 5 to 8, radians.
    """
    cross, along = paired_design(magnetic, heading, airspeed)
    # what A to E leave of a curve looks like a change where an aircraft turns to other headings
    waves = [wave(k * magnetic) for k in (3, 4) for wave in (np.sin, np.cos)]
    place = [ANGLES] * len(waves)
    higher = airspeed[:, np.newaxis] * np.column_stack(waves)
    return np.insert(cross, place, higher, axis=1), np.insert(along, place, 0.0, axis=1)


def _sums_from(
    one: Floats, two: Floats, cross: Floats, along: Floats, start: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Normal matrices and right sides of the rows from each start to the next."""
    size = one.shape[1]
    normal, right = np.empty((start.size, size, size)), np.empty((start.size, size))
    # by pairs of columns: no loop over flights, and no matrix a report
    for i in range(size):
        right[:, i] = np.add.reduceat(one[:, i] * cross + two[:, i] * along, start)
        for j in range(i, size):
            products = one[:, i] * one[:, j] + two[:, i] * two[:, j]
            normal[:, i, j] = normal[:, j, i] = np.add.reduceat(products, start)
    return normal, right


def without_flight_bias(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Eliminate each flight's own bias of the reference, a random effect beside its day's b_u, b_v.

    Parameters
    ----------
    normal, right : array, shape (..., p, p) and (..., p)
        Of a flight each; b_u, b_v come last.

    Returns
    -------
    normal, right : array, shape (..., p, p) and (..., p)
    """
    side = normal[..., -2:]
    inside = side[..., -2:, :] + FLIGHT_BIAS_PRECISION * np.eye(2)
    gain = np.swapaxes(np.linalg.solve(inside, np.swapaxes(side, -1, -2)), -1, -2)
    return (
        normal - gain @ np.swapaxes(side, -1, -2),
        right - np.einsum("...ij,...j->...i", gain, right[..., -2:]),
    )


def _not_gross(
    rows_cross: Floats, rows_along: Floats, cross: Floats, along: Floats
) -> NDArray[np.bool_]:
    """Reports within a wide robust limit of a first fit."""
    keep = np.isfinite(cross + along)
    for _ in range(2):
        # nothing is copied before anything is gross
        one, two = (rows if keep.all() else rows[keep] for rows in (rows_cross, rows_along))
        theta = np.linalg.pinv(one.T @ one + two.T @ two, hermitian=True) @ (
            one.T @ cross[keep] + two.T @ along[keep]
        )
        left = np.hypot(cross - rows_cross @ theta, along - rows_along @ theta)
        # Median of a Rayleigh variable is 1.177 times its parameter.
        keep = left < _CUT * np.nanmedian(left[keep]) / 1.177
    return np.asarray(keep)


def without_day_bias(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Eliminate the day's bias b_u, b_v, a random effect.

    Parameters
    ----------
    normal, right : array, shape (d, 12, 12) and (d, 12)
        Of :func:`design_of_days`, a day each.

    Returns
    -------
    normal, right : array, shape (d, 10, 10) and (d, 10)
    """
    side = normal[:, :FREE, FREE:]
    inside = normal[:, FREE:, FREE:] + DAY_BIAS_PRECISION * np.eye(normal.shape[1] - FREE)
    gain = np.swapaxes(np.linalg.solve(inside, np.swapaxes(side, 1, 2)), 1, 2)
    return (
        normal[:, :FREE, :FREE] - gain @ np.swapaxes(side, 1, 2),
        right[:, :FREE] - np.einsum("dij,dj->di", gain, right[:, FREE:]),
    )


def coefficients(sums: DaySums, weight: Floats | None = None) -> tuple[Floats, Floats]:
    """Fit the ten coefficients and their covariance clustered by day.

    Parameters
    ----------
    weight : array, shape (d, q), optional
        Adds a change of A, B, C for each column: 1 on the days it acts.

    Returns
    -------
    values : array, shape (10 + 3 q,)
    covariance : array, shape (10 + 3 q, 10 + 3 q)
    """
    normal, right = _stacked(sums, weight)
    # pseudo-inverse: what no report of these tells stays at zero and takes part in nothing
    inverse = np.linalg.pinv(normal.sum(0), hermitian=True)
    values = inverse @ right.sum(0)
    score = right - np.einsum("dij,j->di", normal, values)
    days = sums.day.size
    factor = days / max(days - values.size / 2.0, 1.0)
    influence = score @ inverse
    return values, np.asarray(factor * influence.T @ influence)


def _stacked(sums: DaySums, weight: Floats | None) -> tuple[Floats, Floats]:
    """Normal matrices with the changes' columns beside the ten."""
    if weight is None or weight.shape[1] == 0:
        return sums.normal, sums.right
    select = np.zeros((sums.day.size, FREE, FREE + CHANGING * weight.shape[1]))
    select[:, np.arange(FREE), np.arange(FREE)] = 1.0
    for q in range(weight.shape[1]):
        for c in range(CHANGING):
            select[:, c, FREE + CHANGING * q + c] = weight[:, q]
    turned = np.swapaxes(select, 1, 2)
    return turned @ sums.normal @ select, np.einsum("dij,dj->di", turned, sums.right)


def scores(sums: DaySums) -> tuple[Floats, Floats]:
    """Efficient daily scores of A, B and C under no change, and the days' share of information.

    Returns
    -------
    score : array, shape (d, 3)
    share : array, shape (d,)
        Adds up to one.
    """
    total = sums.normal.sum(0)
    # pseudo-inverse: what no report of these tells stays at zero and takes part in nothing
    values = np.linalg.pinv(total, hermitian=True) @ sums.right.sum(0)
    left = sums.right - np.einsum("dij,j->di", sums.normal, values)
    other = slice(CHANGING, FREE)
    gain = total[:CHANGING, other] @ np.linalg.pinv(total[other, other], hermitian=True)
    score = left[:, :CHANGING] - left[:, other] @ gain.T
    block = total[:CHANGING, :CHANGING] - gain @ total[other, :CHANGING]
    inverse = np.linalg.pinv(block, hermitian=True)
    share = np.einsum("dij,ji->d", sums.normal[:, :CHANGING, :CHANGING], inverse)
    return score, share / share.sum()


def largest_statistic(
    score: Floats, share: Floats, order: NDArray[np.int64], *, trim: float, fewest: int
) -> Floats:
    """Largest score statistic over dates, for the days in given orders.

    Parameters
    ----------
    score : array, shape (d, 3)
    share : array, shape (d,)
    order : array of int, shape (draws, d)
    trim : float
        Share of the information that must lie on either side.
    fewest : int
        Days that must lie on either side.

    Returns
    -------
    array, shape (draws,)
        Of chi-square kind with three degrees of freedom at each date.
    """
    values, vectors = np.linalg.eigh(score.T @ score)
    # a coefficient that the headings flown cannot tell has no direction of its own
    good = values > values[-1] * 1e-10
    white = score @ (vectors[:, good] / np.sqrt(values[good]))
    some = np.array_split(order, max(1, order.size // _TOGETHER))
    best = np.concatenate(
        [_path(white, share, own, trim=trim, fewest=fewest).max(axis=1) for own in some]
    )
    # Score to Wald: what a change adds to the errors' variance is taken off.
    return np.asarray(best / np.maximum(1.0 - best / score.shape[0], 1e-3))


def _path(
    white: Floats, share: Floats, order: NDArray[np.int64], *, trim: float, fewest: int
) -> Floats:
    """Statistic at every date between two days, -1 where none is tried, (draws, d - 1)."""
    part = np.cumsum(share[order], axis=1)[:, :-1]
    statistic = np.zeros_like(part)
    # column by column: sums that step over three of them take twice as long
    for own in white.T:
        moved = np.cumsum(own[order], axis=1)[:, :-1] - part * own.sum()
        statistic += moved**2
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic /= part * (1.0 - part)
    number = np.arange(1, white.shape[0])
    tried = (number >= fewest) & (number <= white.shape[0] - fewest)
    tried = tried & (part >= trim) & (part <= 1.0 - trim)
    return np.asarray(np.where(tried, statistic, -1.0))


def without_changes(score: Floats, share: Floats, *, most: int, trim: float, fewest: int) -> Floats:
    """Scores with the most likely changes taken out: what chance alone makes of the days.

    Parameters
    ----------
    score : array, shape (d, 3)
    share : array, shape (d,)
    most : int
        Changes taken out, one after the other.
    trim, fewest
        As for :func:`largest_statistic`.

    Returns
    -------
    array, shape (d, 3)
    """
    order = np.arange(score.shape[0])[np.newaxis]
    edges, left = [0, score.shape[0]], score
    for _ in range(most):
        values, vectors = np.linalg.eigh(left.T @ left)
        # coefficients that a heading flown all day cannot tell apart leave a direction without
        # scatter: its rounding must not be blown up to the size of the others
        white = left @ (vectors / np.sqrt(np.maximum(values, values[-1] * 1e-10)))
        path = _path(white, share, order, trim=trim, fewest=fewest)[0]
        edges = sorted({*edges, int(np.argmax(path)) + 1})
        left = score.copy()
        for begin, end in pairwise(edges):
            mean = score[begin:end].sum(0) / share[begin:end].sum()
            left[begin:end] -= share[begin:end, np.newaxis] * mean
    return left


def block_orders(days: int, *, block: int, draws: int, rng: np.random.Generator) -> Floats:
    """Sort keys that permute days in blocks, the same for every aircraft.

    Parameters
    ----------
    block : int
        Days that stay together.

    Returns
    -------
    array, shape (draws, days)
        Days taken in the order of their keys are permuted block by block, from a random first
        edge.
    """
    keys = np.empty((draws, days))
    number = np.arange(days)
    for k in range(draws):
        piece = (number + rng.integers(block)) // block
        # days of a block share its key: the little more keeps them in their order
        keys[k] = rng.random(int(piece[-1]) + 1)[piece] + number * 1e-9
    return keys


def orders_of(days: NDArray[np.int64], every: NDArray[np.int64]) -> NDArray[np.int64]:
    """Orders of some days, from those of all: nothing is sorted again for each aircraft.

    Parameters
    ----------
    days : array of int, shape (d,)
        In order; a day in which a month ends may stand twice, and is one block with itself.
    every : array of int, shape (draws, n)
        Orders of the days 0 to n - 1.

    Returns
    -------
    array of int, shape (draws, d)
        Places in ``days``.
    """
    first = np.flatnonzero(np.diff(days, prepend=-1))
    place = np.full(every.shape[1], -1)
    place[days[first]] = first
    found = place[every]
    found = found[found >= 0]
    if first.size < days.size:
        many = np.ones(days.size, np.int64)
        many[first] = np.diff(first, append=days.size)
        found = np.repeat(found, many[found])
    found = found.reshape(every.shape[0], days.size)
    if first.size < days.size:
        found[:, 1:] += found[:, 1:] == found[:, :-1]
    return found


def date_of_change(
    sums: DaySums, *, fewest: int
) -> tuple[int, tuple[int, int], Floats, Floats, float]:
    """Most likely date of one change, its interval and its size.

    Parameters
    ----------
    fewest : int
        Days on either side.

    Returns
    -------
    first : int
        First day of the new compass.
    interval : tuple of int
        95 %: earliest and latest such day.
    change : array, shape (3,)
        Of A, B, C, radians.
    covariance : array, shape (3, 3)
    statistic : float
        Likelihood ratio over no change, of chi-square kind.
    """
    # pseudo-inverse: what no report of these tells stays at zero and takes part in nothing
    total = np.linalg.pinv(sums.normal.sum(0), hermitian=True)
    left = sums.right - np.einsum("dij,j->di", sums.normal, total @ sums.right.sum(0))
    splits = np.arange(fewest, sums.day.size - fewest + 1)
    normal = np.cumsum(sums.normal, axis=0)[splits - 1]
    score = np.cumsum(left, axis=0)[splits - 1][:, :CHANGING]
    one = normal[:, :CHANGING, :CHANGING]
    block = one - normal[:, :CHANGING] @ total @ np.swapaxes(normal[:, :CHANGING], 1, 2)
    gain = np.einsum("si,sij,sj->s", score, np.linalg.pinv(block, hermitian=True), score)
    best = int(np.argmax(gain))
    after = (np.arange(sums.day.size) >= splits[best])[:, np.newaxis] * 1.0
    values, covariance = coefficients(sums, after)
    change, wide = values[FREE:], covariance[FREE:, FREE:]
    # How much more the days vary than independent reports would: errors' variance per unit.
    excess = float(np.trace(wide @ block[best]) / CHANGING)
    ratio = gain / excess
    inside = splits[ratio >= ratio[best] - LIKELIHOOD_RATIO_95]
    # The change fell after the last day of the old compass.
    low = sums.day[inside[0] - 1] + 1
    return (
        int(sums.day[splits[best]]),
        (int(low), int(sums.day[inside[-1]])),
        change,
        wide,
        float(ratio[best]),
    )
