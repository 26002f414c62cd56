"""Whitening and interpolation errors against the full covariance matrix of the same reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from airswing.gap.noise import (
    DirectionFactors,
    Gains,
    flight_order,
    flight_steps,
    interpolation_errors,
    kalman_gains,
    whiten,
)

LENGTH = 150.0
SIGNAL, WHITE = 2.1, 0.5


def flights(keep=None, *, anisotropic=False):
    """Three flights in any order: order, gains and covariance (2 n, 2 n) of east and north."""
    rng = np.random.default_rng(4)
    flight = np.repeat([7, 3, 9], [5, 7, 1])
    keep = np.ones(13, bool) if keep is None else keep
    step = np.where(np.r_[True, flight[1:] != flight[:-1]], np.inf, rng.uniform(5, 60, 13))
    order = flight_order(flight, np.arange(13.0))
    level = rng.uniform(0.8, 1.3, 13)
    gains = kalman_gains(
        order, np.exp(-step / LENGTH), level, keep, correlated_sd=SIGNAL, white_sd=WHITE
    )
    position = np.cumsum(np.where(np.isfinite(step), step, 0.0))
    gap = np.abs(position[:, None] - position)
    signal = np.where(flight[:, None] == flight, SIGNAL**2 * np.exp(-gap / LENGTH), 0.0)
    covariance = (signal + WHITE**2 * np.eye(13)) * level[:, None] * level
    covariance = np.kron(covariance, np.eye(2))
    if anisotropic:
        heading = rng.uniform(0, 2 * np.pi, 13)
        factors = DirectionFactors.from_heading(heading, 0.7, 1.2)
        gains = replace(gains, direction=factors.inverse)
        root = np.zeros((13, 2, 13, 2))
        for i, a in enumerate(heading):
            along, across = np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])
            root[i, :, i] = 0.7 * np.outer(along, along) + 1.2 * np.outer(across, across)
        root = root.reshape(26, 26)
        covariance = root @ covariance @ root
    return flight, order, gains, covariance


MASKED = np.isin(np.arange(13), [2, 8])


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("columns", [3, 40])  # above 32 columns the memory layout is another
@pytest.mark.parametrize("keep", [None, ~MASKED])
def test_whitening_is_that_of_the_full_covariance(keep, columns, anisotropic):
    _, order, gains, covariance = flights(keep, anisotropic=anisotropic)
    values = np.random.default_rng(1).normal(size=(13, 2, columns))
    white = whiten(values, order, gains)
    kept = np.ones(13, bool) if keep is None else keep
    assert not white[~kept].any()
    both = np.repeat(kept, 2)
    flat, white = values.reshape(26, -1)[both], white.reshape(26, -1)[both]
    expected = flat.T @ np.linalg.solve(covariance[np.ix_(both, both)], flat)
    np.testing.assert_allclose(white.T @ white, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("keep", [None, ~MASKED])
def test_interpolation_errors_are_those_of_the_inverse_covariance(keep, anisotropic):
    _, order, gains, covariance = flights(keep, anisotropic=anisotropic)
    values = np.random.default_rng(2).normal(size=(13, 2))
    errors, precision = interpolation_errors(values, order, gains)
    kept = np.ones(13, bool) if keep is None else keep
    assert not errors[~kept].any() and not precision[~kept].any()
    both = np.repeat(kept, 2)
    inverse = np.linalg.inv(covariance[np.ix_(both, both)])
    score = (inverse @ values.ravel()[both]).reshape(-1, 2)
    blocks = [inverse[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(kept.sum())]
    expected = [np.linalg.solve(block, row) for block, row in zip(blocks, score, strict=True)]
    np.testing.assert_allclose(errors[kept], expected, atol=1e-10)
    if not anisotropic:
        np.testing.assert_allclose(precision[kept], [b[0, 0] for b in blocks], rtol=1e-10)


def test_flights_are_independent():
    flight, order, gains, _ = flights()
    assert list(np.diff(order.starts)) == [3, 2, 2, 2, 2, 1, 1]
    values = np.random.default_rng(3).normal(size=(13, 2))
    white = whiten(values, order, gains)
    for number in (7, 3, 9):
        rows = np.flatnonzero(flight == number)
        part = flight_order(flight[rows], rows.astype(float))
        own = Gains(*(getattr(gains, f)[rows] for f in ("decay", "gain", "weight", "scale")))
        np.testing.assert_allclose(white[rows], whiten(values[rows], part, own))


def test_flight_steps_by_hand():
    order = flight_order(np.array([1, 1, 2]), np.array([0.0, 60.0, 0.0]))
    distance, step = flight_steps(
        np.array([40.0, 41.0, 10.0]), np.array([-90.0, -90.0, 0.0]), np.log([9e4, 8e4, 5e4]), order
    )
    assert np.isinf(distance[[0, 2]]).all()
    assert distance[1] == pytest.approx(np.radians(1) * 6.371e6, rel=1e-9)
    assert step[1] == pytest.approx(np.log(9 / 8))
