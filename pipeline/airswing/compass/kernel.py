"""Sums for the deviation fit of one aircraft: numpy only, one pass over the reports a step.

Assumptions
-----------
The reference wind is the true wind plus a bias b and noise; the unit's airspeed is (1 + s) times
the true one; the indicated heading psi is the true one plus the deviation
delta(m) = A + B sin m + C cos m + D sin 2m + E cos 2m, m the abscissa (indicated magnetic
heading). So the air vector the reference implies is, exactly,

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

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]

COMPASS = 5
"""A, B, C, D, E come first in every parameter vector, then s, then b_u, b_v a reference."""
LOCAL = COMPASS + 3
CROSS_ROW, ALONG_ROW = np.array([0, 1, 2, 3, 4, 6, 7]), np.array([5, 6, 7])
"""Parameters that each row of the vector equation knows."""
BLOCK = 8192
CUT_2D, CUT_1D = 5.0, 4.685
"""Tukey's constants: 95 % efficiency for a normal vector (2-D) and scalar residual."""
MEDIAN_CHI2 = 0.4549


@dataclass(frozen=True)
class Observations:
    """Reports of one aircraft against one reference, made ready for the passes.

    Attributes
    ----------
    sin_m, cos_m, sin_psi, cos_psi : array, shape (n,)
        Abscissa and indicated true heading.
    along, cross : array, shape (n,)
        V'_A along and to the right of the indicated heading, m/s.
    airspeed : array, shape (n,)
        |V_A|, m/s.
    variance : array, shape (n,)
        Known variance of each component, m2/s2.
    flight : array of int, shape (n,)
        Number of the flight within the aircraft, never falling.
    """

    sin_m: Single
    cos_m: Single
    sin_psi: Single
    cos_psi: Single
    along: Single
    cross: Single
    airspeed: Single
    variance: Single
    flight: Index

    def take(self, keep: slice) -> Observations:
        """Part of the reports (the flight numbers are kept)."""
        return Observations(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


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

    @property
    def kappa(self) -> float:
        """Mean derivative of the robust score over the mean weight."""
        return max(self.slope / self.weight, 0.2) if self.weight > 0 else 1.0


def prepare(
    heading: NDArray[np.floating],
    abscissa: NDArray[np.floating],
    airspeed: NDArray[np.floating],
    heading_error: NDArray[np.floating],
    airspeed_error: NDArray[np.floating],
    standard_error: NDArray[np.floating],
    flight: NDArray[np.integer],
) -> Observations:
    """Make the reports of one aircraft and one reference ready.

    Parameters
    ----------
    heading, abscissa : array, shape (n,)
        Indicated true heading psi and the argument m of the deviation, degrees.
    airspeed : array, shape (n,)
        |V_A|, m/s.
    heading_error, standard_error : array, shape (n,)
        arg V_A - arg V'_A and what is known of its standard error, degrees.
    airspeed_error : array, shape (n,)
        |V_A| - |V'_A|, m/s.
    flight : array of int, shape (n,)
        0, 1, 2 ... within the aircraft; reports of one flight need not stand together.

    Returns
    -------
    Observations
        Sorted by flight.
    """
    code = np.asarray(flight, dtype=np.int64)
    if code.size and np.any(code[1:] < code[:-1]):
        order = np.argsort(code, kind="stable")
        heading, abscissa, airspeed, heading_error, airspeed_error, standard_error, code = (
            part[order] for part in (heading, abscissa, airspeed, heading_error, airspeed_error,
                                     standard_error, code))
    m, psi, error = (_radians32(part) for part in (abscissa, heading, heading_error))
    v = airspeed.astype(np.float32)
    implied = v - airspeed_error.astype(np.float32)
    known = np.nan_to_num(_radians32(standard_error)) * v
    return Observations(np.sin(m), np.cos(m), np.sin(psi), np.cos(psi), implied * np.cos(error),
                        -implied * np.sin(error), v, known * known, code)


def _radians32(degrees: NDArray[np.floating]) -> Single:
    return degrees.astype(np.float32) * np.float32(np.pi / 180.0)


def accumulate(
    obs: Observations,
    theta: Array,
    scatter: Scatter,
    flights: int,
    *,
    joint: bool,
    by_flight: bool = False,
) -> PassSums:
    """Run once over the reports: weighted normal equations at ``theta``.

    Parameters
    ----------
    obs : Observations
    theta : array, shape (8,)
        A, B, C, D, E (radians), s, b_u, b_v (m/s).
    scatter : Scatter
    flights : int
        Number of the aircraft's flights.
    joint : bool
        False: the cross-track row alone, without s and b.
    by_flight : bool
        Keep the normal matrix of every flight too (needed where flights are few).

    Returns
    -------
    PassSums
    """
    sums = PassSums(np.zeros((LOCAL, LOCAL)), np.zeros(LOCAL), np.zeros((flights, LOCAL)),
                    np.zeros((flights, LOCAL, LOCAL)) if by_flight else None)
    for begin in range(0, obs.flight.size, BLOCK):
        _block(obs.take(slice(begin, begin + BLOCK)), theta, scatter, joint, sums)
    sums.score = sums.flight_score.sum(axis=0)
    return sums


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
    delta = a + obs.sin_m * (b + 2 * d * obs.cos_m) + c * obs.cos_m
    if e != 0:
        delta += e * (1 - 2 * obs.sin_m * obs.sin_m)
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
    obs: Observations, theta: Array, scatter: Scatter, joint: bool, sums: PassSums
) -> None:
    r_along, r_cross, sin_t, cos_t, delta = residuals(obs, theta, joint)
    known = np.float32(scatter.part) * obs.variance
    w_cross = 1 / (known + np.float32(scatter.cross))
    w_along = 1 / (known + np.float32(scatter.along)) if joint else None
    q = r_cross * r_cross * w_cross
    if w_along is not None:
        q += r_along * r_along * w_along
    cut = CUT_2D if joint else CUT_1D
    u = np.maximum(1 - q * np.float32(1 / cut**2), 0)
    tukey = u * u
    w_cross *= tukey
    scaled = obs.airspeed * np.float32(1 - theta[COMPASS])
    rows = np.zeros((LOCAL - 1, obs.airspeed.size), dtype=np.float32)
    np.multiply(scaled, obs.sin_m, out=rows[1])
    np.multiply(scaled, obs.cos_m, out=rows[2])
    np.multiply(rows[1], 2 * obs.cos_m, out=rows[3])
    np.subtract(scaled, 2 * rows[1] * obs.sin_m, out=rows[4])
    rows[0] = scaled
    if joint:
        rows[5], rows[6] = cos_t, -sin_t
    _add_rows(rows, w_cross, r_cross, obs.flight, CROSS_ROW, sums)
    if w_along is not None:
        w_along *= tukey
        rows = np.stack([obs.airspeed, sin_t, cos_t])
        _add_rows(rows, w_along, r_along, obs.flight, ALONG_ROW, sums)
    lost = 2 if joint else 4
    sums.weight += float(tukey.sum(dtype=np.float64))
    sums.slope += float((tukey - lost * (1 - u) * u).sum(dtype=np.float64))
    error = np.arctan2(-obs.cross, obs.along)
    sums.before2 += float(np.dot(tukey, error * error))
    error -= delta
    sums.after2 += float(np.dot(tukey, error * error))


