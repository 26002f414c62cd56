"""Calibration against known noise, placebos that close nothing, and fits without other effects."""

from datetime import date

import numpy as np
import pytest
from tests.compass.flown import NO_ERROR, Setting, fly
from tests.gap.toy import effect, make_frame

from airswing.gap import checks
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.model.sums import days_of
from airswing.gap.noise import (
    NoiseFit,
    NoiseModel,
    fit_noise,
    flight_order,
    flight_steps,
    kalman_gains,
    whiten,
)
from airswing.gap.simulation.forward import draw_noise


@pytest.fixture(scope="module")
def archive():
    """Frame, and a noise model with given parameters."""
    frame = make_frame(seed=2, aircraft=5, days=12)
    order = flight_order(frame.flight, frame.time)
    steps = flight_steps(frame.latitude, frame.longitude, np.log(frame.pressure), order)
    model = NoiseModel(2.0, 1.0, 150e3, 1.0, np.zeros(1), np.ones(1))
    every, size = np.ones(frame.size, bool), {"correlated_sd": 2.0, "white_sd": 1.0}
    gains = kalman_gains(order, model.decay(*steps), np.ones(frame.size), every, **size)
    none = np.zeros(1)
    noise = NoiseFit(model, order, gains, none, none, none, none, np.zeros(frame.size, bool))
    return frame, noise


@pytest.fixture(scope="module")
def drawn(archive):
    """Noise drawn along each flight, without the whitening."""
    frame, noise = archive
    return draw_noise(frame, noise.model, rng=np.random.default_rng(0))


def check(archive, residual):
    frame, noise = archive
    return checks.calibrate(frame, residual, noise=noise, day=days_of(frame)[1], seed=1)


def test_correct_noise_is_calibrated(archive, drawn):
    entry, pit = check(archive, drawn)
    assert entry.spread == pytest.approx(1, abs=0.02)
    assert entry.crps_m_s == pytest.approx(entry.crps_expected_m_s, rel=0.03)
    assert abs(entry.lag_one) < 4 * entry.lag_one_standard_error + 1e-3
    assert abs(entry.auc - 0.5) < 4 * entry.auc_standard_error
    assert pit.sum() == 2 * len(drawn)
    expected = 2 * len(drawn) / pit.size
    assert np.abs(pit - expected).max() < 5 * np.sqrt(expected)


def test_underestimated_noise_shows_in_spread_and_score(archive, drawn):
    entry, pit = check(archive, 1.5 * drawn)
    assert entry.spread == pytest.approx(1.5, abs=0.04)
    assert entry.crps_m_s > 1.3 * entry.crps_expected_m_s
    assert pit[[0, -1]].mean() > 1.5 * pit[9:11].mean()


def test_the_classifier_detects_an_error_by_heading(archive, drawn):
    frame, _ = archive
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    entry, _ = check(archive, drawn + 3.0 * np.sin(frame.magnetic_heading)[:, None] * right)
    assert entry.auc > 0.5 + 5 * entry.auc_standard_error


@pytest.fixture(scope="module")
def deviating():
    """Frame with a strong deviation on every aircraft, and its noise."""
    iron = effect("hard_iron", amplitude_deg=3.0)
    frame = make_frame(seed=3, aircraft=4, days=12, noise=0.3, effects=[iron])
    return frame, fit_noise(frame.residual, frame), days_of(frame)[1]


def test_placebo_closes_nothing_on_held_out_flights(deviating):
    frame, noise, day = deviating
    entry = checks.fit_placebo(frame, frame.residual, noise=noise, day=day, fold=day % 4)
    assert entry.closes_nothing
    assert entry.reduction_kt < 0.02
    assert entry.reduction_where_fitted_kt > entry.reduction_kt
    assert entry.reduction_ci_kt[0] < entry.reduction_kt < entry.reduction_ci_kt[1]


def test_the_true_cause_closes_by_the_same_fit(deviating):
    frame, noise, day = deviating
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    cycle = np.stack([np.sin(frame.magnetic_heading), np.cos(frame.magnetic_heading)], -1)
    columns = -(frame.airspeed[:, None] * right)[:, :, None] * cycle[:, None, :]
    white = whiten(columns, noise.order, noise.gains)
    target = whiten(frame.residual, noise.order, noise.gains)
    _, error = checks.placebo_errors(columns, white, target, frame.aircraft, day % 4)
    closed = np.hypot(*frame.residual.T) - np.hypot(*(frame.residual - error).T)
    assert closed.mean() > 0.5


SIZE = 1200


