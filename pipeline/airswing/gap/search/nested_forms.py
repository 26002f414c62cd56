"""Forms of an effect that were not needed to name it but are needed to state it.

Assumptions: the search names an effect by the form with the highest evidence, which for a deviation
that changes is often the constant part alone; a one-cycle part beside it then goes unstated, and
the parameters are off by it (a third in trials). Once the name stands, the question is another:
which form predicts best. A wider form is taken where its further coefficients pay for themselves by
Akaike's rule, twice their number in units of their covariance, over all aircraft of the term.

Validity: as the covariances (`airswing.gap.evidence.term_covariance.term_covariances`).

Source: Akaike (1974), IEEE Trans. Automat. Control 19, 716-723.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.term_covariance import term_covariance, term_offsets
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.elimination import Base

#: What a coefficient must be worth, in units of its variance.
PRICE = 2.0


def widened(base: Base, found: Found, pool: Sequence[Candidate]) -> Found:
    """Give each known term the widest form that pays for itself."""
    for k in range(len(found.terms)):
        for candidate in _wider(found.terms[k], pool):
            term = replace(found.terms[k], candidate=candidate)
            terms = (*found.terms[:k], term, *found.terms[k + 1 :])
            trial = replace(found, terms=terms, given=given_terms(base, terms))
            if _worth(base, trial, k, found.terms[k]) > PRICE:
                found = trial
                break
    return found


def _wider(term: Term, pool: Sequence[Candidate]) -> list[Candidate]:
    """Forms of a term's effect that hold its own, widest first; a band stays one."""
    own, one = set(term.candidate.subset), term.candidate
    forms = [
        c
        for c in pool
        if c.known
        and (c.name, c.scope, c.kind) == (one.name, one.scope, one.kind)
        and own < set(c.subset)
        and (c.tied is None) == (one.tied is None)
    ]
    return sorted(forms, key=lambda c: -len(c.subset))


def _worth(base: Base, trial: Found, k: int, old: Term) -> float:
    """Mean over further coefficients and aircraft of their square over their variance."""
    term = trial.terms[k]
    start = term_offsets(trial.given, trial.terms)[k]
    values = term_coefficients(trial.given, trial.terms)[k]
    more = [i for i, s in enumerate(term.candidate.subset) if s not in old.candidate.subset]
    total = 0.0
    for row, value in enumerate(values):
        spread = term_covariance(base.stats, trial.given, term, start, row)
        total += float(value[more] @ np.linalg.solve(spread[np.ix_(more, more)], value[more]))
    return total / (len(values) * len(more))
