"""Deviations of a fleet and the error of its references, solved together on the blocks' sums.

Assumes what :mod:`airswing.compass.fleet_error` assumes of the reference's error; the aircraft's
own fits are near enough for one linear step. Unknown are A to E and the airspeed scale of every
aircraft and, for each reference, a bias of every aircraft and the lasting part of the field; the
passing part, the pieces' and the blocks' errors are in the weights (generalized least squares).

Errors of different days (four segments, counted from the first) are taken as independent, whatever
they are within a day: the covariance is the model's, times the fleet's mean ratio of the sandwich
over days to the model's, parameter by parameter, since an aircraft's own days are too few to tell;
and not less than the model's where the archive has few days.

With very many blocks the Newton matrix is that of an even choice of them, scaled to all, while the
step is made from everything and repeated: that changes the covariance by a percent and the
estimate not at all.

References
----------
Henderson 1975, Biometrics 31, 423-447; Liang & Zeger 1986, Biometrika 73, 13-22 (sandwich).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from airswing.compass.blocks import SLOPES, Blocks
from airswing.compass.fleet_error import (
    LARGEST_VARIANCE,
    FieldBasis,
    Precision,
    Stretch,
    as_sparse,
    bounds_of,
    estimate_variances,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_BLOCKS = 50_000
"""Blocks the variances and the Newton matrix are made from, about: whole segments, evenly taken."""
SEGMENTS_A_DAY = 4
FEW_DAYS = 15
"""Below so many days their scatter may widen what the model says, not narrow it."""
PRIOR_ROUNDS = 6
SMALLEST_VARIANCE = 1e-4
UNKNOWN_VARIANCE = 1e6
LEAST_FREEDOM = 30
"""Degrees of freedom within blocks that tell an aircraft's white noise."""


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


