"""Calibration on made-up flights whose noise is known: right when right, and how it is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from tests.gap.toy import make_frame

from airswing.gap.checks.calibration import (
    area,
    calibrate,
    crps_normal,
    discriminant,
    lag_one,
    pit_histogram,
    two_sample,
)
from airswing.gap.noise.model import NoiseFit, NoiseModel
from airswing.gap.noise.whitening import flight_order, flight_steps, kalman_gains


@pytest.fixture(scope="module")
def flown():
    """Frame, and a noise model that is told, not fitted."""
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


def _drawn(frame, noise, rng):
    """Draw the noise flight by flight, by its definition: no use is made of the whitening."""
    out = rng.normal(size=(frame.size, 2))
    for number in np.unique(frame.flight):
        own = np.flatnonzero(frame.flight == number)
        own = own[np.argsort(frame.time[own])]
        state = 2.0 * rng.normal(size=2)
        for k, i in enumerate(own):
            if k:
                phi = noise.gains.decay[i]
                state = phi * state + 2.0 * np.sqrt(1 - phi**2) * rng.normal(size=2)
            out[i] += state
    return out


def _check(flown, residual):
    frame, noise = flown
    return calibrate(frame, residual, noise=noise, day=frame.day, seed=1)


def test_right_noise_is_calibrated(flown):
    frame, noise = flown
    made = _check(flown, _drawn(frame, noise, np.random.default_rng(0)))
    assert made.spread == pytest.approx(1, abs=0.02)
    assert made.crps_m_s == pytest.approx(made.crps_expected_m_s, rel=0.03)
    assert abs(made.lag_one) < 4 * made.lag_one_standard_error + 1e-3
    assert abs(made.auc - 0.5) < 4 * made.auc_standard_error
    assert made.pit_count.sum() == 2 * frame.size
    expected = 2 * frame.size / made.pit_count.size
    assert np.abs(made.pit_count - expected).max() < 5 * np.sqrt(expected)


def test_noise_taken_too_small_shows_in_spread_and_score(flown):
    frame, noise = flown
    made = _check(flown, 1.5 * _drawn(frame, noise, np.random.default_rng(0)))
    assert made.spread == pytest.approx(1.5, abs=0.04)
    assert made.crps_m_s > 1.3 * made.crps_expected_m_s
    ends, middle = made.pit_count[[0, -1]].mean(), made.pit_count[9:11].mean()
    assert ends > 1.5 * middle


def test_an_error_by_heading_is_told_by_the_classifier_alone(flown):
    frame, noise = flown
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    error = 3.0 * np.sin(frame.magnetic_heading)[:, None] * right
    made = _check(flown, _drawn(frame, noise, np.random.default_rng(0)) + error)
    assert made.auc > 0.5 + 5 * made.auc_standard_error


def test_gross_errors_are_left_out(flown):
    frame, noise = flown
    masked = np.zeros(frame.size, bool)
    masked[::50] = True
    gains = replace(noise.gains, weight=np.where(masked, 0.0, noise.gains.weight))
    made = _check((frame, replace(noise, gains=gains)), np.zeros((frame.size, 2)))
    assert made.pit_count.sum() == 2 * (~masked).sum()
    assert made.spread == 0.0


def test_crps_agrees_with_its_integral():
    grid = np.linspace(-40, 40, 400_001)
    for value, error in ((0.0, 1.0), (1.3, 2.0), (-2.0, 0.5)):
        at = value * error
        integrand = (norm.cdf(grid, scale=error) - (grid >= at)) ** 2
        integral = np.trapezoid(integrand, grid)
        assert crps_normal(np.array(value), np.array(error)) == pytest.approx(integral, abs=1e-3)


def test_crps_expected_is_that_of_a_right_prediction():
    values = np.random.default_rng(1).normal(size=200_000)
    assert crps_normal(values, np.ones(1)).mean() == pytest.approx(1 / np.sqrt(np.pi), rel=0.01)


def test_histogram_by_hand():
    counts = pit_histogram(norm.ppf([0.01, 0.31, 0.32, 0.99]))
    assert np.flatnonzero(counts).tolist() == [0, 6, 19] and counts[6] == 2
    counts = pit_histogram(np.array([-99.0, 99.0]))
    assert np.flatnonzero(counts).tolist() == [0, 19]


def test_lag_one_by_hand():
    values = np.array([[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [2.0, 0.0]])
    kept = np.ones(4, bool)
    flight, time, day = np.array([1, 1, 1, 2]), np.array([0.0, 1.0, 2.0, 3.0]), np.zeros(4, int)
    assert lag_one(values, kept, flight, time, day)[0] == 0.0
    assert lag_one(values[:2], kept[:2], flight[:2], time[:2], day[:2]) == pytest.approx(
        (float("nan"), float("nan")), nan_ok=True
    )
    same = np.repeat([[1.0, -1.0]], 4, axis=0)
    assert lag_one(same, kept, np.ones(4, int), time, day)[0] == 1.0


def test_area_by_hand():
    assert area(np.array([3.0, 4.0]), np.array([1.0, 2.0])) == 1.0
    assert area(np.array([1.0, 2.0]), np.array([1.0, 2.0])) == 0.5
    assert area(np.array([1.0]), np.array([2.0, 0.0])) == 0.5


def test_discriminant_points_to_what_differs():
    rng = np.random.default_rng(4)
    one, two = rng.normal(size=(2, 3000, 3))
    one[:, 1] += 1.0
    weights = discriminant(one, two)
    assert abs(weights[1]) > 5 * max(abs(weights[0]), abs(weights[2]))
    auc, error = two_sample(one, two, rng)
    assert auc == pytest.approx(norm.cdf(1 / np.sqrt(2)), abs=4 * error)


def test_few_flights_are_not_judged():
    few = np.zeros((10, 3))
    assert np.isnan(two_sample(few, few, np.random.default_rng(0))[0])
