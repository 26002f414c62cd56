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

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from airswing.compass.blocks import ROWS, SLOPES
from airswing.compass.observations import (
    Array,
    Index,
    Observations,
    Reports,
    Single,
    Values,
    radians32,
)

COMPASS = 5
"""A, B, C, D, E come first in every parameter vector, then s, then b_u, b_v a reference."""
LOCAL = COMPASS + 3
CROSS_ROW, ALONG_ROW = np.array([0, 1, 2, 3, 4, 6, 7]), np.array([5, 6, 7])
"""Parameters that each row of the vector equation knows."""
CROSS_SQUARE, ALONG_SQUARE = (np.ix_(row, row) for row in (CROSS_ROW, ALONG_ROW))
SCORE_ROW = np.array([*range(COMPASS), COMPASS + 2, COMPASS, COMPASS + 1])
"""Where every parameter stands among the scores as a block sums them."""
BLOCK = 10240
WORK = 5
"""Rows a block works in beside those it keeps."""
CUT_2D, CUT_1D = 5.0, 4.685
"""Tukey's constants: 95 % efficiency for a normal vector (2-D) and scalar residual."""
MEDIAN_CHI2 = 0.4549


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

    @property
    def kappa(self) -> float:
        """Mean derivative of the robust score over the mean weight."""
        return max(self.slope / self.weight, 0.2) if self.weight > 0 else 1.0


class _Scratch(threading.local):
    """Rows of a block, kept by each thread: asking for new memory costs more than the sums."""

    def __init__(self) -> None:
        self.obs, self.rows, self.weighted = np.empty((3, LOCAL, BLOCK), dtype=np.float32)
        self.other, self.other_weighted = np.empty((2, 4, BLOCK), dtype=np.float32)
        self.work = np.empty((WORK, BLOCK), dtype=np.float32)
        self.block = np.empty((ROWS, BLOCK), dtype=np.float32)


_SCRATCH = _Scratch()


