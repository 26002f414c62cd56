"""gap.json: what is written is read again, whole; what is not one is refused by name."""

from __future__ import annotations

import json

import pytest

from airswing.errors import InputError
from airswing.gap.result.schema import GapReport
from airswing.products.whole_files import plain


def test_what_is_written_is_read_and_written_again_alike(gap_product):
    path = gap_product / "gap.json"
    report = GapReport.read(path)
    assert plain(report.content()) == json.loads(path.read_text())
    assert {effect.name for effect in report.effects} == {"hard_iron", "tas_scale"}
    assert report.closure.before > report.closure.after > report.gap.noise_floor_kt - 0.1


def test_the_keys_of_the_format_stand_in_the_file(gap_product):
    content = json.loads((gap_product / "gap.json").read_text())
    assert set(content["gap"]) == {
        "mean_vector_disagreement_kt",
        "noise_floor_kt",
        "significance",
    }
    assert {"variable", "values", "share_of_gap", "q_value"} <= set(content["where"][0])
    told = {"name", "probability", "tails", "parameters", "standard_errors", "period"}
    assert told | {"ambiguous_with", "share_of_gap"} <= set(content["effects"][0])
    assert content["unknown"] == {"present": False, "where": []}
    asked = {"before", "after", "ci", "fraction_of_excess", "held_out"}
    assert asked <= set(content["closure"])
    assert "known" not in content and "simulation" not in content


@pytest.mark.parametrize("value", [[-15.0, 0.0], ["N401", "N402"], "flag", 2.0, True, None])
def test_a_parameter_may_be_a_range_a_pair_a_word_or_a_number(gap_product, value):
    content = json.loads((gap_product / "gap.json").read_text())
    content["effects"][0]["parameters"] = {"one": value}
    (told,) = GapReport.of(content).effects[0].parameters.values()
    assert told == value and type(told) is type(value)


def test_a_number_of_another_kind_is_named(gap_product, tmp_path):
    content = json.loads((gap_product / "gap.json").read_text())
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
