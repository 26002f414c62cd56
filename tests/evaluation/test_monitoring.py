"""Changes of compasses: stated, dated and sized; states and events of a fleet, reported once."""

from dataclasses import replace

import numpy as np
import pytest

from airswing.compass.correction import add_tables, correct, write_tables_csv
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.monitoring import changes
from airswing.evaluation.monitoring.events import (
    find_events,
    first_days_and_silences,
    read_events,
    read_tables,
    write_events,
)
from airswing.products.ragged import aircraft_of_report, some_reports
from airswing.units import KNOT
from tests.compass.flown import Setting
from tests.evaluation.archives import ORIGIN, day_number, fleet, with_change
from tests.evaluation.daily_fleets import World, watched

# 8 flights of 12 reports: about 100 a day.
SETTING = Setting(aircraft=3, days=60, flights_a_day=8, day_error=1.2, outliers=0.005)
RUC = {"pools": {"ruc": ["ruc"]}, "reference": "ruc"}
CHANGE = np.zeros((3, 5))
CHANGE[1, 0] = 2.0


def days(text):
    return int((np.datetime64(text) - ORIGIN).astype(int))


@pytest.fixture(scope="module")
def changed():
    ds = with_change(1, SETTING, day=35, change=CHANGE)
    return ds, changes.watch_compasses(ds, members=["ruc"]).changes


def test_a_change_agrees_with_the_truth_and_with_the_fits_by_month(changed):
    ds, entries = changed
    assert [len(entry["changes"]) for entry in entries] == [0, 1, 0]
    change = entries[1]["changes"][0]
    assert abs(days(change["date"]) - 35) <= 7
    assert days(change["date_ci"][0]) <= 35 <= days(change["date_ci"][1])
    for name, truth in (("A", 2.0), ("B", 0.0), ("C", 0.0)):
        error = change["standard_error_deg"][name]
        assert abs(change["change_deg"][name] - truth) < 3 * error
        assert error < 0.5
    assert change["curve_rms_deg"] == pytest.approx(2.0, abs=0.5)
    # the change came on 5 August: July is before it, August mostly after
    windows = [entry for entry in changes.fit_by_window(ds, **RUC) if entry["aircraft"] == "N001"]
    for name in "ABC":
        rise = windows[1][name] - windows[0][name]
        errors = [window[f"{name}_standard_error"] for window in windows]
        error = np.hypot(change["standard_error_deg"][name], np.hypot(*errors))
        assert abs(rise * 30 / 26 - change["change_deg"][name]) < 2.5 * error


def test_routes_that_turn_are_no_change_and_a_change_is():
    """Other routes every 60 days; third to fifth harmonics; one compass steps 2 degrees."""
    change = np.zeros((12, 180, 5))
    change[4, 100:, 1] = 2.0 * np.sqrt(2.0)
    entries = watched(World(wrong_curve=0.6), aircraft=12, days=180, seed=6, change=change).changes
    assert [len(entry["changes"]) for entry in entries] == [int(k == 4) for k in range(12)]
    entry = entries[4]["changes"][0]
    first, last = np.array(entry["date_ci"], dtype="M8[D]").astype(int)
    assert first <= 100 <= last and last - first <= 6
    assert abs(entry["change_deg"]["B"] - 2.0 * np.sqrt(2.0)) < 0.5


def test_two_changes_of_one_compass_are_both_stated():
    setting = Setting(aircraft=2, days=90, flights_a_day=6, day_error=0.8)
    step = np.zeros((2, 5))
    step[0, 1] = 3.0
    ds = with_change(4, setting, day=30, until=60, change=step)
    entries = changes.watch_compasses(ds, members=["ruc"]).changes
    assert [days(step["date"]) for step in entries[0]["changes"]] == pytest.approx([30, 60], abs=2)
    assert entries[1]["changes"] == []


