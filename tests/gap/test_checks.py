"""Calibration against known noise, placebos that close nothing, and fits without other effects."""

from __future__ import annotations

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm
from tests.gap.toy import make_frame, noise_of

from airswing.gap.checks import (
    Adjustment,
    adjusted_headings,
    calibrate,
    compared_fits,
    fit_placebo,
    lag_one,
    placebo_errors,
    review_claims,
    two_sample,
)
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
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


FIT = {"shared_error": False, "min_reports": 100, "harmonics": 1}


def _headings(*, scale: float = 0.0, wrong: float = 0.0, seed: int = 0) -> xr.Dataset:
    """Two aircraft, one cycle of 2 degrees each; an airspeed factor; a wrong eastward model wind.

    Written by the wind triangle: the air vector is turned by the deviation and stretched.
    """
    rng = np.random.default_rng(seed)
    each, n = 600, 1200
    true = rng.uniform(0, 2 * np.pi, n)
    speed = 120.0 + rng.normal(0, 5, n)
    wind = rng.normal(0, 8, (2, n))
    pointer = np.stack([np.sin(true), np.cos(true)])
    ground = speed * pointer + wind
    indicated = true + np.radians(2.0) * np.sin(true + 0.5)
    air = speed * (1 + scale) * np.stack([np.sin(indicated), np.cos(indicated)])
    reported = ground - air
    model = wind + rng.normal(0, 1.0, (2, n)) + np.array([[wrong], [0.0]])
    implied = ground - model
    degrees = np.degrees(np.arctan2(*air) - np.arctan2(*implied))
    columns = {
        "eastward_wind": reported[0],
        "northward_wind": reported[1],
        "ground_eastward_velocity": ground[0],
        "ground_northward_velocity": ground[1],
        "heading": np.degrees(indicated) % 360,
        "magnetic_heading": (np.degrees(indicated) + 3) % 360,
        "latitude": rng.uniform(35, 45, n),
        "longitude": rng.uniform(-95, -80, n),
        "pressure": rng.uniform(2e4, 9e4, n),
        "airspeed": np.hypot(*air),
        "declination": np.full(n, -3.0),
        "roll_flag": np.ones(n, np.int8),
        "temperature_qc": np.ones(n, np.int8),
        "screening": np.zeros(n, np.int32),
        "flight": np.arange(n) // 20,
    }
    per = {
        "reference_eastward_wind": model[0],
        "reference_northward_wind": model[1],
        "heading_error": (degrees + 180) % 360 - 180,
        "heading_error_standard_error": np.full(n, 0.1),
        "airspeed_error": np.hypot(*air) - np.hypot(*implied),
    }
    day = np.arange(n) // 20 % 30
    return xr.Dataset(
        {name: ("report", values) for name, values in columns.items()}
        | {name: (("reference", "report"), values[None]) for name, values in per.items()}
        | {
            "row_size": ("aircraft", [each, each]),
            "time": ("report", np.datetime64("2009-07-01", "ns") + day * np.timedelta64(1, "D")),
        },
        coords={"aircraft": ["N1", "N2"], "reference": ["model"]},
    )


def _adjustment(names, reported=None, reference=None, size=1200):
    none = np.zeros((size, 2))
    return Adjustment(
        np.arange(size),
        none if reported is None else reported,
        none if reference is None else reference,
        names,
    )


def test_an_airspeed_factor_is_removed_exactly():
    wrong, right = _headings(scale=0.02), _headings()
    change = np.stack(
        [right[f"{s}_wind"].values - wrong[f"{s}_wind"].values for s in ("eastward", "northward")],
        -1,
    )
    made = adjusted_headings(wrong, _adjustment(("tas_scale",), reported=change))
    for name in ("heading", "magnetic_heading", "airspeed", "heading_error", "airspeed_error"):
        np.testing.assert_allclose(made[name].values, right[name].values, atol=1e-9)


def test_only_rows_of_the_adjustment_change():
    headings = _headings()
    few = Adjustment(np.array([3, 7]), np.full((2, 2), 5.0), np.zeros((2, 2)), ("time_lag",))
    made = adjusted_headings(headings, few)
    changed = np.flatnonzero(made["eastward_wind"].values != headings["eastward_wind"].values)
    np.testing.assert_array_equal(changed, [3, 7])
    others = np.setdiff1d(np.arange(1200), [3, 7])
    for name in ("heading", "heading_error", "airspeed_error"):
        before, after = headings[name].values, made[name].values
        np.testing.assert_array_equal(before[..., others], after[..., others])
        assert (before[..., [3, 7]] != after[..., [3, 7]]).all()


