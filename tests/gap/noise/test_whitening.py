"""The recursion is the Cholesky whitening of the same covariance, and leaves white noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from airswing.gap.noise.whitening import (
    Evened,
    flight_order,
    flight_steps,
    kalman_gains,
    take_gains,
    whiten,
)


def _covariance(position: np.ndarray, *, signal: float, white: float, length: float) -> np.ndarray:
    gap = np.abs(position[:, None] - position[None, :])
    return signal**2 * np.exp(-gap / length) + white**2 * np.eye(position.size)


def _steps(position: np.ndarray) -> np.ndarray:
    return np.r_[np.inf, np.diff(position)]


def test_one_flight_equals_cholesky_whitening():
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.uniform(5, 60, 12))
    order = flight_order(np.zeros(12, int), np.arange(12.0))
    decay = np.exp(-_steps(position) / 150)
    gains = kalman_gains(
        order, decay, np.ones(12), np.ones(12, bool), correlated_sd=2.3, white_sd=0.9
    )
    values = rng.normal(size=(12, 3))
    factor = np.linalg.cholesky(_covariance(position, signal=2.3, white=0.9, length=150))
    np.testing.assert_allclose(
        whiten(values, order, gains), np.linalg.solve(factor, values), atol=1e-12
    )


def test_masked_report_equals_whitening_without_it():
    rng = np.random.default_rng(1)
    position = np.cumsum(rng.uniform(5, 60, 9))
    keep = np.ones(9, bool)
    keep[4] = False
    order = flight_order(np.zeros(9, int), np.arange(9.0))
    gains = kalman_gains(
        order, np.exp(-_steps(position) / 150), np.ones(9), keep, correlated_sd=2.0, white_sd=1.0
    )
    values = rng.normal(size=(9, 1))
    out = whiten(values, order, gains)
    factor = np.linalg.cholesky(_covariance(position[keep], signal=2.0, white=1.0, length=150))
    np.testing.assert_allclose(out[keep], np.linalg.solve(factor, values[keep]), atol=1e-12)
    assert out[4, 0] == 0


def test_flights_do_not_touch_each_other_whatever_their_order():
    rng = np.random.default_rng(2)
    flight = np.repeat([7, 3, 9], [4, 6, 1])
    time = np.r_[np.arange(4.0), np.arange(6.0), 0.0]
    order = flight_order(flight, time)
    assert sorted(order.index) == list(range(11))
    assert list(np.diff(order.starts)) == [3, 2, 2, 2, 1, 1]
    decay = np.full(11, 0.8)
    gains = kalman_gains(
        order, decay, np.ones(11), np.ones(11, bool), correlated_sd=2.0, white_sd=1.0
    )
    values = rng.normal(size=(11, 2))
    whole = whiten(values, order, gains)
    for number in (7, 3, 9):
        own = np.flatnonzero(flight == number)
        alone = whiten(values[own], flight_order(flight[own], time[own]), take_gains(gains, own))
        np.testing.assert_allclose(whole[own], alone)


def test_level_factor_divides_out():
    order = flight_order(np.zeros(5, int), np.arange(5.0))
    keep, decay = np.ones(5, bool), np.full(5, 0.7)
    level = np.array([1.0, 2.0, 0.5, 1.5, 1.0])
    values = np.arange(5.0)[:, None]
    one = kalman_gains(order, decay, np.ones(5), keep, correlated_sd=2.0, white_sd=1.0)
    two = kalman_gains(order, decay, level, keep, correlated_sd=2.0, white_sd=1.0)
    np.testing.assert_allclose(
        whiten(values * level[:, None], order, two), whiten(values, order, one)
    )


def test_flight_steps_by_hand():
    order = flight_order(np.array([1, 1, 2]), np.array([0.0, 60.0, 0.0]))
    distance, step = flight_steps(
        np.array([40.0, 41.0, 10.0]), np.array([-90.0, -90.0, 0.0]), np.log([9e4, 8e4, 5e4]), order
    )
    assert np.isinf(distance[[0, 2]]).all()
    assert distance[1] == pytest.approx(np.radians(1) * 6.371e6, rel=1e-9)
    assert step[1] == pytest.approx(np.log(9 / 8))


def test_errors_larger_across_the_heading_are_whitened_by_their_whole_covariance():
    """Energies r' V^-1 x with V the covariance of east and north of all reports together."""
    rng = np.random.default_rng(5)
    position, heading = np.cumsum(rng.uniform(5, 60, 8)), rng.uniform(0, 2 * np.pi, 8)
    order = flight_order(np.zeros(8, int), np.arange(8.0))
    level = rng.uniform(0.8, 1.3, 8)
    alike = kalman_gains(
        order,
        np.exp(-_steps(position) / 150),
        level,
        np.ones(8, bool),
        correlated_sd=2.0,
        white_sd=0.5,
    )
    uneven = Evened(np.stack([np.sin(heading), np.cos(heading)]), 0.6, 1.3)
    gains = replace(alike, evened=uneven.inverse)
    values = rng.normal(size=(8, 2, 3))
    white = whiten(values, order, gains).reshape(16, 3)
    root = np.zeros((8, 2, 8, 2))
    for i, a in enumerate(heading):
        nose, beam = np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])
        root[i, :, i] = level[i] * (0.6 * np.outer(nose, nose) + 1.3 * np.outer(beam, beam))
    root = root.reshape(16, 16)
    covariance = _covariance(position, signal=2.0, white=0.5, length=150)
    covariance = root @ np.kron(covariance, np.eye(2)) @ root
    flat = values.reshape(16, 3)
    np.testing.assert_allclose(
        white.T @ white, flat.T @ np.linalg.solve(covariance, flat), rtol=1e-10
    )
    back = gains.evened.by_report(uneven.by_report(values))
    np.testing.assert_allclose(back, values, atol=1e-14)
    some = np.array([1, 4])
    np.testing.assert_allclose(
        take_gains(gains, some).evened.by_report(values[some]),
        gains.evened.by_report(values)[some],
    )