def headings(*, wrong=0.0, scale=0.0):
    """Two aircraft, one cycle of 2 degrees each; a wrong eastward model wind, airspeed factors."""
    size = {"aircraft": 2, "days": 30, "flights_a_day": 1, "reports_a_flight": 20}
    setting = Setting(bias=(wrong, 0.0), scale_spread=scale, noise=1.0, **size, **NO_ERROR)
    ds, _ = fly([[0.0, 1.8, 0.9, 0.0, 0.0]] * 2, setting, 0)
    shown = np.radians(ds["heading"])
    return ds.assign(
        ground_eastward_velocity=ds["eastward_wind"] + ds["airspeed"] * np.sin(shown),
        ground_northward_velocity=ds["northward_wind"] + ds["airspeed"] * np.cos(shown),
        roll_flag=("report", np.ones(SIZE, np.int8)),
        temperature_qc=("report", np.ones(SIZE, np.int8)),
    )


def adjustment(name, *, reported=0.0, reference=0.0):
    changes = (np.broadcast_to(change, (SIZE, 2)) for change in (reported, reference))
    return checks.Adjustment(np.arange(SIZE), *changes, (name,))


def test_an_airspeed_factor_is_removed_exactly():
    wrong, right = headings(scale=0.02), headings()
    winds = ("eastward_wind", "northward_wind")
    change = np.stack([right[wind].values - wrong[wind].values for wind in winds], -1)
    adjusted = checks.adjusted_headings(wrong, adjustment("tas_scale", reported=change))
    for name in ("heading", "magnetic_heading", "airspeed", "heading_error", "airspeed_error"):
        np.testing.assert_allclose(adjusted[name].values, right[name].values, atol=1e-9)
    assert (abs(wrong["airspeed"] - right["airspeed"]) > 0.5).any()


def test_fits_and_field_test_without_the_bias_of_a_reference_are_those_of_an_unbiased_one():
    test = {"start": date(2008, 7, 16), "before_start": date(2008, 7, 1), "draws": 50}
    test |= {"corrected": ["N000"], "controls": ["N001"]}
    test |= {"roll": "ignore", "temperature_qc": "ignore"}
    fit = {"shared_error": False, "min_reports": 100, "harmonics": 1, "joint": False}
    options = {"pools": {"ruc": ["ruc"]}, "reference": "ruc", "fit": fit}
    off = adjustment("reference_speed_bias", reference=[-6.0, 0.0])
    claims = checks.review_claims(headings(wrong=6.0), off, field_test=test, **options)
    clean = checks.review_claims(headings(), adjustment("time_lag"), field_test=test, **options)
    assert claims.taken_off == ["reference_speed_bias"]
    assert (claims.stay, claims.of) == (0, 2) and (clean.stay, clean.of) == (2, 2)
    for fit, clean_fit in zip(claims.aircraft, clean.aircraft, strict=True):
        assert fit.amplitude_deg_after == pytest.approx(clean_fit.amplitude_deg, abs=0.02)
        assert abs(fit.amplitude_deg - fit.amplitude_deg_after) > 0.5
    tested = claims.field_test
    assert tested.reduction_kt_after == pytest.approx(clean.field_test.reduction_kt, abs=1e-9)
    low, high = tested.reduction_ci_kt
    assert low <= tested.reduction_kt <= high
    assert tested.stays == (low <= tested.reduction_kt_after <= high)


def test_diagnosis_removes_the_airspeed_error_and_keeps_the_deviation():
    names = ("compass_offset", "hard_iron", "tas_scale", "reference_speed_bias")
    offset, scale = effect("compass_offset", [1], offset_deg=1.5), {"scale_percent": 2.0}
    effects = (offset, effect("tas_scale", [3], **scale))
    frame = make_frame(seed=9, aircraft=5, days=16, noise=0.3, effects=effects)
    diagnosis = diagnose(frame, catalogue={n: CATALOGUE[n] for n in names}, dictionary=False)
    assert {e.name for e in diagnosis.report.effects} == {"compass_offset", "tas_scale"}
    assert diagnosis.adjustment.names == ("tas_scale",)
    affected = frame.aircraft == 3
    assert not diagnosis.adjustment.reported[~affected].any()
    assert not diagnosis.adjustment.reference.any()
    air = np.stack([frame.ground_u - frame.u_rep, frame.ground_v - frame.v_rep], -1)
    corrected = np.hypot(*(air - diagnosis.adjustment.reported)[affected].T)
    assert np.median(frame.airspeed[affected] / corrected) == pytest.approx(1.02, abs=0.003)
