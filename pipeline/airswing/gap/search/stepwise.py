"""Which effects are at work: search over terms, forward, swapped and backward.

Assumptions: the residual is the sum of a few terms (an effect on some aircraft or on all, always or
from a date on), the climatology and noise. Terms are *gated* by evidence tempered with the cluster
factor and by a practical size, *ranked* by raw evidence among those that pass, and re-examined each
time another enters: taken out, everything is ranked again, and the best takes its place. Dictionary
groups compete with the catalogue; where one beats the best known effect by three cluster factors it
enters as an unknown term and is conditioned on like the others.

Validity: coefficients are linear; large heading errors are linearised again by
:mod:`airswing.gap.diagnose`.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.between_aircraft_variance import told
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.of_candidate import background_likelihood
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.search.belief import STATED
from airswing.gap.search.candidate_ranking import (
    CLEARLY,
    LEAST_NOVELTY,
    Ranking,
    better_for,
    evaluate_named,
    ranked_by,
)
from airswing.gap.search.fewest import fewest
from airswing.gap.sums.elimination import Base, Conditional

#: Evidence, as a share of the largest aircraft's, under which another's may be its leak.
LEAK = 0.15


@dataclass(frozen=True)
class Rules:
    """Thresholds of the search."""

    evidence: float = 3.0  # smallest tempered evidence of a term, nats
    # smallest rms where it acts, m s-1. Real fleets have a little of every effect everywhere; what
    # is smaller than this is left to them.
    size: float = 0.2
    # the same of an effect that all aircraft share: the little that each has of its own averages
    # out over them
    fleet_size: float = 0.1
    # the same of a dictionary group on single aircraft. Its curve is sized over all reports, the
    # quiet ones as well, and flattened where its variable is inferred.
    curve_size: float = 0.1
    # raw evidence, in cluster factors, by which a dictionary group must beat the best known effect
    unknown_margin: float = 3.0
    most_terms: int = 12  # length of the search
    probability: float = STATED  # from which a name is stated

    def least(self, candidate: Candidate) -> float:
        """Smallest size of a candidate that may enter, m s-1."""
        fleet = candidate.scope == "fleet"
        if candidate.known:
            return self.fleet_size if fleet else self.size
        return self.size if fleet else self.curve_size


@dataclass(frozen=True)
class Found:
    """Result of the search."""

    terms: tuple[Term, ...]  # in order of entry
    given: Conditional  # sums given all terms
    # for each term, all candidates ranked with that term taken out
    rivals: tuple[tuple[Score, ...], ...]
    left: tuple[Score, ...] = ()  # all candidates ranked given all terms


def with_background(base: Base, pool: Sequence[Candidate]) -> Base:
    """Base with what the effects of single aircraft tell of the fleet's background.

    Parameters
    ----------
    pool : sequence of Candidate
        The lasting ones of the catalogue tell, each in its widest form.
    """
    widest: dict[str, Candidate] = {}
    for c in sorted(pool, key=lambda c: len(c.subset)):
        if c.known and c.scope == "aircraft" and c.kind == "mean":
            widest[c.name] = c
    given = given_terms(base, [])
    rows = [
        told(
            [background_likelihood(base.stats, given, c) for c in widest.values() if c.heading == h]
        )
        for h in (False, True)
    ]
    made = replace(base, background=np.stack(rows))
    # what has been worked out of the sums stays: none of it depends on the background
    vars(made).update({name: value for name, value in vars(base).items() if name not in vars(made)})
    return made


def passes(score: Score, rules: Rules) -> bool:
    """Whether a candidate may enter: tempered evidence and practical size."""
    if not score.candidate.known and score.novelty < LEAST_NOVELTY:
        return False
    return score.tempered > rules.evidence and bool(struck(score, rules).size)


def struck(score: Score, rules: Rules) -> NDArray[np.int64]:
    """Aircraft a candidate strikes: posterior above one half, size, and no mere leak.

    An effect of one aircraft leaks through the day fields into the others: those whose evidence is
    under a share :data:`LEAK` of the largest wait until it is conditioned on.
    """
    if score.candidate.scope == "fleet":
        # one set of coefficients takes up the mean of what is left on each aircraft
        left = np.broadcast_to(score.remainder, score.acting.shape)
        mean = np.average(left, weights=score.acting + 1e-9)
        least = np.hypot(rules.least(score.candidate), mean)
        return np.arange(score.posterior.size if score.size.max() > least else 0)
    ok = _likely(score, rules)
    ok &= score.aircraft_evidence > LEAK * score.aircraft_evidence.max(initial=0.0)
    return np.flatnonzero(ok)


def _likely(score: Score, rules: Rules) -> NDArray[np.bool_]:
    """Aircraft with a posterior above one half and an effect of practical size."""
    least = np.hypot(rules.least(score.candidate), score.remainder)
    return np.asarray((score.posterior > 0.5) & (score.size > least))


def choose(ranked: Sequence[Score], rules: Rules) -> Score | None:
    """Best candidate that passes; a dictionary group only if it beats the known ones clearly.

    The known ones it must beat need not pass: what an effect too small to be stated explains as
    well is not unknown.
    """
    passing = [s for s in ranked if passes(s, rules)]
    best = _best_name([s for s in passing if s.candidate.known])
    unknown = max((s for s in passing if not s.candidate.known), key=_evened, default=None)
    if unknown is None:
        return best
    effects = [s for s in ranked if s.candidate.known]
    evened = max((_evened(s) for s in effects), default=0.0)
    raw = max((s.raw for s in effects), default=0.0)
    margin = rules.unknown_margin
    clear = _evened(unknown) > evened + margin and unknown.raw > raw + margin * unknown.factor
    return unknown if clear else best


def _best_name(known: Sequence[Score]) -> Score | None:
    """Best effect of the catalogue; of the fleet's that explain as much the surer one.

    An offset of all compasses and a declination are told apart by how their days and weeks scatter,
    of which raw evidence knows nothing.
    """
    forms: dict[tuple[str, str], Score] = {}
    for score in sorted(known, key=ranked_by, reverse=True):
        forms.setdefault((score.candidate.name, score.candidate.scope), score)
    best = next(iter(forms.values()), None)
    if best is None or best.candidate.scope != "fleet":
        return best
    least = ranked_by(best) - CLEARLY * best.factor
    alike = [s for s in forms.values() if s.candidate.scope == "fleet" and ranked_by(s) > least]
    return max(alike, key=lambda score: score.tempered)


def _evened(score: Score) -> float:
    """Raw evidence in cluster factors, which compares fleet-wide candidates with others."""
    return score.raw / score.factor


def enter(score: Score, rules: Rules) -> Term:
    """Make a term of a passing candidate."""
    return Term(score.candidate, tuple(int(a) for a in struck(score, rules)), score.period, score)


def search(ranking: Ranking, rules: Rules, start: Sequence[Term] = ()) -> Found:
    """Search the terms that explain the residual.

    Parameters
    ----------
    start : sequence of Term
        Terms to begin with; each must stand against all candidates as those that are found.
    """
    base, pool = ranking.base, ranking.pool
    terms = _swap(ranking, list(start), rules)
    seen = set()
    left = ranking
    for _ in range(rules.most_terms):
        state = frozenset((t.candidate.key, t.tails, t.period) for t in terms)
        if state in seen:
            break
        seen.add(state)
        best = choose(left(terms), rules)
        if best is None:
            break
        new = enter(best, rules)
        made = _swap(left, _merge(terms, new), rules)
        if pushes_out(ranking, terms, new, made):
            left = left.among([c for c in left.pool if (c.name, c.scope) != new.key])
            seen.discard(state)
        else:
            terms = made
    terms = _reassign(base, pool, terms)
    terms = _prune(base, ranking, terms, rules)
    terms = fewest(base, pool, terms)
    terms = [_completed(base, terms, k, rules) for k in range(len(terms))]
    return found_of(ranking, terms)


def found_of(ranking: Ranking, terms: Sequence[Term]) -> Found:
    """Result of a search that ended with these terms."""
    rivals = tuple(ranking([*terms[:k], *terms[k + 1 :]]) for k in range(len(terms)))
    return Found(tuple(terms), given_terms(ranking.base, terms), rivals, ranking(terms))


def _merge(terms: Sequence[Term], new: Term) -> list[Term]:
    """Add a term, joining it with one of the same candidate and period."""
    for k, old in enumerate(terms):
        if old.candidate.key == new.candidate.key and old.period == new.period:
            joined = replace(old, tails=tuple(sorted({*old.tails, *new.tails})))
            return [*terms[:k], joined, *terms[k + 1 :]]
    return [*terms, new]


def _swap(ranking: Ranking, terms: list[Term], rules: Rules) -> list[Term]:
    """Take every earlier term out in turn; where another explains its share better, exchange."""
    k = 0
    while len(terms) > 1 and k < len(terms):
        others = terms[:k] + terms[k + 1 :]
        ranked = ranking(others)
        best = choose(ranked, rules)
        if best is None:
            terms = others
            continue
        new = enter(best, rules)
        same = new.candidate.key == terms[k].candidate.key and new.period == terms[k].period
        if not same and not _stays(ranked, terms[k], best, rules):
            merged = _merge(others, new)
            if len(merged) < len(terms):
                terms = merged
                continue
            terms = [*terms[:k], new, *terms[k + 1 :]]
        k += 1
    return terms


def pushes_out(ranking: Ranking, terms: Sequence[Term], new: Term, made: Sequence[Term]) -> bool:
    """Whether a new name of the fleet leaves one no room that explains more in its place.

    Columns of the wind are made of its large scales: beside a shear times a height, the wind itself
    carries what of it they lack. Either then leaves little to the other, and the one that came
    second, to mop up, would stay.
    """
    keys = {term.key for term in made}
    lost = [term for term in terms if term.key not in keys]
    alike = all(
        term.candidate.known and term.candidate.scope == "fleet" and not term.candidate.heading
        for term in (new, *lost)
    )
    if len(lost) != 1 or new.key not in keys or not alike:
        return False
    ranked = ranking([term for term in made if term.key != new.key])
    first, second = (
        max(
            (ranked_by(s) for s in ranked if (s.candidate.name, s.candidate.scope) == key),
            default=0.0,
        )
        for key in (lost[0].key, new.key)
    )
    return first > second


def _stays(ranked: Sequence[Score], old: Term, best: Score, rules: Rules) -> bool:
    """Whether an unknown term explains clearly more than the known one that would replace it.

    Effects that nearly cancel (an airspeed scale against an offset) bend into the shape of what
    nobody knows, one after the other; taken by evidence alone the search goes round between them.
    """
    if old.candidate.known or not best.candidate.known:
        return False
    own = next((s for s in ranked if s.candidate.key == old.candidate.key), None)
    return own is not None and own.raw > best.raw + rules.unknown_margin * own.factor


def _prune(base: Base, ranking: Ranking, terms: list[Term], rules: Rules) -> list[Term]:
    """Drop terms, and aircraft of terms, that do not stand given all the others."""
    k = 0
    while k < len(terms):
        others = terms[:k] + terms[k + 1 :]
        term = terms[k]
        score = [s for s in ranking(others) if s.candidate.key == term.candidate.key]
        if not score or not passes(score[0], rules):
            terms = others
            continue
        best = enter(score[0], rules)
        period = best.period if term.period is not None else None
        # Aircraft that waited and entered once the strongest were in do not wait again here.
        waited = {int(a) for a in np.flatnonzero(_likely(score[0], rules))} & set(term.tails)
        tails = tuple(sorted({*best.tails, *waited}))
        best = replace(best, period=period, tails=tails)
        term = _prune_tails(base, best, others, rules)
        if not term.tails:
            terms = others
            continue
        terms = [*terms[:k], term, *terms[k + 1 :]]
        k += 1
    return terms


def _reassign(base: Base, pool: Sequence[Candidate], terms: list[Term]) -> list[Term]:
    """Give an aircraft of a term to another effect where that explains it clearly better.

    Aircraft enter a term together; one whose step looks like the others' drift is taken along.
    """
    own_pool = [c for c in pool if c.known and c.scope == "aircraft"]
    for k in range(len(terms)):
        term = terms[k]
        if term.candidate.scope == "fleet" or not term.candidate.known or len(term.tails) < 2:
            continue
        for a in term.tails:
            rest = replace(terms[k], tails=tuple(t for t in terms[k].tails if t != a))
            if not rest.tails:
                break
            others = [*terms[:k], rest, *terms[k + 1 :]]
            best = better_for(base, others, own_pool, a, term)
            if best is not None and best.candidate.key != term.candidate.key:
                terms = _merge(others, Term(best.candidate, (a,), best.period, best))
    return terms


def _completed(base: Base, terms: Sequence[Term], k: int, rules: Rules) -> Term:
    """Add aircraft to a term that strikes half the fleet, where its share makes them likely.

    Terms enter on the evidence of the aircraft that show them most; of an effect most have, the
    others have a little in favour before the data are asked.
    """
    term, aircraft = terms[k], len(base.stats.tails)
    share = len(term.tails) / aircraft
    if not term.candidate.known or term.period is not None or not 0.5 <= share < 1:
        return term
    taken = {a for t in terms if t.key == term.key for a in t.tails}
    allowed = np.array([a not in taken for a in range(aircraft)])
    given = given_terms(base, terms, columns=term.candidate.columns)
    score = evaluate_named(base, given, term.candidate, allowed, None)
    # all but one of fourteen: of a fleet this small no share is certain
    odds = score.aircraft_evidence + np.log(min(share, 0.93) / (1 - min(share, 0.93)))
    likely = allowed & (score.aircraft_evidence > 0) & (odds > 1) & (score.size > rules.size)
    return replace(term, tails=tuple(sorted({*term.tails, *np.flatnonzero(likely).tolist()})))


def _prune_tails(base: Base, term: Term, others: list[Term], rules: Rules) -> Term:
    """Drop aircraft of a term whose own evidence does not stand given the other aircraft's.

    The prior odds are the share of the fleet in the term. A leak of one aircraft's effect into
    another's ends here.
    """
    candidate, aircraft = term.candidate, len(base.stats.tails)
    if candidate.scope == "fleet" or len(term.tails) < 2:
        return term
    kept = list(term.tails)
    for a in sorted(term.tails, key=lambda t: term.score.aircraft_evidence[t]):
        rest = tuple(t for t in kept if t != a)
        if not rest:
            break
        left = [*others, replace(term, tails=rest)]
        given = given_terms(base, left, columns=candidate.columns)
        allowed = np.arange(aircraft) == a
        score = evaluate_named(base, given, candidate, allowed, term.period)
        # one of fourteen to all but one, as above: the prior alone must not decide
        share = float(np.clip(len(kept) / aircraft, 0.07, 0.93))
        odds = score.aircraft_evidence[a] + np.log(share / (1 - share))
        if odds < 0 or score.size[a] < rules.least(candidate):
            kept = list(rest)
    return replace(term, tails=tuple(sorted(kept)))
