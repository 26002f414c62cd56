"""How far the gap shrinks: terms fitted on some weeks, the disagreement measured on the others.

Assumptions: coefficients of the terms found on the whole archive are fitted again without each
fold (whole weeks, so whole flights), and taken off the fold's reports. What acts for a part of the
archive that lies in one or two folds is fitted on five days of six instead. Errors of heading and
airspeed are taken off exactly (the air vector is turned and stretched back), the others to first
order. The *selection* of terms has seen all weeks.

Validity: three weeks and more; with fewer, folds are blocks of days. Speeds in m/s inside, knots in
what is returned for people. Intervals: bootstrap over days of the paired reduction.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan, dictionary_columns, unit_vectors
from airswing.gap.design.layout import effect_columns
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term, term_weights
from airswing.gap.held_out.days_left_out import day_interval, fold_coefficients, folds_of_days
from airswing.gap.sums.accumulate import Calendar
from airswing.gap.sums.problem import Problem
from airswing.units import KNOT

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Folds under which a period is left out by single days, and parts these are dealt to.
FEW_FOLDS, PARTS = 3, 6


@dataclass(frozen=True)
class Closure:
    """Mean vector disagreement on held-out reports, kt."""

    before: float
    after: float
    # reduction_ci, after_ci: 95 % intervals; None where they cannot be had
    reduction_ci: tuple[float, float] | None
    after_ci: tuple[float, float] | None
    # label, disagreement after the terms up to this one, and the interval of this step
    sequence: tuple[tuple[str, float, float, float], ...]
    alone: tuple[float, ...]  # disagreement with each term alone taken off
    residual: Floats  # (n, 2): held-out residual with all terms taken off, m s-1

    def with_interval(self, low: float, high: float) -> Closure:
        """Return the same with this 95 % interval of the reduction, kt."""
        return replace(
            self, reduction_ci=(low, high), after_ci=(self.before - high, self.before - low)
        )


def whole_coefficients(
    coefficients: Sequence[Floats], terms: Sequence[Term], factors: Mapping[str, float] | None
) -> list[Floats]:
    """Coefficients divided by the share of them that is fitted.

    Parameters
    ----------
    coefficients : sequence over terms of (t, k) float
    factors : mapping or None
        Effect name -> share; 1 for those not in it.

    Returns
    -------
    list of (t, k) float
    """
    shares = factors or {}
    return [
        values / shares.get(term.candidate.name, 1.0)
        for values, term in zip(coefficients, terms, strict=True)
    ]


def term_fields(
    frame: Frame, term: Term, *, effects: Mapping[str, Effect], plan: DictionaryPlan
) -> Floats:
    """Columns of a term on reports, (n, 2, k), without regard to aircraft and period."""
    if term.candidate.known:
        columns = effect_columns(frame, effects[term.candidate.name])
        return np.moveaxis(columns, 0, -1)[:, :, list(term.candidate.subset)]
    names = [g.name for g in plan.groups]
    own = replace(plan, groups=(plan.groups[names.index(term.candidate.name)],))
    return dictionary_columns(frame, own)


def term_error(
    fields: Floats,
    term: Term,
    coefficients: Sequence[Floats],
    *,
    aircraft: Integers,
    day: Integers,
    fold: Integers,
    calendar: Calendar,
) -> Floats:
    """Wind error (n, 2) of a term with coefficients by fold.

    Parameters
    ----------
    fields : (n, 2, k) float
    coefficients : sequence over folds of (t, k)
    aircraft, day : (n,) int
        Indices.
    fold : (n,) int
    calendar : Calendar
        Aircraft and days.

    Returns
    -------
    (n, 2) float
        m s-1.
    """
    table = np.zeros((len(coefficients), calendar.aircraft, fields.shape[-1]))
    for f, values in enumerate(coefficients):
        if term.candidate.scope == "fleet":
            table[f] = values[0]
        else:
            table[f, list(term.tails)] = values
    active = term_weights(term, calendar)[aircraft, day]
    return np.asarray(np.einsum("nck,nk->nc", fields, table[fold, aircraft]) * active[:, None])


def fitted_error(
    fields: Floats,
    term: Term,
    values: Floats,
    *,
    aircraft: Integers,
    day: Integers,
    calendar: Calendar,
) -> Floats:
    """Wind error (n, 2) of a term with one set of coefficients (t, k); else as `term_error`."""
    none = np.zeros(day.size, np.int64)
    return term_error(
        fields, term, [values], aircraft=aircraft, day=day, fold=none, calendar=calendar
    )


def retimed(residual: Floats, linear: Floats, fold: Integers) -> Floats:
    """Error (n, 2) that fields of the right time would take off, from its linear estimate.

    The reference's tendency holds that of its own error, and what it misses of small waves does not
    grow with the offset: taken off linearly, an offset of an hour closes nothing. But errors of the
    two times are alike in size, so what the right time takes off the mean square is the offset's
    covariance with the residual, and the residual shrinks by the root of what is left.

    Parameters
    ----------
    residual, linear : (n, 2) float
        m s-1; ``linear`` is the offset times the tendency.
    fold : (n,) int
        The share is measured on each fold.

    Returns
    -------
    (n, 2) float
    """
    whole = np.bincount(fold, (residual**2).sum(axis=1))
    common = np.bincount(fold, (residual * linear).sum(axis=1))
    # of a fold the share may come out below nothing, by chance; that of all would leave no residual
    share = np.clip(common / np.maximum(whole, 1e-12), -0.5, 0.9)
    return np.asarray(residual * (1.0 - np.sqrt(1.0 - share))[fold, None])


def take_off(frame: Frame, sensor: Floats, other: Floats) -> Floats:
    """Residual with errors taken off, heading and airspeed exactly.

    Parameters
    ----------
    sensor, other : (n, 2) float
        First-order wind errors of heading and airspeed, and of everything else, m s-1.

    Returns
    -------
    (n, 2) float
        m s-1.

    Notes
    -----
    The first-order error -V n d - h s of a heading error d and airspeed error s gives d and s; the
    true air vector is (V - s) h(psi - d).
    """
    cross, along = unit_vectors(frame.heading)
    turn = -(sensor * cross).sum(-1) / np.maximum(frame.airspeed, 1.0)
    stretch = -(sensor * along).sum(-1)
    _, true = unit_vectors(frame.heading - turn)
    wind = frame.airspeed[:, None] * along - (frame.airspeed - stretch)[:, None] * true
    return np.asarray(frame.residual + wind - other)


def is_sensor(term: Term, effects: Mapping[str, Effect]) -> bool:
    """Whether a term is an error of heading or airspeed."""
    if term.candidate.known:
        return str(getattr(effects[term.candidate.name], "stage", "sensor")) == "sensor"
    return not term.candidate.name.startswith("wind:")


def held_out_errors(
    problem: Problem,
    terms: Sequence[Term],
    fold: Integers,
    *,
    factors: Mapping[str, float] | None = None,
) -> list[Floats]:
    """Wind error of each term at every report, fitted without the report's fold.

    Parameters
    ----------
    fold : (D,) int
        Fold of every day.
    factors : mapping, optional
        Effect name -> share of its coefficient that is fitted.

    Returns
    -------
    list over terms of (n, 2) float
        m s-1.
    """
    frame, base = problem.archive, problem.base
    if not terms:
        return []
    brief = [_in_few(term, fold) for term in terms]
    folds = {False: fold, True: np.arange(fold.size) % PARTS}
    by_fold = {
        kind: [
            whole_coefficients(c, terms, factors)
            for c in fold_coefficients(base, terms, folds[kind])
        ]
        for kind in set(brief)
    }
    errors = []
    for k, term in enumerate(terms):
        of_report = folds[brief[k]][problem.day]
        fields = term_fields(frame, term, effects=problem.effects, plan=problem.plan)
        errors.append(
            term_error(
                fields,
                term,
                [c[k] for c in by_fold[brief[k]]],
                aircraft=frame.aircraft,
                day=problem.day,
                fold=of_report,
                calendar=problem.calendar,
            )
        )
        if term.candidate.name == "reference_time_offset":
            errors[-1] = retimed(frame.residual, errors[-1], of_report)
    return errors


def _in_few(term: Term, fold: Integers) -> bool:
    """Whether a term acts in a part of the archive that is in too few folds to leave one out."""
    return term.period is not None and np.unique(fold[slice(*term.period)]).size < FEW_FOLDS


def close(
    problem: Problem,
    terms: Sequence[Term],
    *,
    factors: Mapping[str, float] | None = None,
) -> Closure:
    """Held-out closure of the terms, in sequence and alone.

    Parameters
    ----------
    factors : mapping, optional
        Effect name -> share of its coefficient that is fitted
        (:mod:`airswing.gap.held_out.attenuation`): what is taken off is the effect in full.
    """
    frame, base, day, seed = problem.archive, problem.base, problem.day, problem.seed
    effects = problem.effects
    before = np.hypot(*frame.residual.T)
    if not terms:
        mean = float(before.mean()) / KNOT
        ci = day_interval(before / KNOT, day, seed)
        return Closure(mean, mean, (0.0, 0.0), ci, (), (), frame.residual)
    fold = folds_of_days(base.stats)
    errors = held_out_errors(problem, terms, fold, factors=factors)
    sensor = [is_sensor(t, effects) for t in terms]
    left, steps, alone = before, [], []
    residual = frame.residual
    for k, term in enumerate(terms):
        residual = _without(frame, errors[: k + 1], sensor[: k + 1])
        now = np.hypot(*residual.T)
        low, high = day_interval((left - now) / KNOT, day, seed)
        steps.append((term.candidate.name, float(now.mean()) / KNOT, low, high))
        left = now
        alone.append(
            float(np.hypot(*_without(frame, errors[k : k + 1], sensor[k : k + 1]).T).mean())
        )
    low, high = day_interval((before - left) / KNOT, day, seed)
    first, last = float(before.mean()) / KNOT, float(left.mean()) / KNOT
    return Closure(
        first,
        last,
        (low, high),
        (first - high, first - low),
        tuple(steps),
        tuple(a / KNOT for a in alone),
        residual,
    )


def _without(frame: Frame, errors: Sequence[Floats], sensor: Sequence[bool]) -> Floats:
    zero = np.zeros((frame.size, 2))
    own = sum((e for e, s in zip(errors, sensor, strict=True) if s), zero)
    other = sum((e for e, s in zip(errors, sensor, strict=True) if not s), zero)
    return take_off(frame, np.asarray(own), np.asarray(other))
