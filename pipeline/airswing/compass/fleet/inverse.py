"""The inverse of the fleet's Newton matrix: what the fit asks of it, at a cost linear in aircraft.

Assumes the matrix is that of :class:`Equations`, its prior found from the data by restricted
maximum likelihood (Schall's steps). Few aircraft are written out and inverted (:class:`Written`:
exact, and thirty times faster there than iterating). Of many (:class:`Iterated`) nothing is written
out but each aircraft's own block:

* systems are solved by conjugate gradients, preconditioned with the blocks of aircraft and field;
* traces and sums of squares are those of fixed random signs (Hutchinson), which are the same in
  every run;
* an aircraft's own covariance is its block's inverse with what the lasting part adds, that exactly,
  times the fleet's mean ratio of the true variances to these, a random choice of signs telling it:
  what an aircraft lacks by the other aircraft's unknowns in the passing part is the fleet's mean.

References
----------
Schall 1991, Biometrika 78, 719-727; Hutchinson 1990, Comm. Stat. Simul. Comput. 19, 433-450;
Hestenes & Stiefel 1952, J. Res. Nat. Bur. Stand. 49, 409-436.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from airswing.compass.fleet.field_coupling import Coupling, unknowns
from airswing.compass.fleet.flight_segments import SLOPES
from airswing.compass.fleet.reference_error import LARGEST_VARIANCE, Flags, Floats, Ints
from airswing.errors import InputError

WRITTEN_OUT = 1500
"""Unknowns up to which the matrix is written out: some 170 aircraft against one reference."""
ROUNDS = 20  # Of variances in turn, at most: `STEP` ends them before
STEP, COARSE_STEP = 1e-8, 1e-3
"""Relative change of every variance that ends the rounds before: exact, and of random signs."""
FIRST_VARIANCE, SMALLEST_VARIANCE = 0.05, 1e-4
"""(m/s)2."""
UNKNOWN_VARIANCE = 1e6  # (m/s)2: a prior that tells nothing
FINE, COARSE = 1e-7, 1e-4
"""Relative error of a solution in the matrix's own norm: of the estimate, of its variances."""
ITERATIONS = 1000  # Of conjugate gradients; more, and the equations are taken not to settle
AT_ONCE = 32
"""Systems solved side by side, and sums of squares made exactly."""
SIGNS = 8
"""Vectors of random signs for a trace."""


@dataclass(frozen=True)
class Equations:
    """The Newton matrix without its prior.

    The coefficients come first (aircraft, 6), then each reference's biases and lasting part.
    """

    parts: list[Coupling]  # one a reference
    free: Flags  # (aircraft, 6)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.places()[-1][-1]) + 1

    def places(self) -> list[Ints]:
        """Each reference's unknowns among all."""
        shared, start, found = self.free.size, self.free.size, []
        for part in self.parts:
            own = 2 * (part.aircraft + part.lasting.shape[0])
            found.append(np.concatenate([np.arange(shared), start + np.arange(own)]))
            start += own
        return found

    def split(self) -> list[tuple[Ints, Ints]]:
        """Places of aircraft's own unknowns (aircraft, 8) and lasting part (2, n), by reference."""
        found = []
        for part, place in zip(self.parts, self.places(), strict=True):
            own, lasting = unknowns(part.aircraft, part.lasting.shape[0])
            found.append((place[own], place[lasting]))
        return found

    def groups(self) -> list[Ints]:
        """Unknowns that share a variance: biases and lasting part of each reference.

        The mean of the lasting part, last of each component's, is not among them.
        """
        found = []
        for own, lasting in self.split():
            found += [own[:, SLOPES:].ravel(), lasting[:, :-1].ravel()]
        return found


class Inverse(Protocol):
    """Inverse of the Newton matrix with its prior."""

    prior: Floats

    def solve(self, right: Floats) -> Floats:
        """Times a vector or some columns, shape (unknowns, ...)."""

    def own(self) -> Floats:
        """Block of each aircraft's coefficients, shape (aircraft, 6, 6)."""

    def squares(self, columns: Floats) -> Floats:
        """Sums of squares over the columns it is multiplied with, shape (aircraft, 6)."""

    def prior_squares(self) -> Floats:
        """Sums of squares, each column by its unknown's prior, shape (aircraft, 6)."""


