"""Sums for the deviation fit of one aircraft: numpy only, one pass over the reports a step.

Assumptions
-----------
The reference wind is the true wind plus a bias b and noise; the unit's airspeed is (1 + s) times
the true one; the indicated heading psi is the true one plus the deviation
delta(m) = A + g (B sin m + C cos m) + D sin 2m + E cos 2m, m the abscissa (indicated magnetic
heading) and g the aircraft's mean horizontal field over the field at the report: hard iron and
vertical soft iron turn a compass the more, the weaker the field that holds it. So the air vector
the reference implies is, exactly,

    V'_A = V (1 - s) h(psi - delta(m)) - b + noise,

h(x) = (sin x, cos x) in (east, north). The noise is added to V'_A and does not touch psi, m or V,
so least squares on this vector equation has no bias whatever the size of delta: neither the sine's
curvature nor |V'_A| against |V_A| enters. Resolved along and across the fitted true heading the
two rows are those of the joint method (cross: A..E and b; along: s and b) and each gets a scatter
of its own. Noise of the ground vector is common to V_A and V'_A and drops out but for
delta times noise.

Steps are Gauss-Newton with Tukey weights of the standardised vector residual, so gross errors of
the wind (flipped signs, wrong units) weigh nothing at all. Valid for |delta| below about 45
degrees. Radians and metres per second; single precision inside a block, double in the sums.

References
----------
Jacobs et al. 2010 (seed paper) eq. 3; Archibald Smith coefficients: NGA Handbook of Magnetic
Compass Adjustment; Maronna, Martin & Yohai, Robust Statistics (2006), ch. 6 (bivariate bisquare).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, starmap

import numpy as np

from airswing.compass.fit.observations import (
    Array,
    Index,
    Observations,
    Reports,
    Single,
)
from airswing.compass.fit.row_blocks import BLOCK, Rows, fill, rows_for
from airswing.compass.fleet.flight_segments import ROWS, SLOPES

COMPASS = 5
"""A, B, C, D, E come first in every parameter vector, then s, then b_u, b_v a reference."""
# Of one reference: beside the compass s, b_u and b_v.
LOCAL = COMPASS + 3
# Tukey's constants: 95 % efficiency for a normal vector (2-D) and scalar residual.
CUT_2D, CUT_1D = 5.0, 4.685
MEDIAN_CHI2 = 0.4549  # median of the square of a standard normal variable

# A to E of what a block holds: 1, g sin m, g cos m, sin m cos m and sin2 m.
_BASIS = np.array(
    [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 2, 0], [1, 0, 0, 0, -2.0]]
)
# Every parameter of a block's rows: across; along; of its scores, along and across together.
_CROSS, _ALONG, _SCORE = np.zeros((LOCAL, 7)), np.zeros((LOCAL, 3)), np.zeros((LOCAL, LOCAL))
_CROSS[:COMPASS, :COMPASS] = _BASIS
_CROSS[[6, 7], [6, 5]] = 1.0, -1.0
_ALONG[[5, 6, 7], [0, 1, 2]] = 1.0
_SCORE[:, :7] = _CROSS
_SCORE[COMPASS, 7] = 1.0


@dataclass(frozen=True)
class Scatter:
    """Variance of the residual's components, m2/s2: ``part`` of the known one plus a constant."""

    along: float
    cross: float
    part: float


@dataclass
class PassSums:
    """What one pass leaves: normal matrix, score, score by flight and the robust averages."""

    normal: Array
    score: Array
    flight_score: Array
    flight_normal: Array | None
    weight: float = 0.0
    slope: float = 0.0
    before2: float = 0.0
    after2: float = 0.0
    block: Array | None = None
    square: float = 0.0
    scatter: Scatter | None = None


