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
true heading; each component has a variance. Each member of a pool has a bias b and variances;
flights and days are the clusters for all members together.

Method
------
Gauss-Newton steps with Tukey's weights of the standardised vector residual (iteratively reweighted
least squares), so that gross errors have weight zero. The variances come from medians of the
residuals, anew at each step until a step is below `LARGEST_STEP` clustered standard errors; further
steps follow with these variances, until a step is as small again. Covariances are clustered by
flight and by day (`airswing.compass.fit.sandwich`).

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

import numpy as np

from airswing.compass.fit.sandwich import (
    MANY,
    Array,
    Index,
    degrees_of_freedom,
    group_sums,
    influences,
    inverse_root,
)
from airswing.compass.fleet.blocks import SLOPES, Blocks, Reports, sum_blocks

COMPASS = 5
"""Each parameter vector begins with A, B, C, D, E, then s, then b_u and b_v of each member."""
LOCAL = COMPASS + 3
"""Parameters of the equation of one member: A to E, s, b_u, b_v."""
CUT_2D, CUT_1D = 5.0, 4.685
"""Tukey's constants: 95 % efficiency for a normal vector (two components) and a scalar."""
MEDIAN_CHI2 = 0.4549
"""Median of the square of a standard normal variable."""
LARGEST_STEP = 0.3
"""Clustered standard errors below which a step ends the iteration: a Newton step with robust
weights leaves 2 to 3 % of itself, here a hundredth of the standard error."""
MOST_STEPS = 40
"""Limit of the number of steps; five to ten are usual."""
ENOUGH = 2e-6
"""Radians: a step as small as this ends the iteration whatever the standard error."""
FOLDS = 10
"""Parts of the days that are held out in turn (`airswing.compass.fit.held_out`)."""


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
    bias b removed, is a constant plus ``-2 offset'b + weight b'b - 2 theta'(linear - bias b) +
    theta' square theta + O(delta^3)``, summed with the robust weights of the fit.
    """

    weight: Array  # (folds,)
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
        self, reports: Reports, theta: Array, scatter: Scatter | None, *, joint: bool
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
        self.scatter = scatter or _robust_scatter(self.residual, reports.variance)
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
        each = self.weighted[0] * self.residual[0] + self.weighted[1] * self.residual[1]
        return -group_sums(each.T, reports.flight, flights)

    def flight_normals(self, reports: Reports, flights: int) -> Array:
        """Return the normal matrix of each flight, shape (flights, 8, 8)."""
        each = np.einsum("kin,kjn->nij", np.stack(self.weighted), self.design, optimize=False)
        return group_sums(each, reports.flight, flights)

    def block_rows(self, reports: Reports) -> Array:
        """Return the rows that are summed over blocks, shape (15, n).

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
        heading, speed = reports.heading, reports.airspeed * self.tukey
        product = speed * reports.implied
        sine = product * np.sin(reports.heading_error)
        cosine = product * np.cos(reports.heading_error)
        toward, other = heading - reports.heading_error, reports.implied * self.tukey
        # V_A - V'_A, of which the bias is a part
        difference = np.stack(
            [
                speed * np.sin(heading) - other * np.sin(toward),
                speed * np.cos(heading) - other * np.cos(toward),
            ]
        )
        normal = np.stack([speed * np.cos(heading), -speed * np.sin(heading)])
        found = HeldOut(
            np.bincount(fold, weights=self.tukey, minlength=FOLDS).astype(np.float64),
            np.zeros((FOLDS, COMPASS)),
            np.zeros((FOLDS, COMPASS, COMPASS)),
            np.zeros((FOLDS, COMPASS, 2)),
            np.zeros((FOLDS, 2)),
        )
        for k in range(FOLDS):
            rows = np.flatnonzero(fold == k)
            basis = reports.basis[:, rows]
            found.linear[k] = basis @ sine[rows]
            found.square[k] = (basis * cosine[rows]) @ basis.T
            found.bias[k] = basis @ normal[:, rows].T
            found.offset[k] = difference[:, rows].sum(axis=1)
        return found


