"""Closure of the gap: mean vector disagreement on held-out days without the effects found, kt.

Terms are fitted to four of five groups of days and subtracted from the fifth, at the heading,
airspeed and wind that were reported. The interval is from a bootstrap over days and from draws of
the coefficients, which include the error of a fit to a part of the days.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from airswing.gap.archive.reported_variables import RELIABILITY
from airswing.gap.arrays import Floats, Integers
from airswing.gap.model.passes import Fitted
from airswing.gap.model.refit import BLOCK
from airswing.gap.result.schema import ClosesEntry
from airswing.units import KNOT, NORMAL_95

#: Bootstrap samples of days: ten of them lie beyond either end of an interval of 95 %.
SAMPLES = 400


@dataclass(frozen=True)
class Closure:
    """Disagreement before, kt, and the closure by each claim in addition to those before it."""

    before: float
    steps: tuple[ClosesEntry, ...]
    total: ClosesEntry
    residual: Floats  # (n, 2): held-out, without all claims, m/s


def is_held_out(days: int) -> bool:
    """Whether an archive of so many days is closed on days that its fit does not use.

    In shorter ones a group of days is half of the reports or more: the fit to the others has so
    large an error that it says nothing about the closure.
    """
    return days > BLOCK


def close(fitted: Fitted, claims: Sequence[Sequence[int]], *, seed: int = 0) -> Closure:
    """Remove claims, each a list of terms, one after the other."""
    sums, exact = fitted.model.sums, fitted.exact
    theta = exact.by_fold if is_held_out(sums.span) else exact.theta
    response = exact.response
    linear = [response.linear(k, theta, response.reported[k + 1]) for k in range(len(fitted.terms))]
    rng = np.random.default_rng(seed)
    removed: list[int] = []
    residual = fitted.frame.residual
    lengths = [np.hypot(*residual.T) / KNOT]
    for claim in claims:
        removed += claim
        residual = fitted.frame.residual - response.combined(linear, removed)
        lengths.append(np.hypot(*residual.T) / KNOT)
    doubt = _coefficient_doubt(fitted, claims, rng)
    days, count = sums.D, np.bincount(sums.day, minlength=sums.D)
    by_day = np.stack([np.bincount(sums.day, length, days) for length in lengths])
    picks = rng.integers(0, days, (SAMPLES, days))
    drawn = by_day[:, picks].sum(axis=2) / count[picks].sum(axis=1)
    means = by_day.sum(axis=1) / count.sum()
    unseen = [_missed_ratio(fitted, claim) for claim in claims]
    steps = tuple(
        _step(means[j] - means[j + 1], drawn[j] - drawn[j + 1], doubt[j], unseen[j])
        for j in range(len(claims))
    )
    missed = sum(
        share * max(step.reduction, 0.0) for share, step in zip(unseen, steps, strict=True)
    )
    value = means[0] - means[-1]
    share = missed / value if value > 0 else 0.0
    total = _step(value, drawn[0] - drawn[-1], doubt[-1] if claims else 0.0, share)
    return Closure(float(means[0]), steps, total, residual)


def _step(value: float, drawn: Floats, doubt: float, unseen: float) -> ClosesEntry:
    # as stated, with two decimals, a value lies within its interval
    half = NORMAL_95 * float(np.hypot(drawn.std(), doubt)) + 0.005
    value = float(value)
    return ClosesEntry(value, [value - half, value + half + unseen * max(value, 0.0)])


def _missed_ratio(fitted: Fitted, claim: Sequence[int]) -> float:
    """Ratio of the closure that a claim may miss to its closure, 1 / q - 1.

    q is the share of an effect's energy that its columns hold: the reliability of inferred context,
    of tables times 0.9 a variable, the share of a sector of two knots that hat functions hold
    (least squares on sectors at random places; 0.95 of four knots). Of a step at the median of a
    normal variable a normal variable with the correlation rho holds (2 / pi arcsin rho)^2 (Sheppard
    1899, Phil. Trans. R. Soc. A 192, 101-167).
    """
    shares = []
    for group in (fitted.terms[k].group for k in claim):
        share = group.reliability
        for name in () if group.named else group.variables:
            squared = RELIABILITY.get(name, 1.0)
            share *= 0.9 * (2 / np.pi * np.arcsin(np.sqrt(squared))) ** 2 / squared
        shares.append(share)
    return 1.0 / min(shares) - 1.0


def _coefficient_doubt(
    fitted: Fitted, claims: Sequence[Sequence[int]], rng: np.random.Generator
) -> list[float]:
    """Standard deviation of each step and of the total when coefficients are drawn, kt."""
    if not claims:
        return []
    exact = fitted.exact
    response = exact.response
    # by rounding, a covariance of nearly collinear columns may have eigenvalues below zero
    values, vectors = np.linalg.eigh(exact.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # thirty draws on every fifth report
    drawn = [exact.theta + root @ rng.standard_normal(root.shape[1]) for _ in range(30)]
    changes = [
        [response.linear(k, theta)[::5] for k in range(len(fitted.terms))] for theta in drawn
    ]
    residual = fitted.frame.residual[::5]
    out = []
    for claim in [*claims, [k for c in claims for k in c]]:
        lengths = [np.hypot(*(residual - sum(change[k] for k in claim)).T) for change in changes]
        out.append(float(np.std([length.mean() for length in lengths])) / KNOT)
    return out


def day_interval(values: Floats, day: Integers, seed: int) -> tuple[float, float]:
    """Bootstrap 95 % interval over days of a mean over reports, (n,) each.

    Means of days drawn again scatter by (n - 1) / n of the variance; the difference is added.
    """
    count, total = np.bincount(day), np.bincount(day, values)
    used = np.flatnonzero(count)
    picks = np.random.default_rng(seed).integers(0, used.size, (SAMPLES, used.size))
    means = total[used][picks].sum(axis=1) / count[used][picks].sum(axis=1)
    middle = total.sum() / count.sum()
    inflation = np.sqrt(used.size / max(used.size - 1, 1))
    low, high = np.quantile(middle + inflation * (means - middle), [0.025, 0.975])
    return float(low), float(high)
