"""From a fitted model to gap.json: names, unknowns, probabilities, closure.

Claims and their probabilities are those of docs/gap.md, section 8; tables of one variable and
component are one claim as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from airswing.gap.archive.reported_variables import CATEGORIES, KINDS, UNITS
from airswing.gap.arrays import Floats
from airswing.gap.effects import CATALOGUE, separated_by
from airswing.gap.effects.base import Effect, Stated, WindEffect
from airswing.gap.effects.empirical import UNIT_OF
from airswing.gap.model.candidates import Table
from airswing.gap.model.passes import Fitted
from airswing.gap.model.terms import FIRST_ORDER, Term
from airswing.gap.result.schema import (
    ClosesEntry,
    CurveEntry,
    EffectEntry,
    PlaceEntry,
    RivalEntry,
    TailEntry,
)
from airswing.units import DAY

#: Intercept and slope of the log odds that a claim is right, in the logarithm of its evidence.
#: `python -m benchmarks.gap_paired calibrate` on the check of seed 730418 (150 archives) printed
#: "CALIBRATION = (-0.24, 0.73) from 106 claims, 98 right, mean stated 0.873".
CALIBRATION = (-0.24, 0.73)
LARGEST = 30.0  # log odds
#: Share of the largest coefficients of a claim from which an aircraft has it.
SMALL_SHARE = 0.25
#: Cells of a table of one variable and of two, by kind.
CELLS = {"circular": (36, 12), "linear": (20, 8), "category": (3, 3)}
#: Log evidence of a rival behind the best within which 95 % of the posterior mass lies, times
#: the noise factor.
CREDIBLE = 3.0


@dataclass(frozen=True)
class Claim:
    """Terms that are one statement: a name of the catalogue, or tables of one variable."""

    name: str
    terms: tuple[int, ...]
    named: bool
    score: float
    gate: float
    weight: float = 1.0  # posterior probability among the candidates of the contest


def claims_of(terms: Sequence[Term]) -> list[Claim]:
    """Claims of the terms, names first, the largest evidence first."""
    merged: dict[tuple[object, ...], list[int]] = {}
    for k, term in enumerate(terms):
        group = term.group
        form = group.form if group.named else group.columns.start
        key = (group.name, form, tuple(sorted(term.period.items())))
        merged.setdefault(key, []).append(k)
    out = [
        Claim(
            terms[members[0]].group.name,
            tuple(members),
            terms[members[0]].group.named,
            max(terms[k].score for k in members),
            max(terms[k].gate for k in members),
            max(terms[k].weight for k in members),
        )
        for members in merged.values()
    ]
    return sorted(out, key=lambda claim: (not claim.named, -claim.score))


def probability(gate: float) -> float:
    """Probability that a claim is right, from its log posterior odds."""
    odds = CALIBRATION[0] + CALIBRATION[1] * np.log1p(max(gate, 0.0))
    return float(1 / (1 + np.exp(-np.clip(odds, -LARGEST, LARGEST))))


def coefficients(fitted: Fitted, claim: Claim) -> tuple[list[int], Floats, Floats]:
    """Aircraft of a claim, their raw coefficients (t, k), and the covariances (t, k, k)."""
    model, terms = fitted.model, fitted.model.terms
    covariance = fitted.exact.covariance
    tails = sorted({a for k in claim.terms for a in terms[k].tails})
    k_raw = terms[claim.terms[0]].group.transform.shape[0]
    maps = np.zeros((len(tails), k_raw, covariance.shape[0]))
    for k in claim.terms:
        term, start = terms[k], int(model.offsets[k + 1])
        m = term.group.size
        for row, a in enumerate(tails):
            if a in term.tails:
                at = start + (0 if term.scope == "f" else m * term.tails.index(a))
                maps[row, :, at : at + m] += term.group.transform
    values = maps @ fitted.exact.theta
    if len({terms[k].scope for k in claim.terms}) > 1:
        # a common part that is small compared with that of some aircraft is no effect of the rest
        size = np.linalg.norm(values, axis=1)
        retained = np.flatnonzero(size > SMALL_SHARE * size.max())
        tails, values, maps = [tails[row] for row in retained], values[retained], maps[retained]
    errors = np.einsum("tki,ij,tlj->tkl", maps, covariance, maps, optimize=True)
    for k in claim.terms:
        if terms[k].scope == "f":
            # the lasting error of the reference is in the coefficients of the whole fleet
            root = terms[k].group.transform
            errors = errors + model.lasting(terms[k].group) * (root @ root.T)
    return tails, values, errors


def by_member(
    entries: Sequence[EffectEntry], pool: str, members: Mapping[str, Sequence[EffectEntry]]
) -> list[EffectEntry]:
    """Attribute the effects of a reference to the members of a pool that have them.

    ``entries`` were found against the pool, those of ``members`` against each reference alone.
    """
    out = []
    for entry in entries:
        same = {
            reference: TailEntry(effect.parameters, effect.standard_errors)
            for reference, effects in members.items()
            for effect in effects
            if effect.name == entry.name
        }
        if entry.scope == "reference" and same:
            pooled = {pool: TailEntry(entry.parameters, entry.standard_errors)}
            entry = replace(entry, by_reference=pooled | same)
            if len(same) == 1:
                ((reference, of_one),) = same.items()
                errors = of_one.standard_errors or {}
                entry = replace(
                    entry, reference=reference, parameters=of_one.parameters, standard_errors=errors
                )
        out.append(entry)
    return out


def effect_entry(
    fitted: Fitted, claim: Claim, effects: Mapping[str, Effect], step: ClosesEntry
) -> EffectEntry:
    """Entry of a named effect."""
    terms = [fitted.model.terms[k] for k in claim.terms]
    first = terms[0]
    name = first.group.name
    effect = effects[name]
    tails, values, errors = coefficients(fitted, claim)
    fleet = all(term.scope == "f" for term in terms)
    # noise in inferred gradients of the wind shrinks coefficients by the reliability of columns,
    # unless their instruments are free of it
    share = first.group.reliability
    if isinstance(effect, WindEffect) and not fitted.exact.instrumented[claim.terms[0]]:
        values, errors = values / share, errors / share**2
    doubt = np.hypot(0.5 * (1 - share), FIRST_ORDER)
    errors = errors + doubt**2 * np.einsum("ti,tj->tij", values, values)
    scales = np.asarray(effect.column_scales, float)
    frame, sums = fitted.frame, fitted.model.sums
    stated = []
    for a, value, error in zip(tails, values, errors, strict=True):
        counted, coefficient, spread = frame, value * scales, error * np.outer(scales, scales)
        if first.period:
            start = float(sums.days[first.period[a][0]]) * DAY + sums.ends
            counted = replace(frame, epoch=start)
            if effect.kind == "drift":
                # fitted from the archive's first report on, stated from the date on
                turn = np.eye(scales.size)
                turn[1, 0] = start - frame.epoch
                coefficient, spread = turn @ coefficient, turn @ spread @ turn.T
        stated.append(effect.to_parameters(coefficient, spread, counted))
        if fleet:
            break
    names = [frame.tails[a] for a in tails]
    per_tail = {
        frame.tails[a]: TailEntry(p, e, _period(fitted, claim, a))
        for a, (p, e) in zip(tails, stated, strict=False)
    }
    rivals = _rivals(terms, fitted.model.kappa)
    return EffectEntry(
        name=name,
        probability=claim.weight * probability(claim.gate),
        tails=names,
        parameters=summary([p for p, _ in stated]),
        standard_errors={n: float(np.median([e[n] for _, e in stated])) for n in stated[0][1]},
        period=_period(fitted, claim),
        scope="reference" if effect.scope == "reference" else "fleet" if fleet else "aircraft",
        evidence_nats=round(claim.score, 2),
        cluster_factor=round(float(fitted.model.kappa), 2),
        size_m_s=_size(fitted, claim),
        per_tail=None if fleet or len(stated) < 2 else per_tail,
        ambiguous_with=[rival.name for rival in rivals],
        ambiguity=rivals,
        closure=step,
    )


def _size(fitted: Fitted, claim: Claim) -> float:
    """Median over aircraft of the rms of a claim's terms where they act, m/s."""
    model, sizes = fitted.model, list[float]()
    for k in claim.terms:
        theta = fitted.exact.theta[model.offsets[k + 1] : model.offsets[k + 2]]
        # the transform makes an effect of 1 m/s rms of a coefficient vector of length root m
        sizes += np.sqrt((theta.reshape(-1, model.terms[k].group.size) ** 2).mean(axis=1)).tolist()
    return float(np.median(sizes))