def inverse_of(equations: Equations, right: Floats) -> Inverse:
    """Find the prior's variances, and the inverse with them.

    Parameters
    ----------
    right : array, shape (unknowns,)
        Score where every unknown is zero.
    """
    if equations.size <= WRITTEN_OUT:
        return Written(equations, right)
    return Iterated(equations, right)


class Written:
    """The inverse of few aircraft, written out."""

    def __init__(self, equations: Equations, right: Floats) -> None:
        self.aircraft, shared = equations.free.shape[0], equations.free.size
        newton = np.zeros((equations.size, equations.size))
        for part, place in zip(equations.parts, equations.places(), strict=True):
            newton[np.ix_(place, place)] += part.dense()
        diagonal = np.arange(shared)
        # a coefficient held at zero is no unknown: as stiff as the stiffest, it hardly moves
        newton[diagonal, diagonal] += np.where(
            equations.free.ravel(), 0.0, np.diagonal(newton)[:shared].max()
        )
        # aircraft's own coefficients are eliminated: what is left tells the variances of the rest
        top = np.linalg.solve(
            newton[:shared, :shared], np.column_stack([newton[:shared, shared:], right[:shared]])
        )
        square = newton[shared:, shared:] - newton[shared:, :shared] @ top[:, :-1]
        score = right[shared:] - newton[shared:, :shared] @ top[:, -1]
        self.prior = np.zeros(right.size)
        groups = [group - shared for group in equations.groups()]
        # aircraft's coefficients have no prior: a fleet of steep deviations must not be drawn to
        # its mean
        self.prior[shared:] = 1.0 / group_variances(square, score, groups)
        self.covariance = np.linalg.inv(newton + np.diag(self.prior))

    def solve(self, right: Floats) -> Floats:
        """As of :class:`Inverse`."""
        return np.asarray(self.covariance @ right)

    def own(self) -> Floats:
        """As of :class:`Inverse`."""
        index = np.arange(self.aircraft * SLOPES).reshape(self.aircraft, SLOPES)
        return np.asarray(self.covariance[index[:, :, np.newaxis], index[:, np.newaxis]])

    def squares(self, columns: Floats) -> Floats:
        """As of :class:`Inverse`."""
        found = self.covariance[: self.aircraft * SLOPES] @ columns
        return np.asarray((found**2).sum(axis=1).reshape(self.aircraft, SLOPES))

    def prior_squares(self) -> Floats:
        """As of :class:`Inverse`."""
        found = self.covariance[: self.aircraft * SLOPES] ** 2 @ self.prior
        return np.asarray(found.reshape(self.aircraft, SLOPES))


