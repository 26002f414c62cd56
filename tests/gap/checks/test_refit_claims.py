"""Removing an effect from the winds yields the headings of an archive without it."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest
import xarray as xr
from tests.gap.toy import make_frame

from airswing.gap.checks import Adjustment, adjusted_headings, compared_fits, review_claims
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE

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
