"""Held-out reports: the predicted gain is realised, and there is none where there is none."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest

from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.evaluation.held_out import (
    cross_validate,
    flight_folds,
    only,
    predicted_reduction,
    virtual_field_test,
)
from airswing.evaluation.ranking import rank_aircraft
from airswing.products.ragged import aircraft_of_report
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet, flown

SETTING = Setting(aircraft=5, days=50, outliers=0.005)
AGAINST = {"pools": {"ruc": ["ruc"]}, "reference": "ruc"}
QUICK = AGAINST | {"joint": False}
UNTIL = date(2008, 8, 1)


@pytest.fixture(scope="module")
def headings():
    return fleet(3, SETTING, amplitude=5.0)[0]


def test_predicted_and_realised_gains_agree_over_many_fleets():
    scores = []
    for seed in range(8):
        ds = fleet(seed, SETTING, amplitude=5.0)[0]
        found = virtual_field_test(ds, learned_until=UNTIL, draws=300, **QUICK)
        for entry in found["by_aircraft"]:
            low, high = entry["difference_ci_kt"]
            scores.append(entry["difference_kt"] / ((high - low) / 3.92))
    scores = np.array(scores)
    assert scores.size >= 36
    # 40 standard scores: the mean within 3 / sqrt(40), 84 % or more inside 95 % intervals.
    assert abs(scores.mean()) < 0.48
    assert np.mean(np.abs(scores) < 1.96) >= 0.84
    assert np.abs(scores).max() < 4.5


def test_the_gain_is_what_the_corrected_winds_themselves_show(headings):
    found = virtual_field_test(headings, learned_until=UNTIL, draws=50, **AGAINST)
    group = found["groups"]["corrected"]
    assert set(found["groups"]) == {"corrected"}
    fall = group["during_uncorrected_kt"] - group["during_kt"]
    assert found["realised_gain_kt"] == pytest.approx(fall, abs=1e-9)
    low, high = found["realised_gain_ci_kt"]
    assert low < found["realised_gain_kt"] < high


def test_controls_keep_their_winds_and_any_split_will_do(headings):
    found = virtual_field_test(
        headings, learned_until=UNTIL, corrected=["N001", "N003"], draws=50, **QUICK
    )
    controls = found["groups"]["controls"]
    assert controls["during_kt"] == controls["during_uncorrected_kt"]
    assert controls["aircraft"] == 3
    assert {entry["aircraft"] for entry in found["by_aircraft"]} == {"N001", "N003"}


def test_nothing_after_the_date_reaches_the_fit(headings):
    """Ruin every later wind: the prediction stays what it was to the last bit."""
    late = headings["time"].to_numpy() >= np.datetime64(UNTIL)
    ruined = headings.copy(deep=True)
    for name in ("heading_error", "airspeed_error"):
        ruined[name][:, late] = 40.0
    ruined["eastward_wind"][late] += 30.0
    one, two = (
        virtual_field_test(ds, learned_until=UNTIL, draws=20, **QUICK) for ds in (headings, ruined)
    )
    assert one["predicted_gain_kt"] == two["predicted_gain_kt"]
    assert one["realised_gain_kt"] != two["realised_gain_kt"]


def test_the_prediction_for_a_field_test_uses_the_corrected_aircraft_only(headings):
    found = predicted_reduction(headings, start=UNTIL, corrected=["N002"], **QUICK)
    known = next(entry for entry in found["ranking"] if entry["aircraft"] == "N002")
    assert found["predicted_reduction_kt"] == pytest.approx(known["expected_gain_kt"])
    assert found["predicted_aircraft"] == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"corrected": ["N999"]}, ["N999", "does not hold"]),
        ({"corrected": []}, ["no aircraft"]),
        ({"learned_until": date(2001, 1, 1)}, ["2001-01-01", "2008-07-01"]),
        ({"learned_until": date(2020, 1, 1)}, ["no screened report from"]),
        ({"reference": "nam"}, ["nam", "ruc"]),
    ],
)
def test_bad_input_is_named(headings, options, words):
    asked = {"learned_until": UNTIL, "draws": 10} | QUICK | options
    with pytest.raises(InputError) as caught:
        virtual_field_test(headings, **asked)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_the_fleet_is_weighted_by_its_reports_and_one_day_has_no_interval(headings):
    found = virtual_field_test(headings, learned_until=UNTIL, draws=50, **QUICK)
    entries = found["by_aircraft"]
    share = np.array([entry["reports"] for entry in entries]) / found["reports"]
    assert share.sum() == pytest.approx(1.0)
    for name in ("predicted_gain_kt", "realised_gain_kt"):
        assert found[name] == pytest.approx(share @ [entry[name] for entry in entries])
    # the errors of different aircraft are independent
    errors = share * [entry["predicted_standard_error_kt"] for entry in entries]
    assert found["predicted_standard_error_kt"] == pytest.approx(np.sqrt((errors**2).sum()))
    day = headings["time"].to_numpy().astype("datetime64[D]")
    short = only(headings, day <= np.datetime64(UNTIL))
    found = virtual_field_test(short, learned_until=UNTIL, draws=50, **QUICK)
    assert np.isfinite(found["realised_gain_kt"])
    assert np.isnan(found["realised_gain_ci_kt"]).all()
    assert found["agree"] is None and found["by_aircraft"][0]["agree"] is None


def test_folds_hold_whole_flights_evenly_over_the_days(headings):
    number = flight_folds(headings, folds=4, seed=1)
    flight = headings["flight"].to_numpy()
    for one in np.unique(flight)[::37]:
        assert np.unique(number[flight == one]).size == 1
    # 4 flights a day and aircraft and 4 folds: every fold holds each day once
    day = headings["time"].to_numpy().astype("datetime64[D]")
    first = np.unique(flight, return_index=True)[1]
    aircraft = aircraft_of_report(headings)[first]
    for who in range(5):
        mine = first[aircraft == who]
        for k in range(4):
            assert np.unique(day[mine][number[mine] == k]).size == 50


def test_a_compass_without_deviation_gains_nothing_when_held_out():
    ds = flown(np.zeros((4, 5)), Setting(aircraft=4, days=30), 5)
    found = cross_validate(ds, folds=4, draws=100, **QUICK)
    # curves fitted to noise are not published, and one that is gains nothing
    for name in ("realised_gain_kt", "predicted_gain_kt"):
        assert found[name] is None or found[name] < 0.02


def test_held_out_flights_agree_with_the_prediction_and_given_fits_make_no_difference(headings):
    options = {"folds": 3, "draws": 100, "resolution": 1.0}
    found = cross_validate(headings, **options, **QUICK)
    assert found["agree"]
    assert found["realised_gain_kt"] > 1.0
    assert found["in_sample_gain_kt"] >= found["realised_gain_kt"] - 0.02
    fits = add_tables(fit_deviation(headings, joint=False), headings, resolution=1.0)
    ranking = rank_aircraft(headings, fits, **AGAINST)
    assert cross_validate(headings, whole=(fits, ranking), **options, **QUICK) == found


@pytest.mark.parametrize("folds", [1, 100_000])
def test_impossible_folds_are_refused(headings, folds):
    with pytest.raises(InputError, match="folds"):
        cross_validate(headings, folds=folds, **AGAINST)
