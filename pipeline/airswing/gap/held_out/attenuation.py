"""How much of an effect of the wind its estimate holds, told by regressors free of the noise.

Assumptions: the wind an effect of the reference or of position works on, ``x``, is the reference's
own, whose error is in the residual as well. Two cases. Where the design column ``z`` is made of the
large-scale *reported* wind (a speed bias, winds left along the grid, a shear times a height) the
estimate is ``z'Mr / z'Mz``, M being the whole mixed model (whitening, day fields, climatology), and
of a true coefficient c the share ``z'Mx / z'Mz`` is left, whatever the noise. Where the column is
the reference's own tendency (a time offset) the reference's error is in it and flattens the
regression; the large-scale reported tendency of each day, which does not know that error, serves as
instrument: ``z'Mr / z'Mx``. A lag along the path is
:mod:`airswing.gap.held_out.gradient_reliability`'s.

Validity: the large-scale reported wind is free of the reference's error. A share told by a weak
instrument is drawn towards 1. One share for all aircraft of a term.

Source: instrumental variables, Fuller 1987, Measurement Error Models, section 1.4; Berkson error,
Carroll et al. 2006, ch. 1.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.layout import effect_columns, make_layout
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term, term_weights
from airswing.gap.held_out.by_days import BLOCK, LEAST_BLOCKS, ByDays, Column
from airswing.gap.held_out.gradient_reliability import lag_reliability
from airswing.gap.held_out.reduction import fitted_error, term_fields
from airswing.gap.sums.accumulate import SumColumns, accumulate
from airswing.gap.sums.elimination import Included, climatology, eliminate_days, fit_included
from airswing.gap.sums.problem import Problem
from airswing.units import DAY

Floats = NDArray[np.float64]

#: Effects whose column is made of the large-scale reported wind.
EXOGENOUS = ("reference_speed_bias", "reference_grid_relative", "altitude_offset")
#: The effect that is read out by instrument.
TIMED = "reference_time_offset"
#: The effect whose share is told by the reports along the path.
LAGGED = "time_lag"
#: Shares a coefficient is divided by are kept within these.
BOUNDS = (0.1, 1.5)
#: How far from 1 a share usually is, as a ratio: an instrument that errs more counts for less.
USUAL = 0.4


def readout_factors(
    problem: Problem,
    terms: Sequence[Term],
    coefficients: Sequence[Floats],
    *,
    again: bool = False,
) -> tuple[dict[str, float], dict[str, float]]:
    """Share of each wind effect's true coefficient that its estimate holds, and its doubt.

    Parameters
    ----------
    terms : sequence of Term
        Found; those of other effects are passed over.
    coefficients : sequence of (t, k)
        As fitted.
    again : bool
        The estimates are of a second pass, linearised about those of a first, which has taken the
        error of a share s from 1 - s to its square.

    Returns
    -------
    shares : dict
        Effect name -> share in :data:`BOUNDS`.
    doubts : dict
        Effect name -> standard error of its share, relative to it, where an instrument told it.
    """
    frame, columns_frame, noise = problem.archive, problem.context, problem.noise
    regress = partial(_regressed, problem)
    out: dict[str, float] = {}
    doubts: dict[str, float] = {}
    for k, term in enumerate(terms):
        name = term.candidate.name
        if len(term.candidate.subset) != 1 or name not in (*EXOGENOUS, TIMED, LAGGED):
            continue
        effect = problem.effects[name]
        if name == LAGGED:
            out[name] = lag_reliability(frame, columns_frame, noise, effect)
            continue
        acting = term_weights(term, problem.calendar)[frame.aircraft, problem.day, None]
        x = effect_columns(frame, effect)[term.candidate.subset[0]] * acting
        rest = without_others(problem, terms, coefficients, k)
        if name in EXOGENOUS:
            share, _ = regress(columns_frame, x, term, effect)
            out[name] = 1.0 - (1.0 - share) ** 2 if again else share
            told = _told_by_days(problem, term, rest, float(coefficients[k][0, 0]) / out[name])
            if told is not None:
                out[name], doubts[name] = out[name] * told[0], told[1]
            continue
        free = with_large_scale_tendency(columns_frame)
        under, _ = regress(free, x, term, effect)
        found, error = regress(free, rest, term, effect)
        # what is not found at all cannot be read too small
        known = abs(found) > 1e-9
        out[name], doubts[name] = _shrunk(
            float(coefficients[k][0, 0]) * under / found if known else 0.0,
            error * float(np.sqrt(term.score.factor)) / abs(found) if known else np.inf,
        )
    return {name: float(np.clip(share, *BOUNDS)) for name, share in out.items()}, doubts


def _told_by_days(
    problem: Problem, term: Term, rest: Floats, read: float
) -> tuple[float, float] | None:
    """What a coefficient as read is over that by days, and its doubt; None: these tell nothing."""
    blocks = int(problem.day.max()) // BLOCK + 1
    lasts = term.candidate.scope == "fleet" and term.period is None
    if not lasts or blocks < LEAST_BLOCKS:
        return None
    frames, effect = (problem.archive, problem.context), problem.effects[term.candidate.name]
    column = Column.of(*frames, effect, term.candidate.subset[0])
    found = ByDays.of(frames, problem.noise, problem.day, rest, [column]).weigh(0)
    # as above: the ratio of two nothings says nothing
    if found is None or abs(found.value) < 1e-9:
        return None
    return _shrunk(read / found.value, found.error / abs(found.value))


def _shrunk(share: float, error: float) -> tuple[float, float]:
    """Share of a relative standard error, drawn towards 1 as far as it is unknown; what is left."""
    if share <= 0.0 or not np.isfinite(share):
        return 1.0, USUAL
    known = USUAL**2 / (USUAL**2 + error**2)
    return float(np.exp(np.log(share) * known)), float(error * np.sqrt(known))


def without_others(
    problem: Problem, terms: Sequence[Term], coefficients: Sequence[Floats], one: int
) -> Floats:
    """Residual (n, 2) with all terms but one taken off, to first order.

    Parameters
    ----------
    coefficients : sequence of (t, k)
        As fitted.
    one : int
        Number of the term that stays.

    Returns
    -------
    (n, 2) float
        m s-1.
    """
    frame, day = problem.archive, problem.day
    rest = frame.residual
    for k, (term, values) in enumerate(zip(terms, coefficients, strict=True)):
        if k != one:
            fields = term_fields(frame, term, effects=problem.effects, plan=problem.plan)
            rest = rest - fitted_error(
                fields, term, values, aircraft=frame.aircraft, day=day, calendar=problem.calendar
            )
    return np.asarray(rest)


def _regressed(
    problem: Problem, columns_frame: Frame, target: Floats, term: Term, effect: Effect
) -> tuple[float, float]:
    """Coefficient of a target (n, 2) on a term's column in the mixed model, and its error."""
    base, noise = problem.base, problem.noise
    bare, own = replace(problem.plan, groups=()), {effect.name: effect}
    layout = make_layout(own, bare, columns_frame)
    columns = SumColumns(noise, layout, own, bare)
    clock = base.stats.clock
    stats = accumulate(columns_frame, target, columns, clip=np.inf, clock=clock)
    part = eliminate_days(stats, base.variances)
    column = int(layout.columns(effect.name)[term.candidate.subset[0]])
    weights = term_weights(term, stats.calendar)
    # next to no prior: least squares are wanted, and a shrunk slope would hide what is attenuated
    fit = fit_included(part, [*climatology(part), Included(column, weights, 1e-12)])
    return float(fit.coefficients[-1]), float(np.sqrt(fit.covariance[-1, -1]))