def _rivals(terms: Sequence[Term], kappa: float) -> list[RivalEntry]:
    """Names within the credible set of a claim's contests."""
    name = terms[0].group.name
    behind: dict[str, float] = {}
    for term in terms:
        for margin, rival, _ in term.rivals:
            if rival in CATALOGUE and rival != name and margin < CREDIBLE * kappa:
                behind[rival] = min(margin, behind.get(rival, np.inf))
    return [
        RivalEntry(rival, behind[rival], separated_by(rival, name, otherwise="a longer record"))
        for rival in sorted(behind, key=behind.__getitem__)
    ]


def _period(fitted: Fitted, claim: Claim, aircraft: int | None = None) -> list[str | None] | None:
    """First and last day in force, on one of a claim's aircraft or on any; None until the end."""
    sums, term = fitted.model.sums, fitted.model.terms[claim.terms[0]]
    if not term.period:
        return None
    periods = [*term.period.values()] if aircraft is None else [term.period[aircraft]]

    def stated(day: int) -> str:
        # of the two calendar days that a day of the archive lies in, that which holds most of it
        middle = float(sums.days[day]) * DAY + sums.ends + DAY / 2
        return datetime.fromtimestamp(middle, UTC).strftime("%Y-%m-%d")

    last = max(stop for _, stop in periods)
    return [stated(min(start for start, _ in periods)), stated(last - 1) if last < sums.D else None]


