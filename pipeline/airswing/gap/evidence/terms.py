"""Terms: effects at work in some aircraft in some days, and the sums given them.

Assumptions: an aircraft's term has coefficients of its own, with a prior four times as wide as the
catalogue's; one of the fleet has one set. The climatology is always fitted beside them.

Validity: as :mod:`airswing.gap.sums.elimination`.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.gaussian import Score
from airswing.gap.sums.accumulate import Calendar
from airswing.gap.sums.elimination import (
    Base,
    Conditional,
    Fit,
    Included,
    climatology,
    condition,
    digest_of,
    fit_included,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Term:
    """One effect at work."""

    candidate: Candidate
    tails: tuple[int, ...]  # aircraft struck (all, in fleet scope)
    period: tuple[int, int] | None  # first and one past the last day index in force, per term
    score: Score  # evidence when it entered

    @property
    def key(self) -> tuple[str, str]:
        """Name and scope."""
        return self.candidate.name, self.candidate.scope


def day_factors(candidate: Candidate, period: tuple[int, int] | None, days: Integers) -> Floats:
    """Factor on a candidate's columns by day, (D,).

    Parameters
    ----------
    period : (int, int) or None
        First and one past the last index of the days in force; None: all.
    days : (D,) int
        Days since 1970.

    Returns
    -------
    (D,) float
        0 outside the period; in it 1, or of what sets in on a date the days since then.
    """
    factors = np.zeros(days.size)
    inside = slice(None) if period is None else slice(*period)
    factors[inside] = 1.0
    if candidate.kind == "onset" and period is not None and period[0] < days.size:
        middle = 0.5 * np.median(np.diff(days)) if days.size > 1 else 0.5
        factors[inside] = days[inside] - days[period[0]] + middle
    return factors


def term_weights(term: Term, calendar: Calendar) -> Floats:
    """Factor on a term's columns by aircraft and day, (A, D)."""
    weights = np.zeros(calendar.shape)
    weights[list(term.tails)] = day_factors(term.candidate, term.period, calendar.days)
    return weights


def term_columns(term: Term, calendar: Calendar) -> list[Included]:
    """Columns a term conditions on: its own per aircraft, or shared in fleet scope."""
    whole = term_weights(term, calendar)
    # four prior widths: beside what is tested a term found is all but free, and still bounded
    width = 4.0 * np.maximum(term.candidate.scales, 1e-12)
    out = []
    if term.candidate.scope == "fleet":
        same = digest_of(whole)
        return [
            Included(int(j), whole, 1 / w**2, same)
            for j, w in zip(term.candidate.columns, width, strict=True)
        ]
    for a in term.tails:
        weights = np.zeros(calendar.shape)
        weights[a] = whole[a]
        same = _digest_of_one(a, whole[a].tobytes(), calendar.shape)
        out += [
            Included(int(j), weights, 1 / w**2, same)
            for j, w in zip(term.candidate.columns, width, strict=True)
        ]
    return out


@lru_cache(maxsize=4096)  # an aircraft's columns are given again and again in the search
def _digest_of_one(aircraft: int, factors: bytes, shape: tuple[int, int]) -> bytes:
    """Digest of the weights of a term's columns of one aircraft, from its factors by day."""
    weights = np.zeros(shape)
    weights[aircraft] = np.frombuffer(factors)
    return digest_of(weights)


def given_terms(
    base: Base,
    terms: Sequence[Term],
    *,
    columns: NDArray[np.int64] | None = None,
    aircraft: int | None = None,
) -> Conditional:
    """Sums conditioned on the climatology and some terms; of what is asked for, as `condition`."""
    return condition(base, all_columns(base, terms), columns=columns, aircraft=aircraft)


def fit_terms(base: Base, terms: Sequence[Term]) -> Fit:
    """Fit of the climatology and some terms alone."""
    return fit_included(base, all_columns(base, terms))


def all_columns(base: Base, terms: Sequence[Term]) -> list[Included]:
    """Columns of the climatology, then of each term in turn."""
    calendar = base.stats.calendar
    columns = climatology(base)
    for term in terms:
        columns += term_columns(term, calendar)
    return columns
