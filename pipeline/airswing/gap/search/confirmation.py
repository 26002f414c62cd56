"""Every claim held against days it was not fitted on.

Assumptions: what is at work is at work on every day it is in force. Terms that last are fitted on
some blocks of three days or more and judged on the others (seven weeks are too few to tell their
own scatter: an effect nine standard errors from nothing would be a chance of one in 25,000), curves
on weeks, and in an archive of few weeks all on a sixth of the days. A term in force
for a part of the archive may lie within one week: it is fitted on five days of six, its dates found
again on those days alone, and judged on the sixth; in a short period on every day in turn. What has
fewer than :data:`LEAST_PARTS` parts to be judged on cannot be tested, and is no finding. Of a day
or two parts are some hours each (:data:`airswing.gap.sums.accumulate.PART_HOURS`).

What is asked of the days left out is which multiple of the predicted error is there: one where the
term is right, none where it is nothing, whatever was fitted. Its standard error is that of the
scatter between parts, which hold more or less of the effect; with few parts it is itself uncertain,
and Student's distribution says by how much. Errors that persist are met on the days left out as
well: what the evidence allows for them is in the standard error too.

Validity: parts are days or weeks of all aircraft; that blocks of three days are independent shows
in the cluster factors, which do not grow with longer ones. Curves
of the nonparametric basis, whose sums are by week, are taken off as fitted where single days are
left out.

Source: docs/gap.md section 6; ratio estimate and its error after Cochran (1977), Sampling
Techniques, ch. 6; Student (1908), Biometrika 6, 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

from airswing.gap.evidence.of_candidate import fleet_allowance
from airswing.gap.evidence.terms import Term, fit_terms, given_terms, term_weights
from airswing.gap.held_out.days_left_out import (
    folds_of_days,
    held_out_products,
    restrict_term,
    select_days,
    term_coefficients,
)
from airswing.gap.search.candidate_ranking import evaluate_named
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Base, eliminate_days

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Parts on which a term must act to be tested.
LEAST_PARTS = 3
#: Parts that the days of a period, or of an archive of few weeks, are dealt to.
PARTS = 6
#: Days of such a part at least, and parts at most, in an archive of more weeks.
BLOCK, MOST_PARTS = 3, 16
#: Weeks under which lasting terms are judged on blocks of days.
FEW_WEEKS = 5


@dataclass(frozen=True)
class Confirmation:
    """How the terms of a search do on days left out."""

    # energy, error: (t,): energy explained there, and its standard error; 0 where it cannot be
    # tested
    energy: Floats
    error: Floats
    # multiple, doubt: (t,): multiple of the predicted error that is there, and its standard error;
    # 0 and infinite where it cannot be tested
    multiple: Floats
    doubt: Floats
    parts: Integers  # (t,): parts of the archive it was judged on

    @property
    def tested(self) -> Mask:
        """Whether each term could be tested, (t,)."""
        return self.parts >= LEAST_PARTS

    @property
    def deviations(self) -> Floats:
        """Normal deviation as likely as Student's of the multiple, (t,); 0 if untested."""
        out = np.zeros(self.multiple.size)
        for k in np.flatnonzero(self.tested):
            # parts that agree to the last digit leave no doubt to divide by
            ratio = float(self.multiple[k] / max(self.doubt[k], 1e-9))
            tail = stdtr(self.parts[k] - 1.0, -abs(ratio))
            # far out the tail underflows, and its deviation would be infinite
            out[k] = -np.sign(ratio) * ndtri(max(float(tail), 1e-300))
        return out


def confirm(base: Base, terms: Sequence[Term]) -> Confirmation:
    """Judge terms on days left out."""
    out = confirm_lasting(base, terms)
    left, core = _without_curves(base, terms)
    count = base.stats.days.size
    dated = [term for term in core if term.period is not None]
    if dated:
        days = np.arange(count) % PARTS
        _take_over(
            out,
            terms,
            core,
            _judged(left, core, days, _dated_products(left, core, days)),
            only=dated,
        )
    return out


def confirm_lasting(base: Base, terms: Sequence[Term]) -> Confirmation:
    """Judge terms as if all of them lasted: with their dates as found."""
    weeks = folds_of_days(base.stats)
    out = _judged(base, terms, weeks, held_out_products(base, terms, weeks))
    left, core = _without_curves(base, terms)
    if core:
        days = blocks_of_days(base.stats)
        _take_over(out, terms, core, _judged(left, core, days, held_out_products(left, core, days)))
    return out


