"""One candidate weighed against what is included already: of the fleet, or of single aircraft.

Assumptions: those of :mod:`airswing.gap.evidence.gaussian`, whose closed forms are put together
here. Per-aircraft candidates are a spike-and-slab mixture: a share pi of aircraft is struck, pi
averaged over a grid (:mod:`airswing.gap.evidence.aircraft_mixture`). How large the background is
the fleet itself tells, candidate by candidate: its size is averaged over
(:mod:`airswing.gap.evidence.between_aircraft_variance`), in the mixture as in the null, so that a
scatter all aircraft share is background as far as that is plausible and an effect from there on;
and so is the shift of all aircraft where they share what other columns take up
(:mod:`airswing.gap.evidence.common_mode`). Fleet candidates have one set of coefficients and a
fixed allowance.

Validity: a candidate counts in aircraft with twenty reports on which it acts.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.aircraft_mixture import by_share, log_mean, mixture
from airswing.gap.evidence.between_aircraft_variance import GRID, either, whole_prior
from airswing.gap.evidence.common_mode import Shifts, no_shift, shifts
from airswing.gap.evidence.gaussian import (
    SCALE_GRID,
    SIZE_GRID,
    Score,
    allowance_covariance,
    evidence_over_backgrounds,
    grid_evidence,
    raw_evidence,
    rms,
    sizes,
)
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.cluster_inflation import aircraft_factor, fleet_factor
from airswing.gap.sums.elimination import Conditional

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Reports on which a candidate must act to be looked at in an aircraft.
LEAST_ACTING = 20
#: Persistent model error allowed for in the fleet, m/s rms, of a column that the climatology takes
#: up wholly. Chosen on simulated archives: those without an effect of the fleet scatter about none
#: by more than their noise.
FLEET_ALLOWANCE = 0.12


def evaluate(
    stats: Statistics,
    given: Conditional,
    candidate: Candidate,
    *,
    allowed: NDArray[np.bool_] | None = None,
) -> Score:
    """Evidence of one candidate given the included columns.

    Parameters
    ----------
    stats : Statistics
    given : Conditional
    candidate : Candidate
    allowed : (A,) bool, optional
        Aircraft it may still strike; all by default.

    Returns
    -------
    Score
    """
    if candidate.scope == "fleet":
        return _evaluate_fleet(stats, given, candidate)
    return _evaluate_aircraft(stats, given, candidate, allowed)


def fleet_allowance(given: Conditional, columns: Integers) -> float:
    """Persistent model error allowed for in a fleet-wide effect, m/s rms where it acts.

    What the climatology does not hold of the persistent error has its structure: it is met by a
    column in the measure in which the climatology itself takes the column up. An effect that
    changes sign with the heading or with the passing of weather averages it out.

    Parameters
    ----------
    given : Conditional
    columns : (k,) int

    Returns
    -------
    float
        :data:`FLEET_ALLOWANCE` times the root of the share of the columns' X'X taken.
    """
    return FLEET_ALLOWANCE * float(np.sqrt(given.lasting_share[columns].mean()))


def _evaluate_fleet(stats: Statistics, given: Conditional, candidate: Candidate) -> Score:
    columns, aircraft = candidate.columns, len(stats.tails)
    pick = np.ix_(columns, columns)
    information, score = given.fleet_gram[pick], given.fleet_score[:, columns].sum(axis=0)
    factor = fleet_factor(stats, given, columns)
    second, acting = sizes(stats, candidate)
    allowance = allowance_covariance(
        second.sum(axis=0), float(acting.sum()), fleet_allowance(given, columns), candidate.scales
    )
    found = grid_evidence(
        information, score, factor=factor, allowance=allowance, scales=candidate.scales
    )
    estimate = np.tile(found.estimate[int(np.argmax(found.tempered))], (aircraft, 1))
    total = log_mean(found.tempered)
    return Score(
        candidate,
        total,
        log_mean(found.raw),
        factor,
        np.ones(aircraft),
        np.full(aircraft, total),
        estimate,
        rms(second, acting, estimate),
        acting,
    )


def _evaluate_aircraft(
    stats: Statistics, given: Conditional, candidate: Candidate, allowed: NDArray[np.bool_] | None
) -> Score:
    found = _aircraft_evidence(stats, given, candidate)
    second, acting = sizes(stats, candidate)
    asked = acting >= LEAST_ACTING if allowed is None else (acting >= LEAST_ACTING) & allowed
    # the background is told by all aircraft; those not asked about may be struck or not
    found.nothing[:, ~asked] += either(found.tempered[..., ~asked])
    found.tempered[..., ~asked], found.raw[..., ~asked] = 0.0, 0.0
    told = whole_prior() if given.background is None else given.background[int(candidate.heading)]
    mixed = mixture(found.tempered, found.nothing, found.states(told), found.levels)
    estimate = found.estimates[mixed.best]
    return Score(
        candidate,
        mixed.total,
        mixture(found.raw).total,
        found.factor,
        mixed.posterior,
        found.tempered[mixed.best],
        estimate,
        rms(second, acting, estimate),
        acting,
        background=mixed.background,
    )


@dataclass(frozen=True)
class _Aircraft:
    """Evidence about single aircraft at every state (T of them): background times shift.

    Attributes
    ----------
    tempered : (T, S, A) float
    nothing : (T, A) float
    raw : (1, S, A) float
    estimates : (T, S, A, k) float
    factor : float
    shift_weight : (C,) float
        Log weight of each shift of the fleet; one of 0 where aircraft share nothing.
    """

    tempered: Floats
    nothing: Floats
    raw: Floats
    estimates: Floats
    factor: float
    shift_weight: Floats

    @classmethod
    def empty(cls, aircraft: int, k: int, factor: float, shift_weight: Floats) -> _Aircraft:
        """Of no evidence for anything."""
        states, widths = shift_weight.size * GRID.size, SIZE_GRID.size
        return cls(
            np.zeros((states, widths, aircraft)),
            np.zeros((states, aircraft)),
            np.zeros((1, SCALE_GRID.size, aircraft)),
            np.zeros((states, widths, aircraft, k)),
            factor,
            shift_weight,
        )

    @property
    def levels(self) -> Floats:
        """Size of the background in every state, (T,)."""
        return np.tile(GRID, self.shift_weight.size)

    def states(self, background: Floats) -> Floats:
        """Log weight of every state, (T,), from that of the sizes of the background."""
        return np.asarray((self.shift_weight[:, None] + background).ravel())


def _aircraft_evidence(stats: Statistics, given: Conditional, candidate: Candidate) -> _Aircraft:
    """Evidence of each aircraft by background and, where aircraft share much, by shift."""
    columns = candidate.columns
    factor = aircraft_factor(stats, given, columns)
    second, acting = sizes(stats, candidate)
    live = acting >= LEAST_ACTING
    information = given.gram[:, columns[:, None], columns]
    score = given.score[:, :, columns].sum(axis=1)
    shared = _shared(given, columns, np.where(live[:, None, None], information, 0.0), score, factor)
    out = _Aircraft.empty(acting.size, columns.size, factor, shared.log_weight)
    if not live.any():
        return out
    out.raw[0][:, live] = raw_evidence(information[live], score[live], candidate.scales)
    own = (information if columns.size > 1 else shared.own[:, None, None])[live]
    tempered, estimate, nothing = evidence_over_backgrounds(
        own,
        score[live] + shared.values[:, None, None] * own[..., 0],
        factor=factor,
        scales=candidate.scales,
        unit=allowance_covariance(second[live], acting[live], 1.0, candidate.scales),
        levels=GRID,
    )
    states, widths, _ = out.tempered.shape
    width_last = np.moveaxis(tempered, 0, 2), np.moveaxis(estimate, 0, 2)
    out.tempered[:, :, live] = width_last[0].reshape(states, widths, -1)
    out.estimates[:, :, live] = width_last[1].reshape(states, widths, -1, columns.size)
    out.nothing[:, live] = nothing.reshape(states, -1)
    return out


def raw_of_one(given: Conditional, candidate: Candidate, one: int) -> float:
    """Raw evidence that one aircraft alone is struck, of those that may be, nats.

    Parameters
    ----------
    given : Conditional
    candidate : Candidate
        Of single aircraft.
    one : int

    Returns
    -------
    float
    """
    columns = candidate.columns
    information = given.gram[one][np.ix_(columns, columns)]
    score = given.score[one][:, columns].sum(axis=0)
    return log_mean(by_share(raw_evidence(information, score, candidate.scales)[:, None]))


def _shared(
    given: Conditional, columns: Integers, information: Floats, score: Floats, factor: float
) -> Shifts:
    """Shifts of the fleet to average over; only none where the candidate has more columns."""
    if columns.size > 1:
        return no_shift(information[:, 0, 0])
    fleet = float(given.fleet_gram[columns[0], columns[0]])
    return shifts(information[:, 0, 0], score[:, 0], fleet, factor)


def background_likelihood(stats: Statistics, given: Conditional, candidate: Candidate) -> Floats:
    """Log density of all aircraft's estimates at every size of the background, (T,).

    Parameters
    ----------
    stats : Statistics
    given : Conditional
    candidate : Candidate
        Of single aircraft.

    Returns
    -------
    (T,) float
    """
    found = _aircraft_evidence(stats, given, candidate)
    each = (found.nothing + either(found.tempered)).sum(axis=1).reshape(-1, GRID.size)
    return np.asarray(np.logaddexp.reduce(each + found.shift_weight[:, None], axis=0))
