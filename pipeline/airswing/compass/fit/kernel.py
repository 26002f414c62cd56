"""Robust joint fit of one aircraft's deviation against one reference or a pool of references.

Assumptions
-----------
The reference wind is the true wind plus a bias b and noise; the reported airspeed is (1 + s) times
the true one; the indicated heading psi is the true heading plus the deviation
``delta(m) = A + g (B sin m + C cos m) + D sin 2m + E cos 2m``, with m the indicated magnetic
heading and g the aircraft's mean horizontal field over the field at the report. The air vector
that the reference implies is then, exactly,

    V'_A = V (1 - s) h(psi - delta(m)) - b + noise,    h(x) = (sin x, cos x) in (east, north).

The noise is added to V'_A and does not enter psi, m or V, so that least squares on this vector
equation has no bias, however large delta is. The residual is resolved along and across the fitted
true heading; each component has its own variance. Each member of a pool has its own b and its own
variances; flights and days are the clusters for all members together.

Method
------
Gauss-Newton steps with Tukey's weights of the standardised vector residual (iteratively reweighted
least squares), so that gross errors have weight zero. The variances come from medians of a sample
of about `MIDDLE` reports, on which the first steps are made too; passes over all reports follow
with these variances until a step is below `FINAL_STEP` clustered standard errors. Covariances are
clustered by flight and by day (`airswing.compass.fit.sandwich`).

Units and validity
------------------
Radians and m s-1; deviations below about 45 degrees.

References
----------
Jacobs et al. 2010 (seed paper), eq. 3; Maronna, Martin & Yohai, Robust Statistics (2006), ch. 6
(bivariate bisquare).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airswing.compass.fit.sandwich import (
    MANY,
    Array,
    Index,
    degrees_of_freedom,
    group_sums,
    influences,
    inverse_root,
)
from airswing.compass.fleet.blocks import SLOPES, Blocks, sum_blocks

COMPASS = 5
"""Each parameter vector begins with A, B, C, D, E, then s, then b_u and b_v of each member."""
LOCAL = COMPASS + 3
"""Parameters of the equation of one member: A to E, s, b_u, b_v."""
CUT_2D, CUT_1D = 5.0, 4.685
"""Tukey's constants: 95 % efficiency for a normal vector (two components) and a scalar."""
MEDIAN_CHI2 = 0.4549
"""Median of the square of a standard normal variable."""
THIN, MIDDLE = 1000, 4000
"""Reports of the samples that give the starting point and the variances."""
START_STEP = 15.0
"""Standard errors of the sample, reports taken as independent, below which a step ends the start:
a Newton step with robust weights leaves 2 to 3 % of itself, less than the error of the sample."""
FINAL_STEP = 3.0
"""Clustered standard errors below which a step ends the passes: what is left of it is below a tenth
of the standard error."""
START_STEPS, PASSES = 25, 12
"""Largest numbers of steps; both loops end earlier by the size of the step."""
ENOUGH = 2e-6
"""Radians: a step as small as this ends the passes whatever the standard error."""
FOLDS = 10
"""Parts of the days that are held out in turn (`airswing.compass.fit.held_out`)."""


@dataclass(frozen=True)
class Reports:
    """Reports of one aircraft against one reference, sorted by flight; arrays of shape (n,).

    Angles in radians, speeds in m s-1; without values that are not finite.
    """

    basis: Array  # (5, n): of the deviation, see `deviation_basis`
    heading: Array  # indicated true heading
    heading_error: Array  # against the reference
    airspeed: Array
    implied: Array  # airspeed that the reference implies
    variance: Array  # known variance of a component of the residual, m2 s-2
    flight: Index  # number of the flight within the aircraft, not decreasing
    latitude: Array  # degrees
    longitude: Array
    pressure: Array  # Pa
    time: NDArray[np.datetime64]

    def take(self, index: slice | Index) -> Reports:
        """Return some of the reports."""
        return Reports(*(getattr(self, name)[..., index] for name in self.__dataclass_fields__))

    @cached_property
    def opens(self) -> Index:
        """First report of each flight."""
        return np.flatnonzero(np.diff(self.flight, prepend=-1))


