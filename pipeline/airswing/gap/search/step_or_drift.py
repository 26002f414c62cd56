"""Whether what changes in time went at a date or grew, always or from a date on: the odds.

Assumptions: a change that is small beside the errors of days is told before it is told how it went:
a ramp holds five sixths of the energy of a step in the middle of an archive. Both were ranked, and
the likelier was taken; how much likelier it was is a part of the probability of its name. A drift
is weighed beside a step of the same columns also where the catalogue has no step. A drift that set
in late is a drift: neither of the two speaks against the other.

Validity: effects of single aircraft.

Source: docs/gap.md section 6; odds of two hypotheses from their evidence, as in
:mod:`airswing.gap.search.candidate_ranking`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.search.candidate_ranking import evaluate_named, ranked_by
from airswing.gap.sums.elimination import Base

Floats = NDArray[np.float64]

#: Kinds of what changes in time.
IN_TIME = ("step", "drift", "onset")


def as_it_goes(base: Base, pool: Sequence[Candidate], terms: Sequence[Term]) -> Floats:
    """Probability that each term changes as its name says, (t,); 1 of what lasts.

    Parameters
    ----------
    pool : sequence of Candidate
        Those that change in time otherwise are the rivals.
    terms : sequence of Term
        Each is weighed beside all others.
    """
    out = np.ones(len(terms))
    for k, term in enumerate(terms):
        what = term.candidate
        if not what.known or what.scope == "fleet" or what.kind not in IN_TIME:
            continue
        rivals = _rivals(pool, what)
        given = given_terms(base, [*terms[:k], *terms[k + 1 :]])
        allowed = np.isin(np.arange(len(base.stats.tails)), term.tails)
        scores = (evaluate_named(base, given, one, allowed, None) for one in (what, *rivals))
        own, *others = (ranked_by(score) / score.factor for score in scores)
        nats = own - max(others, default=-np.inf)
        out[k] = 1.0 / (1.0 + np.exp(-np.clip(nats, -50.0, 50.0)))
    return out


def _rivals(pool: Sequence[Candidate], what: Candidate) -> list[Candidate]:
    """Candidates of another name; a step of its lasting columns beside a drift."""
    found = [
        one
        for one in pool
        if one.kind in IN_TIME and one.scope == what.scope and one.name != what.name
    ]
    if what.kind == "drift":
        scales = np.array([scale for _, scale in what.lasting])
        found.append(replace(what, kind="step", columns=what.steady, scales=scales, lasting=()))
    if what.kind == "onset":
        found.append(replace(what, kind="step"))
    return found
