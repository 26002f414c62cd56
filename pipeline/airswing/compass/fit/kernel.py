"""Robust joint fit of one aircraft's deviation against one reference or a pool of references.

The equation V'_A = V (1 - s) h(psi - delta(m)) - b + noise and its symbols are those of
docs/method.md ("The deviation"). The noise does not enter psi, m or V, so that least squares has no
bias, however large delta is. Residuals are resolved along and across the fitted true heading, with
a variance each. Each member of a pool has a bias and variances.

The fit takes Gauss-Newton steps with Tukey's weights of the standardised vector residual: gross
errors have weight zero. The variances are computed from medians of the residuals at each step until
a step is below `LARGEST_STEP` clustered standard errors; they are then held fixed until a step is
again as small.

Clusters (flights, days) are independent of each other; nothing is assumed inside one. The parameter
error is the sum over clusters of M s_g, M the inverse of the slope matrix and s_g the cluster's
score, and the covariance the sum of the outer products (sandwich). With few clusters each score is
divided by (I - N_g / N)^(1/2), which makes the estimate unbiased under the working model (CR2), and
the interval takes Student's t with 1 / sum p_g^2 degrees of freedom, p_g the cluster's share of the
information on that parameter.

Radians and m s-1; valid for deviations below about 45 degrees.

References
----------
Jacobs et al. 2010, eq. 3; Maronna, Martin & Yohai, Robust Statistics (2006), ch. 6
(bivariate bisquare); Bell & McCaffrey 2002 (Survey Methodology 28); Pustejovsky & Tipton 2018 (J.
Bus. Econ. Stat. 36); MacKinnon, Nielsen & Webb 2023 (J. Econometrics 232).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from airswing.compass.fleet.field import SLOPES, Array, Blocks, Index, Reports, sum_blocks

COMPASS = 5
"""Each parameter vector begins with A, B, C, D, E, then s, then b_u and b_v of each member."""
LOCAL = COMPASS + 3  # parameters of the equation of one member: A to E, s, b_u, b_v
CUT_2D, CUT_1D = 5.0, 4.685
"""Tukey's constants: 95 % efficiency for a normal vector (two components) and a scalar."""
MEDIAN_CHI2 = 0.4549  # median of the square of a standard normal variable
LARGEST_STEP = 0.3
"""Clustered standard errors below which a step ends the iteration: a Newton step with robust
weights leaves 2 to 3 % of its length, here a hundredth of the standard error."""
MOST_STEPS = 40  # five to ten are usual
ENOUGH = 2e-6  # radians: a step as small as this ends the iteration for any standard error
FOLDS = 10  # parts of the days that are held out in turn
MANY = 150  # least number of clusters for which one common factor accounts for the leverage


@dataclass(frozen=True)
class Scatter:
    """Variance of the residual's components, m2 s-2: constant plus ``share`` of the known one."""

    along: float
    cross: float
    share: float


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
    """Fit of one aircraft without the rest of the fleet; radians and m s-1."""

    theta: Array  # (p,): A, B, C, D, E, s, then b_u, b_v of each member
    free: Index  # which of them were fitted; the others are zero
    normal: Array  # (p, p): weighted normal matrix
    flight: Array  # (flights, p): influence of each flight
    day: Array  # (days, p): influence of each day
    day_number: Index  # (days,): days since 1970
    freedom: Array  # (p,): degrees of freedom of the standard errors
    converged: bool
    rms_before: float  # robust rms of the heading error without and with the deviation removed
    rms_after: float
    flight_order: Index  # rows of ``flight`` in order of time
    fold: Index  # (flights,): part of the days
    held_out: list[HeldOut] = field(repr=False)  # one for each member; so are the following
    blocks: list[Blocks] = field(repr=False)

    @cached_property
    def covariance(self) -> Array:
        """Covariance clustered by flight."""
        return np.asarray(self.flight.T @ self.flight)

    @cached_property
    def day_covariance(self) -> Array:
        """Covariance clustered by day."""
        return np.asarray(self.day.T @ self.day)

    @property
    def cycles(self) -> int:
        """Cycles of the deviation, 1 or 2."""
        return 2 if 4 in self.free else 1


