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
BLOCK = 8192
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
        self.rows, self.weighted, self.score = np.empty((3, LOCAL, BLOCK), dtype=np.float32)
        self.other, self.other_weighted = np.empty((2, 4, BLOCK), dtype=np.float32)
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
    for begin in range(0, obs.size, BLOCK):
        part = obs.take(slice(begin, begin + BLOCK))
        cuts = None if starts is None else _cuts(starts, begin, part.size)
        _block(part, theta, scatter, joint, sums, cuts)
    if sums.block is not None:
        sums.block[[1, 2, *range(3 + SLOPES, 2 + 2 * SLOPES)]] *= -1
    return sums


def _cuts(starts: Index, begin: int, count: int) -> tuple[slice, Index]:
    """Which blocks a stretch of reports belongs to, and where in it they begin."""
    first = int(np.searchsorted(starts, begin, side="right")) - 1
    last = int(np.searchsorted(starts, begin + count, side="left"))
    return slice(first, last), np.maximum(starts[first:last] - begin, 0)


def residuals(
    obs: Observations, theta: Array, joint: bool
) -> tuple[Single, Single, Single, Single, Single]:
    """Vector residual along and across the fitted true heading.

    Parameters
    ----------
    obs : Observations
    theta : array, shape (8,)
    joint : bool

    Returns
    -------
    r_along, r_cross : array, shape (n,)
        m/s.
    sin_true, cos_true : array, shape (n,)
        Of the fitted true heading psi - delta(m).
    x : array, shape (n,)
        delta(m), radians.
    """
    a, b, c, d, e, s, b_u, b_v = (np.float32(value) for value in theta)
    delta = a + obs.gain * (b * obs.sin_m + c * obs.cos_m)
    if d != 0 or e != 0:
        delta += obs.sin_m * (2 * d * obs.cos_m - 2 * e * obs.sin_m) + e
    sin_d, cos_d = np.sin(delta), np.cos(delta)
    sin_t = obs.sin_psi * cos_d - obs.cos_psi * sin_d
    cos_t = obs.cos_psi * cos_d + obs.sin_psi * sin_d
    r_cross = obs.cross * cos_d + obs.along * sin_d
    r_along = obs.along * cos_d - obs.cross * sin_d - obs.airspeed * (1 - s)
    if joint:
        r_cross += b_u * cos_t - b_v * sin_t
        r_along += b_u * sin_t + b_v * cos_t
    return r_along, r_cross, sin_t, cos_t, delta


def _block(
    obs: Observations,
    theta: Array,
    scatter: Scatter,
    joint: bool,
    sums: PassSums,
    cuts: tuple[slice, Index] | None,
) -> None:
    r_along, r_cross, sin_t, cos_t, delta = residuals(obs, theta, joint)
    w_along, w_cross, tukey = _weights(obs, scatter, r_along, r_cross, joint, sums)
    scaled = obs.airspeed * np.float32(1 - theta[COMPASS])
    # eight rows, the residual last: its products are the score, and eight suit the processor
    count = obs.size
    rows, weighted, score, other, other_weighted = (
        part[:, :count]
        for part in (
            _SCRATCH.rows,
            _SCRATCH.weighted,
            _SCRATCH.score,
            _SCRATCH.other,
            _SCRATCH.other_weighted,
        )
    )
    rows[0] = scaled
    np.multiply(scaled, obs.sin_m, out=rows[1])
    np.multiply(scaled, obs.cos_m, out=rows[2])
    twice = rows[1] + rows[1]
    np.multiply(twice, obs.cos_m, out=rows[3])
    twice *= obs.sin_m
    np.subtract(scaled, twice, out=rows[4])
    rows[1:3] *= obs.gain
    rows[5], rows[7] = cos_t, r_cross
    np.negative(sin_t, out=rows[6])
    np.multiply(rows, w_cross, out=weighted)
    _add_normal(rows, weighted, CROSS_ROW, CROSS_SQUARE, sums)
    other[0], other[1], other[2], other[3] = obs.airspeed, sin_t, cos_t, r_along
    np.multiply(other, w_along, out=other_weighted)
    _add_normal(other, other_weighted, ALONG_ROW, ALONG_SQUARE, sums)
    if cuts is not None:
        _add_blocks(rows, other, w_cross, cuts, sums)
    r_cross *= -1
    r_along *= -1
    np.multiply(weighted[:COMPASS], r_cross, out=score[:COMPASS])
    np.multiply(weighted[COMPASS:-1], r_cross, out=score[COMPASS + 1 :])
    other_weighted *= r_along
    score[COMPASS] = other_weighted[0]
    score[COMPASS + 1 :] += other_weighted[1:-1]
    starts = np.flatnonzero(obs.flight[1:] != obs.flight[:-1]) + 1
    starts = np.concatenate([[0], starts])
    sums.flight_score[obs.flight[starts]] += np.add.reduceat(score, starts, axis=1).T
    if sums.flight_normal is not None:
        _add_by_flight(rows, w_cross, CROSS_ROW, obs.flight, starts, sums.flight_normal)
        _add_by_flight(other, w_along, ALONG_ROW, obs.flight, starts, sums.flight_normal)
    delta -= obs.error
    delta *= delta
    sums.after2 += float(np.dot(tukey, delta))


