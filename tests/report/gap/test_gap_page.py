"""The gap page: the verdict in words, every section, and every way it can be empty."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.report import gap_factories
from tests.report.run.test_page import parsed

from airswing.report import write_gap_page
from airswing.report.gap import parts as gap_parts
from airswing.report.gap.words import (
    digits_for,
    effect_sentence,
    joined,
    parameter_text,
    parameters_text,
    period_text,
    slice_words,
    small_text,
    verdict,
    who_text,
)


def test_verdict_in_the_words_of_the_example() -> None:
    gap = gap_factories.gap()
    gap["effects"] = gap["effects"][:1]
    gap["effects"][0] |= {"parameters": {"amplitude_deg": 3.912}, "tails": ["N412", "N418"]}
    assert verdict(gap) == (
        "N412 and N418: heading error of one cycle, amplitude 3.9 ± 0.2°; explains 61 % of the "
        "gap; adding it takes the disagreement from 7.4 to 6.5 kt on held-out flights, noise "
        "floor 6.3."
    )


def test_verdict_when_nothing_is_missing_claims_nothing() -> None:
    gap = gap_factories.gap() | {"effects": []}
    assert verdict(gap).startswith("Nothing is missing")
    assert verdict({**gap, "counts": {"days": 1}}).startswith("One day of reports is too short")
    assert "7.4 kt and the noise floor 6.3 kt" in verdict(gap)


def test_verdict_says_unknown_and_where() -> None:
    place = [{"variable": "icing", "values": ["on"]}]
    gap = gap_factories.gap() | {"effects": [], "unknown": {"present": True, "where": place}}
    assert "catalogue does not hold (icing: on)" in verdict(gap)
    gap = gap_factories.gap() | {"unknown": {"present": True, "where": place}}
    assert verdict(gap).endswith("Something unknown remains (icing: on).")


@pytest.mark.parametrize(
    ("name", "value", "error", "text"),
    [
        ("amplitude_deg", 3.912, 0.2, "amplitude 3.9 ± 0.2°"),
        ("rate_deg_per_day", 0.0312, 0.004, "rate 0.031 ± 0.004°/day"),
        ("scale_percent", 1.5, 0.31, "scale 1.5 ± 0.3 %"),
        ("offset_m_s", -0.5, 0.05, "offset -0.50 ± 0.05 m/s"),
        ("offset_s", 61.0, 6.6, "offset 61 ± 7 s"),
        ("above_hPa", 400, None, "above 400 hPa"),
        ("fraction", 0.01234, None, "fraction 0.01234"),
        ("pair", "N1/N2", None, "pair N1/N2"),
    ],
)
def test_parameters_carry_their_unit(name: str, value: object, error: object, text: str) -> None:
    assert parameter_text(name, value, error) == text


def test_words() -> None:
    assert joined(["a"]) == "a"
    assert joined(["a", "b", "c"]) == "a, b and c"
    assert joined(list("abcdefgh"), most=2) == "a, b and 6 more"
    assert digits_for(0.2) == 1
    assert small_text(0.0213) == "= 0.021"
    assert small_text(4e-25) == "< 1e-06"
    assert digits_for(6.6) == 0
    assert digits_for(float("nan")) == 2
    assert period_text({"period": ["2009-07-20T00:00", None]}) == "from 2009-07-20"
    assert period_text({"period": {"start": "2009-07-01", "end": "2009-07-09"}}) == (
        "from 2009-07-01 to 2009-07-09"
    )
    assert period_text({"period": [None, "2009-08-01"]}) == "until 2009-08-01"
    assert period_text({"period": None}) == ""
    assert effect_sentence({"name": "reference_time_offset"}).startswith("The reference: ")
    assert effect_sentence({"name": "declination_error", "tails": []}).startswith("The whole fleet")
    place = {"component": "scatter", "variables": ["scatter"], "tails": ["N1"]}
    assert slice_words(place) == "scatter, of single reports: N1"
    place = {"component": "wind", "variables": ["stretched_above_700_hPa", "wind_speed"]}
    assert slice_words(place) == "the reference's wind, stretched above 700 hPa"
    everybody = {"tails": ["N1", "N2", "N3"], "scope": "fleet"}
    assert who_text({"name": "declination_error"} | everybody) == "the whole fleet"
    assert who_text({"name": "reference_speed_bias"} | everybody) == "the reference"
    single = {"name": "tas_scale", "tails": ["n1x"], "scope": "aircraft"}
    assert who_text(single) == "n1x"
    shared = {"name": "reference_speed_bias"} | everybody
    assert verdict({"effects": [single, shared]}).startswith("n1x: ")
    assert "; the reference: " in verdict({"effects": [single, shared]})
    assert verdict({"effects": [shared, single]}).startswith("The reference: ")


def test_page_with_everything(tmp_path: Path) -> None:
    page = write_gap_page(
        tmp_path / "gap",
        gap=gap_factories.gap(),
        maps=gap_factories.maps(),
        details=gap_factories.details(),
    )
    assert page == tmp_path / "gap" / "index.html"
    text, found = parsed(page)
    assert found.open == []
    assert all(a.startswith(("data:image/", "#")) for a in found.addresses)
    where, which, far, method = 1 + 4, 2, 1, 2
    assert found.images == where + which + far + method
    order = [
        text.index(f'<section id="{name}"') for name in ("where", "which", "far", "open", "method")
    ]
    assert order == sorted(order)
    assert text.index("<h1>") < order[0]
    assert "no icing flag in the reports" in text
    assert "What would tell: headings in more compass points." in text


def test_page_of_the_bare_contract(tmp_path: Path) -> None:
    gap = gap_factories.gap()
    bare = {key: gap[key] for key in ("gap", "where", "unknown")}
    bare |= {
        "effects": [],
        "closure": {
            "before": 6.4,
            "after": 6.4,
            "ci": [6.3, 6.5],
            "fraction_of_excess": 0.0,
            "held_out": True,
        },
    }
    text, found = parsed(write_gap_page(tmp_path, gap=bare))
    assert found.open == []
    assert re.search(r"<h1>Nothing is missing", text)
    assert "No effect of the catalogue is needed" in text


def test_an_unknown_effect_is_placed_and_drawn(tmp_path: Path) -> None:
    unknown = {"present": True, "where": [gap_factories.unknown_place()]}
    gap = gap_factories.gap() | {"effects": [], "unknown": unknown}
    text, found = parsed(write_gap_page(tmp_path, gap=gap))
    place = "icing by magnetic heading, across the heading: N403"
    assert f"found in {place}." in text
    assert f"catalogue does not hold ({place})" in text
    assert found.images == 2


def test_steps_of_the_waterfall_carry_the_level_they_leave() -> None:
    steps = gap_parts.closure_steps(gap_factories.details())
    assert [(name, level) for name, level, _ in steps] == [
        ("hard_iron", 6.7),
        ("compass_step", 6.5),
    ]
    assert steps[0][2] == pytest.approx([6.6, 6.8])
    assert steps[1][2] == pytest.approx([6.45, 6.55])


def test_best_evidence_is_of_the_catalogue_alone() -> None:
    best = gap_parts.best_evidence(gap_factories.details()["evidence"])
    assert list(best.items()) == [
        ("hard_iron", 5230.0),
        ("compass_step", 400.0),
        ("soft_iron", 320.0),
        ("tas_scale", -2.0),
    ]


def test_posterior_is_taken_from_the_effect_s_own_row() -> None:
    names = [f"N{i}" for i in range(14)]
    found = gap_parts.posteriors(gap_factories.details()["evidence"], names)
    assert list(found) == ["hard_iron", "compass_step"]
    assert found["hard_iron"][-1] == 0.99


def test_weeks_are_dated_from_the_first_day() -> None:
    starts = gap_parts.week_starts(gap_factories.maps()).astype("datetime64[D]").astype(str)
    assert starts[:3].tolist() == ["2009-07-01", "2009-07-08", "2009-07-15"]
    numbers = gap_parts.week_starts(gap_factories.maps().drop_vars("day"))
    assert numbers.tolist() == list(range(7))


def test_parameters_of_several_aircraft_are_a_range_where_they_differ() -> None:
    effect = {
        "name": "hard_iron",
        "tails": ["N1", "N2"],
        "parameters": {"amplitude_deg": 2.6, "phase_deg": 31.0, "at_horizontal_field_nT": 18820.0},
        "standard_errors": {"amplitude_deg": 0.1, "phase_deg": 3.0},
        "per_tail": {
            "N1": {"parameters": {"amplitude_deg": 1.14, "phase_deg": 170.0}},
            "N2": {"parameters": {"amplitude_deg": 5.92, "phase_deg": -50.0}},
        },
    }
    assert parameters_text(effect) == "amplitude 1.1 to 5.9°, at 18,820 nT"
    assert effect_sentence(effect) == (
        "N1 and N2: heading error of one cycle, amplitude 1.1 to 5.9°"
    )
    effect["per_tail"]["N1"]["parameters"] = {"amplitude_deg": 5.8, "phase_deg": -51.0}
    assert parameters_text(effect, brief=True) == "amplitude 2.6 ± 0.1°, phase 31 ± 3°"
    effect["per_tail"]["N1"]["parameters"] = {"amplitude_deg": 5.8, "phase_deg": 178.0}
    effect["per_tail"]["N2"]["parameters"] = {"amplitude_deg": 5.9, "phase_deg": -179.0}
    effect["parameters"]["phase_deg"] = 179.5
    assert parameters_text(effect, brief=True) == "amplitude 2.6 ± 0.1°, phase 180 ± 3°"


def test_a_range_of_small_values_keeps_its_digits() -> None:
    each = {
        "N1": {"parameters": {"rate_deg_per_day": 0.021}},
        "N2": {"parameters": {"rate_deg_per_day": 0.048}},
    }
    effect = {
        "name": "compass_drift",
        "parameters": {"rate_deg_per_day": 0.03},
        "standard_errors": {"rate_deg_per_day": 0.001},
        "per_tail": each,
    }
    assert parameters_text(effect) == "rate 0.021 to 0.048°/day"


def test_the_aircraft_of_a_swap_are_told_once_and_not_as_a_list() -> None:
    pair = ["N402", "N406"]
    effect = {
        "name": "tail_swap",
        "tails": pair,
        "parameters": {"pair": pair},
        "period": ["2009-03-10", None],
    }
    assert effect_sentence(effect) == (
        "N402 and N406: two aircraft exchanged identifiers, from 2009-03-10"
    )
