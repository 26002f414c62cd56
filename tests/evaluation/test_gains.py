"""Expected gain by hand, the ranking, and gains realised on reports that were held out."""

from datetime import date

import numpy as np
import pytest

from airswing.compass.correction import add_tables
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.gains import (
    cross_validate,
    expected_gain,
    rank_aircraft,
    restrict,
    virtual_field_test,
)
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
    entries = []
    for seed in range(5):
        ds = fleet(seed, SETTING, amplitude=5.0)[0]
        entries += virtual_field_test(ds, learned_until=UNTIL, draws=300, **QUICK)["by_aircraft"]
    width = np.array([np.ptp(entry["difference_ci_kt"]) for entry in entries])
    scores = np.array([entry["difference_kt"] for entry in entries]) / (width / 3.92)
    assert scores.size >= 22
    # 25 standard scores: the mean within 3 / sqrt(25), 84 % or more inside 95 % intervals.
    assert abs(scores.mean()) < 0.6
    assert np.mean(np.abs(scores) < 1.96) >= 0.84
    assert np.abs(scores).max() < 4.5


@pytest.mark.parametrize("corrected", [None, ["N001", "N003"]])
def test_the_gain_is_that_of_the_corrected_winds(headings, corrected):
    options = {"learned_until": UNTIL, "draws": 50} | AGAINST
    test = virtual_field_test(headings, corrected=corrected, **options)
    group = test["groups"]["corrected"]
    fall = group["during_uncorrected_kt"] - group["during_kt"]
    assert test["realised_gain_kt"] == pytest.approx(fall, abs=1e-9)
    low, high = test["realised_gain_ci_kt"]
    assert low < test["realised_gain_kt"] < high
    names = [entry["aircraft"] for entry in test["by_aircraft"]]
    assert names == (corrected or headings["aircraft"].to_numpy().tolist())


def test_the_prediction_uses_no_report_after_the_date(headings):
    """Ruin every later wind: the prediction stays what it was to the last bit."""
    late = headings["time"].to_numpy() >= np.datetime64(UNTIL)
    ruined = headings.copy(deep=True)
    for name in ("heading_error", "airspeed_error"):
        ruined[name][:, late] = 40.0
    ruined["eastward_wind"][late] += 30.0
    options = {"learned_until": UNTIL, "draws": 20} | QUICK
    test, test_of_ruined = (virtual_field_test(ds, **options) for ds in (headings, ruined))
    assert test["predicted_gain_kt"] == test_of_ruined["predicted_gain_kt"]
    assert test["realised_gain_kt"] != test_of_ruined["realised_gain_kt"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"corrected": ["N999"]}, ["N999", "does not hold"]),
        ({"corrected": []}, ["corrected: the group names no aircraft"]),
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
    test = virtual_field_test(headings, learned_until=UNTIL, draws=50, **QUICK)
    entries = test["by_aircraft"]
    share = np.array([entry["reports"] for entry in entries]) / test["reports"]
    assert share.sum() == pytest.approx(1.0)
    for name in ("predicted_gain_kt", "realised_gain_kt"):
        assert test[name] == pytest.approx(share @ [entry[name] for entry in entries])
    # the errors of different aircraft are independent
    errors = share * [entry["predicted_standard_error_kt"] for entry in entries]
    assert test["predicted_standard_error_kt"] == pytest.approx(np.sqrt((errors**2).sum()))
    day = headings["time"].to_numpy().astype("datetime64[D]")
    short = restrict(headings, day <= np.datetime64(UNTIL))
    test = virtual_field_test(short, learned_until=UNTIL, draws=50, **QUICK)
    assert np.isfinite(test["realised_gain_kt"])
    assert np.isnan(test["realised_gain_ci_kt"]).all()
    assert test["agree"] is None and test["by_aircraft"][0]["agree"] is None


def test_a_compass_without_deviation_gains_nothing_when_held_out():
    ds = flown(np.zeros((4, 5)), Setting(aircraft=4, days=30), 5)
    fits = add_tables(fit_deviation(ds, joint=False), ds)
    gains = cross_validate(ds, fits, draws=100, **AGAINST)
    # curves fitted to noise are not published, and one that is gains nothing
    for name in ("realised_gain_kt", "predicted_gain_kt"):
        assert gains[name] is None or gains[name] < 0.02


