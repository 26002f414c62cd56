"""From the found terms to what a person and a program read: names, parameters, errors, rivals.

Assumptions: parameters are those of the catalogue (`to_parameters`), from coefficients fitted on
the whole archive given all other terms, with covariance times the cluster factor plus the
allowance for
persistent model error. Effects of the path's wind change are divided by the reliability of the
reference's gradients, which their noise makes too small.

Validity: probabilities are those of the tempered evidence, calibrated on null archives.

Source: docs/gap.md section 6; docs/formats.md (gap.json).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import variables
from airswing.gap.design.candidates import Candidate
from airswing.gap.effects import separated_by
from airswing.gap.effects.base import Effect, Errors, Told
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.term_covariance import term_covariances
from airswing.gap.evidence.terms import Term
from airswing.gap.result.schema import CurveEntry, EffectEntry, PlaceEntry, RivalEntry, TailEntry
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Base, Conditional
from airswing.units import DAY

Floats = NDArray[np.float64]


def pooled(values: Floats, formal: Floats, allowed: Floats) -> tuple[Floats, Floats]:
    """Coefficients of several aircraft drawn towards their mean as far as they agree.

    Aircraft struck by one effect often have it alike (one installation, one table). Their estimates
    scatter by their own errors and by what they truly differ in; the first part is taken off.

    Parameters
    ----------
    values : (t, k) float
    formal, allowed : (t, k, k) float
        Their covariances: of each fit, and of model error that persists and may be the same in all.

    Returns
    -------
    values, spreads : (t, k), (t, k, k) float
        As given for one aircraft, and where they differ by much more than their errors.

    Notes
    -----
    Random effects with a spread between aircraft proportional to the errors: the share drawn to the
    mean is 1 over chi-squared per degree of freedom, at most 1 (DerSimonian & Laird 1986).
    """
    count, k = values.shape
    spreads = formal + allowed
    if count < 2:
        return values, spreads
    weights = np.linalg.inv(spreads)
    turn = np.linalg.inv(weights.sum(axis=0)) @ weights
    mean = np.einsum("tij,tj->i", turn, values)
    own = np.einsum("tij,tjk,tlk->il", turn, formal, turn)
    apart = values - mean
    squared = float(np.einsum("ti,tij,tj->", apart, weights, apart)) / ((count - 1) * k)
    # the part of what the aircraft differ by that their errors explain is drawn to the mean
    share = min(1.0, 1.0 / max(squared, 1e-12))
    common = own + allowed.mean(axis=0)
    return mean + (1 - share) * apart, share * common + (1 - share) * spreads


@dataclass(frozen=True)
class Readout:
    """How coefficients become parameters."""

    effects: Mapping[str, Effect]  # name -> effect
    frame: Frame  # for constants of the archive
    # factors, doubts: effect name -> factor its coefficient is divided by; relative standard error
    # of that
    factors: Mapping[str, float]
    doubts: Mapping[str, float]


def describe_term(
    term: Term, start: int, found: Found, base: Base, *, readout: Readout
) -> EffectEntry:
    """One entry of ``effects`` in gap.json, without shares.

    Parameters
    ----------
    start : int
        Position of its coefficients.
    """
    stats, given, name = base.stats, found.given, term.candidate.name
    effect, k = readout.effects[name], term.candidate.columns.size
    rows = 1 if term.candidate.scope == "fleet" else len(term.tails)
    factor = readout.factors.get(name, 1.0)
    into = into_parameters(term.candidate, effect)
    values = given.coefficients[start : start + rows * k].reshape(rows, k)
    spreads = [term_covariances(stats, given, term, start, row) for row in range(rows)]
    each = []
    for near, error in zip(
        *pooled(values, *map(np.stack, zip(*spreads, strict=True))), strict=True
    ):
        value, spread = into @ near / factor, into @ error @ into.T / factor**2
        spread += readout.doubts.get(name, 0.0) ** 2 * np.outer(value, value)
        each.append(effect.to_parameters(value, spread, readout.frame))
    tails = [stats.tails[a] for a in term.tails]
    per_tail = {t: TailEntry(p, e) for t, (p, e) in zip(tails, each, strict=False)}
    return EffectEntry(
        name=name,
        probability=probability(term.score),
        tails=tails,
        parameters=summary([p for p, _ in each]),
        standard_errors=_typical([e for _, e in each]),
        period=period_of(term, stats),
        scope=term.candidate.scope,
        evidence_nats=round(term.score.tempered, 2),
        cluster_factor=round(term.score.factor, 2),
        size_m_s=float(np.median(term.score.size[list(term.tails)])),
        per_tail=per_tail if rows > 1 else None,
    )


def into_parameters(candidate: Candidate, effect: Effect) -> Floats:
    """Matrix (m, k) from the coefficients of a candidate to all m of its effect's columns.

    The coefficient of a drift that sets in on a date is a rate of its steady column, by the day.
    """
    into = np.zeros((len(np.asarray(effect.column_scales)), candidate.columns.size))
    if candidate.kind == "onset":
        into[effect.column_names.index("rate"), 0] = 1.0 / DAY
    else:
        into[list(candidate.subset), range(candidate.columns.size)] = 1.0
    return into


def summary(values: Sequence[Told]) -> Told:
    """Median over aircraft of each parameter (the first where it is not a number).

    A phase is averaged as the angle it is.
    """
    if len(values) == 1:
        return dict(values[0])
    out: Told = {}
    for name in values[0]:
        column = [v[name] for v in values]
        numbers = [x for x in column if isinstance(x, int | float)]
        if len(numbers) < len(column):
            out[name] = column[0]
        elif name.startswith("phase"):
            turn = np.exp(1j * np.radians(numbers)).mean()
            out[name] = float(np.degrees(np.angle(turn)))
        else:
            out[name] = float(np.median(numbers))
    return out


def _typical(errors: Sequence[Errors]) -> Errors:
    """Median over aircraft of each standard error, a phase's too."""
    if len(errors) == 1:
        return dict(errors[0])
    return {name: float(np.median([one[name] for one in errors])) for name in errors[0]}


