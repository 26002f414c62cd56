"""gap.json is read as written; its effects are those the simulation takes, less the known ones."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from airswing.errors import InputError
from airswing.gap.effects import ActiveEffect
from airswing.gap.result.schema import (
    CurveEntry,
    EffectEntry,
    GapReport,
    PlaceEntry,
    TailEntry,
    UnknownEntry,
)
from airswing.gap.simulation.effects_file import (
    active_effects,
    not_known,
    read_effects,
    unknown_not_known,
)
from airswing.products.whole_files import plain


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


def test_what_is_written_is_read_and_written_again_alike(gap_product):
    path = gap_product / "gap.json"
    report = GapReport.read(path)
    assert active_effects(report) == read_effects(gap_product / "effects.yaml")
    assert plain(report.content()) == json.loads(path.read_text())
    assert {effect.name for effect in report.effects} == {"hard_iron", "tas_scale"}
    assert report.closure.before > report.closure.after > report.gap.noise_floor_kt - 0.1


def test_a_number_of_another_kind_is_named(gap_product, tmp_path):
    content = json.loads((gap_product / "gap.json").read_text())
    parameters = {"range": [-15.0, 0.0], "pair": ["N401"], "word": "flag", "none": None}
    content["effects"][0]["parameters"] = parameters
    assert GapReport.of(content).effects[0].parameters == parameters
    content["closure"]["before"] = "much"
    bad = tmp_path / "gap.json"
    bad.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"closure\.before"):
        GapReport.read(bad)
    bad.write_text("{")
    with pytest.raises(InputError, match="not the result of a diagnosis"):
        GapReport.read(bad)
    with pytest.raises(InputError, match="cannot be read"):
        GapReport.read(tmp_path / "none.json")
