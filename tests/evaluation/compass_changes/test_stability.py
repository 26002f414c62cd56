"""Stability: changes are found, dated and told; a fleet without one stays quiet."""

from __future__ import annotations

import numpy as np
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import (
    ORIGIN,
    day_number,
    fleet,
    moved,
    persistent_error,
    with_change,
)

from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.compass_changes.change_dates import find_changes
from airswing.evaluation.compass_changes.change_notes import (
    add_changes,
    change_warnings,
    noted_changes,
)
from airswing.evaluation.compass_changes.window_fits import fit_by_window

# 8 flights of 12 reports: about 100 a day.
SETTING = Setting(aircraft=3, days=60, flights_a_day=8, day_error=1.2, outliers=0.005)
CHANGE = np.zeros((3, 5))
CHANGE[1, 0] = 2.0


def days(text: str) -> int:
    return int((np.datetime64(text) - ORIGIN).astype(int))


@pytest.fixture(scope="module")
def changed():
    ds = with_change(1, SETTING, day=35, change=CHANGE)
    return ds, find_changes(ds, members=["ruc"], draws=299)


def test_a_change_of_two_degrees_is_dated_within_a_week_over_many_fleets():
    errors, extra = [], 0
    for seed in range(10):
        at = int(np.random.default_rng(seed).integers(10, 50))
        ds = with_change(seed, SETTING, day=at, change=CHANGE)
        entries = find_changes(ds, members=["ruc"], draws=199)
        extra += len(entries[0]["changes"]) + len(entries[2]["changes"])
        assert len(entries[1]["changes"]) == 1
        change = entries[1]["changes"][0]
        errors.append(abs(days(change["date"]) - at))
        assert days(change["date_ci"][0]) <= at <= days(change["date_ci"][1])
    assert max(errors) <= 7
    assert extra <= 1


def test_the_size_of_the_change_is_told(changed):
    change = changed[1][1]["changes"][0]
    for name, truth in (("A", 2.0), ("B", 0.0), ("C", 0.0)):
        error = change["standard_error_deg"][name]
        assert abs(change["change_deg"][name] - truth) < 4 * error
        assert error < 0.5
    assert change["curve_rms_deg"] == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize("persistence", [0.0, 0.8])
def test_a_model_whose_errors_last_for_days_raises_no_alarm(persistence):
    setting = Setting(aircraft=5, days=60, day_error=0.0, outliers=0.005)
    alarms = 0
    for seed in range(15):
        ds = fleet(seed, setting, amplitude=4.0)[0]
        error = persistent_error(seed, 60, size=1.5, persistence=persistence)[day_number(ds)]
        ds = moved(ds, "ruc", error[:, 0], error[:, 1])
        entries = find_changes(ds, members=["ruc"], draws=199)
        alarms += any(entry["changes"] for entry in entries)
    # At most 2 % a fleet is promised: three in fifteen would come once in 350 such tests.
    assert alarms <= 2


def test_two_changes_of_one_compass_are_both_found():
    setting = Setting(aircraft=2, days=90, flights_a_day=6, day_error=0.8)
    step = np.zeros((2, 5))
    step[0, 1] = 3.0
    first = with_change(4, setting, day=30, change=step)
    back = fleet(4, setting, amplitude=4.0)[0]
    late = day_number(first) >= 60
    ds = first.assign(
        {
            name: (first[name].dims, np.where(late, back[name], first[name]))
            for name in (
                "heading_error",
                "airspeed_error",
                "heading",
                "magnetic_heading",
                "airspeed",
            )
        }
    )
    entries = find_changes(ds, members=["ruc"], draws=299)
    assert [days(one["date"]) for one in entries[0]["changes"]] == pytest.approx([30, 60], abs=2)
    assert entries[1]["changes"] == []


def test_a_fit_that_straddles_a_change_says_so(changed):
    ds, entries = changed
    fits = add_changes(fit_deviation(ds), entries)
    assert fits["change_count"].to_numpy().tolist() == [0, 1, 0]
    assert np.isnat(fits["change_date"].to_numpy()).tolist() == [True, False, True]
    assert fits["change_date_low"][1] <= fits["change_date"][1] <= fits["change_date_high"][1]
    assert fits["change_p_value"][1] <= 0.02 < fits["change_p_value"][0]
    lines = change_warnings(fits)
    assert len(lines) == 1
    assert all(word in lines[0] for word in ("N001", "2008-08-05", "straddles"))
    assert change_warnings(fit_deviation(ds)) == []


def test_the_changes_are_noted_beside_the_fits_as_they_were_found(changed):
    ds, entries = changed
    fits = fit_deviation(ds)
    assert noted_changes(add_changes(fits, entries)) == entries
    with pytest.raises(InputError, match="which compasses changed"):
        noted_changes(fits)


def test_too_few_days_say_nothing():
    ds = fleet(1, Setting(aircraft=2, days=8))[0]
    assert [entry["p_value"] for entry in find_changes(ds, members=["ruc"])] == [None, None]
    fits = add_changes(fit_deviation(ds), find_changes(ds, members=["ruc"]))
    assert np.isnan(fits["change_p_value"]).all()


@pytest.mark.parametrize(
    ("window", "firsts"),
    [
        ("month", ["2008-07-01", "2008-08-01"]),
        ("quarter", ["2008-07-01"]),
    ],
)
def test_windows_are_those_of_the_calendar_and_use_their_own_reports(changed, window, firsts):
    ds, _ = changed
    found = fit_by_window(ds, pools={"ruc": ["ruc"]}, reference="ruc", window=window)
    own = [entry for entry in found if entry["aircraft"] == "N001"]
    assert [entry["window"] for entry in own] == firsts
    assert sum(entry["reports"] for entry in own) == ds.sizes["report"] // 3
    if window == "month":
        # The change came on 5 August: July is before it, August mostly after.
        rise = own[1]["offset"] - own[0]["offset"]
        assert 1.2 < rise < 2.2


def test_a_window_with_too_few_reports_has_its_status(changed):
    found = fit_by_window(
        changed[0], pools={"ruc": ["ruc"]}, reference="ruc", min_reports=1_000_000
    )
    assert {entry["status"] for entry in found} == {"too_few_reports"}
    assert all("offset" not in entry for entry in found)


@pytest.mark.parametrize("options", [{"window": "week"}, {"reference": "nam"}])
def test_an_unknown_window_or_reference_is_named(changed, options):
    asked = {"pools": {"ruc": ["ruc"]}, "reference": "ruc"} | options
    with pytest.raises(InputError, match=next(iter(options.values()))):
        fit_by_window(changed[0], **asked)