def probability(score: Score) -> float:
    """Probability that a term is real.

    Where it was held against days left out, what those say; else prior odds of one in ten against
    its tempered evidence.
    """
    if score.probability is not None:
        return score.probability
    return float(1 / (1 + np.exp(np.clip(np.log(10.0) - score.tempered, -50, 50))))


def period_of(term: Term, stats: Statistics) -> list[str | None] | None:
    """Dates of a term in force for a part of the archive; null at the archive's ends."""
    if term.period is None:
        return None

    first, last = term.period
    return [
        day_text(stats, first) if first > 0 else None,
        day_text(stats, last) if last < stats.days.size else None,
    ]


def day_text(stats: Statistics, day: int) -> str:
    """Date of a day index, ISO 8601."""
    seconds = float(stats.clock.begins(stats.days[day]))
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def ambiguity(term: Term, ranked: Sequence[Score], left: Sequence[Score] = ()) -> list[RivalEntry]:
    """Rivals within three cluster factors of a term, with what would separate them.

    A rival explains what the term explains: only the evidence it loses to the term counts, not what
    it has beside it.

    Parameters
    ----------
    ranked, left : sequence of Score
        All candidates with this term taken out, and with all terms in.

    Returns
    -------
    list of RivalEntry
        Best first, each name once.
    """
    own_name = term.candidate.name
    own = [s for s in ranked if s.candidate.name == own_name]
    best = max((s.raw for s in own), default=term.score.raw)
    beside = {s.candidate.key: max(s.raw, 0.0) for s in left}
    behind: dict[str, float] = {}
    for score in ranked:
        name = score.candidate.name
        lost = score.raw - beside.get(score.candidate.key, 0.0)
        if name == own_name or not score.candidate.known or lost <= 0:
            continue
        if best - lost > 3.0 * max(score.factor, term.score.factor):
            continue
        behind[name] = min(best - lost, behind.get(name, np.inf))
    names = sorted(behind, key=behind.__getitem__)
    return [
        RivalEntry(name, behind[name], separated_by(name, own_name, otherwise="a longer record"))
        for name in names
    ]


def unknown_place(
    term: Term,
    given: Conditional,
    start: int,
    stats: Statistics,
    labels: Sequence[str],
    ranked: Sequence[Score] = (),
) -> PlaceEntry:
    """Where an unknown effect sits: component, variables, aircraft and fitted curve.

    Parameters
    ----------
    term : Term
        A dictionary group.
    start : int
        Position of its coefficients.
    labels : sequence of str
        One per column.
    ranked : sequence of Score
        All candidates with this term taken out: groups within three cluster factors are named too.
    """
    k = term.candidate.columns.size
    rows = 1 if term.candidate.scope == "fleet" else len(term.tails)
    curve = given.coefficients[start : start + rows * k].reshape(rows, k).mean(axis=0)
    told = variables(term.candidate.name)
    groups = [s for s in ranked if not s.candidate.known and s.novelty > 0]
    best = max((s.tempered for s in groups), default=0.0)
    near = [
        s.candidate.name
        for s in sorted(groups, key=lambda s: -s.tempered)
        if s.tempered > best - 3.0 * term.score.factor
    ]
    return PlaceEntry(
        component=term.candidate.component,
        variable=told[0],
        variables=told,
        group=term.candidate.name,
        tails=[stats.tails[a] for a in term.tails],
        scope=term.candidate.scope,
        evidence_nats=round(term.score.tempered, 2),
        size_m_s=float(np.median(term.score.size[list(term.tails)])),
        curve=CurveEntry(list(labels), [float(x) for x in curve]),
        equally_good=[n for n in dict.fromkeys(near) if n != term.candidate.name],
    )