def test_a_fit_over_a_change_carries_a_warning(changed):
    ds, entries = changed
    single = fit_deviation(ds)
    fits = changes.add_changes(single, entries)
    assert changes.noted_changes(fits) == entries
    with pytest.raises(InputError, match="no test of the compasses for changes"):
        changes.noted_changes(single)
    assert fits["change_count"].to_numpy().tolist() == [0, 1, 0]
    assert np.isnat(fits["change_date"].to_numpy()).tolist() == [True, False, True]
    assert fits["change_date_low"][1] <= fits["change_date"][1] <= fits["change_date_high"][1]
    assert fits["change_p_value"][1] <= 0.02 < fits["change_p_value"][0]
    lines = changes.change_warnings(fits)
    assert len(lines) == 1
    assert all(word in lines[0] for word in ("N001", "2008-08-05", "covers both states"))
    assert changes.change_warnings(single) == []


def test_too_few_days_have_no_p_value():
    ds = fleet(1, Setting(aircraft=2, days=8))[0]
    entries = changes.watch_compasses(ds, members=["ruc"]).changes
    assert [entry["p_value"] for entry in entries] == [None, None]
    assert np.isnan(changes.add_changes(fit_deviation(ds), entries)["change_p_value"]).all()


@pytest.mark.parametrize(
    ("window", "firsts"), [("month", ["2008-07-01", "2008-08-01"]), ("quarter", ["2008-07-01"])]
)
def test_windows_are_those_of_the_calendar_and_state_their_reports(changed, window, firsts):
    ds, _ = changed
    windows = changes.fit_by_window(ds, **RUC, window=window, min_reports=1_000_000)
    entries = [entry for entry in windows if entry["aircraft"] == "N001"]
    assert [entry["window"] for entry in entries] == firsts
    assert sum(entry["reports"] for entry in entries) == ds.sizes["report"] // 3
    assert {entry["status"] for entry in windows} == {"too_few_reports"}
    assert all("offset" not in entry for entry in windows)


WORLD = World(days_off=0.0)


@pytest.mark.parametrize("size", [[2, 0, 0, 0, 0], [0, 2.4, 1.5, 0, 0]])
def test_a_compass_that_steps_is_detected_dated_and_sized_and_no_other(size):
    change = np.zeros((12, 60, 5))
    change[3, 40:] = size
    alarms = watched(WORLD, aircraft=12, days=60, seed=6, change=change).tested.alarms
    assert [alarm.number for alarm in alarms] == [3]
    step = alarms[0]
    assert 41 <= alarms[0].night <= 44
    assert step.earliest <= 40 <= step.latest
    error = np.degrees(step.change[:5]) - size
    assert (np.abs(error) < 4.0 * np.degrees(step.error[:5])).all()


@pytest.mark.parametrize("number", [12, 2])
def test_a_step_of_all_aircraft_is_that_of_the_reference(number):
    change = np.zeros((1, 70, 5))
    change[:, 45:, 0] = 2.5
    watch = watched(WORLD, aircraft=number, days=70, seed=3, change=change)
    (alarm,) = watch.tested.alarms
    assert alarm.number == -1
    assert abs(alarm.day - 45) <= 1
    assert np.degrees(alarm.change[0]) == pytest.approx(2.5, abs=0.8)
    if number > 2:  # two aircraft have no common part
        assert not any(entry["changes"] for entry in watch.changes)


def test_a_fleet_without_a_change_has_no_alarm():
    """15 aircraft-years of heavy tails and lasting errors of the reference."""
    watch = watched(replace(WORLD, persistence=0.7, days_off=0.3), aircraft=30, days=180, seed=21)
    assert watch.tested.alarms == []
    assert not any(entry["changes"] for entry in watch.changes)


SMALL = Setting(aircraft=6, days=45, flights_a_day=4, reports_a_flight=10)
STEP = np.zeros((6, 5))
STEP[2, 0] = 2.0


def fitted(ds):
    return add_tables(fit_deviation(ds, shared_error=False), ds)


@pytest.fixture(scope="module")
def stepped():
    ds = with_change(3, SMALL, day=38, change=STEP)
    return ds, fitted(ds)


@pytest.fixture(scope="module")
def monitored(stepped):
    return find_events(*stepped)