def _weights(
    obs: Observations,
    scatter: Scatter,
    r_along: Single,
    r_cross: Single,
    joint: bool,
    sums: PassSums,
) -> tuple[Single, Single, Single]:
    known = np.float32(scatter.part) * obs.variance
    w_cross: Single = np.reciprocal(known + np.float32(scatter.cross), dtype=np.float32)
    w_along: Single = (
        np.reciprocal(known + np.float32(scatter.along), dtype=np.float32)
        if joint
        else np.zeros_like(w_cross)
    )
    q = r_cross * r_cross * w_cross + r_along * r_along * w_along
    u = np.maximum(1 - q * np.float32(1 / (CUT_2D if joint else CUT_1D) ** 2), 0)
    tukey = u * u
    total, plain = float(np.dot(u, u)), float(u.sum())
    sums.weight += total
    sums.slope += total - (2 if joint else 4) * (plain - total)
    error2 = obs.error * obs.error
    sums.before2 += float(np.dot(tukey, error2))
    w_along *= tukey
    w_cross *= tukey
    return w_along, w_cross, tukey


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
    airspeed, sin_t, cos_t, r_along = other
    east, north = sin_t * w, cos_t * w
    out[0] = w
    np.multiply(rows[7], north, out=out[1])
    out[1] += r_along * east
    np.multiply(r_along, north, out=out[2])
    out[2] -= rows[7] * east
    np.multiply(rows[:COMPASS], north, out=out[3 : 3 + COMPASS])
    np.multiply(airspeed, east, out=out[3 + COMPASS])
    np.multiply(rows[:COMPASS], east, out=out[3 + SLOPES : 3 + SLOPES + COMPASS])
    np.multiply(airspeed, north, out=out[3 + SLOPES + COMPASS])
    place, starts = cuts
    if sums.block is None:
        raise ValueError("no room was made for the sums of blocks")
    sums.block[:, place] += np.add.reduceat(out, starts, axis=1)
    for residual in (rows[7] * w, r_along * w):
        sums.square += float(np.dot(residual, residual))


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
        middle = _median(obs.variance)
        low = obs.variance < middle
        spread = float(obs.variance[~low].mean() - obs.variance[low].mean()) if low.any() else 0.0
        if spread > 1e-9:
            gain = (_median(cross[~low]) - _median(cross[low])) / MEDIAN_CHI2
            part = min(max(gain / spread, 0.0), 1.0)
            known = part * float(obs.variance[low].mean())
            along, cross = along[low], cross[low]
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