class _MemberModel:
    """Residuals, design columns and robust weights of some reports at given parameters."""

    def __init__(
        self, reports: Reports, theta: Array, scatter: Scatter | None, *, joint: bool
    ) -> None:
        s, b_u, b_v = theta[COMPASS:]
        deviation = theta[:COMPASS] @ reports.basis
        self.reports, self.rest = reports, deviation - reports.heading_error
        fitted = reports.heading - deviation
        self.sine, self.cosine = np.sin(fitted), np.cos(fitted)
        speed = (1.0 - s) * reports.airspeed
        # across and along the fitted heading
        self.residual = np.stack(
            [
                reports.implied * np.sin(self.rest) + b_u * self.cosine - b_v * self.sine,
                reports.implied * np.cos(self.rest) - speed + b_u * self.sine + b_v * self.cosine,
            ]
        )
        self.scatter = scatter or robust_scatter(self.residual, reports.variance)
        variance = self.scatter.share * reports.variance
        # inverse variance times Tukey's weight
        self.weight = np.stack(
            [1.0 / (self.scatter.cross + variance), 1.0 / (self.scatter.along + variance)]
        )
        if not joint:
            self.weight[1] = 0.0
        squared = (self.residual**2 * self.weight).sum(axis=0)
        root = np.maximum(1.0 - squared / (CUT_2D if joint else CUT_1D) ** 2, 0.0)
        self.tukey = root**2
        self.weight *= self.tukey
        self.total = float(self.tukey.sum())
        # mean derivative of the weighted residual over its plane (two components) or line
        self.slope = self.total - (2.0 if joint else 4.0) * (float(root.sum()) - self.total)
        # derivatives of the residual by A to E, s, b_u, b_v
        self.design = np.zeros((2, LOCAL, reports.flight.size))
        np.multiply(reports.basis, speed, out=self.design[0, :COMPASS])
        self.design[0, 6:] = self.cosine, -self.sine
        self.design[1, COMPASS:] = reports.airspeed, self.sine, self.cosine
        across, ahead = self.design[0], self.design[1, COMPASS:]
        pull = self.weight * self.residual
        self.terms = across * pull[0]  # (8, n): of the score
        self.terms[COMPASS:] += ahead * pull[1]
        self.normal = (across * self.weight[0]) @ across.T
        self.normal[COMPASS:, COMPASS:] += (ahead * self.weight[1]) @ ahead.T

    def blocks(self, bias: Array, step: Array, kappa: float) -> Blocks:
        """Sums of the blocks; ``bias`` of the residual, ``step`` of A to E and s after it."""
        reports = self.reports
        # weight; weighted residual as reference minus corrected wind, eastward and northward; its
        # weighted derivatives by A to E and s, eastward and then northward
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
        square = float((weight**2 * (self.residual**2).sum(axis=0)).sum())
        return sum_blocks(rows, square, reports, bias, step, kappa)

    def held_out(self, fold: Index) -> HeldOut:
        """Sums of each fold; ``fold`` (n,) is that of each report."""
        reports = self.reports
        heading, speed = reports.heading, reports.airspeed * self.tukey
        product = speed * reports.implied
        linear = reports.basis * product * np.sin(reports.heading_error)
        square = reports.basis * product * np.cos(reports.heading_error)
        toward, implied = heading - reports.heading_error, reports.implied * self.tukey
        # V_A - V'_A, of which the bias is a part
        offset = np.stack(
            [
                speed * np.sin(heading) - implied * np.sin(toward),
                speed * np.cos(heading) - implied * np.cos(toward),
            ]
        )
        normal = np.stack([speed * np.cos(heading), -speed * np.sin(heading)])
        folds = [np.flatnonzero(fold == k) for k in range(FOLDS)]
        basis = reports.basis.T
        return HeldOut(
            np.array([self.tukey[rows].sum() for rows in folds]),
            np.array([linear[:, rows].sum(axis=1) for rows in folds]),
            np.array([square[:, rows] @ basis[rows] for rows in folds]),
            np.array([(normal[:, rows] @ basis[rows]).T for rows in folds]),
            np.array([offset[:, rows].sum(axis=1) for rows in folds]),
        )


