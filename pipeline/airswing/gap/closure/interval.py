"""How sure the closure is: drawn from what the data leave open about every coefficient.

Assumptions: how far the disagreement would shrink is a function of the effects' true coefficients,
on the very reports of the archive. Given the data those are normal about their estimates; the
reduction is worked out for each draw (it is lower on average than with the estimates,
which are tuned to the reports' noise: draws undo that). Three things are drawn:

* the fit's own error, with the cluster factor, independent between aircraft;
* model error that persists over the archive, of the allowance's size where the effect acts, shared
  by the aircraft of a term: they fly through the same model;
* the rounding of the reports: without the effect they would have been rounded otherwise.

Columns carry but a part of an effect: nearly all where the heading is wanted (in turns it is that
of chords), less where they are inferred (bank, acceleration) or gradients of the reference. True
closure is then higher by an amount drawn between nothing and twice what that part suggests; and it
is a hundredth off one way or the other. Which
*days* were flown is no part of it: the claim is about these reports (days drawn anew would answer
how the next month turns out, and in trials missed the truth one time in four where the coefficient
was the uncertain thing).

Effects that were not named are not excluded by silence: both limits hold what they could close
(:mod:`airswing.gap.closure.effects_not_named`), which may be less than nothing: a small effect can
lie against the model's error on these very reports. The upper limit holds what the curve of
something unknown closes.

Validity: errors of a few degrees about the estimate (linear in the columns); two days and more: of
one day few effects are told from weather, so where none is what others would close has no bound.
Results in knots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.closure.effects_not_named import left_over
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.term_covariance import term_covariances, term_offsets
from airswing.gap.evidence.terms import Term, day_factors
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.held_out.reduction import (
    Closure,
    fitted_error,
    is_sensor,
    take_off,
    term_fields,
    whole_coefficients,
)
from airswing.gap.search.stepwise import Found
from airswing.gap.search.testability import single_day
from airswing.gap.sums.problem import Problem
from airswing.units import KNOT

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Quantiles of the interval stated.
LIMITS = (0.025, 0.975)
#: Relative standard error of a reduction from what is bent in it: columns are linear in their
#: coefficients and stand at the heading as fitted. Nine of the blind check's archives whose effect
#: has no other doubt were 0.1 to 1.0 % off their twins, one 2.7 %.
BENT = 0.01
DRAWS = 300
#: Reports whose draws are worked out at once: 300 draws of them are 1.2 MB.
AT_ONCE = 256


def with_interval(
    closure: Closure,
    problem: Problem,
    found: Found,
    *,
    known: Sequence[int],
    factors: Mapping[str, float] | None = None,
    doubts: Mapping[str, float] | None = None,
) -> Closure:
    """Closure of the known terms with the interval of what is true.

    Parameters
    ----------
    closure : Closure
        Of the known terms, held out.
    known : sequence of int
        Positions of those terms.
    factors : mapping, optional
        Effect name -> share of its coefficient that is fitted
        (`airswing.gap.held_out.attenuation`).
    doubts : mapping, optional
        Effect name -> relative standard error of that share.

    Returns
    -------
    Closure
        With ``reduction_ci`` and ``after_ci`` that hold what is stated; None of one day
        without names.
    """
    if single_day(problem.base.stats) and not known:
        return replace(closure, reduction_ci=None, after_ci=None)
    rng = np.random.default_rng(problem.seed)
    open_ = _Open(problem, found, rng, DRAWS, factors or {}, doubts or {})
    alone = dict(zip(known, closure.alone, strict=True))
    drawn = _drawn(open_, closure, alone, known)
    more = left_over(problem, found, closure.residual, rng, DRAWS, named=known)
    everything = range(len(found.terms))
    most = drawn
    if len(known) < len(everything):
        most = np.maximum(drawn, _drawn(open_, closure, alone, everything))
    stated = closure.before - closure.after
    low = float(np.quantile(np.minimum(drawn, drawn + more), LIMITS[0])) / KNOT
    high = float(np.quantile(most + more, LIMITS[1])) / KNOT
    return closure.with_interval(min(low, stated), max(high, stated))


@dataclass(frozen=True)
class _Open:
    """What the draws are made of: the problem, its terms, how far each read-out is sure."""

    problem: Problem
    found: Found
    rng: np.random.Generator
    draws: int
    factors: Mapping[str, float]
    doubts: Mapping[str, float]


def _drawn(
    open_: _Open, closure: Closure, alone: Mapping[int, float], terms: Sequence[int]
) -> Floats:
    """Reduction by some terms, by draw, m s-1; ``alone`` holds what each known one leaves, kt."""
    frame, found, rng, draws = open_.problem.archive, open_.found, open_.rng, open_.draws
    if not terms:
        return np.zeros(draws)
    residual, changes = _about_estimate(open_, terms)
    if any(found.terms[k].candidate.name == "reference_time_offset" for k in terms):
        residual = closure.residual  # taken off by more than its column
    gained = float(np.hypot(*frame.residual.T).mean() - np.hypot(*residual.T).mean())
    drawn = gained + reductions(residual, changes, draws)
    drawn += rounding_error(frame, changes) * rng.standard_normal(draws)
    for k in alone:
        share = _told_share(found.terms[k], open_.problem.effects, open_.factors)
        gains = max(closure.before - alone[k], 0.0) * KNOT
        drawn += gains * (1 / share - 1) * rng.uniform(0.0, 2.0, draws)
        drawn += gains * BENT * rng.standard_normal(draws)
    return np.asarray(drawn)


def _told_share(term: Term, effects: Mapping[str, Effect], factors: Mapping[str, float]) -> float:
    """Part of a term's energy that its columns carry, 0.3 to 1."""
    name = term.candidate.name
    share = float(getattr(effects[name], "told_share", 0.99))
    if name == "time_lag":  # along the path the reference's gradient is a noisy one
        share *= factors.get(name, 1.0)
    return float(np.clip(share, 0.3, 1.0))


