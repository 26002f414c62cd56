"""Sections on changes, ranking, references and events: their sentences, and empty ones."""

from itertools import pairwise

import numpy as np
import pytest

from airswing.evaluation.monitoring.events import Event, Monitoring, State, UnitTable
from airswing.report.run.changes import (
    MOST_EVENT_ROWS,
    monitoring_section,
    stability_section,
    write_monitoring_page,
)
from airswing.report.run.evaluation import ranking_section, sensitivity_section
from tests.report.pages import Drawn, labels

SHOW = Drawn()


def window(aircraft, first, **values):
    known = {f"{name}_standard_error": 0.1 for name in ("offset", "amplitude")}
    fit = {"offset": 1.0, "amplitude": 3.0} | known
    return {"aircraft": aircraft, "window": first, "reports": 900, "status": "ok"} | fit | values


@pytest.fixture
def stability():
    change = {
        "date": "2009-10-20",
        "date_ci": ["2009-10-19", "2009-10-22"],
        "change_deg": {"A": 2.0, "B": 0.0, "C": -0.5},
        "standard_error_deg": {"A": 0.1, "B": 0.2, "C": 0.2},
        "p_value": 0.001,
    }
    return {
        "window": "month",
        "changes": [
            {"aircraft": "N1", "p_value": 0.001, "changes": [change]},
            {"aircraft": "N2", "p_value": 0.8, "changes": []},
        ],
        "windows": [
            window("N1", "2009-09-01"),
            window("N2", "2009-09-01"),
            window("N1", "2009-10-01", offset=2.2),
            {"aircraft": "N2", "window": "2009-10-01", "reports": 9, "status": "too_few_reports"},
        ],
    }


def gain(kind, value, low, high):
    return {f"{kind}_gain_kt": value, f"{kind}_gain_ci_kt": [low, high]}


@pytest.fixture
def ranking():
    known = {"aircraft": "N1", "disagreement_kt": 9.1} | gain("expected", 3.2, 2.8, 3.6)
    return [known, {"aircraft": "N2", "rank": None, "expected_gain_kt": None}]


def virtual(*, agree=True, realised=3.0):
    sides = gain("predicted", 3.2, 2.8, 3.6) | gain("realised", realised, 2.5, 3.5)
    rows = [{"aircraft": "N1", "agree": agree} | sides]
    part = {"learned_until": "2009-10-10", "reports": 900, "by_aircraft": rows} | sides
    return {"later": part, "held_out": {"why": "too few flights"}}


def test_the_section_on_changes_gives_date_size_and_consequence(stability):
    section = stability_section(stability, SHOW)
    assert "1 of 2 compasses changed" in section.lead and "neither part" in section.lead
    text = section.body
    assert "2009-10-19 to 2009-10-22" in text and "+2.00 ± 0.20" in text
    figure = SHOW.made["changes"]
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["N1", "N2"]
    assert "1 found" in figure.caption
    stability["changes"][0]["changes"] = []
    stability["windows"].append(window("N2", "2009-11-01"))
    stability["windows"].append(window("N2", "2009-12-01"))
    assert "None of 2" in stability_section(stability, SHOW).lead
    figure, caption = SHOW.made["changes"], SHOW.made["changes"].caption
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["N2", "N1"]
    assert "shown as examples" in caption and "N2 from 2009-10-01 (too few reports)" in caption


@pytest.mark.parametrize("months", [1, 12, 30])
def test_date_labels_do_not_overlap(stability, months):
    first = np.datetime64("2008-07")
    stability["windows"] = [window("N1", f"{first + month}-01") for month in range(months)]
    stability_section(stability, SHOW)
    figure = SHOW.made["changes"]
    for axes in figure.axes[-2:]:
        boxes = [label.get_window_extent() for label in axes.get_xticklabels() if label.get_text()]
        assert len(boxes) >= 3
        assert all(one.x1 < other.x0 for one, other in pairwise(boxes))


