"""Deviations of a fleet and the error of its references, solved together on the blocks' sums.

Assumes what :mod:`airswing.compass.fit.reference_error` assumes of the reference's error; the
aircraft's own fits are near enough for one linear step. Unknown are A to E and the airspeed scale
of every aircraft and, for each reference, a bias of every aircraft and the lasting part of the
field; the passing part, the pieces' and the blocks' errors are in the weights (generalized least
squares).

Errors of different days (four segments, counted from the first) are taken as independent, whatever
they are within a day: the covariance is the model's, times the fleet's mean ratio of the sandwich
over days to the model's, parameter by parameter, since an aircraft's own days are too few to tell;
and not less than the model's where the archive has few days.

With very many blocks the Newton matrix is that of an even choice of them, scaled to all
(:mod:`airswing.compass.fit.reference_equations`), while the step is made from everything and
repeated: that changes the covariance by a percent and the estimate not at all.

References
----------
Henderson 1975, Biometrics 31, 423-447; Schall 1991, Biometrika 78, 719-727 (variances);
Liang & Zeger 1986, Biometrika 73, 13-22 (sandwich).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airswing.compass.fit.flight_segments import SLOPES, Blocks
from airswing.compass.fit.reference_equations import Reference
from airswing.compass.fit.reference_error import LARGEST_VARIANCE, Flags, Floats, Ints

SEGMENTS_A_DAY = 4
FEW_DAYS = 15
"""Below so many days their scatter may widen what the model says, not narrow it."""
PRIOR_ROUNDS = 20
PRIOR_STEP = 1e-8
"""Relative change of every variance that ends the rounds before."""
FIRST_VARIANCE, SMALLEST_VARIANCE = 0.05, 1e-4
"""(m/s)2."""
UNKNOWN_VARIANCE = 1e6


@dataclass(frozen=True)
class FleetFit:
    """Joint estimate.

    Attributes
    ----------
    step : array, shape (aircraft, 6)
        To add to the aircraft's own A to E and airspeed scale, radians.
    covariance : array, shape (aircraft, 6, 6)
    bias, bias_covariance : arrays, shape (2,), (2, 2)
        Mean error of the references over the blocks, m/s.
    ratio : array, shape (6,)
        What the covariance of the model was multiplied by.
    """

    step: Floats
    covariance: Floats
    bias: Floats
    bias_covariance: Floats
    ratio: Floats


def solve_fleet(blocks: list[list[Blocks]], free: Flags) -> FleetFit:
    """Estimate deviations and reference error of a fleet.

    Parameters
    ----------
    blocks : list of list of Blocks
        Of every aircraft, one for each reference.
    free : array of bool, shape (aircraft, 6)
        Which coefficients are fitted.

    Returns
    -------
    FleetFit
    """
    segments = np.unique(
        np.concatenate([np.unique(part.segment) for one in blocks for part in one])
    )
    days = np.unique((segments - segments[0]) // SEGMENTS_A_DAY) * SEGMENTS_A_DAY + segments[0]
    references = [Reference([one[k] for one in blocks], free, days) for k in range(len(blocks[0]))]
    system = _System(references, free)
    covariance = _inverse(system.newton + np.diag(system.prior))
    found = covariance @ system.right
    scores = system.scores(found)
    better = found + covariance @ (scores.sum(axis=0) - system.prior * found)
    return _finished(system, better, covariance, scores)


def _inverse(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


class _System:
    """All references' equations together.

    The coefficients come first, then each reference's own unknowns.
    """

    def __init__(self, references: list[Reference], free: Flags) -> None:
        self.references, self.free = references, free
        shared = free.size
        self.size = shared + sum(one.size for one in references)
        starts = shared + np.cumsum([0, *[one.size for one in references]])
        self.places = [
            np.concatenate([np.arange(shared), start + np.arange(one.size)])
            for start, one in zip(starts[:-1], references, strict=True)
        ]
        self.newton = np.zeros((self.size, self.size))
        for one, place in zip(references, self.places, strict=True):
            self.newton[np.ix_(place, place)] += one.newton()
        diagonal = np.arange(shared)
        self.newton[diagonal, diagonal] += np.where(
            free.ravel(), 0.0, np.diagonal(self.newton)[:shared].max()
        )
        self.prior = np.zeros(self.size)
        self._find_prior()

    def scores(self, unknowns: Floats) -> Floats:
        """As of :meth:`Reference.scores`, summed."""
        found = np.zeros((self.references[0].days.size, self.size))
        for one, place in zip(self.references, self.places, strict=True):
            found[:, place] += one.scores(unknowns[place])
        return found

    def groups(self) -> list[Ints]:
        """Unknowns that share a variance: biases and lasting part of each reference.

        The mean of the lasting part, last of each component's, is not among them.
        """
        found = []
        for one, place in zip(self.references, self.places, strict=True):
            own = place[self.free.size :]
            lasting = own[2 * one.aircraft :].reshape(2, -1)[:, :-1]
            found += [own[: 2 * one.aircraft], lasting.ravel()]
        return found

    def _find_prior(self) -> None:
        """Variances of biases and lasting parts, the aircraft's coefficients unknown."""
        shared = self.free.size
        right = np.zeros(self.size)
        for one, place in zip(self.references, self.places, strict=True):
            right[place] += one.start.sum(axis=0)
        self.right = right
        top = np.linalg.solve(
            self.newton[:shared, :shared],
            np.column_stack([self.newton[:shared, shared:], right[:shared]]),
        )
        square = self.newton[shared:, shared:] - self.newton[shared:, :shared] @ top[:, :-1]
        right = right[shared:] - self.newton[shared:, :shared] @ top[:, -1]
        groups = [group - shared for group in self.groups()]
        self.prior[shared:] = 1.0 / group_variances(square, right, groups)


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
    for _ in range(PRIOR_ROUNDS):
        before = variance.copy()
        covariance = np.linalg.inv(information + np.diag(1.0 / variance))
        energy, unknown = (covariance @ score) ** 2, np.diagonal(covariance)
        for group in groups:
            told = group.size - float(unknown[group].sum()) / variance[group[0]]
            found = float(energy[group].sum()) / max(told, 1e-9 * group.size)
            variance[group] = np.clip(found, SMALLEST_VARIANCE, LARGEST_VARIANCE)
        if np.all(np.abs(variance - before) <= PRIOR_STEP * before):
            break
    return variance


