"""Calibration against known noise, and a placebo that closes nothing on held-out flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from tests.gap.toy import make_frame, noise_of

from airswing.gap.checks import calibrate, fit_placebo, lag_one, placebo_errors, two_sample
from airswing.gap.noise import (
    NoiseFit,
    NoiseModel,
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
    gains = kalman_gains(
        order,
        model.decay(*steps),
        np.ones(frame.size),
        np.ones(frame.size, bool),
        correlated_sd=2.0,
        white_sd=1.0,
    )
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
    return calibrate(frame, residual, noise=noise, day=frame.day, seed=1)


def test_correct_noise_is_calibrated(archive, drawn):
    made, pit = check(archive, drawn)
    assert made.spread == pytest.approx(1, abs=0.02)
    assert made.crps_m_s == pytest.approx(made.crps_expected_m_s, rel=0.03)
    assert abs(made.lag_one) < 4 * made.lag_one_standard_error + 1e-3
    assert abs(made.auc - 0.5) < 4 * made.auc_standard_error
    assert pit.sum() == 2 * len(drawn)
    expected = 2 * len(drawn) / pit.size
    assert np.abs(pit - expected).max() < 5 * np.sqrt(expected)


def test_underestimated_noise_shows_in_spread_and_score(archive, drawn):
    made, pit = check(archive, 1.5 * drawn)
    assert made.spread == pytest.approx(1.5, abs=0.04)
    assert made.crps_m_s > 1.3 * made.crps_expected_m_s
    assert pit[[0, -1]].mean() > 1.5 * pit[9:11].mean()


def test_the_classifier_detects_an_error_by_heading(archive, drawn):
    frame, _ = archive
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    made, _ = check(archive, drawn + 3.0 * np.sin(frame.magnetic_heading)[:, None] * right)
    assert made.auc > 0.5 + 5 * made.auc_standard_error


def test_gross_errors_are_left_out(archive):
    frame, noise = archive
    masked = np.arange(frame.size) % 50 == 0
    gains = replace(noise.gains, weight=np.where(masked, 0.0, noise.gains.weight))
    made, pit = check((frame, replace(noise, gains=gains)), np.zeros((frame.size, 2)))
    assert pit.sum() == 2 * (~masked).sum()
    assert made.spread == 0.0


def test_lag_one_by_hand():
    values = np.array([[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [2.0, 0.0]])
    kept = np.ones(4, bool)
    flight, time, day = np.array([1, 1, 1, 2]), np.array([0.0, 1.0, 2.0, 3.0]), np.zeros(4, int)
    assert lag_one(values, kept, flight, time, day)[0] == 0.0
    few = lag_one(values[:2], kept[:2], flight[:2], time[:2], day[:2])
    assert np.isnan(few).all()
    constant = np.repeat([[1.0, -1.0]], 4, axis=0)
    assert lag_one(constant, kept, np.ones(4, int), time, day)[0] == 1.0


def test_the_classifier_has_the_area_of_two_normal_samples():
    rng = np.random.default_rng(4)
    one, two = rng.normal(size=(2, 3000, 3))
    one[:, 1] += 1.0
    auc, error = two_sample(one, two, rng)
    assert auc == pytest.approx(norm.cdf(1 / np.sqrt(2)), abs=4 * error)
    few = np.zeros((10, 3))
    assert np.isnan(two_sample(few, few, rng)[0])


@pytest.fixture(scope="module")
def deviating():
    """Frame with a strong deviation on every aircraft, and its noise."""
    frame = make_frame(
        seed=3,
        aircraft=4,
        days=12,
        noise=0.3,
        heading_error=lambda context: np.radians(3.0) * np.sin(context["magnetic_heading"]),
    )
    return frame, noise_of(frame), frame.day - frame.day.min()


def test_placebo_closes_nothing_on_held_out_flights(deviating):
    frame, noise, day = deviating
    made = fit_placebo(frame, frame.residual, noise=noise, day=day, fold=day % 4)
    assert made.closes_nothing
    assert made.reduction_kt < 0.02
    assert made.reduction_where_fitted_kt > made.reduction_kt
    assert made.reduction_ci_kt[0] < made.reduction_kt < made.reduction_ci_kt[1]


def test_the_true_cause_closes_by_the_same_fit(deviating):
    frame, noise, day = deviating
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    cycle = np.stack([np.sin(frame.magnetic_heading), np.cos(frame.magnetic_heading)], -1)
    columns = -(frame.airspeed[:, None] * right)[:, :, None] * cycle[:, None, :]
    white = whiten(columns, noise.order, noise.gains)
    target = whiten(frame.residual, noise.order, noise.gains)
    _, error = placebo_errors(columns, white, target, frame.aircraft, day % 4)
    closed = np.hypot(*frame.residual.T) - np.hypot(*(frame.residual - error).T)
    assert closed.mean() > 0.5