def test_held_out_days_agree_with_the_prediction(headings):
    """105 minutes later the last flight of a day ends after midnight: that part is left out."""
    headings = headings.assign(time=headings["time"] + np.timedelta64(105, "m"))
    fits = add_tables(fit_deviation(headings, joint=False), headings, resolution=1.0)
    gains = cross_validate(headings, fits, draws=100, **AGAINST)
    assert gains["folds"] == 10 and gains["agree"]
    assert gains["realised_gain_kt"] > 1.0
    day = headings["time"].to_numpy().astype("datetime64[D]").reshape(-1, 12)
    assert gains["reports"] == (day == day[:, :1]).sum() < day.size
    ranking = rank_aircraft(headings, fits, **AGAINST)
    assert cross_validate(headings, fits, ranking=ranking, draws=100, **AGAINST) == gains


@pytest.mark.parametrize("joint", [False, True])
def test_held_out_coefficients_equal_those_of_a_fit_without_the_fold(headings, joint):
    """First order against a fit of the other reports: closer than a fifth of a standard error."""
    complete = fit_deviation(headings, joint=joint).isel(reference=0)
    error = np.sqrt(np.diagonal(complete["deviation_covariance"].to_numpy(), axis1=1, axis2=2))
    day = headings["time"].to_numpy().astype("datetime64[D]").astype(int)
    for fold in (0, 3):
        refit = fit_deviation(restrict(headings, day % 10 != fold), joint=joint).isel(reference=0)
        same = (refit["harmonics"] == complete["harmonics"]).to_numpy()
        assert same.sum() >= 4
        complete_difference, fold_difference = (
            np.abs((deviation - refit["deviation"]).to_numpy() / error)[same]
            for deviation in (complete["deviation"], complete["held_out_deviation"].isel(fold=fold))
        )
        assert fold_difference.max() < 0.2 < 0.6 < complete_difference.max()


AMPLITUDE = np.array([6.0, 0.0, 3.0, 1.5])


@pytest.fixture(scope="module")
def ranked():
    ds = flown(np.outer(AMPLITUDE, [0, 1, 0, 0, 0]), Setting(aircraft=4, days=40), 2)
    return ds, rank_aircraft(ds, fit_deviation(ds), **AGAINST)


def by_hand(spread_deg):
    """Four headings, calm reference, exact unit 10 degrees off at every heading, 100 m/s."""
    heading, noise = np.radians([0.0, 90.0, 180.0, 270.0]), np.array([1.0, -1.0, 1.0, -1.0])
    shown = heading - np.radians(10.0)
    u, v = 100 * (np.sin(shown) - np.sin(heading)), 100 * (np.cos(shown) - np.cos(heading))
    curve, covariance = np.array([10.0, 0, 0, 0, 0]), np.diag([spread_deg**2, 0, 0, 0, 0])
    winds = np.stack([u + noise, v]), np.zeros((2, 4))
    report = heading, heading, np.full(4, 100.0), np.arange(4)
    return expected_gain(*winds, *report, curve, covariance, draws=200)


def test_the_gain_by_hand_and_its_fall_by_the_optimism_of_an_uncertain_curve():
    """The unit's error is 2 V sin 5 deg = 17.43 m/s; the noise of 1 m/s is left.

    0.1 degrees at 100 m/s is s = 0.1745 m/s; 2 s^2 pi / 8 = 0.0239 m/s with |e| = 1.
    """
    before, certain, _ = by_hand(0.0)
    assert before == pytest.approx(2 * 100 * np.sin(np.radians(5.0)), abs=0.1)
    assert certain == pytest.approx(before - 1.0, abs=1e-9)
    _, uncertain, drawn = by_hand(0.1)
    assert certain - uncertain == pytest.approx(2 * 0.17453**2 * np.pi / 8, rel=1e-3)
    assert drawn.std() > 0.1