def accumulate(
    obs: Observations | Reports,
    theta: Array,
    scatter: Scatter,
    flights: int,
    *,
    joint: bool,
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
    scatter : Scatter
    flights : int
        Number of the aircraft's flights.
    joint : bool
        False: the cross-track row alone, without s and b.
    by_flight : bool
        Keep the normal matrix of every flight too (needed where flights are few).
    starts : array of int, optional
        First report of every block whose sums are kept too (:mod:`airswing.compass.blocks`).

    Returns
    -------
    PassSums
    """
    sums = PassSums(
        np.zeros((LOCAL, LOCAL)),
        np.zeros(LOCAL),
        np.zeros((flights, LOCAL)),
        np.zeros((flights, LOCAL, LOCAL)) if by_flight else None,
    )
    if starts is not None:
        sums.block = np.zeros((ROWS, starts.size))
    own = np.zeros((LOCAL, obs.opens.size))
    for begin in range(0, obs.size, BLOCK):
        part = obs.take(slice(begin, begin + BLOCK), _SCRATCH.obs)
        place, opens = _cuts(obs.opens, begin, part.size)
        cuts = None if starts is None else _cuts(starts, begin, part.size)
        own[:, place] += _block(part, theta, scatter, joint, sums, opens, cuts)
    sums.flight_score[obs.flight[obs.opens]] = -own[SCORE_ROW].T
    if sums.block is not None:
        sums.block[[1, 2, *range(3 + SLOPES, 2 + 2 * SLOPES)]] *= -1
    return sums


def _cuts(starts: Index, begin: int, count: int) -> tuple[slice, Index]:
    """Which of some runs a stretch of reports belongs to, and where in it they begin."""
    first = int(np.searchsorted(starts, begin, side="right")) - 1
    last = int(np.searchsorted(starts, begin + count, side="left"))
    return slice(first, last), np.maximum(starts[first:last] - begin, 0)


def residuals(
    obs: Observations, theta: Array, joint: bool, room: Sequence[Single] | None = None
) -> tuple[Single, Single, Single, Single, Single]:
    """Vector residual along and across the fitted true heading.

    Parameters
    ----------
    obs : Observations
    theta : array, shape (8,)
    joint : bool
    room : six arrays, shape (n,), optional
        Where to put the five that are returned, and one to work in.

    Returns
    -------
    r_along, r_cross : array, shape (n,)
        m/s.
    sin_true, cos_true : array, shape (n,)
        Of the fitted true heading psi - delta(m).
    left : array, shape (n,)
        delta(m) less the heading error, radians.
    """
    a, b, c, d, e, s, b_u, b_v = theta.tolist()
    r_along, r_cross, sin_t, cos_t, left, part = (
        np.empty((6, obs.size), dtype=np.float32) if room is None else room
    )
    np.multiply(obs.sin_m, b, out=left)
    np.multiply(obs.cos_m, c, out=part)
    left += part
    left *= obs.gain
    if d != 0 or e != 0:
        np.multiply(obs.cos_m, 2 * d, out=part)
        np.multiply(obs.sin_m, 2 * e, out=sin_t)
        part -= sin_t
        part *= obs.sin_m
        left += part
    left += a + e
    np.subtract(obs.heading, left, out=part)
    np.sin(part, out=sin_t)
    np.cos(part, out=cos_t)
    left -= obs.error
    np.cos(left, out=r_along)
    np.sin(left, out=r_cross)
    r_along *= obs.implied
    r_cross *= obs.implied
    r_along -= np.multiply(obs.airspeed, 1 - s, out=part)
    if joint:
        r_cross += np.multiply(cos_t, b_u, out=part)
        r_cross -= np.multiply(sin_t, b_v, out=part)
        r_along += np.multiply(sin_t, b_u, out=part)
        r_along += np.multiply(cos_t, b_v, out=part)
    return r_along, r_cross, sin_t, cos_t, left


def _block(
    obs: Observations,
    theta: Array,
    scatter: Scatter,
    joint: bool,
    sums: PassSums,
    opens: Index,
    cuts: tuple[slice, Index] | None,
) -> Single:
    """Add up one block's sums; those of its scores by flight are returned, (8, flights)."""
    # eight rows, the residual last: its products are the score, and eight suit the processor
    rows, weighted, other, other_weighted, work = (
        part[:, : obs.size]
        for part in (
            _SCRATCH.rows,
            _SCRATCH.weighted,
            _SCRATCH.other,
            _SCRATCH.other_weighted,
            _SCRATCH.work,
        )
    )
    room = (other[3], rows[7], other[1], other[2], work[0], work[1])
    r_along, r_cross, sin_t, cos_t, left = residuals(obs, theta, joint, room)
    w_along, w_cross, tukey = _weights(obs, scatter, (r_along, r_cross), joint, sums, work[1:])
    left *= left
    sums.after2 += float(np.dot(tukey, left))
    np.multiply(obs.airspeed, 1 - float(theta[COMPASS]), out=rows[0])
    np.multiply(rows[0], obs.sin_m, out=rows[1])
    np.multiply(rows[0], obs.cos_m, out=rows[2])
    twice = np.add(rows[1], rows[1], out=tukey)
    np.multiply(twice, obs.cos_m, out=rows[3])
    twice *= obs.sin_m
    np.subtract(rows[0], twice, out=rows[4])
    rows[1:3] *= obs.gain
    rows[5] = cos_t
    np.negative(sin_t, out=rows[6])
    np.multiply(rows, w_cross, out=weighted)
    _add_normal(rows, weighted, CROSS_ROW, CROSS_SQUARE, sums)
    other[0] = obs.airspeed
    np.multiply(other, w_along, out=other_weighted)
    _add_normal(other, other_weighted, ALONG_ROW, ALONG_SQUARE, sums)
    if sums.flight_normal is not None:
        _add_by_flight(rows, w_cross, CROSS_ROW, obs.flight, opens, sums.flight_normal)
        _add_by_flight(other, w_along, ALONG_ROW, obs.flight, opens, sums.flight_normal)
    score = weighted
    score[:-1] *= r_cross
    other_weighted[:-1] *= r_along
    score[COMPASS:-1] += other_weighted[1:-1]
    score[-1] = other_weighted[0]
    if cuts is not None:
        _add_blocks(rows, other, w_cross, cuts, sums)
    return np.add.reduceat(score, opens, axis=1)


def _weights(
    obs: Observations,
    scatter: Scatter,
    residual: tuple[Single, Single],
    joint: bool,
    sums: PassSums,
    room: Single,
) -> tuple[Single, Single, Single]:
    """Weights along and across, robust; the robust part alone."""
    w_along, w_cross, q, part = room
    np.multiply(obs.variance, scatter.part, out=w_cross)
    if joint:
        np.add(w_cross, scatter.along, out=w_along)
        np.reciprocal(w_along, out=w_along)
    else:
        w_along[:] = 0.0
    w_cross += scatter.cross
    np.reciprocal(w_cross, out=w_cross)
    np.multiply(residual[0], residual[0], out=q)
    q *= w_along
    np.multiply(residual[1], residual[1], out=part)
    part *= w_cross
    q += part
    q *= -1 / (CUT_2D if joint else CUT_1D) ** 2
    q += 1
    u = np.maximum(q, 0, out=q)
    total, plain = float(np.dot(u, u)), float(u.sum())
    sums.weight += total
    sums.slope += total - (2 if joint else 4) * (plain - total)
    u *= u
    sums.before2 += float(np.dot(u, np.multiply(obs.error, obs.error, out=part)))
    w_along *= u
    w_cross *= u
    return w_along, w_cross, u


def _add_normal(
    rows: Single, weighted: Single, place: Index, square: tuple[Index, ...], sums: PassSums
) -> None:
    normal = weighted @ rows.T
    sums.normal[square] += normal[:-1, :-1]
    sums.score[place] -= normal[:-1, -1]


def _add_blocks(
    rows: Single,
    other: Single,
    w: Single,
    cuts: tuple[slice, Index],
    sums: PassSums,
) -> None:
    """Sum weight, residual and slopes, turned east and north, over the blocks."""
    out = _SCRATCH.block[:, : w.size]
    airspeed, r_along = other[0], other[3]
    east, north, part = np.multiply(other[1:], w, out=_SCRATCH.other_weighted[1:, : w.size])
    sums.square += float(np.dot(part, part))
    np.multiply(rows[7], w, out=part)
    sums.square += float(np.dot(part, part))
    out[0] = w
    np.multiply(rows[7], north, out=out[1])
    out[1] += np.multiply(r_along, east, out=part)
    np.multiply(r_along, north, out=out[2])
    out[2] -= np.multiply(rows[7], east, out=part)
    np.multiply(rows[:COMPASS], north, out=out[3 : 3 + COMPASS])
    np.multiply(airspeed, east, out=out[3 + COMPASS])
    np.multiply(rows[:COMPASS], east, out=out[3 + SLOPES : 3 + SLOPES + COMPASS])
    np.multiply(airspeed, north, out=out[3 + SLOPES + COMPASS])
    place, starts = cuts
    if sums.block is None:
        raise ValueError("no room was made for the sums of blocks")
    sums.block[:, place] += np.add.reduceat(out, starts, axis=1)


def _add_by_flight(
    rows: Single, w: Single, place: Index, flight: Index, starts: Index, normals: Array
) -> None:
    stops = np.append(starts[1:], flight.size)
    for number, begin, end in zip(flight[starts], starts, stops, strict=True):
        part = rows[:-1, begin:end]
        normals[number][np.ix_(place, place)] += (part * w[begin:end]) @ part.T


def robust_scatter(obs: Observations, theta: Array, *, joint: bool, parted: bool = True) -> Scatter:
    """Find the residual's variance a component from medians, so that gross errors do not count.

    Parameters
    ----------
    obs : Observations
    theta : array, shape (8,)
    joint : bool
    parted : bool
        False: one variance for all reports (``part`` 0), enough for a start.

    Returns
    -------
    Scatter
        ``part`` is the share of the known variance that the residuals show (it may cancel in the
        difference of the two air vectors), found from the halves of low and high known variance.
    """
    r_along, r_cross, *_ = residuals(obs, theta, joint)
    along, cross = r_along * r_along, r_cross * r_cross
    part, known = 0.0, 0.0
    if parted and obs.variance.size > 1:
        below = obs.variance < _median(obs.variance)
        # places rather than flags: several times faster to take by
        low, high = np.flatnonzero(below), np.flatnonzero(~below)
        small = float(obs.variance[low].mean()) if low.size else np.inf
        spread = float(obs.variance[high].mean()) - small
        if spread > 1e-9:
            above, along, cross = _median(cross[high]), along[low], cross[low]
            part = min(max((above - _median(cross)) / MEDIAN_CHI2 / spread, 0.0), 1.0)
            known = part * small
    along_total, cross_total = (_median(one) / MEDIAN_CHI2 for one in (along, cross))
    return Scatter(
        max(along_total - known, 0.1 * along_total, 1e-6),
        max(cross_total - known, 0.1 * cross_total, 1e-6),
        part,
    )


def _median(values: Single) -> float:
    middle = values.size // 2
    return float(np.partition(values, middle)[middle])


def plain_sinusoid(heading_error: Values, abscissa: Values) -> tuple[Array, Array]:
    """Fit the seed's sinusoid by ordinary least squares in one pass, each report alike.

    Parameters
    ----------
    heading_error, abscissa : array, shape (n,)
        Degrees, finite.

    Returns
    -------
    curve : array, shape (3,)
        offset, amplitude and phase of offset + amplitude sin(m + phase), degrees; the amplitude
        is not negative and the phase in (-180, 180].
    linear : array, shape (3,)
        A, B, C of A + B sin m + C cos m, degrees.
    """
    normal = np.zeros((4, 4))
    for begin in range(0, heading_error.size, BLOCK):
        m = radians32(abscissa[begin : begin + BLOCK])
        rows = np.empty((4, m.size), dtype=np.float32)
        rows[0] = 1
        np.sin(m, out=rows[1])
        np.cos(m, out=rows[2])
        rows[3] = heading_error[begin : begin + BLOCK]
        normal += rows @ rows.T
    linear = np.linalg.solve(normal[:3, :3], normal[:3, 3])
    curve = np.array(
        [linear[0], np.hypot(linear[1], linear[2]), np.degrees(np.arctan2(linear[2], linear[1]))]
    )
    return curve, np.asarray(linear, dtype=np.float64)