def rounding_error(frame: Frame, changes: Sequence[Change]) -> float:
    """Standard error of the mean reduction from rounding the touched reports one way or another.

    Parameters
    ----------
    frame : Frame
        For the steps in which winds are coded.

    Returns
    -------
    float
        m s-1.
    """
    touched = np.unique(np.concatenate([index for index, _, _ in changes]))
    owner = frame.aircraft[touched]
    speed = np.hypot(frame.u_rep, frame.v_rep)[touched]
    along = np.nan_to_num(frame.wind_speed_resolution[owner])
    across = np.radians(np.nan_to_num(frame.wind_direction_resolution[owner])) * speed
    # two roundings, each of variance step^2/12, seen along one of the two directions
    variance = 2.0 * 0.5 * (along**2 + across**2) / 12.0
    return float(np.sqrt(variance.sum()) / frame.size)


Change = tuple[Integers, Floats, Floats]
"""Reports, their fields (m, 2, k), and changes of the coefficients by draw (draws, k)."""


def reductions(residual: Floats, changes: Sequence[Change], draws: int) -> Floats:
    """Mean reduction of the vector disagreement over all reports, by draw.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1, at the estimates.
    changes : sequence of Change
        What the draws change, each on its own reports; the same report may be in several.

    Returns
    -------
    (draws,) float
        m s-1.
    """
    if not changes:
        return np.zeros(draws)
    touched = np.unique(np.concatenate([index for index, _, _ in changes]))
    start = residual[touched]
    places = [np.searchsorted(touched, index) for index, _, _ in changes]
    left = np.zeros(draws)
    # some reports with all draws at a time stay in the processor's cache
    for first in range(0, touched.size, AT_ONCE):
        some = start[first : first + AT_ONCE].T
        now = np.repeat(some[:, :, None], draws, axis=2)
        for place, (_, fields, steps) in zip(places, changes, strict=True):
            low, high = np.searchsorted(place, [first, first + AT_ONCE])
            if low < high:
                here = place[low:high] - first
                whole = here[-1] - here[0] + 1 == here.size  # a slice is not copied to and fro
                own = slice(here[0], here[-1] + 1) if whole else here
                now[:, own] -= fields[low:high].swapaxes(0, 1) @ steps.T
        now *= now
        left += np.sqrt(now[0] + now[1]).sum(axis=0)
    return np.asarray((np.hypot(*start.T).sum() - left) / residual.shape[0])


def _about_estimate(open_: _Open, known: Sequence[int]) -> tuple[Floats, list[Change]]:
    """Residual at the estimates, and draws about them, of the known terms."""
    frame, base, effects = open_.problem.archive, open_.problem.base, open_.problem.effects
    found, rng, draws, factors = open_.found, open_.rng, open_.draws, open_.factors
    day = open_.problem.day
    values = whole_coefficients(term_coefficients(found.given, found.terms), found.terms, factors)
    offsets = term_offsets(found.given, found.terms)
    sensor, other = np.zeros((2, frame.size, 2))
    changes: list[Change] = []
    for k in known:
        term = found.terms[k]
        fields = term_fields(frame, term, effects=effects, plan=open_.problem.plan)
        part = fitted_error(
            fields,
            term,
            values[k],
            aircraft=frame.aircraft,
            day=day,
            calendar=open_.problem.calendar,
        )
        total = sensor if is_sensor(term, effects) else other
        total += part
        rows = 1 if term.candidate.scope == "fleet" else len(term.tails)
        shared = rng.standard_normal((draws, term.candidate.columns.size))
        scale = open_.doubts.get(term.candidate.name, 0.0) * rng.standard_normal(draws)
        for row in range(rows):
            formal, allowed = term_covariances(base.stats, found.given, term, offsets[k], row)
            steps = _draw(formal, rng, draws) + shared @ _root(allowed).T
            steps /= factors.get(term.candidate.name, 1.0)
            steps += np.outer(scale, values[k][row])
            index = _reports(frame, term, row)
            acts = day_factors(term.candidate, term.period, base.stats.days)[day[index]]
            index = index[acts > 0.0]
            own = fields[index] * acts[acts > 0.0, None, None]
            changes.append((index, own, steps))
    return take_off(frame, sensor, other), changes


def _reports(frame: Frame, term: Term, row: int) -> Integers:
    """Reports of a term's ``row``-th aircraft, or of the fleet."""
    if term.candidate.scope == "fleet":
        return np.arange(frame.size)
    return np.flatnonzero(frame.aircraft == term.tails[row])


def _root(spread: Floats) -> Floats:
    """Symmetric root of a covariance."""
    values, vectors = np.linalg.eigh(spread)
    # rounding leaves the smallest a little below zero
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _draw(spread: Floats, rng: np.random.Generator, draws: int) -> Floats:
    """Draw normal deviations of a covariance, (draws, k)."""
    return np.asarray(rng.standard_normal((draws, spread.shape[0])) @ _root(spread).T)
