"""Whether a model wind too weak or strong beyond a level is so beyond a level at all.

Assumptions: air is warm below and aircraft are fast above, so reports that err where it is warm
look like a model that errs below a level. A bias that begins at a level explains more there than at
any temperature or airspeed; what begins at one of these explains more there, most of all in flights
that cross it elsewhere. Both are fitted to the same residual, the other effects taken off, in the
mixed model of the search (whitening, day fields, climatology), as steps at quantiles.

Validity: one level; a step narrower than the quantiles' spacing is met in part.

Source: raw evidence and its margin as in docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.layout import effect_columns, make_layout
from airswing.gap.effects.base import Effect, FloatArray
from airswing.gap.effects.reference_speed_bias import ReferenceSpeedBias
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.attenuation import without_others
from airswing.gap.sums.accumulate import SumColumns, accumulate
from airswing.gap.sums.elimination import climatology, condition, eliminate_days
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]

#: What a bias may go by in truth.
VARIABLES = ("temperature", "airspeed")
#: Steps of each: two kelvin or so apart in an ordinary archive.
STEPS = 32
#: Raw evidence, in cluster factors, by which a step must beat the level, as for unknowns.
CLEARLY = 3.0


class _Steps(ReferenceSpeedBias):
    """The wind times a form of the bias, then times steps of other variables, as columns."""

    column_names = ()

    def __init__(self, effect: Effect, form: int, bounds: dict[str, Floats]) -> None:
        self.effect, self.form, self.bounds = effect, form, bounds

    def columns(self, frame: Frame) -> FloatArray:
        """See `Effect.columns`."""
        wind = np.stack([frame.u_ref, frame.v_ref], axis=-1)
        beyond = [
            getattr(frame, name) > bound for name, own in self.bounds.items() for bound in own
        ]
        own = effect_columns(frame, self.effect)[self.form]
        return np.stack([own, *(np.where(one[:, None], -wind, 0.0) for one in beyond)])


def goes_by(
    problem: Problem, terms: Sequence[Term], coefficients: Sequence[Floats]
) -> tuple[int, str] | None:
    """Find a bias beyond a level that goes by another variable in truth.

    Parameters
    ----------
    coefficients : sequence of (t, k)
        As fitted.

    Returns
    -------
    (int, str) or None
        Number of the term and the variable; None where the level stands, or there is no such term.
    """
    for k, term in enumerate(terms):
        form = term.candidate.subset
        if term.candidate.name != ReferenceSpeedBias.name or form == (0,):
            continue
        effect, bounds = problem.effects[term.candidate.name], _bounds(problem.context)
        rest = without_others(problem, terms, coefficients, k)
        raw = _raw(problem, _Steps(effect, form[0], bounds), rest)
        names = [name for name, own in bounds.items() for _ in own]
        best = int(np.argmax(raw[1:])) if names else 0
        # the step was picked from as many as there are
        needed = CLEARLY * term.score.factor + np.log(len(names) or 1)
        if raw[1:].size and raw[1 + best] > raw[0] + needed:
            return k, names[best]
    return None


def _bounds(frame: Frame) -> dict[str, Floats]:
    """Quantiles of the variables that are known."""
    shares = np.arange(1, STEPS + 1) / (STEPS + 1)
    known = {name: getattr(frame, name) for name in VARIABLES}
    return {
        name: np.unique(np.nanquantile(values, shares))
        for name, values in known.items()
        if np.isfinite(values).any()
    }


def _raw(problem: Problem, steps: _Steps, rest: Floats) -> Floats:
    """Half the square of each column's estimate over its error, alone in the mixed model, nats."""
    bare, own = replace(problem.plan, groups=()), {steps.name: steps}
    layout = make_layout(own, bare, problem.context)
    columns = SumColumns(problem.noise, layout, own, bare)
    clock = problem.base.stats.clock
    stats = accumulate(problem.context, rest, columns, clock=clock)
    part = eliminate_days(stats, problem.base.variances)
    given = condition(part, climatology(part))
    pick = layout.columns(steps.name)
    score = given.fleet_score[pick]
    left = np.diagonal(given.fleet_gram)[pick]
    # a step with no information beside the others has no evidence either
    raw = np.divide(score**2, 2 * left, out=np.zeros_like(score), where=left > 1e-9)
    return np.asarray(raw)
