"""The fit of one aircraft: the vector equation against scipy, and the covariance by clusters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.compass.flown import Setting, fly

from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.fit.kernel import degrees_of_freedom, influences, inverse_root


def test_without_gross_errors_the_fit_is_least_squares_of_the_vector():
    setting = Setting(aircraft=1, days=30, day_error=0.0, flight_error=0.0)
    headings, _ = fly([[1.0, 8.0, -6.0, 1.5, -1.0]], setting, 7)
    fits = fit_deviation(headings, harmonics=2, shared_error=False).isel(reference=0, aircraft=0)
    shown, magnetic = (
        np.radians(headings[name].to_numpy()) for name in ("heading", "magnetic_heading")
    )
    winds = ("eastward_wind", "northward_wind")
    reported, model = (
        np.stack([headings[f"{kind}{name}"].to_numpy().ravel() for name in winds])
        for kind in ("", "reference_")
    )
    airspeed = headings["airspeed"].to_numpy()
    ground = reported + airspeed * np.stack([np.sin(shown), np.cos(shown)])

    def residuals(theta):
        a, b, c, d, e = theta[:5]
        m = magnetic
        delta = a + b * np.sin(m) + c * np.cos(m) + d * np.sin(2 * m) + e * np.cos(2 * m)
        air = (1 - theta[5]) * airspeed * np.stack([np.sin(shown - delta), np.cos(shown - delta)])
        return (model - theta[6:, None] - (ground - air)).ravel()

    best = least_squares(residuals, np.zeros(8), x_scale=[0.01] * 6 + [1, 1]).x
    error = np.sqrt(np.diagonal(fits["deviation_covariance"]))
    apart = fits["deviation"].to_numpy() - np.degrees(best[:5])
    assert (np.abs(apart) < 0.35 * error).all()  # 95 % efficiency
    assert fits["airspeed_scale"].item() == pytest.approx(best[5], abs=1e-3)
    assert fits["reference_bias"].to_numpy() == pytest.approx(best[6:], abs=0.1)


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