def solve_fleet(blocks: list[list[Blocks]], free: NDArray[np.bool_]) -> FleetFit:
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
    segments = np.unique(np.concatenate([part.segment for one in blocks for part in one]))
    days = np.unique((segments - segments[0]) // SEGMENTS_A_DAY) * SEGMENTS_A_DAY + segments[0]
    references = [Reference([one[k] for one in blocks], free, days) for k in range(len(blocks[0]))]
    system = _System(references, free)
    covariance = _inverse(system.newton + np.diag(system.prior))
    found = covariance @ system.right
    scores = system.scores(found)
    better = found + covariance @ (scores.sum(axis=0) - system.prior * found)
    return _finished(system, better, covariance, scores)


class Reference:
    """One reference's part of the equations.

    The unknowns are, in this order, the coefficients (aircraft, 6), the biases (aircraft, 2) and
    the lasting part (2, functions).

    Parameters
    ----------
    blocks : list of Blocks
        One an aircraft.
    free : array of bool, shape (aircraft, 6)
    days : array of int
        First segment of every day.
    """

    def __init__(self, blocks: list[Blocks], free: NDArray[np.bool_], days: Ints) -> None:
        places = [np.concatenate([getattr(part, name) for part in blocks])
                  for name in ("latitude", "longitude", "log_pressure")]  # fmt: skip
        self.basis = FieldBasis.of(*places)
        self.stretch = Stretch.of(blocks, self.basis)
        for k, (i, j) in enumerate(bounds_of(self.stretch.aircraft, free.shape[0])):
            self.stretch.slopes[:, ~free[k], i:j] = 0.0
        self.aircraft, self.lasting = free.shape[0], self.basis.lasting_size + 1
        white = _white(np.array([(part.within, part.freedom) for part in blocks]))
        every = -(-self.stretch.weight.size // MOST_BLOCKS)
        some = self.stretch.some(every)
        self.variances = estimate_variances(some, white)
        self.precision = Precision(self.stretch, self.variances)
        self.some = self.precision if every == 1 else Precision(some, self.variances)
        self.day_of_segment = np.searchsorted(days, self.stretch.segments, side="right") - 1
        self.days = days.size

    @property
    def size(self) -> int:
        """Number of unknowns of its own."""
        return int(2 * (self.aircraft + self.lasting))

    def columns(self, component: int) -> Ints:
        """Places of the unknowns of one component: (aircraft, 7) ones, then the lasting part's."""
        a, n = self.aircraft, self.lasting
        own = np.empty((a, SLOPES + 1), dtype=np.int64)
        own[:, :SLOPES] = np.arange(a * SLOPES).reshape(a, SLOPES)
        own[:, SLOPES] = a * SLOPES + 2 * np.arange(a) + component
        start = a * (SLOPES + 2) + component * n
        return np.concatenate([own.ravel(), start + np.arange(n)])

    def newton(self) -> Floats:
        """Information about every unknown, from the blocks."""
        total = self.aircraft * SLOPES + self.size
        found, direct = np.zeros((total, total)), np.zeros((2, self.aircraft, 8, 8))
        for component in range(2):
            place = self.columns(component)
            found[np.ix_(place, place)] += _information(
                self.some, component, self.aircraft, self.lasting
            )
        if self.some is not self.precision:
            for k, one in enumerate((self.some, self.precision)):
                direct[k] = _direct(one, self.aircraft)
            gain = float(self.precision.weight.sum() / self.some.weight.sum())
            self._scale(found, direct, gain)
        return found

    def _scale(self, information: Floats, direct: Floats, gain: float) -> None:
        """Make of some segments' information that of all: each aircraft's as its own sums say."""
        ridge = 1e-9 * np.trace(direct[1], axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(8)
        some, every = (np.linalg.cholesky(one + ridge) for one in direct)
        factor = every @ np.linalg.inv(some)
        a = self.aircraft
        own = np.empty((a, 8), dtype=np.int64)
        own[:, :SLOPES] = np.arange(a * SLOPES).reshape(a, SLOPES)
        own[:, SLOPES:] = a * SLOPES + np.arange(2 * a).reshape(a, 2)
        rest = slice(8 * a, None)
        for one in (information, information.T):
            one[own] = factor @ one[own]
            one[rest] *= np.sqrt(gain)

    def leverage(self) -> Floats:
        """Share of each coefficient's scatter between days that fitting took away.

        Of the aircraft's own equations, the field known; shape (aircraft, 6).
        """
        days = self._day_information()
        total = days.sum(axis=1)
        ridge = 1e-9 * np.trace(total, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(8)
        inverse = np.linalg.inv(total + ridge)
        twice = (days @ inverse[:, np.newaxis] @ days).sum(axis=1)
        taken = inverse @ twice @ inverse
        share = np.diagonal(taken, axis1=1, axis2=2) / np.diagonal(inverse, axis1=1, axis2=2)
        return np.asarray(np.minimum(share[:, :SLOPES] * days.shape[1] / self.days, 0.5))

    def _day_information(self) -> Floats:
        """Information on each aircraft's unknowns by day were the field known.

        Returns
        -------
        array, shape (aircraft, day, 8, 8)
            Of the days some segments are of.
        """
        one, a = self.some.stretch, self.aircraft
        place = np.searchsorted(self.stretch.segments, one.segments)
        _, day = np.unique(self.day_of_segment[place], return_inverse=True)
        days = int(day.max()) + 1
        group = (one.aircraft * days + day[one.segment])[one.opens]
        found = np.zeros((a * days, 8, 8))
        for component in range(2):
            design = _own(one, component)
            weighted = self.some.within_pieces(design)
            kept = [*range(SLOPES), SLOPES + component]
            for i, left in enumerate(design):
                pieces = np.add.reduceat(weighted[: i + 1] * left, one.opens, axis=1)
                for j, values in enumerate(pieces):
                    sums = np.bincount(group, weights=values, minlength=a * days)
                    found[:, kept[i], kept[j]] += sums
        found = found + np.tril(found, -1).transpose(0, 2, 1)
        return np.asarray(found.reshape(a, days, 8, 8))

    def scores(self, unknowns: Floats) -> Floats:
        """Score of every unknown by day.

        Parameters
        ----------
        unknowns : array, shape (unknown,)

        Returns
        -------
        array, shape (day, unknown)
        """
        one, a = self.stretch, self.aircraft
        theta = unknowns[: a * SLOPES].reshape(a, SLOPES)
        bias = unknowns[a * SLOPES : a * (SLOPES + 2)].reshape(a, 2)
        lasting = unknowns[a * (SLOPES + 2) :].reshape(2, -1)
        bounds = bounds_of(one.aircraft, a)
        left = one.residual - (one.lasting_design @ lasting.T).T
        for k, (i, j) in enumerate(bounds):
            left[:, i:j] -= theta[k] @ one.slopes[:, :, i:j] + bias[k][:, np.newaxis]
        weighted = self.precision.apply(left)
        found = np.empty((self.days, unknowns.size))
        pieces = np.empty((SLOPES + 2, one.opens.size))
        for i, j in bounds:
            first, last = np.searchsorted(one.opens, (i, j))
            own = np.empty((SLOPES + 2, j - i))
            own[SLOPES:] = weighted[:, i:j]
            np.multiply(one.slopes[0, :, i:j], own[SLOPES], out=own[:SLOPES])
            own[:SLOPES] += one.slopes[1, :, i:j] * own[SLOPES + 1]
            pieces[:, first:last] = np.add.reduceat(own, one.opens[first:last] - i, axis=1)
        group = one.aircraft[one.opens] * self.days + self.day_of_segment[one.segment[one.opens]]
        columns = [slice(k, a * SLOPES, SLOPES) for k in range(SLOPES)]
        columns += [slice(a * SLOPES + c, a * (SLOPES + 2), 2) for c in range(2)]
        for column, values in zip(columns, pieces, strict=True):
            total = np.bincount(group, weights=values, minlength=a * self.days)
            found[:, column] = total.reshape(a, self.days).T
        found[:, a * (SLOPES + 2) :] = self._lasting_scores(weighted)
        return found

    def _lasting_scores(self, weighted: Floats) -> Floats:
        """Scores of the lasting part by day, shape (day, 2 * functions)."""
        one = self.stretch
        shift = (self.day_of_segment * self.lasting).astype(np.int32)[one.segment]
        daily = as_sparse(
            one.lasting + shift[:, np.newaxis], one.lasting_share, self.days * self.lasting
        )
        found = (daily.T @ weighted.T).reshape(self.days, self.lasting, 2)
        return np.asarray(found.transpose(0, 2, 1).reshape(self.days, -1))


def _white(within: Floats) -> Floats:
    """Variance of one report of each aircraft; the fleet's where it has too few to tell."""
    square, freedom = within.T
    known = freedom >= LEAST_FREEDOM
    if not known.any():
        return np.ones(square.size)
    found = square / np.maximum(freedom, 1.0)
    return np.asarray(np.maximum(np.where(known, found, np.median(found[known])), 1e-3))


def _inverse(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _own(one: Stretch, component: int) -> Floats:
    """Design of an aircraft's coefficients and bias, shape (7, n)."""
    return np.vstack([one.slopes[component], np.ones(one.weight.size)])


def _direct(precision: Precision, aircraft: int) -> Floats:
    """Information of each aircraft were the field known, shape (aircraft, 8, 8)."""
    one = precision.stretch
    found = np.zeros((aircraft, 8, 8))
    for k, (i, j) in enumerate(bounds_of(one.aircraft, aircraft)):
        first, last = np.searchsorted(one.opens, (i, j))
        for component in range(2):
            kept = [*range(SLOPES), SLOPES + component]
            design = np.vstack([one.slopes[component, :, i:j], np.ones(j - i)])
            weighted = design * precision.weight[i:j]
            sums = np.add.reduceat(weighted, one.opens[first:last] - i, axis=1)
            square = weighted @ design.T - (sums * precision.tied[first:last]) @ sums.T
            found[k][np.ix_(kept, kept)] += square
    return found


def _information(precision: Precision, component: int, aircraft: int, lasting: int) -> Floats:
    """Information of one component's unknowns, the passing part unknown."""
    one = precision.stretch
    own = _own(one, component)
    columns = one.aircraft[:, np.newaxis] * (SLOPES + 1) + np.arange(SLOPES + 1)
    width = aircraft * (SLOPES + 1)
    left = sparse.hstack([as_sparse(columns, own.T, width), one.lasting_design]).tocsr()
    weighted = precision.within_pieces(own)
    fixed = as_sparse(columns, weighted.T, width)
    dense = precision.within_pieces(one.lasting_design.toarray().T)
    direct = np.empty((width + lasting, width + lasting))
    direct[:, :width] = (left.T @ fixed).toarray()
    direct[:, width:] = left.T @ dense.T
    direct[width:, :width] = direct[:width, width:].T
    nodes = one.passing_design.T
    shape = (one.segments.size, one.nodes, width + lasting)
    seen = np.empty((nodes.shape[0], width + lasting), dtype=np.float32)
    seen[:, :width] = (nodes @ fixed).toarray()
    seen[:, width:] = nodes @ dense.T
    solved = precision.inverse.astype(np.float32) @ seen.reshape(shape)
    return np.asarray(direct - seen.T @ solved.reshape(seen.shape))


class _System:
    """All references' equations together.

    The coefficients come first, then each reference's own unknowns.
    """

    def __init__(self, references: list[Reference], free: NDArray[np.bool_]) -> None:
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
        found = np.zeros((self.references[0].days, self.size))
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
        """Variances of biases and lasting parts by expectation-maximization."""
        shared = self.free.size
        right = self.scores(np.zeros(self.size)).sum(axis=0)
        self.right = right
        top = np.linalg.solve(
            self.newton[:shared, :shared],
            np.column_stack([self.newton[:shared, shared:], right[:shared]]),
        )
        square = self.newton[shared:, shared:] - self.newton[shared:, :shared] @ top[:, :-1]
        right = right[shared:] - self.newton[shared:, :shared] @ top[:, -1]
        groups = [group - shared for group in self.groups()]
        variance = np.full(self.size - shared, UNKNOWN_VARIANCE)
        for group in groups:
            variance[group] = 0.05
        for _ in range(PRIOR_ROUNDS):
            covariance = np.linalg.inv(square + np.diag(1.0 / variance))
            energy = (covariance @ right) ** 2 + np.diagonal(covariance)
            for group in groups:
                variance[group] = np.clip(energy[group].mean(), SMALLEST_VARIANCE, LARGEST_VARIANCE)
        self.prior[shared:] = 1.0 / variance


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
        weight = one.stretch.weight / one.stretch.weight.sum() / len(system.references)
        share = np.bincount(one.stretch.aircraft, weights=weight, minlength=one.aircraft)
        lasting = np.bincount(
            one.stretch.lasting.ravel(),
            weights=(one.stretch.lasting_share * weight[:, np.newaxis]).ravel(),
            minlength=one.lasting,
        )  # fmt: skip
        own = place[system.free.size :]
        for c in range(2):
            rows[c, own[c : 2 * one.aircraft : 2]] = share
            rows[c, own[2 * one.aircraft + c * one.lasting :][: one.lasting]] = lasting
    return rows


def _mean_error(system: _System, found: Floats) -> Floats:
    """Mean of bias and lasting part over the blocks."""
    return np.asarray(_mean_rows(system) @ found)