def summary(values: Sequence[Stated]) -> Stated:
    """Median over aircraft of each number, of a phase as the angle it is; else the mode."""
    if len(values) == 1:
        return dict(values[0])
    out: Stated = {}
    for name in values[0]:
        column = [v[name] for v in values]
        numbers = [x for x in column if isinstance(x, int | float) and not isinstance(x, bool)]
        if len(numbers) < len(column):
            out[name] = max(column, key=column.count)
        elif name.startswith("phase"):
            turn = np.exp(1j * np.radians(numbers)).mean()
            out[name] = float(np.degrees(np.angle(turn)))
        else:
            out[name] = float(np.median(numbers))
    return out


# ------------------------------------------------------------------------------------------ tables
def place_entry(fitted: Fitted, claim: Claim, step: ClosesEntry) -> PlaceEntry:
    """Entry of a table."""
    terms = [fitted.model.terms[k] for k in claim.terms]
    group = terms[0].group
    tails, values, _ = coefficients(fitted, claim)
    frame = fitted.frame
    fleet = any(term.scope == "f" for term in terms) or len(tails) == len(frame.tails)
    curve = table_curve(fitted, fitted.model.sums.candidates.table_of(group), tails, values)
    period = _period(fitted, claim)
    begins = f"from {period[0]} {f'to {period[1]}' if period[1] else 'on'}" if period else None
    words = [words for words in (shape_in_words(curve), begins) if words]
    nearest, share = _nearest(terms)
    return PlaceEntry(
        component=group.component,
        variable=group.variables[0],
        variables=list(group.variables),
        group=group.name,
        tails=[] if fleet else [frame.tails[a] for a in tails],
        scope="fleet" if fleet else "aircraft",
        evidence_nats=round(claim.score, 2),
        size_m_s=_size(fitted, claim),
        curve=curve,
        closure=step,
        probability=claim.weight * probability(claim.gate),
        nearest_effect=nearest,
        nearest_effect_share=share,
        settled_by=SETTLED.get(group.variables[0], OTHERWISE),
        title="; ".join(words) or None,
        period=period,
    )


def _nearest(terms: Sequence[Term]) -> tuple[str | None, float | None]:
    """Named effect with the largest share of the evidence in the contest."""
    best: tuple[str | None, float | None] = (None, None)
    for term in terms:
        for margin, name, _ in term.rivals:
            share = (term.score - margin) / max(term.score, 1e-9)
            if name in CATALOGUE and share > 0 and share > (best[1] or 0.0):
                best = (name, float(min(share, 1.0)))
    return best


def table_curve(fitted: Fitted, table: Table, tails: Sequence[int], values: Floats) -> CurveEntry:
    """Values of a table in cells of its variables, of all aircraft and of each."""
    variables = fitted.model.sums.candidates.variables
    names = [curve.variable for curve in table.curves]
    edges, centres = [], []
    for name in names:
        bounds = variables[name].edges(CELLS[KINDS[name][0]][len(names) - 1])
        edges.append(bounds.tolist())
        centres.append(0.5 * (bounds[1:] + bounds[:-1]))
    functions = np.ones((1, 1))
    for curve, middle in zip(table.curves, centres, strict=True):
        functions = np.asarray(np.kron(functions, curve.functions(middle)), np.float64)
    rows = values @ functions.T
    middle = rows.mean(axis=0)
    per_tail = None
    if np.abs(rows - middle).max() > 1e-9:
        per_tail = {fitted.frame.tails[a]: row.tolist() for a, row in zip(tails, rows, strict=True)}
    return curve_over(names, edges, middle, UNIT_OF[table.component], per_tail)


