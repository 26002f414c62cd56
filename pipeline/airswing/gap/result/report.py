"""Puts the pieces of a diagnosis together as gap.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import UNITS
from airswing.gap.distribution.coded_values import reduction_of_coding
from airswing.gap.distribution.gross_errors import reduction_of_gross
from airswing.gap.distribution.scatter import Scatter, reduction_of_scatter
from airswing.gap.distribution.sent_winds import SentWinds
from airswing.gap.distribution.verdict import Reduction, Verdict
from airswing.gap.effects.base import Effect
from airswing.gap.model.closure import Closure, Step, is_held_out
from airswing.gap.model.passes import Fitted
from airswing.gap.noise.model import gross_errors
from airswing.gap.result.schema import (
    ClosesEntry,
    ClosureEntry,
    CountsEntry,
    CurveEntry,
    DisagreementEntry,
    EffectClosureEntry,
    EffectEntry,
    EvidenceEntry,
    GapReport,
    NoiseEntry,
    PlaceEntry,
    SliceEntry,
    StepEntry,
    StepsEntry,
    TailEntry,
    UnknownClosureEntry,
    UnknownEntry,
)
from airswing.gap.result.statement import (
    Claim,
    claims_of,
    effect_entry,
    place_entry,
    probability,
)
from airswing.units import KNOT

Floats = NDArray[np.float64]

#: Log evidence of independent reports below which an error outside the catalogue may stay
#: unstated, and the size that every fleet has, m/s: see `could_hide`.
STATED_FROM, EVERY_FLEET = 2000.0, 0.2
#: Log evidence from which an effect that shows in no mean is stated: odds of a thousand.
STATED = 7.0


@dataclass(frozen=True)
class Findings:
    """Pieces of a diagnosis."""

    fitted: Fitted
    effects: Mapping[str, Effect]
    claims: Sequence[Claim]
    closure: Closure
    distribution: Sequence[Verdict]
    scatter: Scatter | None
    sent: SentWinds | None
    where: Sequence[SliceEntry]
    untestable: Mapping[str, str]
    seed: int


def could_hide(disagreement: float, reports: int) -> float:
    """Reduction (kt) by an error outside the catalogue that would not be stated.

    An error of rms s on a share f of n reports has log evidence E = n f s^2 / (2 sigma^2) and
    closes m f s^2 / (4 sigma^2) = m E / (2 n) of a mean disagreement m, with m = sigma sqrt(pi / 2)
    for two normal components.
    """
    if disagreement <= 0.0 or reports <= 0:
        return 0.0
    unseen = 0.5 * disagreement * STATED_FROM / reports
    small = np.pi / 8.0 * (EVERY_FLEET / KNOT) ** 2 / disagreement
    return float(min(unseen + small, disagreement))


def assemble(findings: Findings) -> GapReport:
    """Content of gap.json, but for the checks."""
    fitted, closure = findings.fitted, findings.closure
    frame, sums = fitted.frame, fitted.model.sums
    total = closure.whole.reduction
    effects: list[EffectEntry] = []
    places: list[PlaceEntry] = []
    steps: list[tuple[str, Step]] = []
    for claim, step in zip(findings.claims, closure.steps, strict=True):
        if claim.named:
            share = float(np.clip(step.reduction / total, 0, 1)) if total > 1e-6 else 0.0
            entry = effect_entry(fitted, claim, findings.effects, step, share)
            effects.append(entry)
            steps.append((entry.name, step))
        else:
            place = place_entry(fitted, claim, step)
            places.append(place)
            steps.append((f"unknown: {' x '.join(place.variables)}", step))
    if fitted.exchange is not None:
        effects.append(_exchange_entry(fitted))
        steps.append(("tail_swap", Step(0.0, (0.0, 0.0))))
    gross = gross_errors(closure.residual, fitted.noise.order)
    for verdict in findings.distribution:
        reduction = (
            reduction_of_gross(frame, closure.residual, verdict, gross)
            if verdict.name == "outliers"
            else reduction_of_coding(frame, closure.residual, verdict, gross)
        )
        effects.append(_verdict_entry(verdict, reduction, total))
        steps.append((verdict.name, Step(reduction.kt, reduction.interval)))
    for place, reduction in _unseen_in_means(findings, gross):
        places.append(place)
        steps.append((f"unknown: {place.variable}", Step(reduction.kt, reduction.interval)))
    effects.sort(key=lambda entry: -entry.held_out_energy)
    whole = _sum([step for _, step in steps], closure)
    unnamed = [step for name, step in steps if name.startswith("unknown: ")]
    named = whole.reduction - sum(step.reduction for step in unnamed)
    before, hidden = closure.before, could_hide(closure.before, frame.size)
    silent = not effects and not places
    low, high = whole.interval
    if silent:
        # where nothing is stated the interval holds what could hide
        low, high = low - 0.25 * hidden, high + hidden
    excess = whole.reduction / max(whole.reduction, 1e-9) if whole.reduction > 1e-6 else None
    energy = sum(max(e.held_out_energy, 0.0) for e in effects) or 1.0
    best = max((claim.gate for claim in findings.claims), default=0.0)
    flights = np.unique(frame.flight).size
    return GapReport(
        gap=DisagreementEntry(before, before - whole.reduction, float(np.exp(-max(best, 0.0)))),
        where=[row for row in findings.where if row.q_value < 0.05][:20],
        effects=[replace(e, share_of_energy=max(e.held_out_energy, 0.0) / energy) for e in effects],
        unknown=UnknownEntry(bool(places), places, _unknown_closure(before - named, unnamed)),
        closure=ClosureEntry(
            before=before,
            after=before - whole.reduction,
            ci=[before - high, before - low],
            fraction_of_excess=excess,
            held_out=is_held_out(fitted.model.sums.span),
            reduction=whole.reduction,
            reduction_ci=[low, high],
            could_hide_kt=hidden,
            by_effect=[
                EffectClosureEntry(name, step.reduction, list(step.interval))
                for name, step in steps
            ],
        ),
        counts=CountsEntry(
            reports=frame.size,
            flights=int(flights),
            reports_in_view=frame.size,
            days=int(sums.D),
            clipped=0.0,
            gross=float(fitted.noise.gross.sum()),
            aircraft=len(frame.tails),
        ),
        noise=noise_entry(fitted),
        waterfall=_waterfall(before, steps),
        evidence=evidence_entries(fitted),
        untestable=dict(findings.untestable),
        slices=list(findings.where),
        seed=findings.seed,
        ambiguity={entry.name: entry.ambiguity for entry in effects},
    )


def _unseen_in_means(
    findings: Findings, gross: NDArray[np.bool_]
) -> list[tuple[PlaceEntry, Reduction]]:
    """Places of scatter and of winds sent otherwise."""
    tails = findings.fitted.frame.tails
    out = []
    if findings.sent is not None:
        found = findings.sent
        curve = CurveEntry(
            [f"{10 * k}" for k in range(36)], [100.0 * x for x in found.directions], unit="percent"
        )
        component, size = "reported_direction", 0.0
        if found.speeds is not None and found.sent is not None:
            component = "reported_speed"
            size = float(np.sqrt(np.mean((found.sent - found.speeds) ** 2)))
            curve = CurveEntry(
                [f"{speed:.3g}" for speed in found.speeds],
                _floats(found.sent),
                unit="m/s",
                variables=["wind_speed"],
                variable_units=["m/s"],
                edges=[_floats(found.speeds)],
                values=_floats(found.sent),
            )
        place = _place(component, found.variable, found.tails, tails, found.evidence, size, curve)
        if found.lattice is not None:
            grid = found.lattice
            steps = StepsEntry(grid.step, grid.below / KNOT, grid.share)
            place = replace(place, steps=steps)
        place = replace(place, settled_by="the unit's winds before coding and those it sends")
        out.append((_closing(place, found.reduction), found.reduction))
    if findings.scatter is not None:
        one = findings.scatter
        values = _floats(one.values)
        labels = [tails[a] for a in one.tails]
        curve = CurveEntry(labels, values)
        if one.variable != "scatter":
            edges = _floats(one.edges)
            labels = [f"{a:.4g} to {b:.4g}" for a, b in pairwise(edges)]
            curve = CurveEntry(
                labels,
                values,
                unit="m/s",
                variables=[one.variable],
                variable_units=[UNITS[one.variable]],
                edges=[edges],
                values=values,
            )
        size = float(np.median([value for value in values if value > 0]))
        place = _place("scatter", one.variable, one.tails, tails, one.evidence, size, curve)
        reduction = reduction_of_scatter(findings.closure.residual, one, gross)
        out.append((_closing(place, reduction), reduction))
    return out


def _place(
    component: str,
    variable: str,
    affected: Sequence[int],
    tails: Sequence[str],
    evidence: float,
    size: float,
    curve: CurveEntry,
) -> PlaceEntry:
    # three quarters of the fleet are taken for all of it: a cell may be met by few
    whole = len(affected) >= 0.75 * len(tails)
    return PlaceEntry(
        component=component,
        variable=variable,
        variables=[variable],
        group=f"{variable}|{component}",
        tails=[] if whole else [tails[a] for a in affected],
        scope="fleet" if whole else "aircraft",
        evidence_nats=round(evidence, 2),
        size_m_s=size,
        curve=curve,
        probability=probability(evidence),
    )


def _closing(place: PlaceEntry, reduction: Reduction) -> PlaceEntry:
    return replace(place, closure=ClosesEntry(reduction.kt, list(reduction.interval)))


def _sum(steps: Sequence[Step], closure: Closure) -> Step:
    """All steps together: what moves means by its own interval, the others independent of it."""
    value = closure.whole.reduction
    low, high = closure.whole.interval
    below, above = value - low, high - value
    for step in steps[len(closure.steps) :]:
        below = float(np.hypot(below, step.reduction - step.interval[0]))
        above = float(np.hypot(above, step.interval[1] - step.reduction))
        value += step.reduction
    return Step(value, (value - below, value + above))


def _unknown_closure(before: float, steps: Sequence[Step]) -> UnknownClosureEntry | None:
    if not steps:
        return None
    value = sum(step.reduction for step in steps)
    half = float(np.sqrt(sum((step.interval[1] - step.reduction) ** 2 for step in steps)))
    return UnknownClosureEntry(before, before - value, value, [value - half, value + half])


def _exchange_entry(fitted: Fitted) -> EffectEntry:
    found = fitted.exchange
    assert found is not None
    sums = fitted.model.sums
    pair = [fitted.frame.tails[a] for a in found.pair]
    start = np.datetime64(int(sums.days[found.day]), "D")
    return EffectEntry(
        name="tail_swap",
        probability=probability(found.evidence),
        tails=pair,
        parameters={"pair": pair},
        standard_errors={},
        period=[str(start), None],
        scope="pair",
        evidence_nats=found.evidence,
        held_out_energy=2.0 * found.evidence,
    )


def _verdict_entry(verdict: Verdict, reduction: Reduction, total: float) -> EffectEntry:
    return EffectEntry(
        name=verdict.name,
        probability=probability(verdict.evidence),
        tails=list(verdict.tails),
        parameters=dict(verdict.parameters),
        standard_errors=dict(verdict.standard_errors),
        period=verdict.period,
        scope="aircraft",
        evidence_nats=verdict.evidence,
        per_tail={tail: TailEntry(values) for tail, values in verdict.per_tail.items()},
        share_of_gap=float(np.clip(reduction.kt / total, 0, 1)) if total > 1e-6 else 0.0,
        closure=ClosesEntry(reduction.kt, list(reduction.interval)),
    )


def _waterfall(before: float, steps: Sequence[tuple[str, Step]]) -> list[StepEntry]:
    out, now = [StepEntry("reports as they are", before, None)], before
    for name, step in steps:
        now -= step.reduction
        out.append(StepEntry(name, now, list(step.interval)))
    return [*out, StepEntry("noise floor", now, None)]


def evidence_entries(fitted: Fitted) -> list[EvidenceEntry]:
    """Each term and the rivals of its contest."""
    out = []
    for term in fitted.terms:
        rows = [(0.0, term.group.name, term.scope), *term.rivals]
        for apart, name, scope in rows:
            out.append(
                EvidenceEntry(
                    instead_of=term.group.name,
                    name=name,
                    scope={"a": "aircraft", "f": "fleet"}[scope],
                    known="|" not in name,
                    subset=list(term.group.form) if name == term.group.name else [],
                    tempered_nats=float(term.score - apart),
                    raw_nats=float(term.score - apart),
                    cluster_factor=float(fitted.model.kappa),
                    posterior=[]
                    if term.inclusion is None or name != term.group.name
                    else [float(x) for x in term.inclusion],
                )
            )
    return out


def noise_entry(fitted: Fitted) -> NoiseEntry:
    """Noise model, and what weather and climatology vary by."""
    noise, model = fitted.noise, fitted.noise.model
    theta = fitted.exact.theta[: fitted.model.base.group.size]
    return NoiseEntry(
        correlated_sd_m_s=float(model.correlated_sd),
        white_sd_m_s=float(model.white_sd),
        length_km=float(model.length) / 1e3,
        height_ln_p=float(model.height),
        level_hPa=_floats(np.exp(model.level_nodes) / 100),
        level_factor=_floats(model.level_factors),
        day_field_sd_m_s=_floats(np.sqrt(fitted.model.sums.field_variance)),
        climatology_sd_m_s=_floats(np.abs(theta)),
        distance_km=_floats(noise.distance_km),
        autocovariance=_floats(noise.autocovariance),
        autocovariance_model=_floats(noise.autocovariance_model),
        along_heading=float(model.along),
        across_heading=float(model.across),
    )


def _floats(values: Floats) -> list[float]:
    return [float(value) for value in values]


__all__ = ["Findings", "assemble", "claims_of", "could_hide", "evidence_entries"]
