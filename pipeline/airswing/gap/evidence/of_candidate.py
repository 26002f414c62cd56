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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.aircraft_mixture import Same, by_share, log_mean, mixture
from airswing.gap.evidence.between_aircraft_variance import GRID, either, whole_prior
from airswing.gap.evidence.common_mode import COMMON, Shifts, common_part, no_shift, shifts
from airswing.gap.evidence.gaussian import (
    SCALE_GRID,
    SIZE_GRID,
    Score,
    allowance_covariance,
    evidence_of_same,
    evidence_over_backgrounds,
    grid_evidence,
    log_prior_of_sizes,
    own_fit,
    raw_evidence,
    rms,
    sizes,
)
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.cluster_inflation import aircraft_factors, fleet_factors
from airswing.gap.sums.elimination import Base, Conditional

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Reports on which a candidate must act to be looked at in an aircraft.
LEAST_ACTING = 20
#: Persistent model error allowed for in the fleet, m/s rms, of a column that the climatology takes
#: up wholly. Chosen on simulated archives: those without an effect of the fleet scatter about none
#: by more than their noise.
FLEET_ALLOWANCE = 0.12
#: Sizes of one effect that several aircraft have alike, m/s rms in each direction where it acts.
SAME = np.outer([-1.0, 1.0], np.geomspace(0.1, 6.4, 13)).ravel()
#: Their log probability: that of an effect of single aircraft.
SAME_PRIOR = log_prior_of_sizes(SAME)
#: Entries of the daily sums of candidates that are worked out together, for memory (8 bytes each).
MOST_TOGETHER = 2_000_000


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
    allowed : (A,) bool, optional
        Aircraft it may still strike; all by default.
    """
    return evaluate_each(stats, given, [candidate], allowed=[allowed])[0]


def evaluate_each(
    stats: Statistics,
    given: Conditional,
    pool: Sequence[Candidate],
    *,
    allowed: Sequence[NDArray[np.bool_] | None],
) -> list[Score]:
    """Evidence of each of many candidates given the included columns, in their order.

    Candidates of one scope and number of columns are worked out together: their matrices are so
    small that one at a time the calls cost more than the arithmetic.

    Parameters
    ----------
    allowed : sequence of (A,) bool or None
        Of each, aircraft it may still strike; None: all.
    """
    alike: dict[tuple[str, int, int, bool], list[int]] = {}
    for n, c in enumerate(pool):
        core = bool(c.columns.max() < stats.layout.core)
        alike.setdefault((c.scope, c.columns.size, c.free, core), []).append(n)
    found: dict[int, Score] = {}
    for (scope, k, _, _), members in alike.items():
        together = max(1, MOST_TOGETHER // (stats.day_count.size * k * k))
        for start in range(0, len(members), together):
            some = members[start : start + together]
            if scope == "fleet":
                scores = _evaluate_fleet(stats, given, [pool[n] for n in some])
            else:
                asked = [allowed[n] for n in some]
                scores = _evaluate_aircraft(stats, given, [pool[n] for n in some], asked)
            found.update(zip(some, scores, strict=True))
    return [found[n] for n in range(len(pool))]


def fleet_allowance(given: Conditional | Base, columns: Integers) -> float:
    """Persistent model error allowed for in a fleet-wide effect, m/s rms where it acts.

    What the climatology does not hold of the persistent error has its structure: it is met by a
    column in the measure in which the climatology itself takes the column up. An effect that
    changes sign with the heading or with the passing of weather averages it out. Errors of
    heading and airspeed are met by what the scatter of headings looks like as well
    (:mod:`airswing.gap.evidence.scattered_headings`).

    Parameters
    ----------
    given : Conditional or Base
    columns : (k,) int

    Returns
    -------
    float
        :data:`FLEET_ALLOWANCE` times the root of the share of the columns' X'X taken, and that.
    """
    lasting = FLEET_ALLOWANCE * float(np.sqrt(given.lasting_share[columns].mean()))
    like = 0.0 if given.scattered is None else float(given.scattered[columns].max())
    return float(np.hypot(lasting, like))


@dataclass(frozen=True)
class _Alike:
    """Candidates with as many columns (N, k), as many of them free (m)."""

    columns: Integers
    scales: Floats  # (N, m): prior scales of the free coefficients
    tied: Floats | None  # (N, k, m): how all follow from the free ones; None: all are free

    @classmethod
    def of(cls, pool: Sequence[Candidate]) -> _Alike:
        """Stack what belongs to the candidates."""
        tied = [c.tied for c in pool if c.tied is not None]
        return cls(
            np.stack([c.columns for c in pool]),
            np.stack([c.scales[: c.free] for c in pool]),
            np.stack(tied) if tied else None,
        )

    def matrix(self, whole: Floats) -> Floats:
        """X'X (N, ..., k, k) of the free coefficients, (N, ..., m, m)."""
        if self.tied is None:
            return whole
        tied = self.tied.reshape(len(whole), *[1] * (whole.ndim - 3), *self.tied.shape[1:])
        return np.asarray(tied.swapaxes(-1, -2) @ whole @ tied)

    def score(self, whole: Floats) -> Floats:
        """X'r (N, ..., k) of the free coefficients, (N, ..., m)."""
        return whole if self.tied is None else np.einsum("n...k,nkm->n...m", whole, self.tied)

    def sizes(self, stats: Statistics) -> tuple[Floats, Floats]:
        """Second moments (N, A, m, m), and the reports on which the candidates act (N, A).

        A column that is taken off another acts on a part of what that one does.
        """
        second, acting = sizes(stats, self.columns)
        if self.tied is None:
            return second, acting
        off = np.asarray(np.any(self.tied < 0, axis=2))
        each = np.moveaxis(stats.acting[:, self.columns], 0, 1)
        less = np.where(off[:, None], each, 0.0).max(axis=-1)
        return self.matrix(second), np.maximum(acting - less, 0.0)


