"""What effects that were not named could still close: silence excludes nothing.

Assumptions: every effect of the catalogue is at work beside those named with small odds, which its
own evidence raises or lowers; on which aircraft its mixture tells, how large its estimate and that
estimate's error. What it then closes is worked out to second order in its size, draw by draw; most
draws hold nothing. Effects are drawn independently of each other. What of such an effect the named
ones copy closes nothing more: were it at work, they would be smaller by as much (an offset of the
whole fleet beside offsets of every aircraft).

Validity: effects well under the disagreement itself (several m/s); those that act from a date on
count with the days they were found to act on. Swaps of tails, outliers and coding are not in it.

Source: docs/gap.md section 7; posterior of a spike-and-slab mixture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.of_candidate import LEAST_ACTING
from airswing.gap.evidence.terms import Term, day_factors
from airswing.gap.held_out.reduction import term_fields
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Probability of any one effect to be at work that is not named, before its evidence is seen.
BESIDE = 0.05
#: Probability under which an effect is passed over.
LEAST_CHANCE = 0.002
#: Disagreement, m/s, under which a report no longer curves the closure.
LEAST_SPEED = 0.5
#: Relative size under which a combination of named effects' fields copies nothing.
LEAST_OWN = 1e-8


def left_over(
    problem: Problem,
    found: Found,
    residual: Floats,
    rng: np.random.Generator,
    draws: int,
    *,
    named: Sequence[int] = (),
) -> Floats:
    """Draws of what the effects that were not named would close together.

    Parameters
    ----------
    residual : (n, 2) float
        With the named effects taken off, m s-1.
    named : sequence of int
        Positions of the terms that are named.

    Returns
    -------
    (draws,) float
        Mean reduction over all reports, m s-1.
    """
    frame = problem.archive
    total = np.zeros(draws)
    terms = [found.terms[k] for k in named]
    silent = [s for s in _silent(found) if s.chance >= LEAST_CHANCE and s.units.any()]
    for own in _by_aircraft(frame):
        part, when = frame.take(own), problem.day[own]
        beside = _Beside(part, when, residual[own], *_named_fields(problem, terms, part, when))
        for one in silent:
            _add_slopes(one, beside, problem)
    for one in silent:
        slope, curve = one.net()
        steps = _drawn(found, one.score, one.units, rng, draws)
        steps *= (rng.uniform(size=draws) < one.chance)[:, None, None]
        total += np.einsum("dak,ak->d", steps, slope)
        total -= 0.5 * np.einsum("dak,akl,dal->d", steps, curve, steps, optimize=True)
    return np.asarray(total / frame.size)


@dataclass
class _Silent:
    """An effect that was not named: chance that it is at work, and where; what it would close."""

    score: Score
    chance: float
    units: NDArray[np.bool_]
    slope: Floats | float = 0.0
    curve: Floats | float = 0.0
    gram: Floats | float = 0.0

    def add(self, unit: int, residual: Floats, fields: Floats) -> None:
        """Add an aircraft's reports, the fields of named effects of the fleet behind its own."""
        slope, curve = closure_slopes(residual, fields)
        here = np.arange(self.units.size) == unit
        self.slope = self.slope + here[:, None] * slope
        self.curve = self.curve + here[:, None, None] * curve
        self.gram = self.gram + np.einsum("nck,ncl->kl", fields, fields)

    def net(self) -> tuple[Floats, Floats]:
        """Slopes with what named effects of the fleet give back, (units, k) and (units, k, k)."""
        k, gram = self.score.candidate.columns.size, np.asarray(self.gram)
        # least squares with a bound: named effects that copy each other have no inverse
        back = np.linalg.lstsq(gram[k:, k:], gram[k:, :k], rcond=LEAST_OWN)[0]
        whole = np.vstack([np.eye(k), -back])
        return self.slope @ whole, whole.T @ self.curve @ whole


@dataclass(frozen=True)
class _Beside:
    """Reports of an aircraft, and what is named on them."""

    part: Frame
    day: Integers
    residual: Floats
    own: Floats
    of_fleet: Floats


def _silent(found: Found) -> list[_Silent]:
    """All effects that were not named."""
    out = []
    for score in alternatives(found):
        odds = score.tempered + np.log(BESIDE / (1 - BESIDE))
        out.append(_Silent(score, float(1 / (1 + np.exp(-odds))), _units(found, score)))
    return out


def _by_aircraft(frame: Frame) -> list[Integers]:
    """Reports of each aircraft: columns of one at a time fit in memory."""
    order = np.argsort(frame.aircraft, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(frame.aircraft[order])) + 1)