def test_coefficients_that_were_not_fitted_cost_no_gain(ranked):
    """A second cycle that is published as zero has a variance, but not from sampling."""
    fits = fit_deviation(ranked[0], joint=False).isel(reference=[0])
    wider = fits["deviation_covariance"] + np.diag([0.0, 0.0, 0.0, 1.0, 1.0])
    narrow, wide = (
        {entry["aircraft"]: entry for entry in rank_aircraft(ranked[0], case, **AGAINST)}
        for case in (fits, fits.assign(deviation_covariance=wider))
    )
    single = fits["aircraft"].to_numpy()[fits["harmonics"].to_numpy()[0] == 1]
    assert single.size >= 2
    for name in single:
        assert narrow[name]["expected_gain_ci_kt"] == wide[name]["expected_gain_ci_kt"]


def test_the_gain_of_a_constant_is_reduced_by_its_sampling_error_only():
    """Two opposite headings: of a curve only the constant is fitted, and its cycles persist."""
    entries = []
    for seed in range(3):
        curves = np.tile([3.0, 1.5, 0.0, 0.0, 0.0], (4, 1))
        ds = flown(curves, Setting(aircraft=4, days=50), seed)
        away = np.abs((ds["magnetic_heading"] - 75.0 + 90.0) % 180.0 - 90.0) > 20.0
        ds["screening"] = (8 * away).astype(np.int32)
        entries += virtual_field_test(ds, learned_until=UNTIL, draws=300, **QUICK)["by_aircraft"]
    assert len(entries) == 12
    predicted, error, difference = (
        np.array([entry[f"{name}_kt"] for entry in entries])
        for name in ("predicted_gain", "predicted_standard_error", "difference")
    )
    # 3 degrees at 110 m/s are 11 kt; the noise and the cycle of 1.5 degrees remain
    assert predicted.min() > 0.0 and error.max() < 2.5
    width = np.array([np.ptp(entry["difference_ci_kt"]) for entry in entries])
    scores = difference / (width / 3.92)
    # 12 standard scores: the mean within 3 / sqrt(12)
    assert abs(scores.mean()) < 0.87 and np.abs(scores).max() < 3.5


def test_the_worst_compass_comes_first_and_a_good_one_gains_nothing(ranked):
    _, ranking = ranked
    assert [entry["aircraft"] for entry in ranking] == ["N000", "N002", "N003", "N001"]
    assert [entry["rank"] for entry in ranking] == [1, 2, 3, 4]
    assert abs(ranking[-1]["expected_gain_kt"]) < 0.15
    for entry in ranking:
        low, high = entry["expected_gain_ci_kt"]
        assert low <= entry["expected_gain_kt"] <= high
        assert entry["rank_ci"][0] <= entry["rank"] <= entry["rank_ci"][1]


def test_an_aircraft_without_a_fit_is_last_with_its_reason(ranked):
    few = ranked[0].copy(deep=True)
    few["screening"][50 : few.sizes["report"] // 4] = 1
    last = rank_aircraft(few, fit_deviation(few), **AGAINST)[-1]
    assert (last["aircraft"], last["rank"]) == ("N000", None)
    assert "too_few_reports" in last["why"]


def test_a_fit_without_reports_against_the_reference_states_that_as_the_reason(ranked):
    headings, fits = ranked[0], fit_deviation(ranked[0])
    first = np.arange(headings.sizes["report"]) < int(headings["row_size"][0])
    screened = headings.assign(screening=headings["screening"] + first)
    last = rank_aircraft(screened, fits, **AGAINST)[-1]
    assert (last["aircraft"], last["status"]) == ("N000", "ok")
    assert last["why"] == "no screened report has a wind of the reference"


def test_fits_are_matched_by_the_names_of_the_aircraft(ranked):
    headings, ranking = ranked
    fits = fit_deviation(headings)
    assert rank_aircraft(headings, fits.isel(aircraft=slice(None, None, -1)), **AGAINST) == ranking
    with pytest.raises(InputError, match=r"no fit of an aircraft \(found: N003"):
        rank_aircraft(headings, fits.isel(aircraft=slice(3)), **AGAINST)
