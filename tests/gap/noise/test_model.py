"""The noise fit recovers the parameters it was given and keeps effects out of the noise."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.gap.noise.model import Flown, fit_noise
from airswing.gap.noise.residual_statistics import autocovariance
from airswing.gap.noise.whitening import flight_order, whiten


def flown_archive(seed: int = 0, flights: int = 900) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    length = rng.integers(8, 25, flights)
    flight = np.repeat(np.arange(flights), length)
    position = np.arange(flight.size) - np.repeat(np.r_[0, np.cumsum(length)[:-1]], length)
    latitude = 30 + 0.25 * position
    phi = np.exp(-np.radians(0.25) * 6.371e6 / 150e3)
    signal = np.zeros((flight.size, 2))
    for j in range(length.max()):
        now = np.flatnonzero(position == j)
        fresh = rng.normal(size=(now.size, 2))
        signal[now] = fresh if j == 0 else phi * signal[now - 1] + np.sqrt(1 - phi**2) * fresh
    return {
        "residual": 2.3 * signal + 0.9 * rng.normal(size=signal.shape),
        "aircraft": flight % 5,
        "flight": flight,
        "time": flight * 1e4 + position * 120.0,
        "latitude": latitude,
        "longitude": np.full(flight.size, -90.0),
        "pressure": np.full(flight.size, 5e4),
        "heading": rng.uniform(0, 2 * np.pi, flights)[flight],
        "airspeed": np.full(flight.size, 110.0),
    }


def fitted(data):
    reports = {name: values for name, values in data.items() if name != "residual"}
    return fit_noise(data["residual"], Flown(**reports))


def test_parameters_recovered_and_innovations_white():
    data = flown_archive()
    fit = fitted(data)
    assert fit.model.correlated_sd == pytest.approx(2.3, rel=0.06)
    assert fit.model.white_sd == pytest.approx(0.9, rel=0.08)
    assert fit.model.length == pytest.approx(150e3, rel=0.15)
    white = whiten(data["residual"], fit.order, fit.gains)
    assert white.std() == pytest.approx(1.0, abs=0.03)
    same = data["flight"][1:] == data["flight"][:-1]
    assert abs((white[1:] * white[:-1])[same].mean()) < 0.03
    good = fit.pair_count > 500
    np.testing.assert_allclose(fit.autocovariance[good], fit.autocovariance_model[good], atol=0.5)


def test_large_deviation_of_one_aircraft_does_not_pass_for_noise():
    data = flown_archive(1)
    error = np.radians(8) * np.sin(data["heading"]) * (data["aircraft"] == 2) * 110
    cross = np.stack([np.cos(data["heading"]), -np.sin(data["heading"])], -1)
    data["residual"] = data["residual"] + error[:, None] * cross
    fit = fitted(data)
    assert fit.model.correlated_sd == pytest.approx(2.3, rel=0.07)
    assert fit.gross.mean() < 1e-3


def test_the_model_meets_pairs_that_climbed_as_they_did():
    """Correlation of the model over a pair: by the way flown and by all the levels passed."""
    flight, time = np.zeros(3, int), np.arange(3.0)
    residual = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, 2.0]])
    distance, step = np.array([np.inf, 30e3, 40e3]), np.array([np.inf, 0.1, 0.2])
    _, covariance, correlation, count = autocovariance(
        residual,
        distance,
        step,
        flight_order(flight, time),
        decay=lambda way, climb: np.exp(-way / 100e3 - climb / 0.5),
    )
    np.testing.assert_array_equal(count[[0, 3, 4]], [3, 2, 1])
    assert covariance[3] == pytest.approx((0.5 * 2.0 + 0.5 * 8.0) / 2)
    assert correlation[3] == pytest.approx((np.exp(-0.5) + np.exp(-0.8)) / 2)
    assert correlation[4] == pytest.approx(np.exp(-0.7 - 0.6))


def test_a_compass_that_scatters_makes_errors_across_the_heading_larger():
    data = flown_archive(2)
    alike = fitted(data)
    assert alike.model.along == alike.model.across == 1.0 and alike.gains.evened is None
    beam = np.stack([np.cos(data["heading"]), -np.sin(data["heading"])], -1)
    across = (data["residual"] * beam).sum(axis=1)
    data["residual"] = data["residual"] + 0.8 * across[:, None] * beam
    fit = fitted(data)
    assert fit.model.across / fit.model.along == pytest.approx(1.8, rel=0.03)
    assert fit.model.across**2 + fit.model.along**2 == pytest.approx(2.0)
    spread = np.sqrt((1.8**2 + 1) / 2)
    assert fit.model.correlated_sd == pytest.approx(2.3 * spread, rel=0.06)
    white = whiten(data["residual"], fit.order, fit.gains)
    nose = beam @ np.array([[0, 1], [-1, 0]])
    for part in (beam, nose):
        assert (white * part).sum(axis=1).std() == pytest.approx(1.0, abs=0.04)
