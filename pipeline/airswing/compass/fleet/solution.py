"""Deviations of a fleet and the error of its references, solved together on the blocks' sums.

Assumes what :mod:`airswing.compass.fleet.reference_error` assumes of the reference's error; the
aircraft's own fits are near enough for one linear step. Unknown are A to E and the airspeed scale
of every aircraft and, for each reference, a bias of every aircraft and the lasting part of the
field; the passing part, the pieces' and the blocks' errors are in the weights (generalized least
squares).

Errors of different days (four segments, counted from the first) are taken as independent, whatever
they are within a day: the covariance is the model's, times the fleet's mean ratio of the sandwich
over days to the model's, parameter by parameter, since an aircraft's own days are too few to tell;
and not less than the model's where the archive has few days.

With very many blocks the Newton matrix is that of an even choice of them, scaled to all
(:mod:`airswing.compass.fleet.reference_equations`), while the step is made from everything and
repeated: that changes the covariance by a percent and the estimate not at all.

References
----------
Henderson 1975, Biometrics 31, 423-447; Schall 1991, Biometrika 78, 719-727 (variances);
Liang & Zeger 1986, Biometrika 73, 13-22 (sandwich).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airswing.compass.fleet.flight_segments import SLOPES, Blocks
from airswing.compass.fleet.inverse import Equations, Inverse, inverse_of
from airswing.compass.fleet.reference_equations import Reference
from airswing.compass.fleet.reference_error import Flags, Floats

SEGMENTS_A_DAY = 4  # Six hours each, as flight_segments cuts them
FEW_DAYS = 15
"""Below so many days their scatter may widen what the model says, not narrow it."""


@dataclass(frozen=True)
class FleetFit:
    """Joint estimate."""

    step: Floats  # (aircraft, 6): to add to the aircraft's own A to E and airspeed scale, radians
    covariance: Floats  # (aircraft, 6, 6)
    # bias, bias_covariance: (2,), (2, 2): mean error of the references over the blocks, m/s
    bias: Floats
    bias_covariance: Floats
    ratio: Floats  # (6,): what the covariance of the model was multiplied by
    regions: int  # that the passing part was worked in, of the reference that has most


def solve_fleet(blocks: list[list[Blocks]], free: Flags) -> FleetFit:
    """Estimate deviations and reference error of a fleet.

    Parameters
    ----------
    blocks : list of list of Blocks
        Of every aircraft, one for each reference.
    free : array of bool, shape (aircraft, 6)
        Which coefficients are fitted.
    """
    segments = np.unique(
        np.concatenate([np.unique(part.segment) for one in blocks for part in one])
    )
    days = np.unique((segments - segments[0]) // SEGMENTS_A_DAY) * SEGMENTS_A_DAY + segments[0]
    fleet = _Fleet(
        [Reference([one[k] for one in blocks], free, days) for k in range(len(blocks[0]))]
    )
    right = fleet.start()
    inverse = inverse_of(fleet.equations, right)
    found = inverse.solve(right)
    scores = fleet.scores(found)
    better = found + inverse.solve(scores.sum(axis=0) - inverse.prior * found)
    return _finished(fleet, better, inverse, scores)


class _Fleet:
    """All references' equations together."""

    def __init__(self, references: list[Reference]) -> None:
        self.references, self.free = references, references[0].free
        self.equations = Equations([one.coupling() for one in references], self.free)

    def start(self) -> Floats:
        """Score where every unknown is zero."""
        found = np.zeros(self.equations.size)
        for one, place in zip(self.references, self.equations.places(), strict=True):
            found[place] += one.start.sum(axis=0)
        return found

    def scores(self, unknowns: Floats) -> Floats:
        """As of :meth:`Reference.scores`, summed."""
        found = np.zeros((self.references[0].days.size, unknowns.size))
        for one, place in zip(self.references, self.equations.places(), strict=True):
            found[:, place] += one.scores(unknowns[place])
        return found

    def mean_rows(self) -> Floats:
        """What the mean error of the references is made of, shape (2, unknown)."""
        rows = np.zeros((2, self.equations.size))
        for one, (own, lasting) in zip(self.references, self.equations.split(), strict=True):
            total = one.worth.sum() * len(self.references)
            for c in range(2):
                rows[c, own[:, SLOPES + c]] = one.worth / total
                rows[c, lasting[c]] = one.lasting_worth / total
        return rows


def _finished(fleet: _Fleet, found: Floats, inverse: Inverse, scores: Floats) -> FleetFit:
    """Covariance from the scatter between days, and what is published."""
    free, square = fleet.free, inverse.own()
    sandwich = inverse.squares((scores - scores.mean(axis=0)).T) + inverse.prior_squares()
    part = sandwich / np.diagonal(square, axis1=1, axis2=2)
    part /= 1.0 - np.mean([one.leverage() for one in fleet.references], axis=0)
    ratio = np.array(
        [part[:, k][free[:, k]].mean() if free[:, k].any() else 1.0 for k in range(SLOPES)]
    )
    for pair in ([1, 2], [3, 4]):
        ratio[pair] = ratio[pair].mean()
    if scores.shape[0] < FEW_DAYS:
        ratio = np.maximum(ratio, 1.0)
    root = np.sqrt(ratio) * free
    square = square * root[:, :, np.newaxis] * root[:, np.newaxis]
    rows = fleet.mean_rows()
    spread = rows @ inverse.solve(rows.T) * max(float(ratio.mean()), 1.0)
    regions = max(one.basis.regions for one in fleet.references)
    step = found[: free.size].reshape(free.shape)
    return FleetFit(step, square, rows @ found, spread, ratio, regions)