def _robust_scatter(residual: Array, variance: Array) -> Scatter:
    """Return the variances of the residual from medians, which gross errors do not change.

    ``part``, the share of the known variance that the residuals show, comes from the halves of low
    and high known variance.
    """
    cross, along = residual**2
    part, known = 0.0, 0.0
    middle = np.median(variance)
    # more than half of the reports may have the lowest variance
    below = variance < middle if (variance < middle).any() else variance <= middle
    small = float(variance[below].mean())
    spread = float(variance[~below].mean()) - small if not below.all() else 0.0
    if spread > 1e-9:
        above, along, cross = np.median(cross[~below]), along[below], cross[below]
        part = min(max(float(above - np.median(cross)) / MEDIAN_CHI2 / spread, 0.0), 1.0)
        known = part * small
    along_total, cross_total = (float(np.median(each)) / MEDIAN_CHI2 for each in (along, cross))
    # the known variance may be overstated: a tenth at least is left to the wind
    return Scatter(
        max(along_total - known, 0.1 * along_total, 1e-6),
        max(cross_total - known, 0.1 * cross_total, 1e-6),
        part,
    )


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

    places = [
        np.array([*range(COMPASS + 1), COMPASS + 1 + 2 * k, COMPASS + 2 + 2 * k])
        for k in range(len(members))
    ]
    scatters: list[Scatter | None] = [None] * len(members)
    for number in range(MOST_STEPS):
        passes = [
            _Pass(part, theta[place], scatter, joint=joint)
            for part, place, scatter in zip(members, places, scatters, strict=True)
        ]
        held = scatters[0] is not None
        normal, score, scores = np.zeros((size, size)), np.zeros(size), np.zeros((flights, size))
        for part, one, place in zip(members, passes, places, strict=True):
            normal[np.ix_(place, place)] += one.normal
            score[place] += one.score
            scores[:, place] += one.flight_scores(part, flights)
        total = sum(one.total for one in passes)
        # about 0.8 for normal errors; near zero or negative where almost all residuals are gross
        kappa = max(sum(one.slope for one in passes) / total, 0.2) if total else 1.0
        # at a distance from the solution most weights are zero, and the step would be too long
        step = solve(normal[square], score[free]) / (kappa if held else max(kappa, 0.6))
        half = solve(normal[square], scores[:, free].T @ scores[:, free])
        spread = np.sqrt(np.maximum(np.diagonal(solve(normal[square], half.T)), 0.0)) / kappa
        small = bool(np.all(np.abs(step) <= LARGEST_STEP * spread + ENOUGH))
        before = theta.copy()
        theta[free] += step
        if small and held:
            break
        if small and number:
            scatters = [one.scatter for one in passes]
    converged = small and held
    if not total:
        return None

    normals = None
    if min(flights, day_number.size) < MANY:
        every = np.zeros((flights, size, size))
        for part, one, place in zip(members, passes, places, strict=True):
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
        scatters=[one.scatter for one in passes],
    )
    if not with_blocks:
        return found
    move = (theta - before)[:SLOPES]
    blocks = [
        sum_blocks(
            one.block_rows(part),
            float((one.weight[0] ** 2 * (one.residual**2).sum(axis=0)).sum()),
            part,
            before[place[SLOPES:]],
            move,
            kappa,
        )
        for part, one, place in zip(members, passes, places, strict=True)
    ]
    return replace(found, blocks=blocks)


def solve(normal: Array, score: Array) -> Array:
    """Solve symmetric equations after scaling; parameters without information stay near zero."""
    scale = np.sqrt(np.maximum(normal.diagonal(), 1e-30))
    square = normal / (scale * scale[:, np.newaxis])
    square.flat[:: scale.size + 1] += 1e-9
    return np.asarray((np.linalg.solve(square, (score.T / scale).T).T / scale).T)
