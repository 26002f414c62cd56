"""What a first pass found, taken off any reports of the archive, to be linearised about.

Assumptions: effects of heading and airspeed are taken off exactly, all others to first order; what
is taken off is put back to first order by the design columns, so that a second pass sees the whole
effect but for what bends it.

Validity: the reports' days are those of the first pass's sums. m s-1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term
from airswing.gap.held_out.reduction import fitted_error, is_sensor, take_off, term_fields
from airswing.gap.sums.accumulate import Calendar, Clock, day_of_report
from airswing.gap.sums.problem import Problem

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Errors:
    """Wind errors (n, 2) of the terms found, m/s."""

    # sensor, other: (n, 2): on the frame as reported
    sensor: Floats
    other: Floats
    linear: Floats  # (n, 2): by the design columns
    # size that one report in a thousand of those a term acts on exceeds, of the worst term
    peak: float


@dataclass(frozen=True)
class FoundFirst:
    """The terms of a first pass; called with reports and their context it takes them off."""

    terms: Sequence[Term]
    values: Sequence[Floats]  # (t, k) each: their coefficients
    effects: Mapping[str, Effect]
    plan: DictionaryPlan
    calendar: Calendar
    clock: Clock

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[Term], values: Sequence[Floats]) -> FoundFirst:
        """Of the terms of a problem, keeping nothing else of it."""
        stats = problem.base.stats
        return cls(
            terms,
            values,
            problem.effects,
            problem.plan,
            stats.calendar,
            stats.clock,
        )

    def __call__(self, frame: Frame, context: Frame) -> tuple[Floats, Floats]:
        """Residual without the terms, heading and airspeed exactly, and the terms linearly."""
        errors = self.errors(frame, context)
        return take_off(frame, errors.sensor, errors.other), errors.linear

    def errors(self, frame: Frame, context: Frame) -> Errors:
        """Evaluate the terms on every report.

        Parameters
        ----------
        frame, context : Frame
            The same reports, as they are and as design columns take them.
        """
        days, _ = day_of_report(frame, clock=self.clock)
        day = np.searchsorted(self.calendar.days, days, side="right") - 1
        sensor, other, linear = (np.zeros((frame.size, 2)) for _ in range(3))
        peak = 0.0
        for term, value in zip(self.terms, self.values, strict=True):
            own = np.arange(frame.size)
            if term.candidate.scope == "aircraft":
                own = np.flatnonzero(np.isin(frame.aircraft, term.tails))
            if not own.size:
                continue
            total = sensor if is_sensor(term, self.effects) else other
            total[own] += self._error(frame.take(own), term, value, day[own])
            columns = self._error(context.take(own), term, value, day[own])
            linear[own] += columns
            size = np.hypot(*columns.T)
            size = size[size > 0]
            # not the largest: a single report at a front has any gradient
            peak = max(peak, float(np.quantile(size, 0.999)) if size.size else 0.0)
        return Errors(sensor, other, linear, peak)

    def _error(self, frame: Frame, term: Term, value: Floats, day: Integers) -> Floats:
        fields = term_fields(frame, term, effects=self.effects, plan=self.plan)
        return fitted_error(
            fields, term, value, aircraft=frame.aircraft, day=day, calendar=self.calendar
        )