@dataclass(frozen=True)
class Scatter:
    """Variance of the residual's components, m2 s-2: a constant plus ``part`` of the known one."""

    along: float
    cross: float
    part: float


@dataclass(frozen=True)
class HeldOut:
    """Sums over each fold of days, for the disagreement with the reference of held-out reports.

    The squared vector disagreement after a correction by ``delta = x'theta``, with the reference's
    bias b removed, is ``before - 2 offset'b + weight b'b - 2 theta'(linear - bias b) +
    theta' square theta + O(delta^3)``, summed with the robust weights of the fit.
    """

    weight: Array  # (folds,)
    before: Array  # (folds,), m2 s-2
    linear: Array  # (folds, 5)
    square: Array  # (folds, 5, 5)
    bias: Array  # (folds, 5, 2)
    offset: Array  # (folds, 2)


@dataclass(frozen=True)
class AircraftFit:
    """Fit of one aircraft without the rest of the fleet; radians and m s-1.

    ``kappa`` is the mean slope of the robust score over the mean weight (Huber), by which steps and
    standard errors are divided.
    """

    theta: Array  # (p,): A, B, C, D, E, s, then b_u, b_v of each member
    free: Index  # which of them were fitted; the others are zero
    normal: Array  # (p, p): weighted normal matrix
    kappa: float
    flight: Array  # (flights, p): influence of each flight
    day: Array  # (days, p): influence of each day
    day_number: Index  # (days,): days since 1970
    freedom: Array  # (p,): degrees of freedom of the standard errors
    converged: bool
    rms_before: float  # robust rms of the heading error without and with the deviation removed
    rms_after: float
    flight_order: Index = field(repr=False)  # rows of ``flight`` in order of time
    blocks: list[Blocks] = field(repr=False, default_factory=list)  # one for each member
    held_out: list[HeldOut] = field(repr=False, default_factory=list)
    fold: Index = field(repr=False, default_factory=lambda: np.zeros(0, dtype=np.int64))
    scatters: list[Scatter] = field(repr=False, default_factory=list)

    @cached_property
    def covariance(self) -> Array:
        """Covariance clustered by flight."""
        return np.asarray(self.flight.T @ self.flight)

    @cached_property
    def day_covariance(self) -> Array:
        """Covariance clustered by day."""
        return np.asarray(self.day.T @ self.day)