def test_a_biased_reference_changes_the_fit_and_its_removal_restores_it():
    headings = _headings(wrong=6.0)
    off = _adjustment(("reference_speed_bias",), reference=np.tile([-6.0, 0.0], (1200, 1)))
    options = {"pools": {"model": ["model"]}, "reference": "model", "fit": FIT | {"joint": False}}
    made = review_claims(headings, off, **options)
    clean = review_claims(_headings(), _adjustment(("time_lag",)), **options)
    assert made.taken_off == ["reference_speed_bias"]
    assert (made.stay, made.of) == (0, 2)
    for one, two in zip(made.aircraft, clean.aircraft, strict=True):
        assert one.amplitude_deg_after == pytest.approx(two.amplitude_deg, abs=0.02)
        assert abs(one.amplitude_deg - one.amplitude_deg_after) > 0.5
    assert (clean.stay, clean.of) == (2, 2)


def test_comparison_of_fits_by_hand():
    def fits(offset, amplitude, status):
        one = {"offset": offset, "amplitude": amplitude, "status": status}
        one |= {f"{name}_standard_error": [0.1, 0.1] for name in ("offset", "amplitude")}
        return xr.Dataset(
            {name: ("aircraft", values) for name, values in one.items()},
            coords={"aircraft": ["N1", "N2"]},
        )

    out = compared_fits(fits([0.0, 0.0], [1.0, 1.0], [0, 0]), fits([0.1, 0.0], [1.1, 1.3], [0, 0]))
    assert [entry.stays for entry in out] == [True, False]
    assert out[1].amplitude_deg_after == 1.3
    out = compared_fits(fits([0.0, 0.0], [1.0, 1.0], [0, 1]), fits([0.0, 0.0], [1.0, 1.0], [0, 1]))
    assert out[1].stays is None


def test_field_test_is_computed_on_both():
    headings = _headings(wrong=6.0)
    off = _adjustment(("reference_speed_bias",), reference=np.tile([-6.0, 0.0], (1200, 1)))
    test = {
        "start": date(2009, 7, 16),
        "before_start": date(2009, 7, 1),
        "corrected": ["N1"],
        "controls": ["N2"],
        "roll": "ignore",
        "temperature_qc": "ignore",
        "draws": 50,
    }
    made = review_claims(
        headings, off, pools={"model": ["model"]}, reference="model", fit=FIT, field_test=test
    ).field_test
    clean = review_claims(
        _headings(), off, pools={"model": ["model"]}, reference="model", fit=FIT, field_test=test
    ).field_test
    assert made.reduction_kt_after == pytest.approx(clean.reduction_kt, abs=1e-9)
    low, high = made.reduction_ci_kt
    assert low <= made.reduction_kt <= high
    assert made.stays == (low <= made.reduction_kt_after <= high)


def test_diagnosis_removes_the_airspeed_error_and_keeps_the_deviation():
    names = ("compass_offset", "hard_iron", "tas_scale", "reference_speed_bias")
    frame = make_frame(
        seed=9,
        aircraft=5,
        days=16,
        noise=0.3,
        heading_error=lambda c: np.where(c["aircraft"] == 1, np.radians(1.5), 0.0),
        airspeed_factor=lambda c: np.where(c["aircraft"] == 3, 1.02, 1.0),
    )
    made = diagnose(frame, catalogue={n: CATALOGUE[n] for n in names}, dictionary=False)
    assert {e.name for e in made.report.effects} == {"compass_offset", "tas_scale"}
    assert made.adjustment.names == ("tas_scale",)
    affected = frame.aircraft == 3
    assert not made.adjustment.reported[~affected].any()
    assert not made.adjustment.reference.any()
    air = np.stack([frame.ground_u - frame.u_rep, frame.ground_v - frame.v_rep], -1)
    corrected = np.hypot(*(air - made.adjustment.reported)[affected].T)
    assert np.median(frame.airspeed[affected] / corrected) == pytest.approx(1.02, abs=0.003)
