"""Terms that also explain days left out; what does not is no finding.

Assumptions: what is at work is at work in every part of the archive it is in force. The least
certain lasting term whose held-out energy stays within two standard errors of nothing is no
candidate, and the search goes again without it: what it stood for may have another name, or none.
In the end every name has a probability (:mod:`airswing.gap.search.belief`); those that fall short,
or could not be tested (in an archive of a day or two: any), are told apart from the findings, with
the reason.

Validity: as :mod:`airswing.gap.search.confirmation`. Curves by date are not asked: weeks left out
do not tell of their own change.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.search.absorbed_by_unknown import folded
from airswing.gap.search.belief import (
    LIKELIER_ANOTHER,
    as_named,
    features,
    of_one_day,
    probabilities,
)
from airswing.gap.search.candidate_ranking import Ranking, evaluate_named
from airswing.gap.search.confirmation import (
    LEAST_PARTS,
    Confirmation,
    confirm,
    confirm_lasting,
)
from airswing.gap.search.fewest import shared_by_all
from airswing.gap.search.left_beside import left_beside
from airswing.gap.search.nested_forms import widened
from airswing.gap.search.step_or_drift import as_it_goes
from airswing.gap.search.stepwise import Found, Rules, found_of, search
from airswing.gap.sums.elimination import Base, Conditional

Floats = NDArray[np.float64]

#: Standard errors by which held-out energy must exceed nothing.
LEAST = 2.0
#: Why a name is not told that is likelier another effect.
ANOTHER = "its aircraft show more beside it than a right name leaves: it is likelier another effect"
#: Why a change in time is not told that rather goes the other way.
OTHERWISE = "it rather goes otherwise in time: steadily, or at a date"


@dataclass(frozen=True)
class Doubtful:
    """A name that the search came to and that was not confirmed."""

    term: Term
    probability: float  # 0 where it could not be tested
    # (f,): what the probability was made of (`airswing.gap.search.belief.features`)
    weighed: Floats
    reason: str


@dataclass(frozen=True)
class Standing:
    """Result of the search, held against days left out."""

    found: Found
    # energy, error: (t,): held-out energy of each term and its standard error
    energy: Floats
    error: Floats
    probability: Floats  # (t,): that each term is at work as named
    weighed: Floats  # (t, f): what each was made of (`airswing.gap.search.belief.features`)
    doubtful: tuple[Doubtful, ...] = ()  # names that were not confirmed


def settle(ranking: Ranking, rules: Rules, start: Sequence[Term] = ()) -> Standing:
    """Search until every term stands on days left out.

    Parameters
    ----------
    start : sequence of Term
        Terms to begin the search with.
    """
    base, pool = ranking.base, ranking.pool
    if base.stats.clock.short:  # a change, or a curve, of one day may be its weather
        pool = tuple(c for c in pool if c.known and c.kind == "mean")
    whole = ranking.among(pool)
    while True:
        found = widened(base, search(ranking.among(pool), rules, start), pool)
        tests = confirm_lasting(base, found.terms)
        energy, short = tests.energy, tests.energy <= LEAST * tests.error
        # a name that could not be tested is told as such, a curve in no way
        known = np.array([term.candidate.known for term in found.terms], bool)
        weak = [
            k for k in np.flatnonzero(short & (tests.tested | ~known)) if not _dated(found.terms[k])
        ]
        if not weak:
            return _believed(whole, found, rules)
        key = found.terms[min(weak, key=lambda k: energy[k])].key
        pool = tuple(c for c in pool if (c.name, c.scope) != key)
        start = [term for term in start if term.key != key]


def with_name(ranking: Ranking, standing: Standing, named: Doubtful) -> Standing:
    """State a name that a table confirmed.

    Parameters
    ----------
    standing : Standing
        Of a search, maybe on other residuals than those the name was found on.
    named : Doubtful
        With the probability it has now.
    """
    base, pool = ranking.base, ranking.pool
    terms, candidate = list(standing.found.terms), named.term.candidate
    there = any(candidate.key == term.candidate.key for term in terms)
    if there or all(candidate.key != one.key for one in pool):
        return standing
    allowed = np.isin(np.arange(len(base.stats.tails)), named.term.tails)
    given = given_terms(base, terms)
    score = evaluate_named(base, given, candidate, allowed, named.term.period)
    score = replace(score, tempered=max(score.tempered, named.term.score.tempered))
    new = replace(named.term, score=replace(score, probability=named.probability))
    found = found_of(ranking, [*terms, new])
    tests = confirm(base, found.terms)
    return Standing(
        found,
        tests.energy,
        tests.error,
        np.append(standing.probability, named.probability),
        features(found.terms, tests),
        tuple(x for x in standing.doubtful if x.term.candidate.name != candidate.name),
    )


def _believed(ranking: Ranking, found: Found, rules: Rules) -> Standing:
    """Names that are likely enough; without the least likely the others are judged again."""
    base, pool = ranking.base, ranking.pool
    doubtful: list[Doubtful] = []
    terms = list(found.terms)
    while True:
        tests = confirm(base, terms)
        weighed = features(terms, tests)
        chance = _chance(base, pool, terms, weighed, tests)
        shapes = folded(terms, tests.energy, tests.error)  # told with the unknown, not as names
        short = [
            k
            for k, term in enumerate(terms)
            if term.candidate.known and k not in shapes and chance[k] < rules.probability
        ]
        if not short:
            break
        worst = min(short, key=lambda k: (chance[k], terms[k].score.tempered))
        parts = int(tests.parts[worst])
        shared = base.stats.clock.short and shared_by_all(base, pool, terms, worst)
        doubtful.append(
            _doubted(terms[worst], float(chance[worst]), parts, weighed[worst], shared=shared)
        )
        del terms[worst]
    if not base.stats.clock.short:  # what a day leaves beside a name was not learned
        goes = as_it_goes(base, pool, terms)
        likely = _likely_as_named(base, pool, terms, doubtful) * goes
        others = sorted({*np.flatnonzero(likely < LIKELIER_ANOTHER)} - {*shapes})
        chance = chance * likely
        # all at once: one taken out leaves its evidence beside names that are right
        reasons = [OTHERWISE if goes[k] < LIKELIER_ANOTHER else ANOTHER for k in others]
        doubtful += [
            Doubtful(terms[k], float(chance[k]), weighed[k], reason)
            for k, reason in zip(others, reasons, strict=True)
        ]
        if others:
            stay = [k for k in range(len(terms)) if k not in others]
            terms, chance = [terms[k] for k in stay], chance[stay]
            tests = confirm(base, terms)
            weighed = features(terms, tests)
    found = found_of(ranking, terms) if doubtful else found
    sure = tuple(
        replace(term, score=replace(term.score, probability=float(p)))
        for term, p in zip(found.terms, chance, strict=True)
    )
    found = replace(found, terms=sure)
    return Standing(found, tests.energy, tests.error, chance, weighed, tuple(doubtful))


def _likely_as_named(
    base: Base, pool: Sequence[Candidate], terms: Sequence[Term], doubtful: Sequence[Doubtful]
) -> Floats:
    """Probability that each term is what its name says, (t,), whether or not the doubtful are.

    What a name's aircraft show beside it may be another effect that was likelier than not, and not
    likely enough to be told: were it at work, nothing would speak against the name.
    """
    wide = np.array([term.candidate.scope == "fleet" for term in terms], bool)
    alone = as_named(left_beside(base, pool, terms), wide)
    near = [one for one in doubtful if one.probability >= LIKELIER_ANOTHER]
    if not near or not terms:
        return alone
    given = given_terms(base, terms)
    own = sorted({a for term in terms for a in term.tails})
    others = [_spread_to(base, given, one.term, own) for one in near]
    beside = as_named(left_beside(base, pool, [*terms, *others])[: len(terms)], wide)
    weight = min(one.probability for one in near)
    return np.asarray(weight * np.maximum(beside, alone) + (1.0 - weight) * alone)


def _spread_to(base: Base, given: Conditional, term: Term, aircraft: Sequence[int]) -> Term:
    """A term also on those of some aircraft that rather have it than not."""
    if term.candidate.scope == "fleet":
        return term
    allowed = np.isin(np.arange(len(base.stats.tails)), [*aircraft, *term.tails])
    score = evaluate_named(base, given, term.candidate, allowed, term.period)
    more = np.flatnonzero(allowed & (score.aircraft_evidence > 0.0)).tolist()
    return replace(term, tails=tuple(sorted({*term.tails, *more})))


def _chance(
    base: Base,
    pool: Sequence[Candidate],
    terms: Sequence[Term],
    weighed: Floats,
    tests: Confirmation,
) -> Floats:
    """Probability of every term, (t,).

    Of a day, what all aircraft share lasts as its weather does, also where parts of the day did not
    confirm it and it came in again aircraft by aircraft; one aircraft flies beside others.
    """
    if not base.stats.clock.short:
        return probabilities(weighed, tests)
    alone = [not shared_by_all(base, pool, terms, k) for k in range(len(terms))]
    return np.asarray(of_one_day(weighed) * alone)


def _doubted(term: Term, chance: float, parts: int, weighed: Floats, *, shared: bool) -> Doubtful:
    """Say why a name is not stated; ``shared``: of a day, by all aircraft."""
    if shared:
        reason = "of a day or two, what all aircraft share may be their weather"
        return Doubtful(term, 0.0, weighed, reason)
    if parts < LEAST_PARTS:
        few = f"in force on too few days to leave some out ({parts}; {LEAST_PARTS} needed)"
        return Doubtful(term, 0.0, weighed, few)
    return Doubtful(term, chance, weighed, "days left out do not confirm it beyond doubt")


def _dated(term: Term) -> bool:
    """Whether a term is in force for a part of the archive, or a curve by date."""
    return term.period is not None or ":date" in term.candidate.name