def robust_scatter(residual: Array, variance: Array) -> Scatter:
    """Variances of the residual (2, n) from medians, which gross errors do not change.

    ``share``, the part of the known variance (n,) that the residuals show, comes from the halves of
    low and high known variance.
    """
    cross, along = residual**2
    share, explained = 0.0, 0.0
    middle = np.median(variance)
    # more than half of the reports may have the lowest variance
    below = variance < middle if (variance < middle).any() else variance <= middle
    small = float(variance[below].mean())
    spread = float(variance[~below].mean()) - small if not below.all() else 0.0
    if spread > 1e-9:
        above, along, cross = np.median(cross[~below]), along[below], cross[below]
        share = min(max(float(above - np.median(cross)) / MEDIAN_CHI2 / spread, 0.0), 1.0)
        explained = share * small
    raw_along, raw_cross = (float(np.median(square)) / MEDIAN_CHI2 for square in (along, cross))
    # the known variance may be overstated: at least a tenth is attributed to the wind
    return Scatter(
        max(raw_along - explained, 0.1 * raw_along, 1e-6),
        max(raw_cross - explained, 0.1 * raw_cross, 1e-6),
        share,
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

    ``members`` are its reports against each reference of the pool, with the same numbers of
    flights; ``flight_day`` (flights,) the days (since 1970) on which the flights began. With
    ``joint`` the components across and along the heading are fitted together, else the heading
    error only. ``harmonics`` 0: only A and the airspeed scale, with zero bias. ``with_blocks`` also
    returns the sums that the fit of the fleet needs. None where a member has no report, or no
    report lies near any curve.
    """
    if not members or not all(reports.flight.size for reports in members):
        return None
    size = COMPASS + 1 + 2 * len(members)
    compass = np.arange(1 + 2 * harmonics)
    # on few headings a bias cannot be separated from A: the fleet's is removed afterwards
    last = size if harmonics else COMPASS + 1
    free = np.concatenate([compass, np.arange(COMPASS, last)]) if joint else compass
    square = np.ix_(free, free)
    flights, theta = flight_day.size, np.zeros(size)
    day_number, day = np.unique(flight_day, return_inverse=True)
    places = [np.r_[: COMPASS + 1, k : k + 2] for k in range(COMPASS + 1, size, 2)]
    scatters: list[Scatter | None] = [None] * len(members)
    for number in range(MOST_STEPS):
        models = [
            _MemberModel(reports, theta[place], scatter, joint=joint)
            for reports, place, scatter in zip(members, places, scatters, strict=True)
        ]
        is_fixed = scatters[0] is not None
        normal, score, scores = np.zeros((size, size)), np.zeros(size), np.zeros((flights, size))
        for model, place in zip(models, places, strict=True):
            normal[np.ix_(place, place)] += model.normal
            score[place] -= model.terms.sum(axis=1)
            scores[:, place] -= group_sums(model.terms.T, model.reports.flight, flights)
        total = sum(model.total for model in models)
        # slope of the robust score over the mean weight (Huber): about 0.8 for normal errors; near
        # zero or negative where almost all residuals are gross
        kappa = max(sum(model.slope for model in models) / total, 0.2) if total else 1.0
        # far from the solution most weights are zero, and the step would be too long
        step = solve(normal[square], score[free]) / (kappa if is_fixed else max(kappa, 0.6))
        half = solve(normal[square], scores[:, free].T @ scores[:, free])
        spread = np.sqrt(np.maximum(np.diagonal(solve(normal[square], half.T)), 0.0)) / kappa
        small = bool(np.all(np.abs(step) <= LARGEST_STEP * spread + ENOUGH))
        before = theta.copy()
        theta[free] += step
        if small and is_fixed:
            break
        # residuals of a constant contain the cycles on the headings flown: variances that follow
        # the steps would shrink around one of two headings, and the other would pass for gross
        # errors
        if (small and number) or (number == 1 and not harmonics):
            scatters = [model.scatter for model in models]
    if not total:
        return None

    normals = None
    if min(flights, day_number.size) < MANY:
        sums = np.zeros((flights, size, size))
        for model, place in zip(models, places, strict=True):
            weighted = model.design * model.weight[:, np.newaxis]
            terms = np.einsum("kin,kjn->nij", weighted, model.design, optimize=False)
            sums[:, place[:, np.newaxis], place] += group_sums(terms, model.reports.flight, flights)
        normals = sums[:, free[:, np.newaxis], free]
    # at the solution the scores add up to zero except for the last step
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
    rms_before, rms_after = (
        float(np.sqrt(sum(float(model.tukey @ angle**2) for model, angle in pairs) / total))
        for pairs in (
            [(model, model.reports.heading_error) for model in models],
            [(model, model.rest) for model in models],
        )
    )
    fold = (day if day_number.size >= 5 else np.arange(flights)) % FOLDS
    move = (theta - before)[:SLOPES]
    return AircraftFit(
        theta,
        free,
        normal,
        by_flight,
        by_day,
        day_number,
        freedom,
        small and is_fixed,
        rms_before,
        rms_after,
        np.argsort(day, kind="stable"),
        fold,
        [model.held_out(fold[model.reports.flight]) for model in models],
        [
            model.blocks(before[place[SLOPES:]], move, kappa)
            for model, place in zip(models, places, strict=True)
            if with_blocks
        ],
    )


def solve(normal: Array, score: Array) -> Array:
    """Solve symmetric equations after scaling; parameters without information stay near zero."""
    scale = np.sqrt(np.maximum(normal.diagonal(), 1e-30))
    square = normal / (scale * scale[:, np.newaxis])
    square.flat[:: scale.size + 1] += 1e-9
    return np.asarray((np.linalg.solve(square, (score.T / scale).T).T / scale).T)


def group_sums(values: Array, group: Index, groups: int) -> Array:
    """Sums of rows (n, ...) by group, 0 to ``groups - 1``."""
    sums = np.zeros((groups, *values.shape[1:]))
    if group.size:
        if np.any(group[1:] < group[:-1]):
            # a stable sort keeps the order within a group, and sums are the same to the last bit
            order = np.argsort(group, kind="stable")
            values, group = values[order], group[order]
        first = np.flatnonzero(np.diff(group, prepend=-1))
        sums[group[first]] = np.add.reduceat(values, first, axis=0)
    return sums


def inverse_root(normal: Array) -> Array:
    """Matrix whose product with its transpose is the inverse of a normal matrix."""
    values, vectors = np.linalg.eigh(normal)
    # rounding can make the smallest slightly negative, which means a very large error
    return np.asarray(vectors / np.sqrt(np.maximum(values, values[-1] * 1e-14)))


def influences(score: Array, inverse_root: Array, normals: Array | None, kappa: float) -> Array:
    """Share of every cluster in the error of the parameters (g, p).

    ``score`` (g, p) and ``normals`` (g, p, p) are those of the clusters, ``inverse_root`` that of
    the normal matrix of all; without ``normals`` the leverage is a common factor g / (g - p).
    M is (kappa N)^-1. The sum of the outer products is the covariance.
    """
    clusters, size = score.shape
    if normals is None:
        factor = clusters / max(clusters - size, 1)
        return np.asarray(score @ (inverse_root @ inverse_root.T * (np.sqrt(factor) / kappa)))
    whitened = score @ inverse_root
    leverage, axes = np.linalg.eigh(inverse_root.T @ normals @ inverse_root)
    # the leverage is one where a single cluster determines a parameter: its residual is zero
    gain = 1.0 / np.sqrt(np.clip(1.0 - leverage, 0.05, 1.0))
    turned = (whitened[:, np.newaxis, :] @ axes)[:, 0, :] * gain
    whitened = (axes @ turned[..., np.newaxis])[..., 0]
    return np.asarray(whitened @ inverse_root.T / kappa)


def degrees_of_freedom(normal: Array, normals: Array | None, clusters: int) -> Array:
    """Degrees of freedom of the standard errors (p,); arguments as of :func:`influences`."""
    if normals is None:
        # flights have unequal weights: a third of their number is a cautious bound
        return np.full(normal.shape[0], max(clusters / 3.0, 1.0))
    inverse = np.linalg.pinv(normal, hermitian=True)
    contribution = ((inverse @ normals) * inverse.T).sum(axis=2)
    # a parameter that is held fixed has no information in any flight
    share = contribution / np.maximum(contribution.sum(axis=0), 1e-300)
    return np.asarray(np.maximum(1.0 / np.maximum((share**2).sum(axis=0), 1e-12) - 1.0, 1.0))
