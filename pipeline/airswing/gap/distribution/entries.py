"""Entries of gap.json for effects that change no mean: aircraft, evidence and closure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects.base import Stated
from airswing.gap.result.schema import ClosesEntry, CurveEntry, EffectEntry, PlaceEntry, TailEntry
from airswing.gap.result.statement import probability, summary
from airswing.units import KNOT, NORMAL_95

Found = Mapping[str, tuple[Stated, float]]  # aircraft -> parameters, log likelihood ratio

#: Share of the mean square that is always left.
LEAST_LEFT = 0.05
#: Component and variable of effects that have no name where a catalogue leaves it out.
_SHOWN_BY = {
    "wind_coding": ("reported_wind", "wind_direction"),
    "position_coding": ("reported_position", "latitude"),
    "heading_coding": ("reported_heading", "magnetic_heading"),
    "time_lag": ("reported_time", "time"),
    "outliers": ("scatter", "scatter"),
}


def against_chance(count: int, share: float, chance: float) -> float:
    """Log likelihood ratio of a share of ``count`` draws against the share by chance.

    ``count`` times the Kullback-Leibler divergence of the two Bernoulli laws; 0 for a share not
    above chance.
    """
    p, q = (float(np.clip(x, 1e-9, 1 - 1e-9)) for x in (share, chance))
    return count * (p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))) if p > q else 0.0


def effect_of(
    name: str,
    found: Found,
    period: list[str | None] | None = None,
    errors: Mapping[str, float] | None = None,
) -> EffectEntry | None:
    """Combine the findings of aircraft, with their usual parameters; None without any.

    The evidence is the log likelihood ratio of the clearest aircraft against chance, less the
    logarithm of the number of aircraft and steps that are tried, about a hundred.
    """
    if not found:
        return None
    clearest = max(evidence for _, evidence in found.values()) - float(np.log(100.0))
    return EffectEntry(
        name=name,
        probability=probability(clearest),
        tails=list(found),
        parameters=summary([parameters for parameters, _ in found.values()]),
        standard_errors=errors or {},
        period=period,
        scope="aircraft",
        evidence_nats=clearest,
        per_tail={tail: TailEntry(parameters) for tail, (parameters, _) in found.items()},
    )


def place_of(
    component: str,
    variable: str,
    affected: Sequence[int],
    tails: Sequence[str],
    evidence: float,
    size: float,
    curve: CurveEntry,
    closure: ClosesEntry,
) -> PlaceEntry:
    """Entry of an effect without a name on some aircraft, with its log posterior odds.

    Three quarters of the aircraft are taken for the whole fleet: a cell may be met by few.
    """
    fleet = len(affected) >= 0.75 * len(tails)
    return PlaceEntry(
        component=component,
        variable=variable,
        variables=[variable],
        group=f"{variable}|{component}",
        tails=[] if fleet else [tails[a] for a in affected],
        scope="fleet" if fleet else "aircraft",
        evidence_nats=round(evidence, 2),
        size_m_s=size,
        curve=curve,
        closure=closure,
        probability=probability(evidence),
    )


def unnamed(entry: EffectEntry, frame: Frame) -> PlaceEntry:
    """State an effect whose name is not in the catalogue by the variable that shows it.

    Its size is the mean reduction of the reports of the affected aircraft.
    """
    assert entry.closure is not None
    component, variable = _SHOWN_BY[entry.name]
    if entry.parameters.get("direction_step_deg") == 1.0:  # only speeds are coarse
        variable = "wind_speed"
    tails = frame.tails
    affected = [tails.index(tail) for tail in entry.tails]
    size = entry.closure.reduction * KNOT / float(np.isin(frame.aircraft, affected).mean())
    curve = CurveEntry(entry.tails, [size] * len(affected))
    evidence = entry.evidence_nats
    return place_of(component, variable, affected, tails, evidence, size, curve, entry.closure)


def closes(kt: float, error: float) -> ClosesEntry:
    """A reduction with its standard error, kt; the interval is not below zero."""
    return ClosesEntry(kt, [max(kt + side * NORMAL_95 * error, 0.0) for side in (-1, 1)])


def mean_reduction(longer: Floats, affected: Booleans) -> ClosesEntry:
    """Mean over all reports of the length (m/s) that an effect adds to the affected ones.

    16 % is the relative error of the assumed distribution.
    """
    if longer.size == 0:
        return closes(0.0, 0.0)
    kt = float(longer.sum()) / affected.size / KNOT
    drawn = float(longer.std()) * np.sqrt(longer.size) / affected.size / KNOT
    return closes(max(kt, 0.0), float(np.hypot(drawn, 0.16 * kt)))


def reduction_of_scatter(residual: Floats, sizes: Floats, gross: Booleans) -> ClosesEntry:
    """Closure by independent errors of some sizes (n,), m/s per component.

    They add in squares: reports of one size would differ less by the root of the share of their
    mean square that is left. ``residual`` is (n, 2).
    """
    affected = (sizes > 0) & ~gross
    _, group = np.unique(sizes[affected], return_inverse=True)
    square = (residual[affected] ** 2).sum(axis=1)
    mean = np.bincount(group, square) / np.bincount(group)
    left = np.maximum(1 - 2 * sizes[affected] ** 2 / mean[group], LEAST_LEFT)
    return mean_reduction(np.sqrt(square) * (1 - np.sqrt(left)), affected)
