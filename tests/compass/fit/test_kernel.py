"""The fit of one aircraft: the vector equation, weights, clusters, sums by block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from airswing.compass.fit.kernel import (
    degrees_of_freedom,
    fit_aircraft,
    influences,
    inverse_root,
)
from airswing.compass.fleet.field import Reports
from airswing.physics.compass_deviation import deviation_basis

THETA = (1.0, 8.0, -6.0, 1.5, -1.0, 0.02, 0.6, -0.5)  # degrees, 1, m/s


def vector_reports(theta, seed, n=400, noise=0.0, flights=20, gain=None):
    """Reports that obey the vector equation, made from components."""
    rng = np.random.default_rng(seed)
    a, b, c, d, e, s, bu, bv = theta
    psi = np.sort(rng.uniform(0, 2 * np.pi, n))
    rng.shuffle(psi)
    m, g = psi + 0.07, np.ones(n) if gain is None else rng.uniform(*gain, n)
    delta = a + g * (b * np.sin(m) + c * np.cos(m)) + d * np.sin(2 * m) + e * np.cos(2 * m)
    v = rng.uniform(90, 130, n)
    true = psi - np.radians(delta)
    implied = (v * (1 - s))[:, None] * np.column_stack([np.sin(true), np.cos(true)])
    implied += -np.array([bu, bv]) + noise * rng.normal(size=(n, 2))
    error = (psi - np.arctan2(*implied.T) + np.pi) % (2 * np.pi) - np.pi
    flight = np.sort(np.concatenate([np.arange(flights), rng.integers(0, flights, n - flights)]))
    seconds = flight * 8 * 3600 + np.arange(n) % (n // flights) * 180
    return Reports(
        deviation_basis(m, g),
        psi,
        error,
        v,
        np.hypot(*implied.T),
        np.full(n, 0.01),
        flight,
        np.full(n, 43.0),
        np.linspace(-90, -85, n),
        np.full(n, 5e4),
        np.datetime64("2009-01-01", "ns") + seconds.astype("timedelta64[s]"),
    )


def fit(reports, **options):
    days = np.arange(reports.flight.max() + 1) // 2
    return fit_aircraft([reports], days, **options)


def in_degrees(theta):
    return np.concatenate([np.degrees(theta[:5]), theta[5:]])


@pytest.mark.parametrize("gain", [None, (0.8, 1.25)])
def test_ten_degrees_of_deviation_come_back_exactly(gain):
    """Also where iron turns the compass more in a weaker field."""
    found = fit(vector_reports(THETA, 0, gain=gain))
    assert found.converged
    assert in_degrees(found.theta) == pytest.approx(THETA, abs=1e-4)
    assert found.rms_after < 0.1 * found.rms_before


def test_without_gross_errors_the_fit_is_least_squares_of_the_vector():
    reports = vector_reports(THETA, 7, n=600, noise=1.5)

    def residuals(theta):
        delta = theta[:5] @ reports.basis
        speed = (1 - theta[5]) * reports.airspeed
        toward = reports.heading - reports.heading_error
        fitted = reports.heading - delta
        east = reports.implied * np.sin(toward) - speed * np.sin(fitted) + theta[6]
        north = reports.implied * np.cos(toward) - speed * np.cos(fitted) + theta[7]
        return np.concatenate([east, north])

    best = least_squares(residuals, np.zeros(8), x_scale=[0.01] * 6 + [1, 1]).x
    found = fit(reports)
    error = np.sqrt(np.diagonal(found.covariance))
    assert (np.abs(found.theta - best) < 0.35 * error).all()  # 95 % efficiency


def test_a_gross_error_has_no_weight():
    reports = vector_reports(THETA, 2, noise=1.0)
    error = reports.heading_error.copy()
    error[7] += 2.0
    keep = np.arange(400) != 7
    one = fit(replace(reports, heading_error=error))
    two = fit(reports.take(np.flatnonzero(keep)))
    assert in_degrees(one.theta) == pytest.approx(in_degrees(two.theta), abs=1e-3)


def test_clusters_are_in_the_influences():
    reports = vector_reports(THETA, 4, n=6000, noise=1.0, flights=200)
    found = fit(reports)
    assert found.flight.shape == (200, 8) and found.day.shape == (100, 8)
    total = found.flight.sum(axis=0) / np.sqrt(np.diagonal(found.covariance))
    assert np.abs(total).max() < 0.1
    # independent reports: both clusterings give the information of the normal matrix
    expected = np.sqrt(np.diagonal(np.linalg.inv(found.normal)))
    for covariance in (found.covariance, found.day_covariance):
        assert np.sqrt(np.diagonal(covariance)) == pytest.approx(expected, rel=0.3)


def test_cr2_is_unbiased_where_the_working_model_holds():
    rng = np.random.default_rng(8)
    x = np.column_stack([np.ones(60), rng.normal(size=60)])
    cluster = np.repeat(np.arange(6), 10)
    normals = np.array([x[cluster == g].T @ x[cluster == g] for g in range(6)])
    normal = normals.sum(axis=0)
    found = np.zeros((2, 2))
    for _ in range(2000):
        y = rng.normal(size=60)
        residual = y - x @ np.linalg.solve(normal, x.T @ y)
        score = np.array([x[cluster == g].T @ residual[cluster == g] for g in range(6)])
        influence = influences(score, inverse_root(normal), normals, 1.0)
        found += influence.T @ influence / 2000
    assert np.diag(found) == pytest.approx(np.diag(np.linalg.inv(normal)), rel=0.08)
    even = np.array([np.eye(2)] * 6)
    assert degrees_of_freedom(even.sum(axis=0), even, 6) == pytest.approx([5, 5])