def _evaluate_fleet(
    stats: Statistics, given: Conditional, pool: Sequence[Candidate]
) -> list[Score]:
    alike, aircraft = _Alike.of(pool), len(stats.tails)
    columns, scales = alike.columns, alike.scales
    information = alike.matrix(given.fleet_gram[columns[:, :, None], columns[:, None]])
    score = alike.score(given.fleet_score[columns])
    factor = fleet_factors(stats, given, columns)
    second, acting = alike.sizes(stats)
    size = np.array([fleet_allowance(given, own) for own in columns])
    allowance = allowance_covariance(second.sum(axis=1), acting.sum(axis=1), size, scales)
    fit = own_fit(information, score, scales)
    found, raw = grid_evidence(fit, factor=factor, allowance=allowance), raw_evidence(fit)
    out = []
    for n, candidate in enumerate(pool):
        tempered = found.tempered[:, n]
        estimate = np.tile(found.estimate[int(np.argmax(tempered)), n], (aircraft, 1))
        total = log_mean(tempered)
        out.append(
            Score(
                candidate,
                total,
                log_mean(raw[:, n]),
                float(factor[n]),
                np.ones(aircraft),
                np.full(aircraft, total),
                candidate.coefficients(estimate),
                rms(second[n], acting[n], estimate),
                acting[n],
            )
        )
    return out


def _evaluate_aircraft(
    stats: Statistics,
    given: Conditional,
    pool: Sequence[Candidate],
    allowed: Sequence[NDArray[np.bool_] | None],
) -> list[Score]:
    second, acting = _Alike.of(pool).sizes(stats)
    out = []
    for n, found in enumerate(_aircraft_evidence(stats, given, pool)):
        candidate, may = pool[n], allowed[n]
        asked = acting[n] >= LEAST_ACTING if may is None else (acting[n] >= LEAST_ACTING) & may
        # the background is told by all aircraft; those not asked about may be struck or not
        found.nothing[:, ~asked] += either(found.tempered[..., ~asked])
        found.tempered[..., ~asked], found.raw[..., ~asked] = 0.0, 0.0
        if found.same is not None:
            found.same.evidence[..., ~asked] = 0.0
        prior = given.background
        told = whole_prior() if prior is None else prior[int(candidate.heading)]
        mixed = mixture(found.tempered, found.nothing, found.states(told), found.levels, found.same)
        estimate = found.estimates[mixed.best]
        out.append(
            Score(
                candidate,
                mixed.total,
                log_mean(by_share(found.raw).sum(axis=-1)),
                found.factor,
                mixed.posterior,
                found.tempered[mixed.best],
                candidate.coefficients(estimate),
                rms(second[n], acting[n], estimate),
                acting[n],
                background=mixed.background,
            )
        )
    return out


@dataclass(frozen=True)
class _Aircraft:
    """Evidence about single aircraft at every state (T of them): background times shift."""

    tempered: Floats  # (T, S, A)
    nothing: Floats  # (T, A)
    raw: Floats  # (1, S, A)
    estimates: Floats  # (T, S, A, k)
    factor: float
    # (C,): log weight of each shift of the fleet; one of 0 where aircraft share nothing
    shift_weight: Floats
    same: Same | None  # of one coefficient; None of more

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
            Same(np.zeros((states, SAME.size, aircraft)), SAME_PRIOR) if k == 1 else None,
        )

    @property
    def levels(self) -> Floats:
        """Size of the background in every state, (T,)."""
        return np.tile(GRID, self.shift_weight.size)

    def states(self, background: Floats) -> Floats:
        """Log weight of every state, (T,), from that of the sizes of the background."""
        return np.asarray((self.shift_weight[:, None] + background).ravel())


