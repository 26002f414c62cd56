"""Closure of the gap on held-out days, kt (docs/gap.md, section 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

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
    theta = exact.by_fold if is_held_out(sums.D) else exact.theta
    rng = np.random.default_rng(seed)
    residual, lengths = _without_claims(fitted, theta, claims)
    fit_means = np.mean(_without_claims(fitted, exact.theta, claims)[1], axis=1)
    doubt = _coefficient_doubt(fitted, claims, rng)
    block = sums.day // BLOCK if is_held_out(sums.D) else sums.day
    number = int(block.max()) + 1
    count = np.bincount(block, minlength=number)
    by_block = np.stack([np.bincount(block, length, number) for length in lengths])
    picks = rng.integers(0, number, (SAMPLES, number))
    drawn = by_block[:, picks].sum(axis=2) / count[picks].sum(axis=1)
    means = by_block.sum(axis=1) / count.sum()
    # drawn means of n blocks have (n - 1) / n of the variance, and Student's law
    freedom = max(number - 1, 1)
    widening = np.sqrt(number / freedom) * float(stdtrit(freedom, 0.975)) / NORMAL_95
    unseen = [_missed_ratio(fitted, claim) for claim in claims]

    def step(first: int, last: int, doubt: tuple[float, float], unseen: float) -> ClosesEntry:
        value, scatter = float(means[first] - means[last]), (drawn[first] - drawn[last]).std()
        error, cost = doubt
        # as stated, with two decimals, a value lies within its interval
        half = NORMAL_95 * float(np.hypot(widening * scatter, error)) + 0.005
        # errors of coefficients make the closure of their own days too large, of others too small
        most = max(value + cost, float(fit_means[first] - fit_means[last]) - cost)
        return ClosesEntry(value, [value - half, most + half + unseen * max(value, 0.0)])

    steps = tuple(step(j, j + 1, doubt[j], unseen[j]) for j in range(len(claims)))
    missed = sum(ratio * max(x.reduction, 0.0) for ratio, x in zip(unseen, steps, strict=True))
    value = float(means[0] - means[-1])
    share = float(missed) / value if value > 0 else 0.0
    total = step(0, -1, doubt[-1] if claims else (0.0, 0.0), share)
    return Closure(float(means[0]), steps, total, residual)


def _without_claims(
    fitted: Fitted, theta: Floats, claims: Sequence[Sequence[int]]
) -> tuple[Floats, list[Floats]]:
    """Residual without all claims, and the lengths (n,), kt, before and after each of them."""
    response = fitted.exact.response
    linear = [response.linear(k, theta, response.reported[k + 1]) for k in range(len(fitted.terms))]
    residual = fitted.frame.residual
    removed: list[int] = []
    lengths = [np.hypot(*residual.T) / KNOT]
    for claim in claims:
        removed += claim
        residual = fitted.frame.residual - response.combined(linear, removed)
        lengths.append(np.hypot(*residual.T) / KNOT)
    return residual, lengths


def _missed_ratio(fitted: Fitted, claim: Sequence[int]) -> float:
    """Ratio of the closure that a claim may miss to its closure, 1 / q - 1.

    q is the share of an effect's energy that its columns hold: the reliability of inferred context,
    of tables times 0.9 a variable, the share of a sector of two knots that hat functions hold
    (least squares on sectors at random places; 0.95 of four knots). Of a step at the median of a
    normal variable a normal variable with the correlation rho holds (2 / pi arcsin rho)^2 (Sheppard
    1899, Phil. Trans. R. Soc. A 192, 101-167).
    """
    reliability = fitted.model.sums.candidates.reliability
    shares = []
    for k in claim:
        group = fitted.terms[k].group
        # tables are subtracted at the reported winds without the blur of their fit
        blurred = group.named or k in fitted.exact.response.averaged
        share = group.reliability if blurred else 1.0
        for name in () if group.named else group.variables:
            squared = reliability.get(name, 1.0)
            share *= 0.9 * (2 / np.pi * np.arcsin(np.sqrt(squared))) ** 2
        shares.append(share)
    return float(1.0 / min(shares) - 1.0)


def _coefficient_doubt(
    fitted: Fitted, claims: Sequence[Sequence[int]], rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Scatter of each step and of the total by errors of coefficients, and their mean cost, kt."""
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
        [response.linear(k, theta, response.reported[k + 1])[::5] for k in range(len(fitted.terms))]
        for theta in (exact.theta, *drawn)
    ]
    residual = fitted.frame.residual[::5]
    out = []
    for claim in [*claims, [k for c in claims for k in c]]:
        fitted_best, *lengths = (
            float(np.hypot(*(residual - sum(change[k] for k in claim)).T).mean()) / KNOT
            for change in changes
        )
        out.append((float(np.std(lengths)), max(float(np.mean(lengths)) - fitted_best, 0.0)))
    return out


def day_interval(values: Floats, day: Integers, seed: int) -> tuple[float, float]:
    """Bootstrap 95 % interval over days (each with reports) of a mean over reports, (n,) each.

    Means of days drawn again scatter by (n - 1) / n of the variance; the difference is added.
    """
    count, total = np.bincount(day), np.bincount(day, values)
    picks = np.random.default_rng(seed).integers(0, count.size, (SAMPLES, count.size))
    means = total[picks].sum(axis=1) / count[picks].sum(axis=1)
    middle = total.sum() / count.sum()
    inflation = np.sqrt(count.size / max(count.size - 1, 1))
    low, high = np.quantile(middle + inflation * (means - middle), [0.025, 0.975])
    return float(low), float(high)
