"""Dates: the evidence for columns that act only from a date on, or between two dates.

Assumptions: the change happens between two days; before it (and after the end, where there is one)
the columns do not act. Aircraft struck together change on one date, each by an amount of its own;
those that change on another date are another change. What sets in on a date grows from nothing
there, by so much a day, and to the archive's end. The posterior over dates is exact: every
date's Gaussian evidence from cumulative sums of the daily sums. What is conditioned on stays
conditioned on: its columns of the same aircraft are projected out of the window's columns.

Validity: about 60 dates are tried (every day of two months, every third of half a year); the
climatology is conditioned on at its fitted value.

Source: docs/gap.md section 6; cumulative-sum change-point posterior (Smith 1975, Biometrika 62).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.aircraft_mixture import by_share, mixture
from airswing.gap.evidence.change_windows import Windows, windows_tried
from airswing.gap.evidence.gaussian import (
    GridEvidence,
    OwnFit,
    Score,
    allowance_covariance,
    grid_evidence,
    own_fit,
    raw_evidence,
    rms,
)
from airswing.gap.evidence.of_candidate import LEAST_ACTING, evaluate
from airswing.gap.evidence.terms import day_factors
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.cluster_inflation import aircraft_factor
from airswing.gap.sums.day_scores import core_residual_scores, day_scores
from airswing.gap.sums.elimination import Base, Conditional

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Not the test of `evaluation.monitoring`: a step competes here with every other effect, so it
# is weighed by evidence, beside what is conditioned on, in periods that may end, and in several
# aircraft at once.
#: What a period must explain beyond the same effect lasting: log evidence, and part of its own.
GAIN, GAIN_SHARE = 5.0, 0.04
#: Cluster factor from which it is asked how much of it the change itself makes.
WORTH_A_LOOK = 1.3
#: Blocks that a period's start and its coefficients take of the freedom of the scatter.
SPENT = 2


def own_day_grams(base: Base, aircraft: int, columns: Integers) -> Floats:
    """X'X of some core columns by day, day fields eliminated, (D, k, k)."""
    cross = base.cross[aircraft][:, :, columns]
    own = base.stats.day_gram[aircraft][:, columns][:, :, columns]
    return np.asarray(own - np.einsum("dik,dil->dkl", cross, cross))


def evaluate_step(
    base: Base,
    given: Conditional,
    candidate: Candidate,
    *,
    allowed: NDArray[np.bool_] | None = None,
    period: tuple[int, int] | None = None,
    shown: bool = False,
) -> Score:
    """Evidence that columns act within a period only, or grow from a date on, all dates averaged.

    Parameters
    ----------
    candidate : Candidate
        Per-aircraft, core columns.
    allowed : (A,) bool, optional
    period : (int, int), optional
        Days of a change that has been shown: only windows near it are tried.
    shown : bool
        That they change has been shown: it is not asked what the columns explain lasting.

    Returns
    -------
    Score
        With the most probable period of the aircraft together.
    """
    stats = base.stats
    tried, prior = windows_tried(stats, candidate, period)
    acting = stats.acting[:, candidate.columns].max(axis=1)
    asked = np.zeros(acting.size, bool) if len(prior) == 0 else acting >= LEAST_ACTING
    if allowed is not None:
        asked &= allowed
    # of a change nothing tells the background but what the same columns show lasting
    background = evaluate(stats, given, candidate).background
    look = partial(_window_evidence, stats, candidate, tried, background)
    sums = {
        int(a): _window_sums(base, given, int(a), candidate.columns, tried)
        for a in np.flatnonzero(asked)
    }
    fits = {a: own_fit(*own, tried.scales(candidate)) for a, own in sums.items()}
    factor, found = _steadily(base, given, candidate, tried, sums, partial(look, fits))
    changing = {a: x.tempered[:, :-1] for a, x in found.items()}
    struck = list(sums)
    if not shown:
        struck = _changing(changing, {a: x.tempered[:, -1:] for a, x in found.items()}, prior)
    if not struck:
        nothing = np.zeros((acting.size, candidate.columns.size))
        return Score(
            candidate,
            0.0,
            0.0,
            factor,
            np.zeros(acting.size),
            np.zeros(acting.size),
            nothing,
            np.zeros(acting.size),
            acting,
            period=(0, 0),
            background=background,
        )
    raw = [raw_evidence(fits[a])[:, :-1] for a in struck]
    best = _one_date([found[a] for a in struck], raw, prior)
    posterior, evidence = np.zeros((2, acting.size))
    estimate = np.zeros((acting.size, candidate.columns.size))
    posterior[struck], evidence[struck], estimate[struck] = best.posterior, best.each, best.estimate
    second = stats.raw_gram[:, candidate.columns][:, :, candidate.columns]
    first, last = tried.windows[best.window]
    return Score(
        candidate,
        best.total,
        best.raw,
        factor,
        posterior,
        evidence,
        estimate,
        rms(second, acting, estimate * tried.size[best.window]),
        acting,
        period=(int(first), int(last)),
        background=background,
    )