class _Pass:
    """Residuals, design columns and robust weights of some reports at given parameters.

    Attributes
    ----------
    residual : array, shape (2, n)
        Across and along the fitted heading, m s-1.
    design : array, shape (2, 8, n)
        Derivatives of the residual by A to E, s, b_u, b_v.
    weight : array, shape (2, n)
        Inverse variance times Tukey's weight.
    tukey : array, shape (n,)
        Tukey's weight, 0 to 1.
    """

    def __init__(
        self,
        reports: Reports,
        theta: Array,
        scatter: Scatter | None,
        *,
        joint: bool,
        parted: bool = True,
    ) -> None:
        s, b_u, b_v = theta[COMPASS:]
        deviation = theta[:COMPASS] @ reports.basis
        self.rest = deviation - reports.heading_error
        fitted = reports.heading - deviation
        self.sine, self.cosine = np.sin(fitted), np.cos(fitted)
        speed = (1.0 - s) * reports.airspeed
        self.residual = np.stack(
            [
                reports.implied * np.sin(self.rest) + b_u * self.cosine - b_v * self.sine,
                reports.implied * np.cos(self.rest) - speed + b_u * self.sine + b_v * self.cosine,
            ]
        )
        self.scatter = scatter or _robust_scatter(self.residual, reports.variance, parted=parted)
        known = self.scatter.part * reports.variance
        self.weight = np.stack(
            [1.0 / (self.scatter.cross + known), 1.0 / (self.scatter.along + known)]
        )
        if not joint:
            self.weight[1] = 0.0
        squared = (self.residual**2 * self.weight).sum(axis=0)
        root = np.maximum(1.0 - squared / (CUT_2D if joint else CUT_1D) ** 2, 0.0)
        self.tukey = root**2
        self.weight *= self.tukey
        self.total = float(self.tukey.sum())
        # mean derivative of the weighted residual over its plane (two components) or line
        slope = (2.0 if joint else 4.0) * (float(root.sum()) - self.total)
        self.slope = self.total - slope
        self.design = np.zeros((2, LOCAL, reports.flight.size))
        np.multiply(reports.basis, speed, out=self.design[0, :COMPASS])
        self.design[0, 6:] = self.cosine, -self.sine
        self.design[1, COMPASS:] = reports.airspeed, self.sine, self.cosine
        across, along = self.design * self.weight[:, np.newaxis]
        self.weighted = across, along
        self.normal = across @ self.design[0].T + along @ self.design[1].T
        self.score = -(across @ self.residual[0] + along @ self.residual[1])

    def flight_scores(self, reports: Reports, flights: int) -> Array:
        """Return the score of each flight, shape (flights, 8)."""
        found = np.zeros((flights, LOCAL))
        each = self.weighted[0] * self.residual[0] + self.weighted[1] * self.residual[1]
        opens = reports.opens
        found[reports.flight[opens]] = -np.add.reduceat(each, opens, axis=1).T
        return found

    def flight_normals(self, reports: Reports, flights: int) -> Array:
        """Return the normal matrix of each flight, shape (flights, 8, 8)."""
        found = np.zeros((flights, LOCAL, LOCAL))
        edges = np.append(reports.opens, reports.flight.size)
        for begin, end in pairwise(edges.tolist()):
            for weighted, design in zip(self.weighted, self.design, strict=True):
                found[reports.flight[begin]] += weighted[:, begin:end] @ design[:, begin:end].T
        return found

    def block_rows(self, reports: Reports) -> Array:
        """Return what is summed over blocks, shape (15, n).

        The weight; the weighted residual as reference minus corrected wind, eastward and northward;
        its weighted derivatives by A to E and s, eastward and then northward.
        """
        rows = np.empty((3 + 2 * SLOPES, reports.flight.size))
        weight = rows[0] = self.weight[0]
        east, north = weight * self.sine, weight * self.cosine
        rows[1] = -self.residual[0] * north - self.residual[1] * east
        rows[2] = self.residual[0] * east - self.residual[1] * north
        across = self.design[0, :COMPASS]
        np.multiply(across, north, out=rows[3:8])
        rows[8] = reports.airspeed * east
        np.multiply(across, -east, out=rows[9:14])
        rows[14] = reports.airspeed * north
        return rows

    def held_out(self, reports: Reports, fold: Index) -> HeldOut:
        """Return the sums of each fold; ``fold`` (n,) is that of each report."""
        order, counts = np.argsort(fold, kind="stable"), np.bincount(fold, minlength=FOLDS)
        opens = np.cumsum(counts) - counts
        product = reports.airspeed * reports.implied * self.tukey
        sine = product * np.sin(reports.heading_error)
        cosine = product * np.cos(reports.heading_error)
        apart = (reports.airspeed - reports.implied) ** 2 * self.tukey + 2.0 * (product - cosine)
        heading, speed = reports.heading, reports.airspeed * self.tukey
        toward = heading - reports.heading_error
        # V_A - V'_A, of which the bias is a part
        difference = np.stack(
            [
                speed * np.sin(heading) - reports.implied * self.tukey * np.sin(toward),
                speed * np.cos(heading) - reports.implied * self.tukey * np.cos(toward),
            ]
        )
        normal = np.stack([speed * np.cos(heading), -speed * np.sin(heading)])
        found = HeldOut(
            np.bincount(fold, weights=self.tukey, minlength=FOLDS).astype(np.float64),
            np.bincount(fold, weights=apart, minlength=FOLDS).astype(np.float64),
            np.zeros((FOLDS, COMPASS)),
            np.zeros((FOLDS, COMPASS, COMPASS)),
            np.zeros((FOLDS, COMPASS, 2)),
            np.zeros((FOLDS, 2)),
        )
        for k, (begin, count) in enumerate(zip(opens, counts, strict=True)):
            rows = order[begin : begin + count]
            basis = reports.basis[:, rows]
            found.linear[k] = basis @ sine[rows]
            found.square[k] = (basis * cosine[rows]) @ basis.T
            found.bias[k] = basis @ normal[:, rows].T
            found.offset[k] = difference[:, rows].sum(axis=1)
        return found


