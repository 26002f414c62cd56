"""Acceleration at the reports, estimated from all flights."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.acceleration import (
    acceleration_at_reports,
    expected_acceleration,
    fit_levelling,
    time_since_levelling,
)


def test_time_of_levelling_off_is_extrapolated_from_the_climb():
    # 10 m/s up to 3000 m, reached 30 s after the report at 2700 m; then cruise
    time = np.array([0.0, 60, 120, 180, 300, 420, 540, 660])
    altitude = np.array([1500.0, 2100, 2700, 3000, 3000, 3000, 3000, 3000])
    phase = np.array([1, 1, 1, 2, 2, 2, 2, 2])
    since = time_since_levelling(time, altitude, phase, np.zeros(8, int))
    np.testing.assert_allclose(since[3:], [30, 150, 270, 390, 510])
    assert np.isnan(since[:3]).all()


def _flights(number: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Start, end and mean speed of four chords of flights whose acceleration is known."""
    fine = np.arange(0.0, 1200.0, 0.5)
    gain = np.where(fine < 30, 0.3, 0.3 * np.exp(-(fine - 30) / 45))
    path = np.cumsum(np.cumsum(gain) * 0.5) * 0.5
    first = rng.uniform(0, 60, number)
    edges = first[:, None] + 120.0 * np.arange(5)
    distance = np.interp(edges, fine, path)
    mean = np.diff(distance, axis=1) / 120 + rng.normal(120, 8, (number, 1))
    mean += rng.normal(0, 1.0, mean.shape)
    flight = np.repeat(np.arange(number), 4)
    return edges[:, :-1].ravel(), edges[:, 1:].ravel(), mean.ravel(), flight


def test_acceleration_after_levelling_off_from_longer_chords():
    gain = fit_levelling(*_flights(1500, np.random.default_rng(3)))
    assert gain is not None
    found = np.interp([10.0, 50.0, 90.0, 200.0], [0, 20, 40, 65, 100, 150, 210], gain)
    truth = 0.3 * np.exp(-np.maximum(np.array([10.0, 50.0, 90.0, 200.0]) - 30, 0) / 45)
    np.testing.assert_allclose(found, truth, atol=0.06)


def test_too_few_flights():
    assert fit_levelling(*_flights(20, np.random.default_rng(3))) is None


def test_unknown_acceleration_remains_unknown():
    unknown = np.full(6, np.nan)
    time = 60.0 * np.arange(6)
    found = acceleration_at_reports(
        unknown, np.full(6, 5e4), np.full(6, 2), np.zeros(6, int), time, time / 100, time / 100
    )
    assert np.isnan(found).all()


def test_acceleration_is_the_fleets_profile_and_not_the_reports_noise():
    rng = np.random.default_rng(2)
    phase = np.tile(np.repeat([1, 2, 3], 20), 400)
    flight = np.repeat(np.arange(400), 60)
    level = np.tile(
        np.concatenate(
            [np.linspace(11.5, 10.6, 20), np.full(20, 10.6), np.linspace(10.6, 11.5, 20)]
        ),
        400,
    )
    true = np.choose(phase, [0.0, 0.06 - 0.02 * (11.5 - level), 0.0, -0.05])
    found = expected_acceleration(true + rng.normal(0, 0.05, phase.size), level, phase, flight)
    steady = phase != 2
    np.testing.assert_allclose(found[steady], true[steady], atol=0.006)


def test_chords_spreading_is_undone_in_cruise():
    # a curve x^2 under a triangle over (-1, 1) is x^2 + 1/6
    true = np.arange(-3.0, 4.0) ** 2
    found = expected_acceleration(true + 1 / 6, np.full(7, 10.5), np.full(7, 2), np.zeros(7, int))
    np.testing.assert_allclose(found[1:-1], true[1:-1], atol=1e-12)