def with_large_scale_tendency(frame: Frame) -> Frame:
    """Frame whose tendency is that of the reported winds' large-scale part, day by day.

    Returns
    -------
    Frame
        ``dudt`` and ``dvdt`` (m s-2) replaced: the derivative by time of a fit, each day, to
        position, level and their products, each constant, linear and (the lower ones) quadratic in
        time.
    """
    time, design, rate = _in_space_and_time(frame)
    winds = np.stack([frame.u_rep, frame.v_rep], -1)
    out = np.zeros_like(winds)
    day = np.floor(time).astype(np.int64)
    order = np.argsort(day, kind="stable")
    ridge = 3.0 * np.eye(design.shape[1])
    ridge[0, 0] = 1e-6
    for own in np.split(order, np.flatnonzero(np.diff(day[order])) + 1):
        if own.size < 2 * design.shape[1]:
            continue
        part = design[own]
        fit = np.linalg.solve(part.T @ part + ridge, part.T @ winds[own])
        out[own] = rate[own] @ fit
    return replace(frame, dudt=out[:, 0], dvdt=out[:, 1])


def _in_space_and_time(frame: Frame) -> tuple[Floats, Floats, Floats]:
    """Time in days from the quietest hour, the design of the fit and its derivative (s-1)."""
    hours = np.bincount((np.mod(frame.time, DAY) // 3600).astype(int), minlength=24)
    quiet = int(np.argmin(hours + np.roll(hours, 1) + np.roll(hours, -1)))
    time = (frame.time - 3600.0 * quiet) / DAY
    t = 4.0 * (np.mod(time, 1.0) - 0.5)
    x, y, z = (
        np.clip((v - v.mean()) / (v.std() or 1.0), -3, 3)
        for v in (frame.longitude, frame.latitude, np.log(frame.pressure))
    )
    one, none = np.ones_like(x), np.zeros_like(x)
    low = [one, x, y, z, x * z, y * z]
    space = [*low, x * x, x * y, y * y, z * z, z**3, z * z * x, z * z * y]
    terms = [*space, *(s * t for s in space), *(s * t * t for s in low)]
    rates = [none for _ in space] + space + [2 * s * t for s in low]
    return time, np.stack(terms, -1), np.stack(rates, -1) * (4.0 / DAY)