def test_the_ranking_names_the_largest_reduction_and_how_predictions_held(ranking):
    section = ranking_section(ranking, virtual(), SHOW)
    assert section.lead == "Largest expected reduction: N1, by 3.20 kt (2.80 to 3.60) of 9.10 kt."
    text = section.body
    assert "on all later days, 900 reports of 1 aircraft: realised reduction 3.00 kt" in text
    assert "3.00 kt (2.50 to 3.50), predicted 3.20 kt" in text and "outside" not in text
    assert "1 without a usable fit" in text
    text = ranking_section(ranking, virtual(agree=False, realised=3.7), SHOW).body
    assert "outside the interval of the prediction" in text and "errors for N1." in text
    assert "n = 1 point" in SHOW.made["virtual_field_test"].caption
    metric = ranking_section(ranking, virtual(), Drawn(units="m/s"))
    assert "1.65 m/s (1.44 to 1.85) of 4.68 m/s" in metric.lead


def test_an_unknown_interval_is_omitted(ranking):
    ranking[0]["expected_gain_ci_kt"] = [float("nan")] * 2
    one_day = virtual(agree=None)
    for part in (one_day["later"], one_day["later"]["by_aircraft"][0]):
        part["realised_gain_ci_kt"] = [None, None]
    section = ranking_section(ranking, one_day, SHOW)
    assert "by 3.20 kt of 9.10" in section.lead
    assert "reduction 3.00 kt, predicted 3.20 kt (2.80" in section.body


def test_what_is_missing_leaves_no_section_and_no_false_figure(ranking):
    assert ranking_section(ranking[1:], None, SHOW).body == ""
    assert sensitivity_section({"pairs": []}, SHOW).body == ""
    stability_section({"window": "month", "changes": [], "windows": []}, SHOW)
    assert "n = 0" in SHOW.made["changes"].caption


SIZES = dict(zip("ABCDE", (2.04, 0.1, 0.0, 0.0, 0.0), strict=True))
CHANGED = {
    "date_ci": ["2009-03-09", "2009-03-11"],
    "curve_rms_deg": 2.04,
    "change_deg": SIZES,
    "standard_error_deg": SIZES,
}
ROSE = {"date_ci": ["2009-03-19", "2009-03-19"], "factor": 1.62, "standard_error": 0.1}
EVENTS = [
    Event("compass_changed", "2009-03-10", "2009-03-12", "N1", CHANGED),
    Event("aircraft_silent", "2009-03-13", "2009-03-19", "N<2>", {"days": 6, "usual_days": 5}),
    Event("disagreement_rose", "2009-03-19", "2009-03-20", None, ROSE),
]


def monitored(events, told_before=0):
    tables = [UnitTable([size] * 8, [0.1] * 8) for size in (0.0, 3.0)]
    speeds = {"disagreement_kt": 6.1, "past_disagreement_kt": 4.0}
    states = [
        State("N1", "2009-03-01", "2009-03-20", False, *tables, **speeds),
        State("N<2>", "2009-03-01", "2009-03-12", True),
    ]
    return Monitoring("2009-03-20", "ruc", states, events, told_before)


def test_new_events_come_first_and_names_are_escaped(tmp_path):
    content = monitored(EVENTS, told_before=1)
    lead = monitoring_section(content, SHOW).lead
    assert lead.startswith("New up to 2009-03-20: wind disagreement rose (1), no reports (1).")
    assert lead.endswith("Another table is needed for N1.")
    text = write_monitoring_page(tmp_path / "monitoring.html", content).read_text()
    assert "2.0° rms, offset +2.0 ± 4.0°" in text and "× 1.62 ± 0.20" in text
    assert "N&lt;2&gt;" in text and "N<2>" not in text
    assert "no report for 6 days when noticed" in text
    first = monitored([])
    first.states[0].table_in_use, first.states[0].table_difference_deg = (
        first.states[0].table_now,
        0.0,
    )
    quiet = monitoring_section(first, SHOW)
    assert "no, same table" in quiet.body and "no, same table" not in text
    assert quiet.lead.startswith("No new event.") and "<img" not in quiet.body


def test_the_time_axis_has_the_latest_event_first_and_a_limit():
    monitoring_section(monitored(EVENTS), SHOW)
    figure = SHOW.made["monitoring"]
    assert labels(figure.axes[0]) == ["all aircraft at once", "N<2>", "N1"]
    assert "n = 3 events in 3 rows" in figure.caption
    many = [Event("aircraft_new", "2009-03-02", "2009-03-02", f"N{k:03d}", {}) for k in range(90)]
    monitoring_section(monitored(many), SHOW)
    figure = SHOW.made["monitoring"]
    assert len(labels(figure.axes[0])) == MOST_EVENT_ROWS
    assert f"{90 - MOST_EVENT_ROWS} more are in events.json" in figure.caption