def _finished(system: _System, found: Floats, covariance: Floats, scores: Floats) -> FleetFit:
    """Covariance from the scatter between days, and what is published."""
    aircraft = system.free.shape[0]
    moved = (scores - scores.mean(axis=0)) @ covariance
    own = system.free.size
    inside = covariance[:own] ** 2 @ system.prior
    sandwich = (moved[:, :own] ** 2).sum(axis=0) + inside
    part = (sandwich / np.diagonal(covariance)[:own]).reshape(aircraft, SLOPES)
    part /= 1.0 - np.mean([one.leverage() for one in system.references], axis=0)
    ratio = np.array(
        [
            part[:, k][system.free[:, k]].mean() if system.free[:, k].any() else 1.0
            for k in range(SLOPES)
        ]
    )
    for pair in ([1, 2], [3, 4]):
        ratio[pair] = ratio[pair].mean()
    if scores.shape[0] < FEW_DAYS:
        ratio = np.maximum(ratio, 1.0)
    index = np.arange(own).reshape(aircraft, SLOPES)
    square = covariance[index[:, :, np.newaxis], index[:, np.newaxis]]
    root = np.sqrt(ratio) * system.free
    square = square * root[:, :, np.newaxis] * root[:, np.newaxis]
    mean = _mean_error(system, found)
    rows = _mean_rows(system)
    spread = rows @ covariance @ rows.T * max(float(ratio.mean()), 1.0)
    return FleetFit(found[:own].reshape(aircraft, SLOPES), square, mean, spread, ratio)


def _mean_rows(system: _System) -> Floats:
    """What the mean error of the references is made of, shape (2, unknown)."""
    rows = np.zeros((2, system.size))
    for one, place in zip(system.references, system.places, strict=True):
        total = one.worth.sum() * len(system.references)
        share, lasting = one.worth / total, one.lasting_worth / total
        own = place[system.free.size :]
        for c in range(2):
            rows[c, own[c : 2 * one.aircraft : 2]] = share
            rows[c, own[2 * one.aircraft + c * one.lasting :][: one.lasting]] = lasting
    return rows


def _mean_error(system: _System, found: Floats) -> Floats:
    """Mean of bias and lasting part over the blocks."""
    return np.asarray(_mean_rows(system) @ found)
