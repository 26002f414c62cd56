"""States and events of simulated fleets, reported once; their file; tables in use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet, with_change

from airswing.compass.correction import add_tables, correct, write_tables_csv
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.monitoring.events import (
    find_events,
    first_days_and_silences,
    read_events,
    read_tables,
    write_events,
)
from airswing.products.ragged import aircraft_of_report, some_reports
from airswing.units import KNOT

SETTING = Setting(aircraft=6, days=45, flights_a_day=4, reports_a_flight=10)
CHANGE = np.zeros((6, 5))
CHANGE[2, 0] = 2.0


def fitted(ds):
    return add_tables(fit_deviation(ds, shared_error=False), ds)


@pytest.fixture(scope="module")
def changed():
    ds = with_change(3, SETTING, day=38, change=CHANGE)
    return ds, fitted(ds)


@pytest.fixture(scope="module")
def monitored(changed):
    return find_events(*changed)


def test_a_change_of_two_degrees_is_one_event_noticed_within_three_days(monitored):
    event = monitored.events[0]
    assert len(monitored.events) == 1
    assert (event.kind, event.aircraft) == ("compass_changed", "N002")
    # day 38 is 2008-08-08, its reports are in that night
    assert "2008-08-08" <= event.noticed <= "2008-08-10"
    low, high = event.evidence["date_ci"]
    assert low <= "2008-08-08" <= high
    assert event.evidence["change_deg"]["A"] == pytest.approx(2.0, abs=0.7)
    assert "N002: compass changed (by" in event.line


def test_an_event_is_reported_once_also_when_later_days_come_in(changed, tmp_path):
    ds, fits = changed
    before = find_events(ds, fits, until="2008-08-07")
    assert before.events == [] and before.until == "2008-08-07"
    first = find_events(ds, fits, previous=before, until="2008-08-11")
    assert [event.aircraft for event in first.new_events] == ["N002"]
    kept = read_events(write_events(first, tmp_path / "events.json"))
    assert kept == first
    second = find_events(ds, fits, previous=kept)
    assert second.new_events == [] and second.events == first.events


def test_states_hold_the_disagreement_of_the_winds_and_the_tables(changed, monitored):
    ds, fits = changed
    du, dv = (
        ds[f"{name}_wind"].to_numpy() - ds[f"reference_{name}_wind"].to_numpy()[0]
        for name in ("eastward", "northward")
    )
    n004 = aircraft_of_report(ds) == 4
    late = ds["time"].to_numpy() >= np.datetime64("2008-07-01") + np.timedelta64(38, "D")
    state = monitored.states[4]
    assert state.disagreement_kt == pytest.approx(np.hypot(du, dv)[n004 & late].mean() / KNOT)
    assert state.past_disagreement_kt == pytest.approx(np.hypot(du, dv)[n004 & ~late].mean() / KNOT)
    assert (state.first_day, state.last_day, state.silent) == ("2008-07-01", "2008-08-14", False)
    assert state.tables_differ is False and state.table_difference_deg == 0.0
    np.testing.assert_allclose(
        state.table_now.correction_deg, fits["table_correction"].isel(reference=0, aircraft=4)
    )


def test_a_table_on_board_that_is_off_is_reported(changed, monitored, tmp_path):
    ds, fits = changed
    path = write_tables_csv(fits, tmp_path / "tables.csv")
    read = read_tables(path, reference="ruc")
    now = monitored.states[4].table_now
    np.testing.assert_allclose(read["N004"].correction_deg, now.correction_deg, atol=5e-4)
    off = replace(read["N004"], correction_deg=[c + 1.5 for c in read["N004"].correction_deg])
    found = find_events(ds, fits, tables_in_use=read | {"N004": off})
    assert found.differing == ["N004"]
    assert found.states[4].table_difference_deg == pytest.approx(1.5, abs=1e-3)
    # the table first seen stays in use until another is named
    later = find_events(ds, fits, previous=found)
    assert later.differing == ["N004"]
    path.write_text(path.read_text().replace("subtract_error", "add_error"))
    turned = read_tables(path, reference="ruc")
    np.testing.assert_allclose(
        turned["N004"].correction_deg, -np.array(now.correction_deg), atol=5e-4
    )
    path.write_text("aircraft,heading\nN1,0\n")
    with pytest.raises(InputError, match="not a file of tables"):
        read_tables(path, reference="ruc")


def test_winds_that_grow_worse_are_reported_and_corrected_winds_are_what_counts():
    ds, _ = fleet(5, SETTING, amplitude=2.0)
    fits = fitted(ds)
    worse = (aircraft_of_report(ds) == 1) & (ds["time"].to_numpy() >= np.datetime64("2008-08-03"))
    noise = np.random.default_rng(2).normal(0, 6.0, worse.size) * worse
    ds = ds.assign(northward_wind=("report", ds["northward_wind"].to_numpy() + noise))
    found = find_events(ds, fits, corrected=correct(ds, fits, reference="ruc"))
    assert [(event.kind, event.aircraft) for event in found.events] == [
        ("disagreement_rose", "N001")
    ]
    assert found.events[0].evidence["factor"] > 1.5
    assert found.states[1].disagreement_kt > 1.5 * found.states[1].past_disagreement_kt
    assert found.states[3].disagreement_kt < find_events(ds, fits).states[3].disagreement_kt


def test_aircraft_that_come_and_go():
    ds, _ = fleet(7, SETTING, amplitude=2.0)
    day = (ds["time"].to_numpy() - np.datetime64("2008-07-01")) // np.timedelta64(1, "D")
    who = aircraft_of_report(ds)
    kept = ~((who == 0) & (day < 30)) & ~((who == 5) & (day > 33))
    ds = some_reports(ds, kept)
    fits = fitted(ds)
    found = find_events(ds, fits, until="2008-08-08")
    assert [(e.kind, e.aircraft, e.date) for e in found.events] == [
        ("aircraft_new", "N000", "2008-07-31")
    ]
    found = find_events(ds, fits, previous=found)
    assert [(e.kind, e.aircraft, e.date) for e in found.new_events] == [
        ("aircraft_silent", "N005", "2008-08-04")
    ]
    assert [state.silent for state in found.states] == [False] * 5 + [True]
    alone = some_reports(ds, (who != 2)[kept])
    known = find_events(alone, fits)
    assert [e.aircraft for e in find_events(ds, fits, previous=known).new_events] == ["N002"]


def test_a_second_change_soon_after_the_first_is_reported(changed, monitored):
    """The file of the last run holds the first change; of the same archive another is found."""
    ds, fits = changed
    (event,) = monitored.events
    early = replace(event, date="2008-07-25", noticed="2008-07-27")
    before = replace(monitored, until="2008-08-07", events=[early], told_before=0)
    # one old event explains one new one, within a month of it
    assert find_events(ds, fits, previous=before).new_events == []
    other = replace(before, events=[replace(early, aircraft="N001")])
    assert find_events(ds, fits, previous=other).new_events == [event]
    # what an earlier run could have noticed a month ago and did not is not reported
    late = replace(before, until="2008-09-20", events=[])
    assert find_events(ds, fits, previous=late).new_events == []


def test_reports_that_were_all_left_out_are_days_without_a_wind():
    ds, _ = fleet(7, replace(SETTING, aircraft=2, days=12), amplitude=2.0)
    fits = fitted(ds)
    none = ds.assign(screening=("report", np.full(ds.sizes["report"], 2, np.int32)))
    found = find_events(none, fits)
    assert found.events == [] and found.states[0].disagreement_kt is None
    assert found.states[0].last_day == "2008-07-12"
    with pytest.raises(InputError, match="no report to monitor"):
        find_events(none, fits, until="2008-06-01")


def test_a_silence_is_measured_by_the_aircrafts_past_and_days_of_the_fleet():
    daily = np.delete(np.arange(60), range(40, 48))  # nobody reports for eight days
    weekly = np.arange(0, 39, 7)  # last seen on day 35
    aircraft = np.repeat([0, 1, 2], [daily.size, daily.size, weekly.size])
    days = np.concatenate([daily, daily, weekly])
    assert first_days_and_silences(aircraft, days, 3, 59)[1] == []
    stopped = np.concatenate([daily, daily[:35], weekly])
    aircraft = np.repeat([0, 1, 2], [daily.size, 35, weekly.size])
    first, spells = first_days_and_silences(aircraft, stopped, 4, 59)
    assert [(s.number, s.first, s.lasts) for s in spells] == [(1, 35, True)]
    assert first.tolist() == [0, 0, 0, 60]


def test_a_file_of_something_else_is_one_message(tmp_path):
    path = tmp_path / "events.json"
    for text in ("{", "[]", '{"version": 9}', '{"version": 1, "states": [{}]}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"events\.json"):
            read_events(path)