def raw_of_one_step(base: Base, given: Conditional, candidate: Candidate, one: int) -> float:
    """Raw evidence, nats, that columns of one aircraft alone act within a period, all averaged.

    Parameters
    ----------
    base, given, candidate
        As for :func:`evaluate_step`.

    Returns
    -------
    float
        That of :func:`evaluate_step` where the aircraft is one that changes.
    """
    tried, prior = windows_tried(base.stats, candidate, None)
    if not len(prior):
        return 0.0
    sums = _window_sums(base, given, one, candidate.columns, tried)
    return _pooled([raw_evidence(own_fit(*sums, tried.scales(candidate)))[:, :-1]], prior)


@dataclass(frozen=True)
class _OneDate:
    """Evidence that some aircraft (n of them) change on one date."""

    # total, raw: log evidence over all dates
    total: float
    raw: float
    window: int  # the most probable one
    # posterior, each: (n,): probability that each aircraft changes then, and its evidence for it
    posterior: Floats
    each: Floats
    estimate: Floats  # (n, k)


def _one_date(found: list[GridEvidence], raw: list[Floats], prior: Floats) -> _OneDate:
    """Mix aircraft by window, then average over windows; the one at work all the time is none."""
    tempered = np.stack([x.tempered[:, :-1] for x in found], -1)
    joint = by_share(tempered).sum(axis=-1)
    by_window = _over_shares(joint) + prior
    window = int(np.argmax(by_window))
    _, width = np.unravel_index(int(np.argmax(joint[..., window])), joint.shape[:2])
    at_best = mixture(tempered[None, :, window])
    return _OneDate(
        float(np.logaddexp.reduce(by_window)),
        _pooled(raw, prior),
        window,
        at_best.posterior,
        tempered[width, window],
        np.stack([x.estimate[width, window] for x in found]),
    )


def _over_shares(joint: Floats) -> Floats:
    """Mean of evidence (P, S, w) over shares struck and widths of the prior, (w,)."""
    count = joint.shape[0] * joint.shape[1]
    return np.asarray(np.logaddexp.reduce(joint, axis=(0, 1)) - np.log(count))


def _pooled(evidence: list[Floats], prior: Floats) -> float:
    """Log evidence of aircraft that change on one date, from (S, w) of each."""
    joint = by_share(np.stack(evidence, -1)).sum(axis=-1)
    return log_mean_with(_over_shares(joint), prior)


def _changing(changing: dict[int, Floats], steady: dict[int, Floats], prior: Floats) -> list[int]:
    """Aircraft that a period explains clearly more than the same columns at work all the time.

    A lasting deviation that is not in the model yet would otherwise enter as one that begins in
    the archive's first days or ends in its last. Together aircraft may tell what none tells alone.
    """
    if not changing:
        return []
    own = {a: max(log_mean_with(row, prior) for row in x) for a, x in changing.items()}
    lasting = {a: float(x.max()) for a, x in steady.items()}
    alone = [a for a in own if own[a] - lasting[a] > max(GAIN, GAIN_SHARE * own[a])]
    whole = _pooled(list(changing.values()), prior)
    stays = _pooled(list(steady.values()), np.zeros(1))
    if whole - stays <= max(GAIN, GAIN_SHARE * whole):
        return alone
    return sorted({*alone, *(a for a in own if own[a] > max(lasting[a], 0.0))})


