"""Days left out: folds of whole weeks, sums without them, what terms of the rest explain there.

Assumptions: errors of different weeks are independent, so a fold is whole weeks and whole flights.
Validity: three weeks and more; with fewer, folds are blocks of days. Intervals are bootstraps over
days.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.evidence.terms import Term, all_columns
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Base, Conditional, Fit, fits_by_fold

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


MOST_FOLDS = 8
DRAWS = 400  # of days: an end of a 95 % interval then scatters by a thirtieth of its width


def folds_of_days(stats: Statistics) -> Integers:
    """Fold of every day: whole weeks, or blocks of days in short archives; shape (D,)."""
    if stats.weeks.size >= 3:
        return np.asarray(stats.week_of_day * min(MOST_FOLDS, stats.weeks.size) // stats.weeks.size)
    count = max(2, min(4, stats.days.size))
    return np.asarray(np.arange(stats.days.size) * count // stats.days.size)


def select_days(stats: Statistics, keep: NDArray[np.bool_]) -> Statistics:
    """Sums of some days.

    Parameters
    ----------
    keep : (D,) bool
        Where weeks are cut, their X'X is shared out by reports.
    """
    week = stats.week_of_day
    share = np.zeros((len(stats.tails), stats.weeks.size))
    for w in range(stats.weeks.size):
        own = week == w
        total = stats.day_count[:, own].sum(axis=1)
        share[:, w] = stats.day_count[:, own & keep].sum(axis=1) / np.maximum(total, 1e-9)
    used = np.isin(np.arange(stats.weeks.size), week[keep])
    gram = stats.week_gram[:, used] * share[:, used, None, None].astype(np.float32)
    return replace(
        stats,
        days=stats.days[keep],
        weeks=stats.weeks[used],
        week_gram=gram,
        day_gram=stats.day_gram[:, keep],
        day_cross=stats.day_cross[:, keep],
        day_score=stats.day_score[:, keep],
        day_energy=stats.day_energy[:, keep],
        day_count=stats.day_count[:, keep],
    )


def restrict_term(term: Term, keep: NDArray[np.bool_]) -> Term:
    """A term with its period counted in the kept days."""
    if term.period is None:
        return term
    running = np.r_[0, np.cumsum(keep)]
    return replace(term, period=(int(running[term.period[0]]), int(running[term.period[1]])))


def term_coefficients(given: Conditional | Fit, terms: Sequence[Term]) -> list[Floats]:
    """Coefficients of each term, (aircraft of the term, k); one row in fleet scope.

    Parameters
    ----------
    given : Conditional or Fit
        Of the same terms.

    Returns
    -------
    list of (t, k) float
    """
    out = []
    counts = [len(t.tails) if t.candidate.scope == "aircraft" else 1 for t in terms]
    start = len(given.coefficients) - sum(
        n * t.candidate.columns.size for n, t in zip(counts, terms, strict=True)
    )
    for n, term in zip(counts, terms, strict=True):
        k = term.candidate.columns.size
        out.append(given.coefficients[start : start + n * k].reshape(n, k))
        start += n * k
    return out


def fold_coefficients(base: Base, terms: Sequence[Term], fold: Integers) -> list[list[Floats]]:
    """Coefficients of the terms fitted without each fold.

    Parameters
    ----------
    fold : (D,) int

    Returns
    -------
    list over folds of list over terms of (t, k) float
    """
    fits = fits_by_fold(base, all_columns(base, terms), fold)
    return [term_coefficients(without, terms) for without, _ in fits]


def day_interval(values: Floats, day: Integers, seed: int) -> tuple[float, float]:
    """Bootstrap 95 % interval over days of a mean over reports.

    Drawn from n days, means scatter by the root of (n - 1) / n too little: they are drawn apart.
    """
    count, total = np.bincount(day), np.bincount(day, values)
    used = np.flatnonzero(count)
    rng = np.random.default_rng(seed)
    pick = rng.integers(0, used.size, (DRAWS, used.size))
    means = total[used][pick].sum(axis=1) / count[used][pick].sum(axis=1)
    middle = total.sum() / count.sum()
    # days drawn again scatter by (n - 1) / n of the variance days have
    apart = np.sqrt(used.size / max(used.size - 1, 1))
    low, high = np.quantile(middle + apart * (means - middle), [0.025, 0.975])
    return float(low), float(high)


def held_out_products(base: Base, terms: Sequence[Term], fold: Integers) -> tuple[Floats, Floats]:
    """Predictions of each term for each fold, fitted on the others, against what is there.

    Parameters
    ----------
    fold : (D,) int
        Fold of every day.

    Returns
    -------
    product, square : (folds, t) float
        Of the whitened prediction with what the other terms leave of the residual, and with itself.
        The energy explained is twice the first less the second.
    """
    fits = fits_by_fold(base, all_columns(base, terms), fold)
    rows = [_products(without, within, terms) for without, within in fits]
    product, square = np.stack(rows, axis=1)
    return product, square


def _products(train: Fit, test: Fit, terms: Sequence[Term]) -> Floats:
    """Products (2, t) of each term on the test sums, the others off at the trained coefficients."""
    theta = train.coefficients
    score = test.score.sum(axis=0) - test.gram @ theta
    sizes = [c.size for c in term_coefficients(train, terms)]
    start = theta.size - sum(sizes)
    out = []
    for size in sizes:
        own = slice(start, start + size)
        square = theta[own] @ test.gram[own, own] @ theta[own]
        out.append((theta[own] @ score[own] + square, square))
        start += size
    return np.array(out).reshape(-1, 2).T
