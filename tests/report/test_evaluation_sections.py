"""Sections on changes, ranking, references and events: their sentences, and empty ones."""

from itertools import pairwise

import numpy as np
import pytest

from airswing.evaluation.monitoring.events import Event, Monitoring, State, UnitTable
from airswing.report.run.changes import monitoring_section, stability_section, write_monitoring_page
from airswing.report.run.evaluation import ranking_section, sensitivity_section
from tests.report.pages import Drawn

SHOW = Drawn()


def window(aircraft, first, **values):
    errors = {f"{name}_standard_error": 0.1 for name in ("offset", "amplitude")}
    fit = {"offset": 1.0, "amplitude": 3.0} | errors
    return {"aircraft": aircraft, "window": first, "reports": 900, "status": "ok"} | fit | values


SIZES = {"change_deg": {"A": 2.0, "B": 0.0, "C": -0.5}, "p_value": 0.001}
CHANGE = SIZES | {"standard_error_deg": {"A": 0.1, "B": 0.2, "C": 0.2}, "date": "2009-10-20"}
CHANGE["date_ci"] = ["2009-10-19", "2009-10-22"]


def stability(*changes):
    few = {"aircraft": "N2", "window": "2009-10-01", "reports": 9, "status": "too_few_reports"}
    first, later = window("N1", "2009-09-01"), window("N1", "2009-10-01", offset=2.2)
    return {
        "window": "month",
        "changes": [
            {"aircraft": "N1", "p_value": 0.001, "changes": list(changes)},
            {"aircraft": "N2", "p_value": 0.8, "changes": []},
        ],
        "windows": [first, window("N2", "2009-09-01"), later, few],
    }


def test_the_section_on_changes_gives_date_size_and_consequence():
    section = stability_section(stability(CHANGE), SHOW)
    assert "1 of 2 compasses changed" in section.lead and "neither part" in section.lead
    text = section.body
    assert "2009-10-19 to 2009-10-22" in text and "+2.00 ± 0.20" in text
    figure = SHOW.made["changes"]
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["N1", "N2"]
    assert "1 found" in figure.caption
    content = stability()
    content["windows"] += [window("N2", "2009-11-01"), window("N2", "2009-12-01")]
    assert "None of 2" in stability_section(content, SHOW).lead
    figure = SHOW.made["changes"]
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["N2", "N1"]
    assert "shown as examples" in figure.caption
    assert "N2 from 2009-10-01 (too few reports)" in figure.caption


@pytest.mark.parametrize("months", [1, 12, 30])
def test_date_labels_do_not_overlap(months):
    windows = [window("N1", f"{np.datetime64('2008-07') + month}-01") for month in range(months)]
    stability_section(stability() | {"windows": windows}, SHOW)
    for axes in SHOW.made["changes"].axes[-2:]:
        boxes = [label.get_window_extent() for label in axes.get_xticklabels() if label.get_text()]
        assert len(boxes) >= 3
        assert all(first.x1 < second.x0 for first, second in pairwise(boxes))


def gain(kind, value, low, high):
    return {f"{kind}_gain_kt": value, f"{kind}_gain_ci_kt": [low, high]}


RANKING = [
    {"aircraft": "N1", "disagreement_kt": 9.1} | gain("expected", 3.2, 2.8, 3.6),
    {"aircraft": "N2", "rank": None, "expected_gain_kt": None},
]


def virtual(*, agree=True, realised=3.0, ends=(2.5, 3.5)):
    sides = gain("predicted", 3.2, 2.8, 3.6) | gain("realised", realised, *ends)
    rows = [{"aircraft": "N1", "agree": agree} | sides]
    later = {"learned_until": "2009-10-10", "reports": 900, "by_aircraft": rows} | sides
    return {"later": later, "held_out": {"why": "too few flights"}}


def test_the_ranking_names_the_largest_reduction_and_how_predictions_held():
    section = ranking_section(RANKING, virtual(), SHOW)
    assert section.lead == "Largest expected reduction: N1, by 3.20 kt (2.80 to 3.60) of 9.10 kt."
    text = section.body
    assert "on all later days, 900 reports of 1 aircraft: realised reduction 3.00 kt" in text
    assert "3.00 kt (2.50 to 3.50), predicted 3.20 kt" in text and "outside" not in text
    assert "1 without a usable fit" in text
    text = ranking_section(RANKING, virtual(agree=False, realised=3.7), SHOW).body
    assert "outside the interval of the prediction" in text and "errors for N1." in text
    assert "n = 1 row" in SHOW.made["virtual_field_test"].caption


def test_unknown_intervals_and_empty_sections_are_omitted():
    unknown = [RANKING[0] | {"expected_gain_ci_kt": [float("nan")] * 2}]
    section = ranking_section(unknown, virtual(agree=None, ends=(None, None)), SHOW)
    assert "by 3.20 kt of 9.10" in section.lead
    assert "reduction 3.00 kt, predicted 3.20 kt (2.80" in section.body
    assert ranking_section(RANKING[1:], None, SHOW).body == ""
    assert sensitivity_section({"pairs": []}, SHOW).body == ""
    stability_section({"window": "month", "changes": [], "windows": []}, SHOW)
    assert "n = 0" in SHOW.made["changes"].caption


ERRORS = dict(zip("ABCDE", (2.04, 0.1, 0.0, 0.0, 0.0), strict=True))
CHANGED = {"date_ci": ["2009-03-09", "2009-03-11"], "curve_rms_deg": 2.04}
CHANGED |= {"change_deg": ERRORS, "standard_error_deg": ERRORS}
ROSE = {"date_ci": ["2009-03-19", "2009-03-19"], "factor": 1.62, "standard_error": 0.1}
EVENTS = [
    Event("compass_changed", "2009-03-10", "2009-03-12", "N1", CHANGED),
    Event("aircraft_silent", "2009-03-13", "2009-03-19", "N<2>", {"days": 6, "usual_days": 5}),
    Event("disagreement_rose", "2009-03-19", "2009-03-20", None, ROSE),
]


def monitored(events, reported_before=0, sizes=(0.0, 3.0)):
    tables = [UnitTable([size] * 8, [0.1] * 8) for size in sizes]
    speeds = {"disagreement_kt": 6.1, "past_disagreement_kt": 4.0}
    states = [
        State("N1", "2009-03-01", "2009-03-20", False, *tables, **speeds),
        State("N<2>", "2009-03-01", "2009-03-12", True),
    ]
    return Monitoring("2009-03-20", "ruc", states, events, reported_before)


def test_new_events_come_first_and_names_are_escaped(tmp_path):
    content = monitored(EVENTS, reported_before=1)
    first, second = monitoring_section(content).lead.split(". ")
    assert first == "New events up to 2009-03-20: disagreement rose (all aircraft), silent (N<2>)"
    assert second == "Another table is needed for N1."
    text = write_monitoring_page(tmp_path / "monitoring.html", content).read_text()
    assert "by 2.0 degrees rms, offset +2.0 ± 4.0" in text and "1.62 ± 0.20 times the" in text
    assert "no report for 6 days; up to 5 is usual" in text
    assert "N&lt;2&gt;" in text and "N<2>" not in text
    first = monitoring_section(monitored([], sizes=(3.0, 3.0)))
    assert "no, same table" in first.body and "no, same table" not in text
    assert first.lead.startswith("No new event.") and "<img" not in first.body
