"""Figures and sections on stability, ranking and prediction: what they say, and empty ones."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from airswing.report.html.embed import embedded
from airswing.report.run.stability_figures import (
    prediction_figure,
    ranking_figure,
    stability_figure,
)
from airswing.report.run.stability_sections import ranking_section, stability_section


def window(aircraft: str, first: str, **values) -> dict:
    known = {f"{name}_standard_error": 0.1 for name in ("offset", "amplitude")}
    fit = {"offset": 1.0, "amplitude": 3.0} | known
    return {"aircraft": aircraft, "window": first, "reports": 900, "status": "ok"} | fit | values


@pytest.fixture
def stability() -> dict:
    change = {
        "date": "2009-10-20",
        "date_ci": ["2009-10-19", "2009-10-22"],
        "change_deg": {"A": 2.0, "B": 0.0, "C": -0.5},
        "standard_error_deg": {"A": 0.1, "B": 0.2, "C": 0.2},
        "curve_rms_deg": 2.03,
        "p_value": 0.001,
    }
    return {
        "reference": "ruc",
        "window": "month",
        "changes": [
            {"aircraft": "N1", "days": 60, "p_value": 0.001, "changes": [change]},
            {"aircraft": "N2", "days": 60, "p_value": 0.8, "changes": []},
        ],
        "windows": [
            window("N1", "2009-09-01"),
            window("N2", "2009-09-01"),
            window("N1", "2009-10-01", offset=2.2),
            {"aircraft": "N2", "window": "2009-10-01", "reports": 9, "status": "too_few_reports"},
        ],
    }


@pytest.fixture
def ranking() -> list[dict]:
    known = {
        "aircraft": "N1",
        "rank": 1,
        "status": "ok",
        "expected_gain_kt": 3.2,
        "expected_gain_ci_kt": [2.8, 3.6],
        "disagreement_kt": 9.1,
    }
    return [known, {"aircraft": "N2", "rank": None, "expected_gain_kt": None}]


def virtual(agree: bool) -> dict:
    sides = {
        "predicted_gain_kt": 3.2,
        "predicted_gain_ci_kt": [2.8, 3.6],
        "realised_gain_kt": 3.0,
        "realised_gain_ci_kt": [2.5, 3.5],
        "agree": agree,
    }
    part = {"learned_until": "2009-10-10", "by_aircraft": [{"aircraft": "N1"} | sides]} | sides
    return {"later": part, "held_out": {"why": "too few flights"}}


def test_the_aircraft_that_changed_comes_first_with_its_date(stability):
    figure = stability_figure(stability)
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["N1", "N2"]
    assert "1 found" in figure.caption
    lines = len(figure.axes[0].lines), len(figure.axes[2].lines)
    assert lines[0] > lines[1]


@pytest.mark.parametrize("months", [1, 2, 12, 30])
def test_the_months_do_not_run_into_each_other(stability, months):
    first = np.datetime64("2008-07")
    stability["windows"] = [window("N1", f"{first + month}-01") for month in range(months)]
    figure = stability_figure(stability)
    figure.canvas.draw()
    for axes in figure.axes[-2:]:
        boxes = [label.get_window_extent() for label in axes.get_xticklabels() if label.get_text()]
        assert len(boxes) >= 3
        assert all(one.x1 < other.x0 for one, other in pairwise(boxes))


def test_the_section_tells_the_change_and_that_the_fit_straddles_it(stability):
    section = stability_section(stability)
    assert "1 of 2 compasses changed" in section.lead
    text = "".join(str(part) for part in section.parts)
    assert "2009-10-19 to 2009-10-22" in text
    assert "+2.00 ± 0.20" in text
    stability["changes"][0]["changes"] = []
    assert "None of 2" in stability_section(stability).lead


def test_the_ranking_names_who_gains_most_and_how_predictions_held(ranking):
    section = ranking_section(ranking, virtual(True))
    assert section.lead.startswith("N1 would gain most: 3.20 kt (2.80 to 3.60)")
    text = "".join(str(part) for part in section.parts)
    assert "3.00 kt (2.50 to 3.50); expected were 3.20 kt" in text
    assert "1 without a fit" in ranking_figure(ranking).caption


def test_an_interval_that_is_unknown_is_left_away(ranking):
    ranking[0]["expected_gain_ci_kt"] = [float("nan")] * 2
    one_day = virtual(True)
    for part in (one_day["later"], one_day["later"]["by_aircraft"][0]):
        part |= {"realised_gain_ci_kt": [float("nan")] * 2, "agree": None}
    section = ranking_section(ranking, one_day)
    assert section.lead.startswith("N1 would gain most: 3.20 kt of its")
    assert "gain 3.00 kt; expected were 3.20 kt (2.80" in "".join(map(str, section.parts))


def test_a_point_an_aircraft_of_thousands_does_not_fill_the_page():
    """In SVG 3,000 points with their intervals took 2.5 MB a panel, half of what a page may."""
    many = virtual(True)
    many["held_out"] = many["later"]
    many["later"]["by_aircraft"] *= 3000
    figure = prediction_figure(many)
    assert len(embedded(figure)) < 400_000 and "n = 6,000 points" in figure.caption


def test_what_is_missing_leaves_no_section_and_no_false_figure(ranking):
    assert stability_section(None).parts == []
    assert ranking_section(None, None).parts == []
    assert ranking_section(ranking[1:], None).parts == []
    assert "n = 0" in ranking_figure(ranking[1:]).caption
    assert "n = 0" in stability_figure({"window": "month", "changes": [], "windows": []}).caption
    assert "n = 1 point" in prediction_figure(virtual(False)).caption