def accumulate(
    obs: Observations | Reports,
    theta: Array,
    scatter: Scatter | None,
    flights: int,
    *,
    joint: bool,
    parted: bool = True,
    by_flight: bool = False,
    starts: Index | None = None,
) -> PassSums:
    """Run once over the reports: weighted normal equations at ``theta``.

    Parameters
    ----------
    obs : Observations or Reports
        Sorted by flight; reports are made ready a block at a time.
    theta : array, shape (8,)
        A, B, C, D, E (radians), s, b_u, b_v (m/s).
    scatter : Scatter, optional
        By default what the reports of the first block show at ``theta`` (`_robust_scatter`).
    flights : int
        Number of the aircraft's flights; 0 for no sums by flight.
    joint : bool
        False: the cross-track row alone, without s and b.
    parted : bool
        As for `_robust_scatter`.
    by_flight : bool
        Keep the normal matrix of every flight too (needed where flights are few).
    starts : array of int, optional
        First report of every block whose sums are kept too
        (:mod:`airswing.compass.fleet.flight_segments`).
    """
    sums = PassSums(np.zeros((LOCAL, LOCAL)), np.zeros(LOCAL), np.zeros((flights, LOCAL)), None)
    apart = (np.zeros((flights, 7, 7)), np.zeros((flights, 3, 3))) if by_flight else None
    if starts is not None:
        sums.block = np.zeros((ROWS, starts.size))
    cross, along = np.zeros((8, 8)), np.zeros((4, 4))
    # Blocks of one length, as many as need be: the last is not a scrap.
    length = -(-obs.size // max(-(-obs.size // BLOCK), 1))
    begins = np.arange(0, obs.size, max(length, 1))
    opens = obs.opens if flights else np.zeros(0, dtype=np.int64)
    own, runs = np.zeros((LOCAL, opens.size)), _runs(opens, begins, length)
    cuts = None if starts is None else _runs(starts, begins, length)
    for k, begin in enumerate(begins.tolist()):
        rows = rows_for(min(length, obs.size - begin))
        part = obs.take(slice(begin, begin + length), rows.obs)
        place, first = runs[k]
        fill(part, theta, joint, rows)
        if scatter is None:
            scatter = _robust_scatter(rows.along[0], rows.cross[7], part.variance, parted=parted)
        _weigh(part, scatter, joint, rows, sums)
        np.multiply(rows.cross, rows.weight[0], out=rows.weighted_cross)
        np.multiply(rows.along, rows.weight[1], out=rows.weighted_along)
        cross += rows.weighted_cross @ rows.cross.T
        along += rows.weighted_along @ rows.along.T
        if apart is not None:
            _add_by_flight(rows, part.flight, first, *apart)
        if flights:
            own[:, place] += np.add.reduceat(_scores(rows), first, axis=1)
        if cuts is not None:
            _add_blocks(rows, cuts[k], sums)
    sums.scatter = scatter
    # the eighth row is the residual itself: it is no parameter of the normal matrix
    sums.normal += _of_all(cross[:7, :7], along[1:, 1:])
    if apart is not None:
        sums.flight_normal = _of_all(*apart)
    sums.score -= _CROSS @ cross[:7, 7] + _ALONG @ along[1:, 0]
    sums.flight_score[obs.flight[opens]] = -(_SCORE @ own).T
    if sums.block is not None:
        for row, sign in ((3, 1.0), (3 + SLOPES, -1.0)):
            slopes = sums.block[row : row + COMPASS]
            slopes[:] = sign * _BASIS @ slopes
        sums.block[1:3] *= -1
    return sums


def _runs(starts: Index, begins: Index, length: int) -> list[tuple[slice, Index]]:
    """Which of some runs each stretch of reports belongs to, and where in it they begin."""
    if not starts.size:
        return [(slice(0), starts)] * begins.size
    first = np.searchsorted(starts, begins, side="right") - 1
    last = np.searchsorted(starts, begins + length, side="left")
    return [
        (slice(i, j), np.maximum(starts[i:j] - begin, 0))
        for i, j, begin in zip(first.tolist(), last.tolist(), begins.tolist(), strict=True)
    ]


def _weigh(obs: Observations, scatter: Scatter, joint: bool, rows: Rows, sums: PassSums) -> None:
    """Find the weights of one block's rows, robust; add up the robust averages."""
    np.multiply(rows.unit, rows.speed, out=rows.cross[:COMPASS])
    rows.along[1] = obs.airspeed
    weight, part = rows.weight, rows.part
    np.multiply(obs.variance, scatter.part, out=weight[0])
    np.add(weight[0], scatter.along, out=weight[1])
    weight[0] += scatter.cross
    np.reciprocal(weight, out=weight)
    if not joint:
        weight[1] = 0.0
    np.multiply(rows.residual, rows.residual, out=part)
    part *= weight
    u = np.add(part[0], part[1], out=part[0])
    # Tukey's weight is (1 - r2/c2)^2 below the cut: u is its root, and u squared the weight.
    u *= -1 / (CUT_2D if joint else CUT_1D) ** 2
    u += 1
    np.maximum(u, 0, out=u)
    total, plain = float(np.dot(u, u)), float(u.sum())
    sums.weight += total
    # Mean derivative of w(r) r over its plane (two components) or line.
    sums.slope += total - (2 if joint else 4) * (plain - total)
    u *= u
    weight *= u
    sums.before2 += float(np.dot(np.multiply(u, obs.error, out=part[1]), obs.error))
    sums.after2 += float(np.dot(np.multiply(u, rows.turn[1], out=part[1]), rows.turn[1]))


def _scores(rows: Rows) -> Single:
    """Scores of every report, in the place of the weighted rows, shape (8, n)."""
    cross, along = rows.weighted_cross, rows.weighted_along[1:]
    cross[:7] *= rows.cross[7]
    along *= rows.along[0]
    # both components tell of b_u and b_v, and only the one along of s, which takes the place of the
    # residual
    cross[5] -= along[2]
    cross[6] += along[1]
    cross[7] = along[0]
    return cross


def _add_blocks(rows: Rows, cuts: tuple[slice, Index], sums: PassSums) -> None:
    """Sum weight, residual and slopes, turned east and north, over the blocks."""
    out, weight = rows.sums, rows.weight[0]
    east, north = np.multiply(rows.along[2:], weight, out=rows.part)
    both = np.multiply(rows.residual, weight, out=out[:2])
    sums.square += float(np.dot(both[0], both[0]) + np.dot(both[1], both[1]))
    np.multiply(rows.residual, north, out=out[1:3])
    np.multiply(rows.residual, east, out=out[3:5])
    out[1] += out[4]
    out[2] -= out[3]
    np.multiply(rows.cross[:COMPASS], north, out=out[3 : 3 + COMPASS])
    np.multiply(rows.along[1], rows.part, out=out[2 + SLOPES :: SLOPES])
    np.multiply(rows.cross[:COMPASS], east, out=out[3 + SLOPES : 3 + SLOPES + COMPASS])
    out[0] = weight
    place, starts = cuts
    if sums.block is None:
        raise ValueError("no room was made for the sums of blocks")
    sums.block[:, place] += np.add.reduceat(out, starts, axis=1)


def _of_all(cross: Array, along: Array) -> Array:
    """Normal matrix of all parameters from those of the rows, shapes (..., 7, 7), (..., 3, 3)."""
    return np.asarray(_CROSS @ cross @ _CROSS.T + _ALONG @ along @ _ALONG.T)


def _add_by_flight(rows: Rows, flight: Index, starts: Index, cross: Array, along: Array) -> None:
    """Add up the rows' normal matrices of every flight."""
    weighted_cross, own_cross = rows.weighted_cross[:7], rows.cross[:7].T
    weighted_along, own_along = rows.weighted_along[1:], rows.along[1:].T
    edges = [*starts.tolist(), flight.size]
    for number, one in zip(flight[starts].tolist(), starmap(slice, pairwise(edges)), strict=True):
        cross[number] += weighted_cross[:, one] @ own_cross[one]
        along[number] += weighted_along[:, one] @ own_along[one]


def _robust_scatter(
    r_along: Single, r_cross: Single, variance: Single, *, parted: bool = True
) -> Scatter:
    """Find the residual's variance a component from medians, so that gross errors do not count.

    Residuals (n,) in m/s, known variance in m2/s2. ``part`` is the share of the known variance
    that the residuals show (it may cancel in the difference of the two air vectors), found from
    the halves of low and high known variance; not ``parted``: 0, one variance for all reports,
    enough for a start.
    """
    along, cross = r_along * r_along, r_cross * r_cross
    part, known = 0.0, 0.0
    if parted and variance.size > 1:
        # sorted, not partitioned: the known variance takes few values, and that is slow with ties
        below = variance < np.sort(variance)[variance.size // 2]
        # places rather than flags: several times faster to take by
        low, high = np.flatnonzero(below), np.flatnonzero(~below)
        small = float(variance[low].mean()) if low.size else np.inf
        # what the two halves differ by tells how much of the known variance the residuals show
        spread = float(variance[high].mean()) - small
        if spread > 1e-9:
            above, along, cross = _median(cross[high]), along[low], cross[low]
            part = min(max((above - _median(cross)) / MEDIAN_CHI2 / spread, 0.0), 1.0)
            known = part * small
    along_total, cross_total = (_median(one) / MEDIAN_CHI2 for one in (along, cross))
    return Scatter(
        # what is stated of the ground vector may be too large: something is left to the wind
        max(along_total - known, 0.1 * along_total, 1e-6),
        max(cross_total - known, 0.1 * cross_total, 1e-6),
        part,
    )


def _median(values: Single) -> float:
    middle = values.size // 2
    return float(np.partition(values, middle)[middle])