def test_a_change_of_two_degrees_is_one_event_noticed_within_three_days(monitored):
    (event,) = monitored.events
    assert (event.kind, event.aircraft) == ("compass_changed", "N002")
    # day 38 is 2008-08-08, its reports are in that night
    assert "2008-08-08" <= event.noticed <= "2008-08-10"
    low, high = event.evidence["date_ci"]
    assert low <= "2008-08-08" <= high
    assert event.evidence["change_deg"]["A"] == pytest.approx(2.0, abs=0.7)
    assert "N002: compass changed (by" in event.line


def test_an_event_is_reported_once_also_when_later_days_come_in(stepped, tmp_path):
    ds, fits = stepped
    before = find_events(ds, fits, until="2008-08-07")
    assert before.events == [] and before.until == "2008-08-07"
    first = find_events(ds, fits, previous=before, until="2008-08-11")
    assert [event.aircraft for event in first.new_events] == ["N002"]
    stored = read_events(write_events(first, tmp_path / "events.json"))
    assert stored == first
    second = find_events(ds, fits, previous=stored)
    assert second.new_events == [] and second.events == first.events


def test_states_hold_the_disagreement_of_the_winds_and_the_tables(stepped, monitored):
    ds, fits = stepped
    names = ("eastward_wind", "northward_wind")
    du, dv = (ds[name].to_numpy() - ds[f"reference_{name}"].to_numpy()[0] for name in names)
    n004, late = aircraft_of_report(ds) == 4, day_number(ds) >= 38
    state, size = monitored.states[4], np.hypot(du, dv) / KNOT
    assert state.disagreement_kt == pytest.approx(size[n004 & late].mean())
    assert state.past_disagreement_kt == pytest.approx(size[n004 & ~late].mean())
    assert (state.first_day, state.last_day, state.silent) == ("2008-07-01", "2008-08-14", False)
    assert state.tables_differ is False and state.table_difference_deg == 0.0
    table = fits["table_correction"].isel(reference=0, aircraft=4)
    np.testing.assert_allclose(state.table_now.correction_deg, table)


def test_an_outdated_table_on_board_is_reported(stepped, monitored, tmp_path):
    ds, fits = stepped
    path = write_tables_csv(fits, tmp_path / "tables.csv")
    read = read_tables(path, reference="ruc")
    mine, now = read["N004"], np.array(monitored.states[4].table_now.correction_deg)
    np.testing.assert_allclose(mine.correction_deg, now, atol=5e-4)
    off = replace(mine, correction_deg=[c + 1.5 for c in mine.correction_deg])
    monitoring = find_events(ds, fits, tables_in_use=read | {"N004": off})
    assert monitoring.differing == ["N004"]
    assert monitoring.states[4].table_difference_deg == pytest.approx(1.5, abs=1e-3)
    # the table first seen stays in use until another is named
    later = find_events(ds, fits, previous=monitoring)
    assert later.differing == ["N004"]
    path.write_text(path.read_text().replace("subtract_error", "add_error"))
    turned = read_tables(path, reference="ruc")["N004"]
    np.testing.assert_allclose(turned.correction_deg, -now, atol=5e-4)
    _, rows = path.read_text().split("\n", 1)
    path.write_text(path.read_text() + rows.replace(",ruc,", ",rr,"))
    with pytest.raises(InputError, match="tables against ruc, rr, none against nam"):
        read_tables(path, reference="nam")
    path.write_text("aircraft,heading\nN1,0\n")
    with pytest.raises(InputError, match="not a file of tables"):
        read_tables(path, reference="ruc")


def test_by_default_the_winds_are_compared_with_the_members_of_the_pool():
    ds, _ = fleet(5, Setting(aircraft=3, days=20, references=3), amplitude=2.0)
    members = ["ruc", "rtfdaa"]
    fits = fit_deviation(ds, pools={"ruc+rtfdaa": members}, shared_error=False)
    fits = add_tables(fits, ds)
    states = find_events(ds, fits).states
    assert states == find_events(ds, fits, members=members).states