class Iterated:
    """The inverse of many aircraft, never written out."""

    def __init__(self, equations: Equations, right: Floats) -> None:
        self.equations, self.aircraft = equations, equations.free.shape[0]
        self.split = equations.split()
        biases = [own[:, SLOPES:] for own, _ in self.split]
        self.place = np.hstack([self.split[0][0][:, :SLOPES], *biases])
        self.blocks = self._own_blocks()
        self.held = np.zeros(right.size)
        diagonal = np.diagonal(self.blocks, axis1=1, axis2=2)[:, :SLOPES]
        self.held[: equations.free.size] = np.where(equations.free, 0.0, diagonal.max()).ravel()
        self.lasting = [part.lasting_block() for part in equations.parts]
        # without a prior first: finding it needs a preconditioner already
        self._settle(np.zeros(right.size))
        self._find_prior(right)

    def solve(self, right: Floats) -> Floats:
        """As of :class:`Inverse`."""
        found = self._solved(right.reshape(right.shape[0], -1), FINE)
        return found.reshape(right.shape)

    def own(self) -> Floats:
        """As of :class:`Inverse`."""
        low = np.concatenate([lasting.ravel() for _, lasting in self.split])
        unit = np.zeros((self.prior.size, low.size))
        unit[low, np.arange(low.size)] = 1.0
        solved = self._solved(unit, COARSE)
        among = solved[low]
        # solved to a tolerance only, it is symmetric but for that, and its root would not exist
        root = np.linalg.cholesky(np.linalg.inv((among + among.T) / 2.0))
        part = (solved[self.place[:, :SLOPES]]) @ root
        # the inverse of a block and what passes through the lasting part; what aircraft share
        # otherwise is made up for by the mean ratio below
        found = self.inverse[:, :SLOPES, :SLOPES] + part @ part.transpose(0, 2, 1)
        ratio = np.sqrt(self._mean_ratio(np.diagonal(found, axis1=1, axis2=2)))
        return np.asarray(found * ratio[:, np.newaxis] * ratio)

    def squares(self, columns: Floats) -> Floats:
        """As of :class:`Inverse`."""
        if columns.shape[1] <= AT_ONCE:
            return self._squares(columns)
        # sums of columns under random signs have the same sum of squares in the mean (Hutchinson):
        # a thousand columns become a few
        return self._squares(columns @ _signs(columns.shape[1], AT_ONCE)) / AT_ONCE

    def prior_squares(self) -> Floats:
        """As of :class:`Inverse`."""
        signs = _signs(self.prior.size, AT_ONCE)
        return self._squares(np.sqrt(self.prior)[:, np.newaxis] * signs) / AT_ONCE

    def _squares(self, columns: Floats) -> Floats:
        found = self._solved(columns, COARSE)[: self.aircraft * SLOPES]
        return np.asarray((found**2).sum(axis=1).reshape(self.aircraft, SLOPES))

    def _mean_ratio(self, variance: Floats) -> Floats:
        """Of the true variances to these, the fleet's mean by coefficient, shape (6,)."""
        found = np.ones(SLOPES)
        for k in np.flatnonzero(self.equations.free.any(axis=0)):
            rows = np.flatnonzero(self.equations.free[:, k])
            # Hutchinson's estimate of a trace, each aircraft brought to one
            signs = _signs(rows.size, SIGNS) / np.sqrt(variance[rows, k, np.newaxis])
            right = np.zeros((self.prior.size, SIGNS))
            right[self.place[rows, k]] = signs
            found[k] = (right * self._solved(right, COARSE)).sum() / (SIGNS * rows.size)
        return found

    def _own_blocks(self) -> Floats:
        width = self.place.shape[1]
        found = np.zeros((self.aircraft, width, width))
        for k, part in enumerate(self.equations.parts):
            kept = np.array([*range(SLOPES), SLOPES + 2 * k, SLOPES + 2 * k + 1])
            found[:, kept[:, np.newaxis], kept] += part.own_blocks()
        return found

    def _settle(self, prior: Floats) -> None:
        """Take a prior, and make the preconditioner with it."""
        self.prior = prior
        added = (prior + self.held)[self.place]
        self.inverse = np.linalg.inv(self.blocks + added[:, :, np.newaxis] * np.eye(added.shape[1]))
        self.lasting_inverse = [
            [np.linalg.inv(block + np.diag(prior[one])) for one in lasting]
            for block, (_, lasting) in zip(self.lasting, self.split, strict=True)
        ]

    def _find_prior(self, right: Floats) -> None:
        """Variances of biases and lasting parts, the aircraft's coefficients unknown."""
        groups = self.equations.groups()
        columns = np.zeros((right.size, 1 + SIGNS * len(groups)))
        columns[:, 0] = right
        own = [slice(1 + SIGNS * k, 1 + SIGNS * (k + 1)) for k in range(len(groups))]
        for group, some in zip(groups, own, strict=True):
            # solved along with the score: the trace of the inverse over a group, which Schall's
            # step needs
            columns[group, some] = _signs(group.size, SIGNS)
        variance = np.full(len(groups), FIRST_VARIANCE)
        prior = np.zeros(right.size)
        prior[self.equations.free.size :] = 1.0 / UNKNOWN_VARIANCE
        solved = np.zeros_like(columns)
        for _ in range(ROUNDS):
            for group, value in zip(groups, variance, strict=True):
                prior[group] = 1.0 / value
            self._settle(prior)
            # from the last round's solution: variances move less and less
            solved = self._solved(columns, COARSE, solved)
            before = variance.copy()
            for k, (group, some) in enumerate(zip(groups, own, strict=True)):
                unknown = float((columns[group, some] * solved[group, some]).sum()) / SIGNS
                energy = float((solved[group, 0] ** 2).sum())
                variance[k] = _next_variance(energy, unknown, group.size, before[k])
            if np.all(np.abs(variance - before) <= COARSE_STEP * before):
                break
        for group, value in zip(groups, variance, strict=True):
            prior[group] = 1.0 / value
        self._settle(prior)

    def _times(self, values: Floats) -> Floats:
        found = values * (self.prior + self.held)[:, np.newaxis]
        for part, (own, lasting) in zip(self.equations.parts, self.split, strict=True):
            above, below = part.times(values[own], values[lasting])
            found[own] += above
            found[lasting] += below
        return found

    def _preconditioned(self, values: Floats) -> Floats:
        found = np.empty_like(values)
        found[self.place] = self.inverse @ values[self.place]
        for inverses, (_, lasting) in zip(self.lasting_inverse, self.split, strict=True):
            for inverse, one in zip(inverses, lasting, strict=True):
                found[one] = inverse @ values[one]
        return found

    def _solved(self, right: Floats, tolerance: float, start: Floats | None = None) -> Floats:
        """Solve for some columns by conjugate gradients, preconditioned."""
        size = right.shape[0]
        matrix = LinearOperator((size, size), matvec=lambda x: self._times(x[:, None])[:, 0])
        near = LinearOperator((size, size), matvec=lambda x: self._preconditioned(x[:, None])[:, 0])
        found = np.zeros_like(right)
        for k, column in enumerate(right.T):
            first = None if start is None else start[:, k]
            found[:, k], failed = cg(
                matrix, column, first, rtol=tolerance, maxiter=ITERATIONS, M=near
            )
            if failed:
                raise InputError(
                    "the equations of the fleet and its references' shared error do not settle",
                    field="fit.shared_error",
                    found=f"{self.aircraft} aircraft, {ITERATIONS} iterations",
                    remedy="Set it to false, or divide the fleet by region.",
                )
        return found


