"""Deviations of a fleet and the error of its references, estimated together.

The fits of single aircraft are accurate enough for one linear step. The unknowns are those of
`airswing.compass.fleet.information`, for all references together. Prior variances of the biases and
of the lasting parts are estimated by restricted maximum likelihood (Schall's steps). The
coefficients of the aircraft have no prior: a fleet with large deviations must not be shrunk to its
mean. Up to `MOST_EXACT` unknowns the matrix is formed and inverted. With more unknowns

* systems are solved by `scipy.sparse.linalg.cg`, preconditioned with the blocks of each aircraft
  and of each lasting part;
* traces and sums of squares are estimated with random signs (Hutchinson), the same in every run;
* an aircraft's covariance is the inverse of its block, plus the contribution of the lasting part,
  which is exact, times the mean over the fleet of the ratio of the true variances to these.

Errors of different days (four segments, UTC) are taken as independent; within a day any correlation
is allowed. The covariance is the model's times the fleet's mean ratio of the sandwich over days to
the model's, for each coefficient, because the days of one aircraft are too few; in an archive of
few days this ratio is at least one.

References
----------
Henderson 1975, Biometrics 31, 423-447; Schall 1991, Biometrika 78, 719-727; Hutchinson 1990, Comm.
Stat. Simul. Comput. 19, 433-450; Liang & Zeger 1986, Biometrika 73, 13-22 (sandwich).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from airswing.compass.fit.kernel import FOLDS
from airswing.compass.fleet.field import LARGEST_VARIANCE, SLOPES, Array, Blocks, Index
from airswing.compass.fleet.information import Reference
from airswing.errors import InputError

SEGMENTS_A_DAY = 4  # segments of six hours, as in `airswing.compass.fleet.field`
FEW_DAYS = 15
"""Number of days below which their scatter may widen the model's covariance and not narrow it."""
MOST_EXACT = 1500
"""Unknowns up to which the matrix is formed: some 170 aircraft against one reference."""
ROUNDS = 20  # most rounds of the prior variances
STEP, COARSE_STEP = 1e-8, 1e-3
"""Relative change of every variance that ends the rounds: exact, and with random signs."""
FIRST_VARIANCE, SMALLEST_VARIANCE = 0.05, 1e-4  # (m/s)2
UNKNOWN_VARIANCE = 1e6  # (m/s)2: variance of an unknown without prior
FINE, COARSE = 1e-7, 1e-4
"""Relative residual at which the solver stops, for the estimate and for variances."""
ITERATIONS = 1000  # most iterations of the conjugate gradients
COLUMNS = 32  # columns multiplied at a time
SIGNS, MANY_SIGNS = 8, 32  # number of vectors of random signs for a trace, and for a sum of squares


@dataclass(frozen=True)
class FleetFit:
    """Joint estimate."""

    step: Array  # (aircraft, 6): to add to A to E and airspeed scale of the single fits, radians
    covariance: Array  # (aircraft, 6, 6)
    # (FOLDS, aircraft, 6): change of the estimate without the days of each part, except for the
    # weight of the other days: to first order, the equations of the days being additive
    without: Array
    bias: Array  # (2,): mean error of the references over the blocks, m/s
    bias_covariance: Array  # (2, 2)
    regions: int  # largest number of regions of a reference's passing part


