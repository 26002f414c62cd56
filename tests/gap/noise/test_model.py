"""The noise fit recovers the simulated parameters and is insensitive to sensor effects."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from airswing.gap.noise import fit_noise, flight_order, gross_errors, level_factors, whiten


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
    return fit_noise(data["residual"], SimpleNamespace(**data))


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


def test_large_deviation_of_one_aircraft_is_not_noise():
    data = flown_archive(1)
    error = np.radians(8) * np.sin(data["heading"]) * (data["aircraft"] == 2) * 110
    cross = np.stack([np.cos(data["heading"]), -np.sin(data["heading"])], -1)
    data["residual"] = data["residual"] + error[:, None] * cross
    fit = fitted(data)
    assert fit.model.correlated_sd == pytest.approx(2.3, rel=0.07)
    assert fit.gross.mean() < 1e-3


def test_larger_scatter_across_the_heading():
    data = flown_archive(2)
    isotropic = fitted(data)
    assert isotropic.model.along == isotropic.model.across == 1.0
    assert isotropic.gains.direction is None
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


def test_gross_errors_are_single_reports_not_long_departures():
    data = flown_archive(2, flights=300)
    first = np.flatnonzero(data["flight"] == 50)
    residual = data["residual"].copy()
    residual[first] += 15.0
    residual[first[3]] += 25.0
    found = np.flatnonzero(gross_errors(residual, flight_order(data["flight"], data["time"])))
    assert set(first) & set(found) == {first[3]}


def test_level_factors_follow_the_spread():
    rng = np.random.default_rng(3)
    log_pressure = np.linspace(np.log(2e4), np.log(9e4), 10_000)
    residual = rng.normal(size=(10_000, 2))
    residual[:4000] *= 2.0  # two of the five levels
    nodes, factors = level_factors(residual, log_pressure)
    assert nodes.size == 5 and (np.diff(nodes) > 0).all()
    np.testing.assert_allclose(factors[:2] / factors[2:4], 2.0, rtol=0.1)
    assert np.mean(factors**2) == pytest.approx(1.0)
    nodes, factors = level_factors(residual, np.full(10_000, 11.0))
    assert nodes.tolist() == [11.0] and factors.tolist() == [1.0]
