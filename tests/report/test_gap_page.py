"""The gap page: the verdict as issue 4 words it, every section, and every way it can be empty."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from airswing.report import write_gap_page
from airswing.report.gap_words import (
    digits_for,
    effect_sentence,
    joined,
    parameter_text,
    period_text,
    verdict,
)
from tests.report import gap_factories
from tests.report.test_page import parsed


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
    assert digits_for(6.6) == 0
    assert digits_for(float("nan")) == 2
    assert period_text({"period": ["2009-07-20T00:00", None]}) == "from 2009-07-20"
    assert period_text({"period": {"start": "2009-07-01", "end": "2009-07-09"}}) == (
        "from 2009-07-01 to 2009-07-09"
    )
    assert effect_sentence({"name": "reference_time_offset"}).startswith("The reference: ")
    assert effect_sentence({"name": "declination_error", "tails": []}).startswith("The whole fleet")


def test_page_with_everything(tmp_path: Path) -> None:
    page = write_gap_page(tmp_path / "gap", gap=gap_factories.gap(), maps=gap_factories.maps())
    assert page == tmp_path / "gap" / "index.html"
    text, found = parsed(page)
    assert found.open == []
    assert all(a.startswith(("data:image/", "#")) for a in found.addresses)
    assert found.images == 11
    order = [
        text.index(f'<section id="{name}"') for name in ("where", "which", "far", "open", "method")
    ]
    assert order == sorted(order)
    assert text.index("<h1>") < order[0]
    assert "no icing flag in the reports" in text
    assert "flights farther north" in text


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
