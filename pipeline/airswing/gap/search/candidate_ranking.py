"""All candidates evaluated against one state of the search, best first.

Assumptions: an effect that changes in time has a lasting version of itself among its columns; it is
evaluated only for aircraft whose change, or the fleet's together, explains clearly more than that
(a lasting offset would otherwise enter as a drift of no rate, or as a step in the archive's first
days). Dictionary groups must have something to say beyond the steady sensor errors.

Validity: as the evidence it ranks, :mod:`airswing.gap.evidence.gaussian`.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.aircraft_mixture import log_mean
from airswing.gap.evidence.changepoint import GAIN_SHARE, evaluate_step, raw_of_one_step
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.of_candidate import evaluate, evaluate_each, raw_of_one
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.sums.beyond import beyond
from airswing.gap.sums.elimination import Base, Conditional

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Effects beyond which a dictionary group must have something to say.
BASICS = ("compass_offset", "hard_iron", "soft_iron", "tas_scale", "tas_offset")
#: Tempered evidence beyond the basics that a dictionary group needs, nats.
LEAST_NOVELTY = 3.0
#: Prior log odds against an effect that changes in time where a steady one does, nats; a unit that
#: is exchanged or swung is commoner than one that drifts.
CHANGE_PENALTY = {"step": 3.0, "drift": 4.0, "onset": 5.0}
#: Raw evidence by which an effect explains an aircraft clearly better than another, in cluster
#: factors.
CLEARLY = 3.0
#: What a drift must explain beyond the same effect lasting, nats.
DRIFT_GAIN = 2.5


class Ranking:
    """All candidates ranked given some terms; the search comes back to the same terms often.

    So does a search again without a candidate that days left out did not confirm: what is ranked
    is kept for all of them, and of it those are given that are still candidates.
    """

    def __init__(self, base: Base, pool: Sequence[Candidate]) -> None:
        self.base, self.pool = base, tuple(pool)
        self._whole = self.pool
        self._made: dict[frozenset[object], tuple[Score, ...]] = {}

    def among(self, pool: Sequence[Candidate]) -> Ranking:
        """Ranking of a part of the candidates, from what is kept."""
        part = copy(self)
        part.pool = tuple(pool)
        return part

    def __call__(self, terms: Sequence[Term]) -> tuple[Score, ...]:
        """Rank the candidates given some terms, best raw evidence first."""
        state = frozenset((t.candidate.key, t.tails, t.period) for t in terms)
        if state not in self._made:
            given = given_terms(self.base, terms)
            ranked = rank(self.base, given, self._whole, _taken(terms))
            self._made[state] = tuple(replace(s, remainder=remainder(terms, s)) for s in ranked)
        keys = {candidate.key for candidate in self.pool}
        return tuple(score for score in self._made[state] if score.candidate.key in keys)


def remainder(terms: Sequence[Term], score: Score) -> Floats:
    """Size of what the columns of some terms cannot carry, as a candidate may take it up.

    Bank and acceleration are inferred, gradients are the reference's: a part of such an effect
    stays in the residual when all its columns explain is taken off, and is nothing else. Across the
    heading it stays across; over more reports than the effect acts on it is thinned out.

    Parameters
    ----------
    score : Score
        Of the candidate.

    Returns
    -------
    (A,) float
        m/s rms where the candidate acts.
    """
    square = np.zeros(score.acting.size)
    for term in terms:
        what = term.candidate
        of_weather = score.candidate.scope == "fleet" and not score.candidate.heading
        if of_weather or (what.heading and not score.candidate.heading):
            continue
        # the reference's error is met by all aircraft alike: none parts from the others by it
        if not what.heading and what.scope == "fleet" and score.candidate.scope != "fleet":
            continue
        tails = list(term.tails)
        thinned = np.minimum(1.0, term.score.acting[tails] / np.maximum(score.acting[tails], 1.0))
        square[tails] += term.score.size[tails] ** 2 * (1 / what.told_share - 1) * thinned
    return np.asarray(np.sqrt(square))


def _taken(terms: Sequence[Term]) -> dict[tuple[str, str], set[int]]:
    out: dict[tuple[str, str], set[int]] = {}
    for term in terms:
        out.setdefault(term.key, set()).update(term.tails)
    return out


def rank(
    base: Base,
    given: Conditional,
    pool: Sequence[Candidate],
    taken: dict[tuple[str, str], set[int]],
) -> list[Score]:
    """Evaluate all candidates, best raw evidence first.

    Parameters
    ----------
    taken : dict
        (name, scope) -> aircraft already in a term of that name.
    """
    aircraft = len(base.stats.tails)
    free = {}
    for key in {(c.name, c.scope) for c in pool}:
        own = taken.get(key, set())
        free[key] = np.array([a not in own for a in range(aircraft)])
    pool = [c for c in pool if free[c.name, c.scope].any()]
    named = [c for c in pool if c.known]
    known = evaluate_all_known(base, given, named, [free[c.name, c.scope] for c in named])
    out = _one_of_many(known)
    groups = [c for c in pool if not c.known]
    allowed = [free[c.name, c.scope] for c in groups]
    out += _groups(base, given, groups, allowed)
    # as if each had been weighed in the pool's order: of equals the first stays first
    place = {c.key: n for n, c in enumerate(pool)}
    return sorted(out, key=lambda s: (-s.raw, place[s.candidate.key]))


def _one_of_many(scores: Sequence[Score]) -> list[Score]:
    """Take off every form's evidence what the best gains by being chosen among its like.

    Of the bands of temperature a heater may be on in, forty are looked at, and one stands out on
    some aircraft of nearly every fleet. Their mean is the evidence that there is any of them; forms
    that share no column (by a flag, by temperature) are questions of their own.
    """
    out, families = list(scores), _families([score.candidate for score in scores])
    for family in families:
        evidence = np.array([scores[n].tempered for n in family])
        gained = float(evidence.max()) - log_mean(evidence)
        for n in family:
            out[n] = replace(scores[n], tempered=scores[n].tempered - gained)
    return out


def _families(pool: Sequence[Candidate]) -> list[list[int]]:
    """Places of the lasting forms of one effect and scope that are joined by columns they share."""
    out: list[tuple[tuple[str, str], set[int], list[int]]] = []
    for n, one in enumerate(pool):
        if one.kind != "mean" or not one.subset:
            continue
        key, columns, places = (one.name, one.scope), {int(j) for j in one.columns}, [n]
        joined = [f for f in out if f[0] == key and f[1] & columns]
        for family in joined:
            columns, places = columns | family[1], family[2] + places
            out.remove(family)
        out.append((key, columns, places))
    return [places for _, _, places in out if len(places) > 1]


def _groups(
    base: Base, given: Conditional, groups: Sequence[Candidate], allowed: Sequence[Mask]
) -> list[Score]:
    """Scores of dictionary groups: all each explains where it has something new to say."""
    layout = base.stats.layout
    names = [name for name in BASICS if name in layout.blocks]
    novel = beyond(given, np.concatenate([layout.columns(n) for n in names])) if names else given
    out = [
        replace(score, novelty=score.tempered)
        for score in evaluate_each(base.stats, novel, groups, allowed=allowed)
    ]
    whole = [
        n
        for n, score in enumerate(out)
        if score.novelty >= LEAST_NOVELTY and groups[n].component != "wind"
    ]
    again = evaluate_each(
        base.stats, given, [groups[n] for n in whole], allowed=[allowed[n] for n in whole]
    )
    for n, score in zip(whole, again, strict=True):
        if score.tempered > out[n].novelty:
            out[n] = replace(score, novelty=out[n].novelty)
    return out


def evaluate_all_known(
    base: Base, given: Conditional, pool: Sequence[Candidate], allowed: Sequence[Mask]
) -> list[Score]:
    """Evidence of effects of the catalogue, in time if they change in time.

    Parameters
    ----------
    allowed : sequence of (A,) bool
        Aircraft each may still strike.

    Returns
    -------
    list of Score
        In the pool's order.
    """
    pairs = list(zip(pool, allowed, strict=True))
    whole = [(c, may) for c, may in pairs if not c.dated]
    scores = iter(
        evaluate_each(base.stats, given, [c for c, _ in whole], allowed=[may for _, may in whole])
    )
    out = []
    for candidate, may in pairs:
        if candidate.dated:
            out.append(evaluate_step(base, given, candidate, allowed=may))
        elif candidate.lasting:
            out.append(_where_it_changes(base, given, next(scores), may))
        else:
            out.append(next(scores))
    return out


def _where_it_changes(base: Base, given: Conditional, score: Score, allowed: Mask) -> Score:
    """Evidence of a drift in the aircraft, or the fleet, that show it beyond what lasts."""
    candidate = score.candidate
    lasting = evaluate(base.stats, given, _lasting(candidate), allowed=allowed)
    own, steady = score.aircraft_evidence, lasting.aircraft_evidence
    changes = own - steady > np.maximum(DRIFT_GAIN, GAIN_SHARE * own)
    # together aircraft may tell what none of them tells alone
    gain, whole = (score.raw - lasting.raw) / score.factor, score.raw / score.factor
    if gain > max(DRIFT_GAIN, GAIN_SHARE * whole):
        changes |= (own > np.maximum(steady, 0.0)) | _like(score, changes)
    if candidate.scope == "fleet" and not changes.any():
        return replace(score, tempered=0.0, raw=0.0, aircraft_evidence=np.zeros_like(own))
    return evaluate(base.stats, given, candidate, allowed=allowed & changes)


def _like(score: Score, changes: Mask) -> Mask:
    """Aircraft (A,) that change as those do that show it alone: by half as much and more."""
    growing = ~np.isin(score.candidate.columns, score.candidate.steady)
    found = score.estimate[:, growing] / score.candidate.scales[growing]
    usual = found[changes].mean(axis=0) if changes.any() else np.zeros(int(growing.sum()))
    return np.asarray((found @ usual > 0.5 * (usual @ usual)) & (score.aircraft_evidence > 0.0))


def evaluate_named(
    base: Base,
    given: Conditional,
    candidate: Candidate,
    allowed: Mask,
    period: tuple[int, int] | None,
) -> Score:
    """Evidence of an effect that was named, for some of its aircraft.

    That it changes in time, and when, was shown by all of them together and is not asked of each
    again.

    Parameters
    ----------
    base, given, candidate, allowed
        As for :func:`evaluate_all_known`.
    period : (int, int) or None
        Days in which it was found to act; None: always, of a step any.
    """
    if candidate.dated:
        return evaluate_step(base, given, candidate, allowed=allowed, period=period, shown=True)
    return evaluate(base.stats, given, candidate, allowed=allowed)


def _lasting(candidate: Candidate) -> Candidate:
    """Version of a candidate without its change in time."""
    scales = np.array([scale for _, scale in candidate.lasting])
    return replace(candidate, columns=candidate.steady, scales=scales)


def better_for(
    base: Base, others: Sequence[Term], pool: Sequence[Candidate], one: int, current: Term
) -> Score | None:
    """Find the best candidate for one aircraft where it beats the term it is in clearly.

    Effects are ranked by raw evidence, of one aircraft as of all: the background weighs on a drift
    more than on a step.

    Parameters
    ----------
    others : sequence of Term
        What is given.
    pool : sequence of Candidate
        Known ones of aircraft scope.
    """
    allowed = np.arange(len(base.stats.tails)) == one
    given = given_terms(base, others, columns=current.candidate.columns, aircraft=one)
    own = ranked_by(evaluate_named(base, given, current.candidate, allowed, current.period))
    # cluster factors are 1 at least, and no evaluation finds more raw evidence than this
    most = _most(base, given, pool, one)
    likely = [c for c, raw in zip(pool, most, strict=True) if raw > own + CLEARLY]
    if not likely:
        return None
    given = given_terms(base, others)
    scores = evaluate_all_known(base, given, likely, [allowed] * len(likely))
    best = max(scores, key=ranked_by, default=None)
    clear = best is not None and ranked_by(best) - own > CLEARLY * best.factor
    return best if clear else None


def _most(base: Base, given: Conditional, pool: Sequence[Candidate], one: int) -> Floats:
    """Raw evidence `evaluate_all_known` finds at most in one aircraft, less the odds, nats."""
    raw = raw_of_one(given, pool, one)
    for n, candidate in enumerate(pool):
        if candidate.dated:
            raw[n] = raw_of_one_step(base, given, candidate, one)
    odds = np.array([CHANGE_PENALTY.get(candidate.kind, 0.0) for candidate in pool])
    return np.asarray(np.maximum(raw, 0.0) - odds)


def ranked_by(score: Score) -> float:
    """Raw evidence with the prior odds of effects that change in time, nats.

    Raw evidence is too large by the cluster factor, and odds weigh beside it as if they were.
    """
    return score.raw - CHANGE_PENALTY.get(score.candidate.kind, 0.0) * score.factor
