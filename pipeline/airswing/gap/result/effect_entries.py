"""From gap.json to effects.yaml: one entry an aircraft where each has parameters of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from airswing.gap.effects import CATALOGUE, ActiveEffect
from airswing.gap.effects.empirical import IRREVERSIBLE
from airswing.gap.result.schema import EffectEntry, GapReport, PlaceEntry, UnknownEntry
from airswing.gap.simulation.effects_file import parse_effects
from airswing.products.whole_files import plain


def active_effects(report: GapReport) -> list[ActiveEffect]:
    """Effects of a diagnosis as the simulation takes them: one entry per aircraft or fleet."""
    entries = [one for effect in report.effects for one in _of_effect(effect, report.reference)]
    entries += [one for place in report.unknown.where for one in _of_place(place)]
    return parse_effects(plain(entries))


def _of_effect(effect: EffectEntry, reference: str | None) -> list[dict[str, object]]:
    who = "all" if effect.scope == "fleet" else effect.tails
    # of a pool, of which one member alone may have the effect
    against_all = (effect.by_reference or {}).get(reference or "", effect)
    pieces = [(who, against_all.parameters)]
    if effect.per_tail:
        pieces = [([tail], values.parameters) for tail, values in effect.per_tail.items()]
    return [
        {"name": effect.name, "tails": tails, "parameters": values, "period": effect.period}
        for tails, values in pieces
    ]


def _of_place(place: PlaceEntry) -> list[dict[str, object]]:
    curve = place.curve
    if curve.edges is None:
        return []
    parameters = {"component": place.component, "variables": curve.variables, "edges": curve.edges}
    pieces = [(place.tails or "all", curve.values)]
    if curve.per_tail:
        pieces = [([tail], values) for tail, values in curve.per_tail.items()]
    return [
        {
            "name": "empirical",
            "tails": tails,
            "parameters": parameters | {"values": values},
            "period": None,
        }
        for tails, values in pieces
    ]


def not_known(entries: Sequence[EffectEntry], effects: Sequence[ActiveEffect]) -> list[EffectEntry]:
    """Return the effects found but for those of scatter that were known.

    An effect known on some of its aircraft is kept with the others.
    """
    out = []
    for entry in entries:
        kind = CATALOGUE[entry.name].kind if entry.name in CATALOGUE else "mean"
        own = [one for one in effects if one.name == entry.name]
        if kind != "second_moment" or not own:
            out.append(entry)
            continue
        known = {tail for one in own for tail in one.tails or entry.tails}
        left = [tail for tail in entry.tails if tail not in known]
        each = {t: v for t, v in (entry.per_tail or {}).items() if t in left}
        if left:
            out.append(replace(entry, tails=left, per_tail=each))
    return out


def unknown_not_known(unknown: UnknownEntry, effects: Sequence[ActiveEffect]) -> UnknownEntry:
    """Return the unknowns but for known tables that no report can be rid of.

    Where one is left out, the closure of all of them is too.
    """
    known = [one.parameters for one in effects if one.name == "empirical"]
    components = {str(t["component"]) for t in known} & set(IRREVERSIBLE)
    left = [p for p in unknown.where if p.component not in components]
    if len(left) == len(unknown.where):
        return unknown
    return replace(unknown, present=bool(left), where=left, closure=None)
