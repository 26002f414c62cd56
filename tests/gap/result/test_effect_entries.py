"""What was found as the simulation takes it, and what was known taken out of it."""

from __future__ import annotations

from dataclasses import replace

from airswing.gap.effects import ActiveEffect
from airswing.gap.result.effect_entries import active_effects, not_known, unknown_not_known
from airswing.gap.result.schema import (
    CurveEntry,
    EffectEntry,
    GapReport,
    PlaceEntry,
    TailEntry,
    UnknownEntry,
)
from airswing.gap.simulation.effects_file import read_effects


def found(name, *tails, each=None):
    per_tail = {tail: TailEntry({"fraction": 0.02}) for tail in each or ()}
    made = EffectEntry(name, 1.0, list(tails), {}, {}, None, "aircraft", 9.0)
    return replace(made, per_tail=per_tail or None)


def test_scatter_that_was_known_is_not_named_again():
    entries = [found("outliers", "N401", "N402", each=["N401", "N402"]), found("hard_iron", "N401")]
    known = [
        ActiveEffect("outliers", {"fraction": 0.02}, ("N401",)),
        ActiveEffect("hard_iron", {"amplitude_deg": 1.0}, ("N401",)),
    ]
    left = not_known(entries, known)
    assert [(one.name, one.tails) for one in left] == [
        ("outliers", ["N402"]),
        ("hard_iron", ["N401"]),
    ]
    assert list(left[0].per_tail) == ["N402"]
    everyone = [ActiveEffect("outliers", {"fraction": 0.02})]
    assert [one.name for one in not_known(entries, everyone)] == ["hard_iron"]


def test_effects_of_a_report_are_those_of_its_effects_file(gap_product):
    report = GapReport.read(gap_product / "gap.json")
    assert active_effects(report) == read_effects(gap_product / "effects.yaml")


def test_a_known_floor_of_the_speeds_is_not_told_again():
    """No report tells what it was before: it shows again, and it was known."""
    curve = CurveEntry(variables=["wind_speed"], labels=[], m_s=[])
    places = [
        PlaceEntry(component, "wind_speed", ["wind_speed"], "", [], "fleet", 30.0, 0.4, curve)
        for component in ("reported_speed", "along_wind")
    ]
    unknown = UnknownEntry(True, places)
    parameters = {"component": "reported_speed", "variables": ["wind_speed"]}
    known = [ActiveEffect("empirical", parameters)]
    assert unknown_not_known(unknown, known) == UnknownEntry(True, places[1:])
    assert unknown_not_known(UnknownEntry(True, places[:1]), known) == UnknownEntry(False, [])
    along = [ActiveEffect("empirical", parameters | {"component": "along_wind"})]
    assert unknown_not_known(unknown, along) is unknown