def solve_fleet(blocks: list[list[Blocks]], free: NDArray[np.bool_]) -> FleetFit:
    """Estimate deviations and reference error of a fleet.

    ``blocks`` are those of every aircraft, one for each reference; ``free`` (aircraft, 6) are the
    coefficients that are fitted.
    """
    segments = np.concatenate([np.unique(sums.segment) for row in blocks for sums in row])
    days = np.unique(segments // SEGMENTS_A_DAY) * SEGMENTS_A_DAY
    references = [Reference([row[k] for row in blocks], free, days) for k in range(len(blocks[0]))]
    system = Equations(references, free)
    right = np.zeros(system.size)
    for reference, place in zip(references, system.places, strict=True):
        right[place] += reference.start.sum(axis=0)
    inverse = (ExactInverse if system.size <= MOST_EXACT else IterativeInverse)(system, right)
    solution = inverse.solve(right)
    scores = np.zeros((days.size, right.size))
    for reference, place in zip(references, system.places, strict=True):
        scores[:, place] += reference.scores(solution[place])
    solution = solution + inverse.solve(scores.sum(axis=0) - inverse.prior * solution)

    # by part of the days; about their mean, as they add up to the score of the prior
    centred = scores - scores.mean(axis=0)
    fold = days // SEGMENTS_A_DAY % FOLDS
    by_fold = np.array([centred[fold == k].sum(axis=0) for k in range(FOLDS)])
    without = -inverse.solve(by_fold.T)

    square = inverse.covariances()
    inflation = inverse.squares(centred.T) + inverse.prior_squares()
    inflation /= np.diagonal(square, axis1=1, axis2=2)
    inflation /= 1.0 - np.mean([reference.leverage() for reference in references], axis=0)
    ratio = np.array(
        [inflation[:, k][free[:, k]].mean() if free[:, k].any() else 1.0 for k in range(SLOPES)]
    )
    for pair in ([1, 2], [3, 4]):
        ratio[pair] = ratio[pair].mean()
    if days.size < FEW_DAYS:
        ratio = np.maximum(ratio, 1.0)
    root = np.sqrt(ratio) * free
    # the mean error of the references over the blocks, from biases and lasting parts
    rows = np.zeros((2, system.size))
    for reference, craft, lasting in zip(references, system.craft, system.lasting, strict=True):
        total = reference.worth.sum() * len(references)
        for c in range(2):
            rows[c, craft[:, SLOPES + c]] = reference.worth / total
            rows[c, lasting[c]] = reference.lasting_worth / total
    return FleetFit(
        solution[: free.size].reshape(free.shape),
        square * root[:, :, np.newaxis] * root[:, np.newaxis],
        without[: free.size].T.reshape(FOLDS, *free.shape),
        rows @ solution,
        rows @ inverse.solve(rows.T) * max(float(ratio.mean()), 1.0),
        max(reference.basis.regions for reference in references),
    )


class Equations:
    """The Newton matrix without its prior.

    The coefficients come first (aircraft, 6), then each reference's biases and lasting part.
    """

    def __init__(self, references: list[Reference], free: NDArray[np.bool_]) -> None:
        self.references, self.free, self.aircraft = references, free, free.shape[0]
        # of each reference: its unknowns among all, those of the aircraft (aircraft, 8), and those
        # of the lasting part (2, functions)
        self.places: list[Index] = []
        self.craft: list[Index] = []
        self.lasting: list[Index] = []
        # unknowns that share a prior variance: biases and lasting part of each reference. The mean
        # of a lasting part, the last of its functions, has no prior.
        self.groups: list[Index] = []
        coefficients, start = np.arange(free.size), free.size
        for reference in references:
            bias = start + np.arange(2 * self.aircraft).reshape(self.aircraft, 2)
            lasting = start + bias.size + np.arange(2 * reference.functions).reshape(2, -1)
            self.craft.append(np.hstack([coefficients.reshape(free.shape), bias]))
            self.lasting.append(lasting)
            self.places.append(np.concatenate([coefficients, bias.ravel(), lasting.ravel()]))
            self.groups += [bias.ravel(), lasting[:, :-1].ravel()]
            start += bias.size + lasting.size
        self.size = start

    def times(self, values: Array) -> Array:
        """Multiply with some columns, (size, k)."""
        product = np.zeros_like(values)
        for reference, rows, lasting in zip(self.references, self.craft, self.lasting, strict=True):
            above, below = reference.times(values[rows], values[lasting])
            product[rows] += above
            product[lasting] += below
        return product


class ExactInverse:
    """Inverse of the Newton matrix of few aircraft, with its prior."""

    def __init__(self, equations: Equations, right: Array) -> None:
        self.aircraft, shared = equations.aircraft, equations.free.size
        unit = np.eye(equations.size)
        newton = np.hstack(
            [equations.times(unit[:, k : k + COLUMNS]) for k in range(0, equations.size, COLUMNS)]
        )
        newton = (newton + newton.T) / 2.0
        diagonal = np.arange(shared)
        # a coefficient held at zero gets the largest information, so that it hardly changes
        newton[diagonal, diagonal] += np.where(
            equations.free.ravel(), 0.0, np.diagonal(newton)[:shared].max()
        )
        # the coefficients are eliminated; the rest gives the prior variances
        top = np.linalg.solve(
            newton[:shared, :shared], np.column_stack([newton[:shared, shared:], right[:shared]])
        )
        square = newton[shared:, shared:] - newton[shared:, :shared] @ top[:, :-1]
        score = right[shared:] - newton[shared:, :shared] @ top[:, -1]
        groups = [group - shared for group in equations.groups]
        self.prior = np.zeros(right.size)
        self.prior[shared:] = 1.0 / group_variances(square, score, groups)
        self.covariance = np.linalg.inv(newton + np.diag(self.prior))

    def solve(self, right: Array) -> Array:
        """Multiply the inverse with a vector or some columns, (unknowns, ...)."""
        return np.asarray(self.covariance @ right)

    def covariances(self) -> Array:
        """Block of each aircraft's coefficients, (aircraft, 6, 6)."""
        index = np.arange(self.aircraft * SLOPES).reshape(self.aircraft, SLOPES)
        return np.asarray(self.covariance[index[:, :, np.newaxis], index[:, np.newaxis]])

    def squares(self, columns: Array) -> Array:
        """Sum of squares of the products with some columns, (aircraft, 6)."""
        product = self.covariance[: self.aircraft * SLOPES] @ columns
        return np.asarray((product**2).sum(axis=1).reshape(self.aircraft, SLOPES))

    def prior_squares(self) -> Array:
        """Sum of squares with the prior as weights, (aircraft, 6)."""
        total = self.covariance[: self.aircraft * SLOPES] ** 2 @ self.prior
        return np.asarray(total.reshape(self.aircraft, SLOPES))


class IterativeInverse:
    """Inverse of the Newton matrix of many aircraft, never formed; methods as in `ExactInverse`."""

    def __init__(self, equations: Equations, right: Array) -> None:
        self.equations, self.aircraft = equations, equations.aircraft
        biases = [craft[:, SLOPES:] for craft in equations.craft]
        # coefficients and all biases of each aircraft
        self.place = np.hstack([equations.craft[0][:, :SLOPES], *biases])
        width = self.place.shape[1]
        self.blocks = np.zeros((self.aircraft, width, width))
        for k, reference in enumerate(equations.references):
            columns = np.array([*range(SLOPES), SLOPES + 2 * k, SLOPES + 2 * k + 1])
            self.blocks[:, columns[:, np.newaxis], columns] += reference.aircraft_blocks()
        self.fixed = np.zeros(right.size)
        diagonal = np.diagonal(self.blocks, axis1=1, axis2=2)[:, :SLOPES]
        self.fixed[: equations.free.size] = np.where(equations.free, 0.0, diagonal.max()).ravel()
        self.lasting = [reference.lasting_block() for reference in equations.references]
        self._estimate_prior(right)

    def solve(self, right: Array) -> Array:
        """As in `ExactInverse`."""
        return self._solve_columns(right.reshape(right.shape[0], -1), FINE).reshape(right.shape)

    def covariances(self) -> Array:
        """As in `ExactInverse`."""
        low = np.concatenate([lasting.ravel() for lasting in self.equations.lasting])
        unit = np.zeros((self.prior.size, low.size))
        unit[low, np.arange(low.size)] = 1.0
        solved = self._solve_columns(unit, COARSE)
        among = solved[low]
        # symmetric only within the tolerance of the solver
        root = np.linalg.cholesky(np.linalg.inv((among + among.T) / 2.0))
        factor = solved[self.place[:, :SLOPES]] @ root
        covariance = self.inverse[:, :SLOPES, :SLOPES] + factor @ factor.transpose(0, 2, 1)
        # mean over the fleet of the true variances over these, by coefficient: Hutchinson's
        # estimate of a trace, each aircraft scaled to one
        variance, ratio = np.diagonal(covariance, axis1=1, axis2=2), np.ones(SLOPES)
        for k in np.flatnonzero(self.equations.free.any(axis=0)):
            rows = np.flatnonzero(self.equations.free[:, k])
            right = np.zeros((self.prior.size, SIGNS))
            right[self.place[rows, k]] = _signs(rows.size, SIGNS) / np.sqrt(
                variance[rows, k, np.newaxis]
            )
            ratio[k] = (right * self._solve_columns(right, COARSE)).sum() / (SIGNS * rows.size)
        root = np.sqrt(ratio)
        return np.asarray(covariance * root[:, np.newaxis] * root)

    def squares(self, columns: Array) -> Array:
        """As in `ExactInverse`; many columns are reduced by random signs, with the same mean."""
        number = columns.shape[1]
        if number > MANY_SIGNS:
            columns = columns @ _signs(number, MANY_SIGNS) / np.sqrt(MANY_SIGNS)
        product = self._solve_columns(columns, COARSE)[: self.aircraft * SLOPES]
        return np.asarray((product**2).sum(axis=1).reshape(self.aircraft, SLOPES))

    def prior_squares(self) -> Array:
        """As in `ExactInverse`."""
        signs = _signs(self.prior.size, MANY_SIGNS) / np.sqrt(MANY_SIGNS)
        return self.squares(np.sqrt(self.prior)[:, np.newaxis] * signs)

    def _estimate_prior(self, right: Array) -> None:
        """Estimate the variances of biases and lasting parts, the coefficients unknown."""
        groups = self.equations.groups
        columns = np.zeros((right.size, 1 + SIGNS * len(groups)))
        columns[:, 0] = right
        probes = [slice(1 + SIGNS * k, 1 + SIGNS * (k + 1)) for k in range(len(groups))]
        for group, probe in zip(groups, probes, strict=True):
            # for the trace of the inverse over a group, which Schall's step needs
            columns[group, probe] = _signs(group.size, SIGNS)
        variance = np.full(len(groups), FIRST_VARIANCE)
        solved: Array | None = None
        self._set_prior(variance)
        for _ in range(ROUNDS):
            # from the solution of the round before: variances move less and less
            solved = self._solve_columns(columns, COARSE, solved)
            before = variance.copy()
            for k, (group, probe) in enumerate(zip(groups, probes, strict=True)):
                unknown = float((columns[group, probe] * solved[group, probe]).sum()) / SIGNS
                energy = float((solved[group, 0] ** 2).sum())
                variance[k] = _next_variance(energy, unknown, group.size, before[k])
            self._set_prior(variance)
            if np.all(np.abs(variance - before) <= COARSE_STEP * before):
                break

    def _set_prior(self, variance: Array) -> None:
        self.prior = np.zeros(self.equations.size)
        self.prior[self.equations.free.size :] = 1.0 / UNKNOWN_VARIANCE
        for group, value in zip(self.equations.groups, variance, strict=True):
            self.prior[group] = 1.0 / value
        added = (self.prior + self.fixed)[self.place]
        self.inverse = np.linalg.inv(self.blocks + added[:, :, np.newaxis] * np.eye(added.shape[1]))
        self.lasting_inverse = [
            [np.linalg.inv(block + np.diag(self.prior[rows])) for rows in lasting]
            for block, lasting in zip(self.lasting, self.equations.lasting, strict=True)
        ]

    def _solve_columns(self, right: Array, tolerance: float, start: Array | None = None) -> Array:
        size, added = right.shape[0], self.prior + self.fixed

        def times(vector: Array) -> Array:
            column = vector.reshape(-1, 1)
            return np.asarray(self.equations.times(column)[:, 0] + added * column[:, 0])

        matrix = LinearOperator((size, size), matvec=times, dtype=np.float64)
        near = LinearOperator((size, size), matvec=self._preconditioned, dtype=np.float64)
        solution = np.zeros_like(right)
        for k, column in enumerate(right.T):
            first = None if start is None else start[:, k]
            solution[:, k], failed = cg(
                matrix, column, first, rtol=tolerance, maxiter=ITERATIONS, M=near
            )
            if failed:
                raise InputError(
                    "the equations of the fleet and its references' shared error do not converge",
                    field="fit.shared_error",
                    found=f"{self.aircraft} aircraft, {ITERATIONS} iterations",
                    remedy="Set it to false, or divide the fleet by region.",
                )
        return solution

    def _preconditioned(self, vector: Array) -> Array:
        values = vector.ravel()
        product = np.empty_like(values)
        product[self.place] = (self.inverse @ values[self.place][:, :, np.newaxis])[:, :, 0]
        for inverses, lasting in zip(self.lasting_inverse, self.equations.lasting, strict=True):
            for inverse, rows in zip(inverses, lasting, strict=True):
                product[rows] = inverse @ values[rows]
        return product


def _signs(rows: int, columns: int) -> Array:
    """Random signs, the same in every run for the same shape."""
    signs = np.random.default_rng([rows, columns]).integers(0, 2, (rows, columns))
    return np.asarray(2.0 * signs - 1.0)


def _next_variance(energy: float, unknown: float, size: int, before: float) -> float:
    """Schall's step of one variance: energy of the effects over the number that the data show."""
    effective = max(size - unknown / before, 1e-9 * size)
    return min(max(energy / effective, SMALLEST_VARIANCE), LARGEST_VARIANCE)


def group_variances(information: Array, score: Array, groups: list[Index]) -> Array:
    """Variance of every effect (n,) by restricted maximum likelihood, in Schall's steps.

    Steps of expectation-maximization converge to the same values, ten to a hundred times more
    slowly where a variance is small. ``information`` (n, n) is that of the data about the effects,
    with the other unknowns eliminated; ``score`` (n,) that where the effects are zero; ``groups``
    are the effects that share a variance; those of no group have no prior.
    """
    variance = np.full(score.size, UNKNOWN_VARIANCE)
    for group in groups:
        variance[group] = FIRST_VARIANCE
    for _ in range(ROUNDS):
        before = variance.copy()
        covariance = np.linalg.inv(information + np.diag(1.0 / variance))
        energy, unknown = (covariance @ score) ** 2, np.diagonal(covariance)
        for group in groups:
            sums = float(energy[group].sum()), float(unknown[group].sum())
            variance[group] = _next_variance(*sums, group.size, float(before[group[0]]))
        if np.all(np.abs(variance - before) <= STEP * before):
            break
    return variance