def _dots(one: Floats, other: Floats) -> Floats:
    return np.asarray((one * other).sum(axis=0))


def _signs(rows: int, columns: int) -> Floats:
    """The same random signs for the same numbers of them."""
    # drawn alike in every run: fits of the same archive are the same to the bit
    signs = np.random.default_rng([rows, columns]).integers(0, 2, (rows, columns))
    return np.asarray(2.0 * signs - 1.0)


def _next_variance(energy: float, unknown: float, size: int, before: float) -> float:
    """Schall's step of one variance."""
    told = size - unknown / before
    # where nothing is told of it the bounds below decide, not a division by zero
    found = energy / max(told, 1e-9 * size)
    return min(max(found, SMALLEST_VARIANCE), LARGEST_VARIANCE)


def group_variances(information: Floats, score: Floats, groups: list[Ints]) -> Floats:
    """Variances of random effects by restricted maximum likelihood.

    Schall's steps: the energy of a group's estimates over the number of them that the data tell.
    Steps of expectation-maximization have the same end but come near it ten to a hundred times more
    slowly where a variance is small, and an error that is only thought to be there widens every
    interval.

    Parameters
    ----------
    information : array, shape (n, n)
        Of the data about the effects, what else is unknown taken out.
    score : array, shape (n,)
        At effects of zero.
    groups : list of array of int
        Effects that share a variance; those of no group are unknown altogether.

    Returns
    -------
    array, shape (n,)
        Variance of every effect, between `SMALLEST_VARIANCE` and `LARGEST_VARIANCE` in a group.
    """
    variance = np.full(score.size, UNKNOWN_VARIANCE)
    for group in groups:
        variance[group] = FIRST_VARIANCE
    for _ in range(ROUNDS):
        before = variance.copy()
        covariance = np.linalg.inv(information + np.diag(1.0 / variance))
        energy, unknown = (covariance @ score) ** 2, np.diagonal(covariance)
        for group in groups:
            variance[group] = _next_variance(
                float(energy[group].sum()),
                float(unknown[group].sum()),
                group.size,
                float(before[group[0]]),
            )
        if np.all(np.abs(variance - before) <= STEP * before):
            break
    return variance