def blocks_of_days(stats: Statistics) -> Integers:
    """Part of every day on which what lasts is judged, (D,)."""
    count = stats.days.size
    if stats.clock.short:
        return np.arange(count) * min(count, MOST_PARTS) // count
    few = stats.weeks.size < FEW_WEEKS
    parts = min(PARTS, count) if few else min(count // BLOCK, MOST_PARTS)
    return np.asarray(np.arange(count) * parts // count)


def _take_over(
    out: Confirmation,
    terms: Sequence[Term],
    core: Sequence[Term],
    again: Confirmation,
    *,
    only: Sequence[Term] | None = None,
) -> None:
    """Put what some of the terms came to when judged on other parts in its place."""
    wanted = {id(term) for term in (core if only is None else only)}
    for place, term in enumerate(core):
        if id(term) not in wanted:
            continue
        k = next(i for i, other in enumerate(terms) if other is term)
        for name in ("energy", "error", "multiple", "doubt", "parts"):
            getattr(out, name)[k] = getattr(again, name)[place]


def _judged(
    base: Base, terms: Sequence[Term], fold: Integers, products: tuple[Floats, Floats]
) -> Confirmation:
    """Sums and multiples over the parts on which each term acts."""
    count = len(terms)
    energy, error, multiple = np.zeros((3, count))
    doubt, parts = np.full(count, np.inf), np.zeros(count, np.int64)
    out = Confirmation(energy, error, multiple, doubt, parts)
    for k, term in enumerate(terms):
        acting = [f for f in range(products[0].shape[0]) if _acts(base, term, fold == f)]
        product, square = (own[acting, k] for own in products)
        n = out.parts[k] = len(acting)
        whole = float(square.sum())
        if n < LEAST_PARTS or whole <= 0:
            continue
        energy = 2 * product - square
        out.energy[k], out.error[k] = energy.sum(), energy.std(ddof=1) * np.sqrt(n)
        out.multiple[k] = product.sum() / whole
        apart = ((product - out.multiple[k] * square) ** 2).sum() * n / (n - 1)
        formal = term.score.factor * whole
        out.doubt[k] = np.hypot(np.sqrt(max(apart, formal)) / whole, _persistent(base, term))
    return out


def _persistent(base: Base, term: Term) -> float:
    """Standard deviation of the multiple by errors that persist over the archive."""
    score, tails = term.score, list(term.tails)
    # an aircraft on which it came out as nil
    size = np.maximum(score.size[tails], 1e-9)
    if term.candidate.scope == "fleet":
        allowed = fleet_allowance(base, term.candidate.columns)
        return float(allowed / np.sqrt(np.average(size**2, weights=score.acting[tails])))
    energy = np.maximum(score.acting[tails], 1e-9) * size**2  # aircraft err each by its own
    return float(np.sqrt(((energy * score.background / size) ** 2).sum()) / energy.sum())


def _acts(base: Base, term: Term, days: Mask) -> bool:
    """Whether a term's aircraft report on some of these days of its period."""
    here = days.copy()
    if term.period is not None:
        here[: term.period[0]] = here[term.period[1] :] = False
    return bool(base.stats.day_count[list(term.tails)][:, here].any())


def _without_curves(base: Base, terms: Sequence[Term]) -> tuple[Base, list[Term]]:
    """Sums with the curves among the terms off at their fitted values; the other terms."""
    stats = base.stats
    curves = [term.candidate.columns.max() >= stats.layout.core for term in terms]
    core = [term for term, curve in zip(terms, curves, strict=True) if not curve]
    if not any(curves):
        return base, core
    week = stats.week_of_day
    count = stats.weeks.size
    reports = np.stack([np.bincount(week, own, minlength=count) for own in stats.day_count])
    share = stats.day_count / np.maximum(reports[:, week], 1e-9)
    score = stats.day_score.copy()
    fitted = term_coefficients(fit_terms(base, terms), terms)
    for term, curve, values in zip(terms, curves, fitted, strict=True):
        if not curve:
            continue
        weights = term_weights(term, stats.calendar) * share
        rows = range(len(stats.tails)) if term.candidate.scope == "fleet" else term.tails
        for place, a in enumerate(rows):
            value = values[0 if term.candidate.scope == "fleet" else place]
            pulled = np.tensordot(value, stats.week_gram[a][:, term.candidate.columns], (0, 1))
            score[a] -= weights[a][:, None] * pulled[week]
    return eliminate_days(replace(stats, day_score=score), base.variances), core


def _dated_products(base: Base, terms: Sequence[Term], fold: Integers) -> tuple[Floats, Floats]:
    """Held-out products (folds, terms), the dates of terms found again without each fold."""
    number = int(fold.max()) + 1
    out = np.zeros((2, number, len(terms)))
    for f in range(number):
        keep = fold != f
        train = eliminate_days(select_days(base.stats, keep), base.variances)
        own = _dated_again(train, [restrict_term(t, keep) for t in terms])
        whole = [_unrestricted(t, keep) for t in own]
        product, square = held_out_products(base, whole, np.where(keep, 1, 0))
        out[:, f] = product[0], square[0]
    return out[0], out[1]


def _dated_again(train: Base, terms: Sequence[Term]) -> list[Term]:
    """Terms with their dates found again, each given the others."""
    out = list(terms)
    for k, term in enumerate(out):
        if term.period is None or not term.candidate.dated:
            continue
        allowed = np.isin(np.arange(len(train.stats.tails)), term.tails)
        given = given_terms(train, out[:k] + out[k + 1 :])
        score = evaluate_named(train, given, term.candidate, allowed, term.period)
        if score.period is not None and score.period[1] > score.period[0]:
            out[k] = replace(term, period=score.period)
    return out


def _unrestricted(term: Term, keep: Mask) -> Term:
    """A term whose period was counted in the kept days, counted in all."""
    if term.period is None:
        return term
    kept = np.flatnonzero(keep)
    first, last = term.period
    start = 0 if first == 0 else int(kept[first])
    end = int(kept[last]) if last < kept.size else keep.size
    return replace(term, period=(start, end))