def test_rising_disagreement_of_the_corrected_winds_is_reported():
    ds, _ = fleet(5, SMALL, amplitude=2.0)
    fits = fitted(ds)
    worse = (aircraft_of_report(ds) == 1) & (ds["time"].to_numpy() >= np.datetime64("2008-08-03"))
    noise = np.random.default_rng(2).normal(0, 6.0, worse.size) * worse
    ds = ds.assign(northward_wind=("report", ds["northward_wind"].to_numpy() + noise))
    monitoring = find_events(ds, fits, corrected=correct(ds, fits, reference="ruc"))
    (event,) = monitoring.events
    assert (event.kind, event.aircraft) == ("disagreement_rose", "N001")
    assert monitoring.events[0].evidence["factor"] > 1.5
    assert monitoring.states[1].disagreement_kt > 1.5 * monitoring.states[1].past_disagreement_kt
    assert monitoring.states[3].disagreement_kt < find_events(ds, fits).states[3].disagreement_kt


def test_new_and_silent_aircraft_are_events():
    ds, _ = fleet(7, SMALL, amplitude=2.0)
    day, who = day_number(ds), aircraft_of_report(ds)
    present = ~((who == 0) & (day < 30)) & ~((who == 5) & (day > 33))
    ds = some_reports(ds, present)
    fits, previous = fitted(ds), None
    for until, event in (
        ("2008-08-08", ("aircraft_new", "N000", "2008-07-31")),
        (None, ("aircraft_silent", "N005", "2008-08-04")),
    ):
        previous = find_events(ds, fits, previous=previous, until=until)
        assert [(e.kind, e.aircraft, e.date) for e in previous.new_events] == [event]
    assert [state.silent for state in previous.states] == [False] * 5 + [True]
    first = find_events(some_reports(ds, (who != 2)[present]), fits)
    assert [e.aircraft for e in find_events(ds, fits, previous=first).new_events] == ["N002"]


def test_a_second_change_soon_after_the_first_is_reported(stepped, monitored):
    """The file of the last run holds the first change; of the same archive another is found."""
    ds, fits = stepped
    (event,) = monitored.events
    early = replace(event, date="2008-07-25", noticed="2008-07-27")
    before = replace(monitored, until="2008-08-07", events=[early], reported_before=0)
    # one old event explains one new one, within a month of it
    assert find_events(ds, fits, previous=before).new_events == []
    of_another = replace(before, events=[replace(early, aircraft="N001")])
    assert find_events(ds, fits, previous=of_another).new_events == [event]
    # what an earlier run could have noticed a month ago and did not is not reported
    late = replace(before, until="2008-09-20", events=[])
    assert find_events(ds, fits, previous=late).new_events == []


def test_days_with_only_screened_reports_have_no_disagreement():
    ds, _ = fleet(7, replace(SMALL, aircraft=2, days=12), amplitude=2.0)
    fits = fitted(ds)
    none = ds.assign(screening=("report", np.full(ds.sizes["report"], 2, np.int32)))
    monitoring = find_events(none, fits)
    assert monitoring.events == [] and monitoring.states[0].disagreement_kt is None
    assert monitoring.states[0].last_day == "2008-07-12"
    with pytest.raises(InputError, match="no report to monitor"):
        find_events(none, fits, until="2008-06-01")


def test_a_silence_is_measured_by_the_aircrafts_past_and_days_of_the_fleet():
    daily = np.delete(np.arange(60), range(40, 48))  # nobody reports for eight days
    weekly = np.arange(0, 39, 7)  # last seen on day 35
    for second, silent in ((daily, []), (daily[:35], [(1, 35, True)])):
        seen = daily, second, weekly
        aircraft = np.repeat([0, 1, 2], [*map(len, seen)])
        first, spells = first_days_and_silences(aircraft, np.concatenate(seen), 4, 59)
        assert [(s.number, s.first, s.lasts) for s in spells] == silent
        assert first.tolist() == [0, 0, 0, 60]


def test_files_of_other_content_are_refused(tmp_path):
    path = tmp_path / "events.json"
    for text in ("{", "[]", '{"version": 9}', '{"version": 1, "states": [{}]}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"events\.json"):
            read_events(path)