def _aircraft_evidence(
    stats: Statistics, given: Conditional, pool: Sequence[Candidate]
) -> list[_Aircraft]:
    """Evidence of each aircraft by background and, where aircraft share much, by shift."""
    alike = _Alike.of(pool)
    columns, scales, free = alike.columns, alike.scales, alike.scales.shape[1]
    rows, along = columns[:, :, None], columns[:, None]
    factor = aircraft_factors(stats, given, columns)
    second, acting = alike.sizes(stats)
    live = acting >= LEAST_ACTING
    information = alike.matrix(given.gram[:, rows, along].swapaxes(0, 1))
    score = alike.score(given.score[:, columns].swapaxes(0, 1))
    known = np.where(live[..., None, None], information, 0.0)
    fleet = alike.matrix(given.fleet_gram[rows, along])
    unit = np.sqrt(second.sum(axis=1)[:, 0, 0] / np.maximum(acting.sum(axis=1), 1.0))
    of_size = 1.0 / np.maximum(unit, 1e-12)  # coefficient of 1 m/s
    common = COMMON * of_size
    shared = [_shared(*each) for each in zip(fleet, known, score, factor, common, strict=True)]
    out = [
        _Aircraft.empty(live.shape[1], free, float(own), s.log_weight)
        for own, s in zip(factor, shared, strict=True)
    ]
    which, who = np.nonzero(live)
    wide = scales[which]
    unit = allowance_covariance(second[live], acting[live], 1.0, wide)
    raw = raw_evidence(own_fit(information[live], score[live], wide))
    if free == 1:
        information = np.stack([s.own for s in shared])[..., None, None]
    # candidates whose aircraft share nothing have one state a background, and go together
    alone = np.array([s.values.size == 1 for s in shared])
    for several in [np.flatnonzero(alone), *np.flatnonzero(~alone)[:, None]]:
        mine = np.isin(which, several)
        if not mine.any():
            continue
        own = information[live][mine]
        shift = shared[several[0]].values[:, None, None]
        fit = own_fit(own, score[live][mine] + shift * own[..., 0], wide[mine])
        beside = {"factor": factor[which[mine]], "unit": unit[mine], "levels": GRID}
        tempered, estimate, nothing = evidence_over_backgrounds(fit, **beside)
        states, widths = out[several[0]].tempered.shape[:2]
        tempered = np.moveaxis(tempered, 0, 2).reshape(states, widths, -1)
        estimate = np.moveaxis(estimate, 0, 2).reshape(states, widths, -1, free)
        nothing = nothing.reshape(states, -1)
        values = SAME[:, None] * of_size[which[mine]]
        same = evidence_of_same(fit, **beside, values=values) if free == 1 else np.zeros(0)
        for n in several:
            here, to = which[mine] == n, who[which == n]
            out[n].tempered[:, :, to] = tempered[..., here]
            out[n].estimates[:, :, to] = estimate[:, :, here]
            out[n].nothing[:, to] = nothing[:, here]
            if (own_same := out[n].same) is not None:
                by_state = np.moveaxis(same[..., here], 0, 2)
                own_same.evidence[:, :, to] = by_state.reshape(states, SAME.size, -1)
    for n, found in enumerate(out):
        found.raw[0][:, live[n]] = raw[:, which == n]
    return out


def raw_of_one(given: Conditional, pool: Sequence[Candidate], one: int) -> Floats:
    """Raw evidence that one aircraft alone is struck by each candidate, of those that may be, nats.

    Parameters
    ----------
    pool : sequence of Candidate
        Of single aircraft.

    Returns
    -------
    (N,) float
    """
    out = np.zeros(len(pool))
    score = given.score[one]
    for kind in {(c.columns.size, c.free) for c in pool}:
        members = [n for n, c in enumerate(pool) if (c.columns.size, c.free) == kind]
        alike = _Alike.of([pool[n] for n in members])
        rows, along = alike.columns[:, :, None], alike.columns[:, None]
        fit = own_fit(
            alike.matrix(given.gram[one][rows, along]),
            alike.score(score[alike.columns]),
            alike.scales,
        )
        shares = by_share(raw_evidence(fit))
        out[members] = [log_mean(shares[..., n]) for n in range(len(members))]
    return out


def _shared(
    fleet: Floats, information: Floats, score: Floats, factor: float, common: float
) -> Shifts:
    """Shifts of the fleet to average over; only none where the candidate has more coefficients."""
    own = information[:, 0, 0]
    if len(fleet) > 1:
        return no_shift(own)
    found = shifts(own, score[:, 0], float(fleet[0, 0]), factor)
    return found if found.values.size > 1 else common_part(own, score[:, 0], common, factor)


def background_likelihood(stats: Statistics, given: Conditional, candidate: Candidate) -> Floats:
    """Log density of all aircraft's estimates at every size of the background, (T,).

    Parameters
    ----------
    candidate : Candidate
        Of single aircraft.
    """
    (found,) = _aircraft_evidence(stats, given, [candidate])
    each = (found.nothing + either(found.tempered)).sum(axis=1).reshape(-1, GRID.size)
    return np.asarray(np.logaddexp.reduce(each + found.shift_weight[:, None], axis=0))
