"""The fit of one aircraft against scipy, and its status by the days held out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.compass.flown import Setting, fly

from airswing.compass.correction import add_tables, correct
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.fit.kernel import degrees_of_freedom, influences, inverse_root
from airswing.flags import STATUS, published


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


def statuses(size: float, seeds: range, **setting) -> np.ndarray:
    """Status of fleets of 20 aircraft with one cycle of this amplitude (degrees)."""
    found = []
    for seed in seeds:
        phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 20)
        deviation = np.zeros((20, 5))
        deviation[:, 1], deviation[:, 2] = size * np.cos(phase), size * np.sin(phase)
        headings, _ = fly(deviation, Setting(aircraft=20, **setting), seed + 100)
        found.append(fit_deviation(headings)["status"].to_numpy()[0])
    return np.concatenate(found)


def test_without_deviation_no_correction_is_needed():
    found = statuses(0.0, range(3), days=30)
    assert np.mean(found == STATUS["no_correction_needed"]) >= 0.88  # 95 % in the mean
    assert np.mean(found == STATUS["ok"]) <= 0.1
    assert published(STATUS["no_correction_needed"]) and not published(STATUS["no_improvement"])


@pytest.mark.parametrize("bias", [(0.5, -0.4), (1.0, -0.8)])
def test_a_small_deviation_is_corrected_whatever_the_bias_of_the_reference(bias):
    assert (statuses(0.7, range(2), days=30, bias=bias) == STATUS["ok"]).mean() > 0.94


@pytest.mark.slow
def test_rates_of_false_corrections_and_false_refusals():
    found = statuses(0.0, range(10))
    assert 0.02 <= np.mean(found != STATUS["no_correction_needed"]) <= 0.09
    found = statuses(0.3, range(10))
    assert np.mean(found == STATUS["ok"]) > 0.9
    assert np.mean(found == STATUS["no_improvement"]) < 0.03


def test_the_improvement_is_that_of_the_winds():
    """On days that the fit has not seen, in the mean square."""
    deviation = [[1.0, 3.0, -2.0, 0.0, 0.0]] * 4
    headings, _ = fly(deviation, Setting(aircraft=4, days=60, bias=(0.0, 0.0), bias_spread=0.0), 5)
    early = (headings["time"] < headings["time"].quantile(0.5)).to_numpy()
    learned = headings.assign(screening=("report", np.where(early, 0, 1).astype(np.int32)))
    done = correct(headings, add_tables(fit_deviation(learned), learned), method="curve")
    squares = [
        (done[f"{name}eastward_wind"] - headings["reference_eastward_wind"][0]) ** 2
        + (done[f"{name}northward_wind"] - headings["reference_northward_wind"][0]) ** 2
        for name in ("", "corrected_")
    ]
    size = int(headings["row_size"][0])
    later = np.where(early, np.nan, (squares[0] - squares[1]).to_numpy()).reshape(4, size)
    fits = fit_deviation(headings).isel(reference=0)
    stated, error = (
        fits[f"held_out_improvement{name}"].to_numpy() for name in ("", "_standard_error")
    )
    assert (fits["status"] == STATUS["ok"]).all()
    assert (np.abs(np.nanmean(later, axis=1) - stated) < 4 * error + 0.1 * stated).all()


@pytest.mark.parametrize("kind", ["half", "twice", "opposite"])
def test_winds_that_contradict_the_reference_have_no_table(kind):
    """Half is m/s read as kt, twice kt read as m/s, opposite a direction toward."""
    headings, _ = fly([[1.0, 3.0, -2.0, 0.0, 0.0]] * 3, Setting(aircraft=3, days=30), 6)
    factor = {"half": 0.5144, "twice": 1.944, "opposite": -1.0}[kind]
    shown = np.radians(headings["heading"])
    wind, model = (
        headings[f"{kind}eastward_wind"] + 1j * headings[f"{kind}northward_wind"]
        for kind in ("", "reference_")
    )
    ground = wind + headings["airspeed"] * (np.sin(shown) + 1j * np.cos(shown))
    air, implied = ground - factor * wind, ground - model
    heading = 90.0 - np.degrees(np.arctan2(air.imag, air.real))
    error = np.degrees(np.arctan2((implied / air).imag, (implied / air).real))
    changed = headings.assign(
        heading=heading % 360,
        magnetic_heading=(heading - headings["declination"]) % 360,
        airspeed=abs(air),
        heading_error=error,
        airspeed_error=abs(air) - abs(implied),
    )
    fits = add_tables(fit_deviation(changed), changed)
    assert not published(fits["status"]).any()
    assert (fits["status"] == STATUS["implausible_reports"]).sum() >= 2
    assert np.isnan(fits["table_correction"]).all()
    assert np.isfinite(fits["held_out_improvement"]).all()
