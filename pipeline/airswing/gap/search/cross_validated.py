"""Terms that also explain weeks left out; without those that do not the search is made again.

Assumptions: what is at work is at work in every fold of the archive. The least certain term whose
held-out energy stays within two standard errors of nothing is no candidate, and the search goes
again without it: what it stood for may have another name, or none.

Validity: as the folds of :func:`airswing.gap.held_out.reduction.held_out_energy`. What changes with
the date as a curve or from a day on is not asked: weeks left out do not tell of their own change.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.reduction import held_out_energy
from airswing.gap.search.nested_forms import widened
from airswing.gap.search.stepwise import Found, Rules, search
from airswing.gap.sums.elimination import Base

Floats = NDArray[np.float64]

#: Standard errors by which held-out energy must exceed nothing.
LEAST = 2.0


@dataclass(frozen=True)
class Standing:
    """Result of the search, held against weeks left out.

    Attributes
    ----------
    found : Found
    energy, error : (t,) float
        Held-out energy of each term and its standard error.
    """

    found: Found
    energy: Floats
    error: Floats


def settle(
    base: Base, pool: Sequence[Candidate], rules: Rules, start: Sequence[Term] = ()
) -> Standing:
    """Search until every term stands on weeks left out.

    Parameters
    ----------
    base : Base
    pool : sequence of Candidate
    rules : Rules
    start : sequence of Term
        Terms to begin the search with.

    Returns
    -------
    Standing
    """
    while True:
        found = widened(base, search(base, pool, rules=rules, start=start), pool)
        energy, error = held_out_energy(base, found.terms)
        weak = [k for k in np.flatnonzero(energy <= LEAST * error) if not _dated(found.terms[k])]
        if not weak:
            return Standing(found, energy, error)
        key = found.terms[min(weak, key=lambda k: energy[k])].key
        pool = [c for c in pool if (c.name, c.scope) != key]
        start = [term for term in start if term.key != key]


def _dated(term: Term) -> bool:
    """Whether a term is in force for a part of the archive, or a curve by date."""
    return term.period is not None or ":date" in term.candidate.name
