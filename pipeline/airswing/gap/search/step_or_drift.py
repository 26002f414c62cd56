"""Whether what changes in time went at a date or grew steadily: the odds of one against the other.

Assumptions: a change that is small beside the errors of days is told before it is told how it went:
a ramp holds five sixths of the energy of a step in the middle of an archive. Both were ranked, and
the likelier was taken; how much likelier it was is a part of the probability of its name. A drift
is weighed beside a step of the same columns also where the catalogue has no step.

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


def as_it_goes(base: Base, pool: Sequence[Candidate], terms: Sequence[Term]) -> Floats:
    """Probability that each term changes as its name says, (t,); 1 of what lasts.

    Parameters
    ----------
    pool : sequence of Candidate
        Those of the other kind are the rivals.
    terms : sequence of Term
        Each is weighed beside all others.
    """
    out = np.ones(len(terms))
    for k, term in enumerate(terms):
        what = term.candidate
        if not what.known or what.scope == "fleet" or what.kind not in ("step", "drift"):
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
    """Candidates that change the other way; a step of its lasting columns beside a drift."""
    other = "drift" if what.kind == "step" else "step"
    found = [one for one in pool if one.kind == other and one.scope == what.scope]
    if other == "step" and what.lasting:
        scales = np.array([scale for _, scale in what.lasting])
        found.append(replace(what, kind="step", columns=what.steady, scales=scales, lasting=()))
    return found
