"""Deviations of a fleet and the error of its references, solved together on the blocks' sums.

Assumes what :mod:`airswing.compass.fleet_error` assumes of the reference's error; the aircraft's
own fits are near enough for one linear step. Unknown are A to E and the airspeed scale of every
aircraft and, for each reference, a bias of every aircraft and the lasting part of the field; the
passing part, the pieces' and the blocks' errors are in the weights (generalized least squares).

Errors of different days (four segments, counted from the first) are taken as independent, whatever
they are within a day: the covariance is the model's, times the fleet's mean ratio of the sandwich
over days to the model's, parameter by parameter, since an aircraft's own days are too few to tell.

With many segments the Newton matrix is that of an even choice of them, scaled to all, while the
step is made from everything and repeated: that changes the covariance by a percent and the
estimate not at all.

References
----------
Henderson 1975, Biometrics 31, 423-447; Liang & Zeger 1986, Biometrika 73, 13-22 (sandwich).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

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
    estimate_variances,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_SEGMENTS = 240
"""Segments the variances and the Newton matrix are made from."""
SEGMENTS_A_DAY = 4
PRIOR_ROUNDS = 10
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
        self.stretch.slopes[:] *= free.T[:, self.stretch.aircraft]
        self.aircraft, self.lasting = free.shape[0], self.basis.lasting_size + 1
        white = _white(np.array([(part.within, part.freedom) for part in blocks]))
        every = -(-self.stretch.segments.size // MOST_SEGMENTS)
        self.some = self.stretch.some(every)
        self.variances = estimate_variances(self.some, white)
        self.precision = Precision(self.stretch, self.variances)
        self.day = np.searchsorted(days, self.stretch.segments, side="right")[self.stretch.segment]
        self.day -= 1
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
        some = self.some
        whole = some is self.stretch
        precision = self.precision if whole else Precision(some, self.variances)
        total = self.aircraft * SLOPES + self.size
        found, direct = np.zeros((total, total)), np.zeros((2, self.aircraft, 8, 8))
        for component in range(2):
            place = self.columns(component)
            found[np.ix_(place, place)] += _information(
                precision, component, self.aircraft, self.lasting
            )
            for k, one in enumerate((precision, self.precision)):
                kept = [*range(SLOPES), SLOPES + component]
                direct[k][np.ix_(range(self.aircraft), kept, kept)] += _direct(
                    one, component, self.aircraft
                )
        if not whole:
            gain = float(self.precision.weight.sum() / precision.weight.sum())
            found = self._scaled(found, direct, gain)
        return found

    def _scaled(self, information: Floats, direct: Floats, gain: float) -> Floats:
        """Information of all segments from that of some: each aircraft's as its own sums say."""
        ridge = 1e-9 * np.trace(direct[1], axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(8)
        some, every = (np.linalg.cholesky(one + ridge) for one in direct)
        factor = every @ np.linalg.inv(some)
        a = self.aircraft
        scale = np.sqrt(gain) * np.eye(information.shape[0])
        own = np.empty((a, 8), dtype=np.int64)
        own[:, :SLOPES] = np.arange(a * SLOPES).reshape(a, SLOPES)
        own[:, SLOPES:] = a * SLOPES + np.arange(2 * a).reshape(a, 2)
        scale[own[:, :, np.newaxis], own[:, np.newaxis]] = factor
        return np.asarray(scale @ information @ scale.T)

    def day_information(self) -> Floats:
        """Information on each aircraft's unknowns by day were the field known.

        Returns
        -------
        array, shape (aircraft, day, 8, 8)
        """
        one, a = self.stretch, self.aircraft
        group = one.aircraft * self.days + self.day
        found = np.zeros((a * self.days, 8, 8))
        for component in range(2):
            design = _own(one, component)
            weighted = self.precision.within_pieces(design)
            kept = [*range(SLOPES), SLOPES + component]
            for i, left in zip(kept, design, strict=True):
                for j, right in zip(kept, weighted, strict=True):
                    found[:, i, j] += np.bincount(
                        group, weights=left * right, minlength=a * self.days
                    )
        return found.reshape(a, self.days, 8, 8)

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
        left = one.residual - np.einsum("cjn,jn->cn", one.slopes, theta.T[:, one.aircraft])
        left -= bias.T[:, one.aircraft]
        design = as_sparse(
            one.lasting + self.day * self.lasting, one.lasting_share, self.days * self.lasting
        )
        left -= (design @ np.tile(lasting.T, (self.days, 1))).T
        weighted = self.precision.apply(left)
        found = np.empty((self.days, unknowns.size))
        group = one.aircraft * self.days + self.day

        def by_day(values: Floats) -> Floats:
            total = np.bincount(group, weights=values, minlength=a * self.days)
            return np.asarray(total.reshape(a, self.days).T, dtype=np.float64)

        for k in range(SLOPES):
            found[:, k : a * SLOPES : SLOPES] = by_day((one.slopes[:, k] * weighted).sum(axis=0))
        for c in range(2):
            found[:, a * SLOPES + c : a * (SLOPES + 2) : 2] = by_day(weighted[c])
        fields = (design.T @ weighted.T).reshape(self.days, self.lasting, 2)
        found[:, a * (SLOPES + 2) :] = fields.transpose(0, 2, 1).reshape(self.days, -1)
        return found


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


def _direct(precision: Precision, component: int, aircraft: int) -> Floats:
    """Information of each aircraft were the field known, shape (aircraft, 7, 7)."""
    one = precision.stretch
    design = _own(one, component)
    weighted = precision.within_pieces(design)
    bounds = np.searchsorted(one.aircraft, np.arange(aircraft + 1))
    return np.array([design[:, i:j] @ weighted[:, i:j].T for i, j in pairwise(bounds)])


def _information(precision: Precision, component: int, aircraft: int, lasting: int) -> Floats:
    """Information of one component's unknowns, the passing part unknown."""
    one = precision.stretch
    own = _own(one, component)
    columns = one.aircraft * (SLOPES + 1) + np.arange(SLOPES + 1)[:, np.newaxis]
    width = aircraft * (SLOPES + 1)
    left = sparse.hstack(
        [as_sparse(columns, own, width), as_sparse(one.lasting, one.lasting_share, lasting)]
    ).tocsr()
    weighted = precision.within_pieces(own)
    fixed = as_sparse(columns, weighted, width)
    dense = precision.within_pieces(as_sparse(one.lasting, one.lasting_share, lasting).toarray().T)
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

    def leverage(self) -> Floats:
        """Share of each coefficient's scatter between days that fitting took away.

        Of the aircraft's own equations, the field known; shape (aircraft, 6).
        """
        days = np.mean([one.day_information() for one in self.references], axis=0)
        total = days.sum(axis=1)
        ridge = 1e-9 * np.trace(total, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(8)
        inverse = np.linalg.inv(total + ridge)
        twice = np.einsum("adij,ajk,adkl->ail", days, inverse, days, optimize=True)
        taken = inverse @ twice @ inverse
        share = np.diagonal(taken, axis1=1, axis2=2) / np.diagonal(inverse, axis1=1, axis2=2)
        return np.asarray(np.minimum(share[:, :SLOPES], 0.5))


def _finished(system: _System, found: Floats, covariance: Floats, scores: Floats) -> FleetFit:
    """Covariance from the scatter between days, and what is published."""
    aircraft = system.free.shape[0]
    moved = (scores - scores.mean(axis=0)) @ covariance
    own = system.free.size
    inside = covariance[:own] ** 2 @ system.prior
    sandwich = (moved[:, :own] ** 2).sum(axis=0) + inside
    part = (sandwich / np.diagonal(covariance)[:own]).reshape(aircraft, SLOPES)
    part /= 1.0 - system.leverage()
    ratio = np.array(
        [
            part[:, k][system.free[:, k]].mean() if system.free[:, k].any() else 1.0
            for k in range(SLOPES)
        ]
    )
    for pair in ([1, 2], [3, 4]):
        ratio[pair] = ratio[pair].mean()
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
            one.stretch.lasting.ravel(), weights=(one.stretch.lasting_share * weight).ravel(),
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
