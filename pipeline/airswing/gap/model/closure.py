"""How far the gap closes: mean vector disagreement on held-out days without what was found.

Terms are fitted to four of five groups of days (blocks of two days, in turn) and taken off the
fifth. The reduction of the mean length of the residual has an interval from a bootstrap over days
and from draws of the coefficients, which hold what a fit to less than all days may miss.

Units: kt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.model.passes import Fitted, term_effect
from airswing.gap.model.terms import Model
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Groups of days, and days in a block: weather lasts for two days.
FOLDS, BLOCK = 5, 2
#: Bootstrap samples of days, and draws of the coefficients, on every how many-th report.
SAMPLES, COEFFICIENTS, EVERY = 400, 30, 5
#: kt: as stated, with two decimals, a value lies within its interval.
ROUNDING = 0.005


@dataclass(frozen=True)
class Step:
    """Closure of one claim in addition to the claims before it, with its interval, kt."""

    reduction: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Closure:
    """Disagreement before and after, kt, in steps.

    Attributes
    ----------
    residual : (n, 2) float
        Held-out residual with all claims taken off, m/s.
    """

    before: float
    steps: tuple[Step, ...]
    whole: Step
    residual: Floats

    @property
    def after(self) -> float:
        """Disagreement with all claims taken off."""
        return self.before - self.whole.reduction


def fold_of_day(days: int) -> Integers:
    """Group of each day, (D,); single days in turn where there are few."""
    if days < FOLDS * BLOCK:
        return np.asarray(np.arange(days) % min(FOLDS, days))
    return np.asarray((np.arange(days) // BLOCK) % FOLDS)


def is_held_out(days: int) -> bool:
    """Whether an archive of so many days is closed on days that its fit does not use.

    In shorter ones a group of days is half of the reports or more: the fit to the others has so
    large an error that it says nothing about the closure.
    """
    return days > BLOCK


def held_out_coefficients(model: Model) -> Floats:
    """Coefficients fitted without each group of days, (FOLDS, m).

    Of an archive that is not held out (:func:`is_held_out`) they are those of all days.
    """
    sums = model.sums
    if not is_held_out(sums.span):
        return np.tile(model.theta, (FOLDS, 1))
    every = [model.base, *model.terms]
    made = [model._columns(term) for term in every]
    width = int(model.offsets[-1])
    fold = fold_of_day(sums.D)
    gram, score = np.zeros((FOLDS, width, width)), np.zeros((FOLDS, width))
    for a in range(sums.A):
        own = sums.rows_of(a)
        inside = [
            (s + one.rows[a][0], one.rows[a][1])
            for s, one in zip(model.offsets, made, strict=False)
            if a in one.rows
        ]
        at = np.concatenate([where for where, _ in inside])
        rows = np.concatenate([values for _, values in inside], axis=1)
        of_row = fold[sums.day_of_row[own]]
        for k in range(FOLDS):
            chosen = rows[of_row == k]
            gram[k][np.ix_(at, at)] += chosen.T @ chosen
            score[k][at] += chosen.T @ sums.inverse_residual[own][of_row == k]
    for k in range(FOLDS):
        shared = model.term_shared[fold == k]
        gram[k] -= np.einsum("dqi,dqj->ij", shared, shared, optimize=True)
    precision = np.concatenate(
        [np.full(one.width, 1 / t.scale**2) for t, one in zip(every, made, strict=True)]
    )
    return np.stack(
        [
            np.linalg.solve(gram.sum(0) - gram[k] + np.diag(precision), score.sum(0) - score[k])
            for k in range(FOLDS)
        ]
    )


def held_out_effects(fitted: Fitted) -> list[Floats]:
    """What each term does to every report by the fit to other days, (n, 2) each, m/s."""
    model = fitted.model
    fold = fold_of_day(model.sums.D)[model.sums.day]
    theta: Floats = held_out_coefficients(model)
    out = []
    for k in range(len(model.terms)):
        effect = np.zeros((model.sums.n, 2))
        for j in range(FOLDS):
            chosen = fold == j
            effect[chosen] = term_effect(model, k, theta[j])[chosen]
        out.append(effect)
    return out


def close(fitted: Fitted, claims: Sequence[Sequence[int]], *, seed: int = 0) -> Closure:
    """Take claims off, one after the other.

    Parameters
    ----------
    claims : sequence of sequence of int
        Terms of each claim, in the order in which they are taken off.
    """
    sums = fitted.model.sums
    effects = held_out_effects(fitted)
    before = np.hypot(*fitted.frame.residual.T) / KNOT
    residual = fitted.residual
    lengths = [before]
    rng = np.random.default_rng(seed)
    left = residual.copy()
    # of the linearised second pass the residual holds the errors to first order
    for claim in claims:
        for k in claim:
            left = left - effects[k]
        lengths.append(np.hypot(*left.T) / KNOT)
    doubt = _coefficient_doubt(fitted, claims, rng)
    days, count = sums.D, np.bincount(sums.day, minlength=sums.D)
    by_day = np.stack([np.bincount(sums.day, one, days) for one in lengths])
    picks = rng.integers(0, days, (SAMPLES, days))
    drawn = by_day[:, picks].sum(axis=2) / count[picks].sum(axis=1)
    means = by_day.sum(axis=1) / count.sum()
    steps = tuple(
        _step(means[j] - means[j + 1], drawn[j] - drawn[j + 1], doubt[j])
        for j in range(len(claims))
    )
    whole = _step(means[0] - means[-1], drawn[0] - drawn[-1], doubt[-1] if claims else 0.0)
    return Closure(float(means[0]), steps, whole, left)


def _step(value: float, drawn: Floats, doubt: float) -> Step:
    half = NORMAL_95 * float(np.hypot(drawn.std(), doubt)) + ROUNDING
    return Step(float(value), (float(value) - half, float(value) + half))


def _coefficient_doubt(
    fitted: Fitted, claims: Sequence[Sequence[int]], rng: np.random.Generator
) -> list[float]:
    """Standard deviation of each step and of the whole when coefficients are drawn, kt."""
    model = fitted.model
    if not claims:
        return []
    root = np.sqrt(model.kappa) * model.inverse_root.T.astype(float)
    some = slice(None, None, EVERY)
    base = [term_effect(model, k, model.theta)[some] for k in range(len(model.terms))]
    residual = fitted.residual[some]
    out = []
    shifts: list[Floats] = [
        np.asarray(rng.standard_normal(root.shape[1]) @ root.T, np.float64)
        for _ in range(COEFFICIENTS)
    ]
    moved = [
        [term_effect(model, k, shift)[some] for k in range(len(model.terms))] for shift in shifts
    ]
    for claim in [*claims, [k for one in claims for k in one]]:
        rest = residual - sum((base[k] for k in claim), np.zeros_like(residual))
        gains = [float(np.hypot(*(rest - sum(one[k] for k in claim)).T).mean()) for one in moved]
        out.append(float(np.std(gains)) / KNOT)
    return out


def day_interval(values: Floats, day: Integers, seed: int) -> tuple[float, float]:
    """Bootstrap 95 % interval over days of a mean over reports, (n,) each.

    Means of days drawn again scatter by (n - 1) / n of the variance; the difference is put back.
    """
    count, total = np.bincount(day), np.bincount(day, values)
    used = np.flatnonzero(count)
    picks = np.random.default_rng(seed).integers(0, used.size, (SAMPLES, used.size))
    means = total[used][picks].sum(axis=1) / count[used][picks].sum(axis=1)
    middle = total.sum() / count.sum()
    apart = np.sqrt(used.size / max(used.size - 1, 1))
    low, high = np.quantile(middle + apart * (means - middle), [0.025, 0.975])
    return float(low), float(high)