def curve_over(
    names: Sequence[str],
    edges: Sequence[Sequence[float]],
    values: Floats,
    unit: str,
    per_tail: Mapping[str, Sequence[float]] | None = None,
) -> CurveEntry:
    """Values in the cells between the edges of each variable, in C order."""
    labels = [""]
    for name, bounds in zip(names, edges, strict=True):
        between = [f"{a:.4g} to {b:.4g}" for a, b in pairwise(bounds)]
        cells = CATEGORIES.get(name, between)
        labels = [f"{label}; {cell}" if label else cell for label in labels for cell in cells]
    units, flat = [UNITS[name] for name in names], values.tolist()
    return CurveEntry(labels, flat, unit, names, units, edges, flat, per_tail)


#: Share of a curve's variance that a simple shape must hold to be stated.
SIMPLE = 0.9


def shape_in_words(curve: CurveEntry) -> str | None:
    """The curve as a simple shape, where one holds nearly all of its variance."""
    if curve.variables is None or curve.edges is None or len(curve.variables) != 1:
        return None
    name, unit = curve.variables[0], (curve.variable_units or [""])[0]
    values, edges = np.asarray(curve.values, float), np.asarray(curve.edges[0], float)
    if np.ptp(values) < 1e-6 * np.abs(values).max():
        return f"a constant of {values[0]:+.3g} {curve.unit}"
    if KINDS[name][0] != "linear":
        return None
    x = 0.5 * (edges[1:] + edges[:-1])
    total = float(((values - values.mean()) ** 2).sum())
    if values.size < 4 or total <= 0:
        return None
    label = name.replace("_", " ")
    slope, intercept = np.polyfit(x, values, 1)
    if 1 - ((values - slope * x - intercept) ** 2).sum() / total > SIMPLE:
        return f"linear in {label}: {slope:+.3g} {curve.unit} per {unit or 'unit'}"
    shares = []
    for k in range(1, values.size):
        fit = np.r_[np.full(k, values[:k].mean()), np.full(values.size - k, values[k:].mean())]
        shares.append(1 - ((values - fit) ** 2).sum() / total)
    at = 1 + int(np.argmax(shares))
    if max(shares) > SIMPLE:
        change = values[at:].mean() - values[:at].mean()
        return f"a step of {change:+.3g} {curve.unit} at {label} {edges[at]:.4g} {unit}".rstrip()
    away = values - np.median(values)
    peak = int(np.argmax(np.abs(away)))
    near = np.abs(np.arange(values.size) - peak) <= max(1, values.size // 6)
    if (away[near] ** 2).sum() / (away**2).sum() > SIMPLE:
        change = away[peak]
        return f"a bump of {change:+.3g} {curve.unit} near {label} {x[peak]:.4g} {unit}".rstrip()
    return None


OTHERWISE = "another unit on the same routes, or these units on other routes"
#: Measurement that would identify an unknown effect, by its variable.
SETTLED = {
    "magnetic_heading": "a compass swing of one of these aircraft on the ground and in flight",
    "track": "the unit's raw heading and track on flights in both directions",
    "wind_direction": "the raw air and ground vectors together with the computed wind",
    "wind_speed": "the raw air and ground vectors together with the computed wind",
    "temperature": "a recording of the unit's raw sensors through these temperatures",
    "icing": "flights with de-icing switched on and off in clear air on every heading",
    "ground_speed": "these legs flown in both directions next to another aircraft",
    "drift": "the unit's raw heading and track on flights in both directions",
    "airspeed": "a run at several airspeeds with a trailing cone or a second air data unit",
    "altitude": "levels flown in both directions next to another aircraft or a radiosonde",
    "hour": "the unit's clock and its data link compared with a GPS clock over a day",
    "phase": "the unit's raw sensors through a climb, a cruise and a descent",
    "acceleration": "a recording of the raw heading through speed changes on several headings",
    "turn": "a recording of the raw heading through turns and for minutes after them",
    "last_turn": "the raw heading on one course, turned into from either side",
    "flight_time": "the unit's raw sensors through an hour of level flight on one course",
    "flight": "the headings before and after each flight, at the gate",
    "bank": "a recording of the raw heading through steady turns in both directions",
}
