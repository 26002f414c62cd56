"""The watch on the page: what is new first, a row an aircraft on the line of time."""

from airswing.evaluation.monitoring import Event, Monitoring, State, UnitTable
from airswing.report.run.monitoring_figures import MOST_ROWS, timeline_figure
from airswing.report.run.monitoring_section import monitoring_section, write_monitoring_page

SIZES = dict(zip("ABCDE", (2.04, 0.1, 0.0, 0.0, 0.0), strict=True))
CHANGED = {
    "date_ci": ["2009-03-09", "2009-03-11"],
    "curve_rms_deg": 2.04,
    "change_deg": SIZES,
    "standard_error_deg": SIZES,
}
ROSE = {"date_ci": ["2009-03-19", "2009-03-19"], "factor": 1.62, "standard_error": 0.1}


def watched(events, told_before=0):
    table = UnitTable([0.0] * 8, [0.1] * 8)
    states = [
        State("N1", "2009-03-01", "2009-03-20", False, table, table, True, 1.23, 6.1, 4.0),
        State("N<2>", "2009-03-01", "2009-03-12", True),
    ]
    return Monitoring("2009-03-20", "ruc", states, events, told_before)


EVENTS = [
    Event("compass_changed", "2009-03-10", "2009-03-12", "N1", CHANGED),
    Event("aircraft_silent", "2009-03-13", "2009-03-19", "N<2>", {"days": 6, "usual_days": 5}),
    Event("disagreement_rose", "2009-03-19", "2009-03-20", None, ROSE),
]


def test_what_is_new_leads_and_names_are_text(tmp_path):
    content = watched(EVENTS, told_before=1)
    lead = monitoring_section(content).lead
    assert lead.startswith("New up to 2009-03-20: 1 wind disagreement rose, 1 silent.")
    assert lead.endswith("Another table should go to N1.")
    text = write_monitoring_page(tmp_path / "monitoring.html", content).read_text()
    assert "2.0° rms, offset +2.0 ± 4.0°" in text and "× 1.62 ± 0.20" in text
    assert "N&lt;2&gt;" in text and "N<2>" not in text
    assert monitoring_section(None).parts == []
    assert monitoring_section(watched([])).lead.startswith("Nothing new.")


def test_the_line_of_time_has_the_latest_first_and_an_end():
    figure = timeline_figure(watched(EVENTS))
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["all at once", "N<2>", "N1"]
    assert "3 events in 3 rows" in figure.caption
    many = [Event("aircraft_new", "2009-03-02", "2009-03-02", f"N{k:03d}", {}) for k in range(90)]
    figure = timeline_figure(watched(many))
    assert len(figure.axes[0].get_yticklabels()) == MOST_ROWS
    assert f"{90 - MOST_ROWS} more are in the file" in figure.caption
    assert "No event" in timeline_figure(watched([])).caption