def _steadily(
    base: Base,
    given: Conditional,
    candidate: Candidate,
    tried: Windows,
    sums: dict[int, tuple[Floats, Floats]],
    look: Callable[[int, float], GridEvidence],
) -> tuple[float, dict[int, GridEvidence]]:
    """Cluster factor with every aircraft's likeliest period taken off, where that is smaller.

    A change most of the fleet has makes their days scatter about anything that lasts; it must not
    count as doubt about itself. What the period's own fit takes of the scatter is given back.
    Beside it, what each aircraft shows by window with that factor.
    """
    stats, columns = base.stats, candidate.columns
    plain = aircraft_factor(stats, given, columns)
    found = {a: look(a, plain) for a in sums}
    if plain < WORTH_A_LOOK or not sums:
        return plain, found
    score = day_scores(given, columns)
    for a, own in sums.items():
        values = found[a].tempered[:, :-1]
        _, w = np.unravel_index(int(np.argmax(values)), values.shape)
        grams = own_day_grams(base, a, columns)
        factors = day_factors(candidate, (tried.windows[w, 0], tried.windows[w, 1]), stats.days)
        score[a] -= factors[:, None] * (grams @ _unshrunk(own, int(w)))
    factor = min(plain, aircraft_factor(stats, given, columns, score=score, spent=SPENT))
    return factor, found if factor == plain else {a: look(a, factor) for a in sums}


def _unshrunk(sums: tuple[Floats, Floats], window: int) -> Floats:
    """Least-squares coefficients (k,) of one window."""
    information, score = sums[0][window], sums[1][window]
    # a window may lack what tells one coefficient: it stays at nil and moves no other
    ridge = 1e-6 * np.trace(information) + 1e-12
    return np.asarray(np.linalg.solve(information + ridge * np.eye(score.size), score))


def log_mean_with(values: Floats, log_prior: Floats) -> float:
    """Logarithm of the prior-weighted mean of exponentials."""
    return float(np.logaddexp.reduce(values + log_prior))


def _window_sums(
    base: Base,
    given: Conditional,
    aircraft: int,
    columns: Integers,
    tried: Windows,
) -> tuple[Floats, Floats]:
    """Information (w, k, k) and score (w, k) of the columns in every window."""
    remains = core_residual_scores(given, aircraft)
    included = [
        x for x, own in zip(given.included, _owner(base, given), strict=True) if own == aircraft
    ]
    others = np.array([x.column for x in included], np.int64)
    both = np.r_[columns, others]
    grams = own_day_grams(base, aircraft, both)
    k = columns.size
    if others.size:
        factor = np.stack([x.weights[aircraft] for x in included], -1)
        grams[:, :, k:] *= factor[:, None, :]
        cross_total = (grams[:, k:, k:] * factor[:, :, None]).sum(axis=0)
        cross_total += np.diag([x.precision for x in included])
        # terms already found may share a direction: then either of them may take it up
        inverse = np.linalg.inv(cross_total + 1e-9 * np.trace(cross_total) * np.eye(others.size))
    information = tried.sums(grams[:, :k, :k], 2)
    if others.size:
        side = tried.sums(grams[:, :k, k:], 1)
        # of a window wholly within another's period nothing is left, in single precision less
        least = 1e-4 * information * np.eye(k)
        information = information - side @ inverse @ side.transpose(0, 2, 1) + least
    return information, tried.sums(remains[:, columns], 1)


def _owner(base: Base, given: Conditional) -> Floats:
    """Aircraft (m,) that alone has each included core column; -1 where none or several have it."""
    if "owner" not in given.derived:
        has = np.stack([x.weights.any(axis=1) for x in given.included])
        core = np.array([x.column < base.stats.layout.core for x in given.included])
        given.derived["owner"] = np.where(core & (has.sum(axis=1) == 1), has.argmax(axis=1), -1.0)
    return given.derived["owner"]


def _window_evidence(
    stats: Statistics,
    candidate: Candidate,
    tried: Windows,
    background: float,
    fits: dict[int, OwnFit],
    aircraft: int,
    factor: float,
) -> GridEvidence:
    """Evidence (S, w) and estimates (S, w, k) of every prior scale and window."""
    columns = candidate.columns
    second = stats.raw_gram[aircraft][np.ix_(columns, columns)]
    acting = stats.acting[aircraft, columns].max()
    unit = allowance_covariance(second, acting, 1.0, candidate.scales)
    unit = unit / np.square(tried.size)[:, None, None]
    return grid_evidence(fits[aircraft], factor=factor, allowance=background**2 * unit, unit=unit)


__all__ = ["evaluate_step", "own_day_grams"]