def _add_rows(
    rows: Single, w: Single, r: Single, flight: Index, place: Index, sums: PassSums
) -> None:
    weighted = rows * w
    sums.normal[np.ix_(place, place)] += weighted @ rows.T
    weighted *= -r
    starts = np.flatnonzero(np.diff(flight, prepend=flight[0] - 1))
    sums.flight_score[np.ix_(flight[starts], place)] += np.add.reduceat(weighted, starts, axis=1).T
    if sums.flight_normal is None:
        return
    stops = np.append(starts[1:], flight.size)
    for number, begin, end in zip(flight[starts], starts, stops, strict=True):
        part = rows[:, begin:end]
        sums.flight_normal[number][np.ix_(place, place)] += (part * w[begin:end]) @ part.T


def robust_scatter(obs: Observations, theta: Array, *, joint: bool) -> Scatter:
    """Find the residual's variance a component from medians, so that gross errors do not count.

    Parameters
    ----------
    obs : Observations
    theta : array, shape (8,)
    joint : bool

    Returns
    -------
    Scatter
        ``part`` is the share of the known variance that the residuals show (it may cancel in the
        difference of the two air vectors), found from the halves of low and high known variance.
    """
    r_along, r_cross, *_ = residuals(obs, theta, joint)
    low = obs.variance <= np.median(obs.variance)
    part = 0.0
    if low.any() and not low.all():
        gain = _median_square(r_cross[~low]) - _median_square(r_cross[low])
        spread = float(obs.variance[~low].mean() - obs.variance[low].mean())
        part = float(np.clip(gain / max(spread, 1e-12), 0.0, 1.0))
    known = part * float(np.median(obs.variance))
    return Scatter(*(max(total - known, 0.1 * total, 1e-6) for total in
                     (_median_square(r_along), _median_square(r_cross))), part)


def _median_square(residual: Single) -> float:
    return float(np.median(residual * residual)) / MEDIAN_CHI2


def plain_sinusoid(
    heading_error: NDArray[np.floating], abscissa: NDArray[np.floating]
) -> tuple[Array, Array]:
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
        m = _radians32(abscissa[begin:begin + BLOCK])
        rows = np.empty((4, m.size), dtype=np.float32)
        rows[0] = 1
        np.sin(m, out=rows[1])
        np.cos(m, out=rows[2])
        rows[3] = heading_error[begin:begin + BLOCK]
        normal += rows @ rows.T
    linear = np.linalg.solve(normal[:3, :3], normal[:3, 3])
    curve = np.array([linear[0], np.hypot(linear[1], linear[2]),
                      np.degrees(np.arctan2(linear[2], linear[1]))])
    return curve, linear
