"""Fewest effects that explain: changes that are one told as one.

Assumptions: the residual is the sum of the terms, each coefficient normal about nothing with the
prior of its column; the evidence of the whole is then known in closed form. The search puts terms
in one by one, so a change of two aircraft on one day may come in as two changes a day apart. Here
the terms are weighed together: those of one kind are tried as one, on either's dates and with the
form that holds both, and the best exchange is made until none gains. A drift and a step are each
other's likeness where the record is short beside the noise: one on some aircraft and one on others
are tried as one of them on all, and aircraft by aircraft. Every date costs what it was
picked from, the days of the archive. Whether a term, or an aircraft of it, is needed at all is no
question here: its evidence given all the others says so (`airswing.gap.search.stepwise`), with a
prior that is averaged over sizes; the wide one of a fit would price out what acts for a few days.

Validity: closed forms of linear terms; curves of the nonparametric basis stay as they are.

Source: docs/gap.md section 6; Occam factor: MacKay (1992), Neural Comput. 4, 415.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term, all_columns
from airswing.gap.sums.elimination import Base, fit_included

#: Days by which the dates of changes that may be one are apart.
NEAR = 5


def fewest(base: Base, pool: Sequence[Candidate], terms: Sequence[Term]) -> list[Term]:
    """Join terms as long as the whole is worth more so.

    Parameters
    ----------
    pool : sequence of Candidate
        For the forms that hold those of two terms.
    """
    best = list(terms)
    now = worth(base, best)
    while True:
        top, gain = best, 0.0
        for trial, factor in _exchanges(pool, best):
            then = worth(base, trial)
            # only what the exchange changes is tempered, by the factor of the terms it changes: a
            # factor of all terms together would move with every term that goes
            more = (then.explained - now.explained) / factor + then.fixed - now.fixed
            if more > gain:
                top, gain, value = trial, more, then
        if top is best:
            return best
        best, now = top, value


class Worth(NamedTuple):
    """Log evidence of terms together less their prices, nats."""

    explained: float  # what they explain, as if errors were independent
    fixed: float  # occam factors less prices


def worth(base: Base, terms: Sequence[Term]) -> Worth:
    """Work out what terms are worth together.

    Returns
    -------
    Worth
        Up to a constant of the archive.
    """
    included = all_columns(base, terms)
    fit = fit_included(base, included)
    score = fit.score.sum(axis=0)
    occam = np.linalg.slogdet(fit.half)[1] + 0.5 * sum(np.log(x.precision) for x in included)
    explained = 0.5 * float(score @ fit.coefficients)
    return Worth(explained, float(occam) - sum(_price(base, term) for term in terms))


def shared_by_all(base: Base, pool: Sequence[Candidate], terms: Sequence[Term], k: int) -> bool:
    """Whether one effect of all aircraft is worth more than a term on most of them.

    Parameters
    ----------
    pool : sequence of Candidate
        Forms for the whole fleet are looked for here.
    k : int
        Position of the term.
    """
    term, everyone = terms[k], tuple(range(len(base.stats.tails)))
    if term.candidate.scope == "fleet" or 2 * len(term.tails) <= len(everyone):
        return term.candidate.scope == "fleet"
    name, form = term.candidate.name, term.candidate.subset
    wide = [c for c in pool if (c.name, c.scope, c.subset) == (name, "fleet", form)]
    own = worth(base, terms)
    for candidate in wide:
        one = replace(term, candidate=candidate, tails=everyone)
        all_ = worth(base, [*terms[:k], one, *terms[k + 1 :]])
        gain = (all_.explained - own.explained) / max(term.score.factor, 1.0)
        if gain + all_.fixed > own.fixed:
            return True
    return False


def _price(base: Base, term: Term) -> float:
    """What the dates of a term cost before the data are asked, nats."""
    if term.period is None:
        return 0.0
    days = base.stats.days.size
    ends = (term.period[0] > 0) + (term.period[1] < days)
    return float(ends * np.log(days))


def _exchanges(pool: Sequence[Candidate], terms: list[Term]) -> Iterator[tuple[list[Term], float]]:
    """Terms with two joined, and the cluster factor of the two."""
    for k, term in enumerate(terms):
        if not term.candidate.known:
            continue
        for j in range(k):
            both = max(0.5 * (term.score.factor + terms[j].score.factor), 1.0)
            left = [*terms[:j], *terms[j + 1 : k], *terms[k + 1 :]]
            for joined in _joined(pool, terms[j], term):
                yield [*left[:j], joined, *left[j:]], both
            for told in _other_kind(pool, terms[j], term):
                yield [*left, *told], both


def _other_kind(pool: Sequence[Candidate], one: Term, other: Term) -> Iterator[list[Term]]:
    """A drift and a step as one of them, on all their aircraft or with one aircraft moved."""
    kinds = {term.candidate.kind: term for term in (one, other)}
    if set(kinds) != {"drift", "step"} or "fleet" in (one.candidate.scope, other.candidate.scope):
        return
    for term, giver in ((kinds["step"], kinds["drift"]), (kinds["drift"], kinds["step"])):
        forms = [c for c in pool if (c.name, c.scope, c.kind) == (*term.key, term.candidate.kind)]
        whole = tuple(sorted({*term.tails, *giver.tails}))
        for form in forms:
            yield [replace(term, candidate=form, tails=whole)]
        for a in giver.tails if len(giver.tails) > 1 else ():
            kept = replace(giver, tails=tuple(t for t in giver.tails if t != a))
            yield [replace(term, tails=tuple(sorted({*term.tails, a}))), kept]


def _joined(pool: Sequence[Candidate], one: Term, other: Term) -> list[Term]:
    """Terms that two of one name could be: of either form or one that holds both, either dates."""
    if one.key != other.key or (one.period is None) != (other.period is None):
        return []
    if one.period is not None and other.period is not None:
        apart = np.abs(np.subtract(one.period, other.period)).max()
        if apart > NEAR:
            return []
    both = {*one.candidate.subset, *other.candidate.subset}
    like = [c for c in pool if (c.name, c.scope, c.kind) == (*one.key, one.candidate.kind)]
    forms = [c for c in like if both <= set(c.subset)]
    if not forms:
        return []
    own = {
        tuple(one.candidate.subset): one.candidate,
        tuple(other.candidate.subset): other.candidate,
    }
    widest = min(forms, key=lambda c: len(c.subset))
    shapes = own | {tuple(widest.subset): widest}
    tails = tuple(sorted({*one.tails, *other.tails}))
    larger = max(one, other, key=lambda term: term.score.tempered)
    periods = {one.period, other.period}
    return [
        replace(larger, candidate=form, tails=tails, period=period)
        for form in shapes.values()
        for period in sorted(periods, key=lambda p: p or (0, 0))
    ]