def _robust_scatter(residual: Array, variance: Array, *, parted: bool) -> Scatter:
    """Return the variances of the residual from medians, which gross errors do not change.

    ``part``, the share of the known variance that the residuals show, comes from the halves of low
    and high known variance; it is 0 where not ``parted``, which is enough for a start.
    """
    cross, along = residual**2
    part, known = 0.0, 0.0
    if parted and variance.size > 1:
        middle = _median(variance)
        below = variance < middle
        if not below.any():  # more than half of the reports have the lowest variance
            below = variance <= middle
        small = float(variance[below].mean())
        spread = float(variance[~below].mean()) - small if not below.all() else 0.0
        if spread > 1e-9:
            above, along, cross = _median(cross[~below]), along[below], cross[below]
            part = min(max((above - _median(cross)) / MEDIAN_CHI2 / spread, 0.0), 1.0)
            known = part * small
    along_total, cross_total = _median(along) / MEDIAN_CHI2, _median(cross) / MEDIAN_CHI2
    # the known variance may be overstated: a tenth at least is left to the wind
    return Scatter(
        max(along_total - known, 0.1 * along_total, 1e-6),
        max(cross_total - known, 0.1 * cross_total, 1e-6),
        part,
    )


def _median(values: Array) -> float:
    middle = values.size // 2
    return float(np.partition(values, middle)[middle])