def _named_fields(
    problem: Problem, terms: Sequence[Term], part: Frame, day: Integers
) -> tuple[Floats, Floats]:
    """Fields of the named effects of this aircraft, and of the fleet's beside them."""
    kinds: list[list[Floats]] = [[np.zeros((part.size, 2, 0))], [np.zeros((part.size, 2, 0))]]
    for term in terms:
        of_fleet = term.candidate.scope == "fleet"
        if of_fleet or int(part.aircraft[0]) in term.tails:
            fields = term_fields(part, term, effects=problem.effects, plan=problem.plan)
            acts = day_factors(term.candidate, term.period, problem.calendar.days)
            kinds[of_fleet].append(fields * acts[day, None, None])
    own, shared = (np.concatenate(kind, axis=2) for kind in kinds)
    return own, _beside(shared, own)


def _beside(fields: Floats, named: Floats) -> Floats:
    """What of fields no combination of the named ones copies: the rest they would give back."""
    if not named.shape[2] or not fields.shape[2]:
        return fields
    flat = fields.reshape(-1, fields.shape[2])
    like = named.reshape(-1, named.shape[2])
    back = np.linalg.lstsq(like.T @ like, like.T @ flat, rcond=LEAST_OWN)[0]
    return np.asarray((flat - like @ back).reshape(fields.shape))


def _add_slopes(one: _Silent, beside: _Beside, problem: Problem) -> None:
    """Add an aircraft's reports to the slopes of an effect."""
    score, part = one.score, beside.part
    unit = 0 if _of_fleet(score) else int(part.aircraft[0])
    if not one.units[unit]:
        return
    term = Term(score.candidate, (unit,), score.period, score)
    fields = term_fields(part, term, effects=problem.effects, plan=problem.plan)
    acts = day_factors(score.candidate, score.period, problem.calendar.days)
    fields = _beside(fields * acts[beside.day, None, None], beside.own)
    # what one aircraft has the fleet's effects do not follow: they answer to all
    shared = beside.of_fleet if _of_fleet(score) else np.zeros((part.size, 2, 0))
    one.add(unit, beside.residual, np.concatenate([fields, shared], axis=2))


def alternatives(found: Found) -> list[Score]:
    """Likeliest form of every effect of the catalogue that was left over."""
    best: dict[tuple[str, str], Score] = {}
    for score in found.left:
        key = score.candidate.name, score.candidate.scope
        if score.candidate.known and (key not in best or score.tempered > best[key].tempered):
            best[key] = score
    return list(best.values())


def closure_slopes(residual: Floats, fields: Floats) -> tuple[Floats, Floats]:
    """First and second derivative of the summed disagreement by coefficients taken off.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    fields : (n, 2, k) float
        Wind error per unit of each coefficient.

    Returns
    -------
    slope : (k,) float
    curve : (k, k) float
        Coefficients c close ``slope c - c' curve c / 2``, summed over reports, m s-1.
    """
    speed = np.hypot(*residual.T)
    # a residual of nil has no direction, and closes nothing either way
    along = np.einsum("nc,nck->nk", residual / np.maximum(speed, 1e-9)[:, None], fields)
    weight = 1 / np.maximum(speed, LEAST_SPEED)
    curve = np.einsum("nck,ncl,n->kl", fields, fields, weight, optimize=True)
    curve -= np.einsum("nk,nl,n->kl", along, along, weight, optimize=True)
    return along.sum(axis=0), curve


def _of_fleet(score: Score) -> bool:
    return score.candidate.scope == "fleet"


def _units(found: Found, score: Score) -> NDArray[np.bool_]:
    """Aircraft, or the one fleet, that the effect may strike beside what is named."""
    key = score.candidate.name, score.candidate.scope
    taken = [t for term in found.terms if term.key == key for t in term.tails]
    if _of_fleet(score):
        return np.array([not taken])
    out = score.acting >= LEAST_ACTING
    out[taken] = False
    return np.asarray(out)


def _drawn(
    found: Found, score: Score, units: NDArray[np.bool_], rng: np.random.Generator, draws: int
) -> Floats:
    """Coefficients (draws, units, k) where the effect is at work; zero on aircraft not struck."""
    columns, given = score.candidate.columns, found.given
    pick = np.ix_(columns, columns)
    out = np.zeros((draws, units.size, columns.size))
    for unit in np.flatnonzero(units).tolist():
        if _of_fleet(score):
            gram, own, struck = given.fleet_gram[pick], given.fleet_score, 1.0
        else:
            gram, own = given.gram[unit][pick], given.score[unit]
            struck = float(score.posterior[unit])
        spread = np.linalg.inv(gram / score.factor + np.diag(1 / score.candidate.scales**2))
        middle = spread @ own[columns] / score.factor
        values, vectors = np.linalg.eigh(spread)
        # rounding leaves the smallest a little below zero
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        steps = middle + rng.standard_normal((draws, columns.size)) @ root.T
        out[:, unit] = steps * (rng.uniform(size=draws) < struck)[:, None]
    return out
