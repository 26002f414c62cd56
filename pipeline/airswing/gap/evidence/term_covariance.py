"""Covariances of the coefficients of found terms, and where they stand among what is included.

Assumes sums that are whitened and conditioned on day fields and climatology; valid for columns of
the layout's core (what weather takes up has no persistent model error of its own).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.gaussian import allowance_covariance
from airswing.gap.evidence.of_candidate import fleet_allowance
from airswing.gap.evidence.terms import Term
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Conditional

Floats = NDArray[np.float64]


def term_covariances(
    stats: Statistics, given: Conditional, term: Term, start: int, row: int
) -> tuple[Floats, Floats]:
    """Two parts of the covariance of a term's coefficients.

    Parameters
    ----------
    start : int
        Position of the term's coefficients.
    row : int
        Which of its aircraft; 0 in fleet scope.

    Returns
    -------
    formal, allowed : (k, k) float
        Of the fit, with the cluster factor; of model error that persists over the archive.
    """
    k = term.candidate.columns.size
    own = slice(start + row * k, start + (row + 1) * k)
    columns, scales = term.candidate.columns, term.candidate.scales
    formal = np.asarray(given.covariance[own, own] * term.score.factor)
    if columns.max() >= stats.layout.core:
        return formal, np.zeros_like(formal)
    fleet = term.candidate.scope == "fleet"
    pick = list(range(len(stats.tails))) if fleet else [term.tails[row]]
    second = stats.raw_gram[pick].sum(axis=0)[np.ix_(columns, columns)]
    acting = float(stats.acting[pick].sum(axis=0)[columns].max())
    # that of the fleet is the most it may be, an aircraft's is what the fleet shows
    size = 0.5 * fleet_allowance(given, columns) if fleet else term.score.background
    return formal, allowance_covariance(second, acting, size, scales)


def term_covariance(
    stats: Statistics, given: Conditional, term: Term, start: int, row: int
) -> Floats:
    """Covariance (k, k) of a term's coefficients for its ``row``-th aircraft (or the fleet)."""
    formal, allowed = term_covariances(stats, given, term, start, row)
    return np.asarray(formal + allowed)


def term_offsets(given: Conditional, terms: Sequence[Term]) -> list[int]:
    """Position of each term's first coefficient among the included columns."""
    sizes = [
        t.candidate.columns.size * (1 if t.candidate.scope == "fleet" else len(t.tails))
        for t in terms
    ]
    first = len(given.coefficients) - sum(sizes)
    return [first + sum(sizes[:k]) for k in range(len(terms))]