def fit_aircraft(
    members: list[Reports],
    flight_day: Index,
    *,
    joint: bool = True,
    harmonics: int = 2,
    with_blocks: bool = False,
) -> AircraftFit | None:
    """Fit A to E, the airspeed scale and the reference's bias of one aircraft.

    Parameters
    ----------
    members : list of Reports
        One for each reference of the pool, with the same numbers of flights.
    flight_day : array of int, shape (flights,)
        Day (since 1970) on which each flight began.
    joint : bool
        Fit the components across and along the heading together; else the heading error alone.
    harmonics : {0, 1, 2}
        Cycles of the deviation; 0: A and the airspeed scale alone, the bias zero.
    with_blocks : bool
        Also return the sums that the fit of the fleet needs.

    Returns
    -------
    AircraftFit or None
        None where a member has no report, or no report lies near any curve.
    """
    if not members or not all(part.flight.size for part in members):
        return None
    size = COMPASS + 1 + 2 * len(members)
    compass = np.arange(1 + 2 * harmonics)
    # on few headings a bias cannot be separated from A: the fleet's is removed afterwards
    last = size if harmonics else COMPASS + 1
    free = np.concatenate([compass, np.arange(COMPASS, last)]) if joint else compass
    square = np.ix_(free, free)
    flights, theta = flight_day.size, np.zeros(size)
    day_number, day = np.unique(flight_day, return_inverse=True)

    middle = [part.take(slice(None, None, max(part.flight.size // MIDDLE, 1))) for part in members]
    thin = [part.take(slice(None, None, max(part.flight.size // THIN, 1))) for part in middle]
    theta, _ = _start(thin, theta, free, joint=joint, hold=False)
    theta, scatters = _start(middle, theta, free, joint=joint, hold=True)
    for _ in range(PASSES):
        passes = [
            _Pass(part, theta[_place(k)], scatters[k], joint=joint)
            for k, part in enumerate(members)
        ]
        normal, score, kappa = _joined(passes, size)
        step = solve(normal[square], score[free]) / kappa
        scores = np.zeros((flights, size))
        for k, (part, one) in enumerate(zip(members, passes, strict=True)):
            scores[:, _place(k)] += one.flight_scores(part, flights)
        half = solve(normal[square], scores[:, free].T @ scores[:, free])
        spread = np.sqrt(np.maximum(np.diagonal(solve(normal[square], half.T)), 0.0)) / kappa
        converged = bool(np.all(np.abs(step) <= FINAL_STEP * spread + ENOUGH))
        before = theta.copy()
        theta[free] += step
        if converged:
            break
    total = sum(one.total for one in passes)
    if not total:
        return None

    normals = None
    if min(flights, day_number.size) < MANY:
        every = np.zeros((flights, size, size))
        for k, (part, one) in enumerate(zip(members, passes, strict=True)):
            place = _place(k)
            every[:, place[:, np.newaxis], place] += one.flight_normals(part, flights)
        normals = every[:, free[:, np.newaxis], free]
    # at the solution the scores add up to zero but for the last step
    centred = scores[:, free] - scores[:, free].mean(axis=0)
    root = inverse_root(normal[square])
    by_flight, by_day = np.zeros((flights, size)), np.zeros((day_number.size, size))
    by_flight[:, free] = influences(centred, root, normals, kappa)
    by_day[:, free] = influences(
        group_sums(centred, day, day_number.size),
        root,
        None if normals is None else group_sums(normals, day, day_number.size),
        kappa,
    )
    freedom = np.full(size, np.inf)
    freedom[free] = degrees_of_freedom(normal[square], normals, flights)
    squares = [
        sum(float(one.tukey @ angle**2) for one, angle in zip(passes, angles, strict=True))
        for angles in ([part.heading_error for part in members], [one.rest for one in passes])
    ]
    fold = (day if day_number.size >= 5 else np.arange(flights)) % FOLDS
    found = AircraftFit(
        theta,
        free,
        normal,
        kappa,
        by_flight,
        by_day,
        day_number,
        freedom,
        converged,
        float(np.sqrt(squares[0] / total)),
        float(np.sqrt(squares[1] / total)),
        np.argsort(day, kind="stable"),
        held_out=[
            one.held_out(part, fold[part.flight]) for part, one in zip(members, passes, strict=True)
        ],
        fold=fold,
        scatters=scatters,
    )
    if not with_blocks:
        return found
    move = (theta - before)[:SLOPES]
    blocks = [
        sum_blocks(
            one.block_rows(part),
            float((one.weight[0] ** 2 * (one.residual**2).sum(axis=0)).sum()),
            part,
            before[_place(k)[SLOPES:]],
            move,
            kappa,
        )
        for k, (part, one) in enumerate(zip(members, passes, strict=True))
    ]
    return replace(found, blocks=blocks)


def _start(
    few: list[Reports], theta: Array, free: Index, *, joint: bool, hold: bool
) -> tuple[Array, list[Scatter]]:
    """Make steps on a sample, with variances anew at each step or (``hold``) those of the first."""
    theta = theta.copy()
    scatters: list[Scatter] = []
    for number in range(START_STEPS):
        known = scatters if hold and scatters else [None] * len(few)
        passes = [
            _Pass(part, theta[_place(k)], one, joint=joint, parted=hold)
            for k, (part, one) in enumerate(zip(few, known, strict=True))
        ]
        scatters = [one.scatter for one in passes]
        normal, score, kappa = _joined(passes, theta.size)
        # far from the solution most weights are zero, kappa is small and the step would overshoot
        step = solve(normal[np.ix_(free, free)], score[free]) / max(kappa, 0.6)
        theta[free] += step
        small = np.all(np.abs(step) * np.sqrt(np.diagonal(normal)[free]) < START_STEP)
        if small and (hold or number):
            break
    return theta, scatters


def _place(member: int) -> Index:
    """Places of a member's parameters among all."""
    return np.array([*range(COMPASS + 1), COMPASS + 1 + 2 * member, COMPASS + 2 + 2 * member])


def _joined(passes: list[_Pass], size: int) -> tuple[Array, Array, float]:
    """Normal matrix and score of all parameters, and kappa."""
    normal, score = np.zeros((size, size)), np.zeros(size)
    for k, one in enumerate(passes):
        place = _place(k)
        normal[np.ix_(place, place)] += one.normal
        score[place] += one.score
    total, slope = sum(one.total for one in passes), sum(one.slope for one in passes)
    # about 0.8 for normal errors; near zero or negative where almost all residuals are gross
    return normal, score, max(slope / total, 0.2) if total > 0 else 1.0


def solve(normal: Array, score: Array) -> Array:
    """Solve symmetric equations after scaling; parameters without information stay near zero."""
    scale = np.sqrt(np.maximum(normal.diagonal(), 1e-30))
    square = normal / (scale * scale[:, np.newaxis])
    square.flat[:: scale.size + 1] += 1e-9
    return np.asarray((np.linalg.solve(square, (score.T / scale).T).T / scale).T)
