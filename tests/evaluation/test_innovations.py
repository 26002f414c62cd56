"""Innovations: values worked by hand, error profiles, statistics that agree with numpy's."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from airswing.evaluation.disagreement import (
    disagreement_sums,
    innovations,
    measures_of,
)
from airswing.evaluation.innovations import combined, error_profiles, innovation_statistics
from airswing.flags import PHASE, SCREENING
from airswing.vocabulary import describe

CRUISE, ASCENT = PHASE["cruise"], PHASE["ascent"]


def profiled(u, v, *, pressure, phase, flight, screening=0) -> tuple[xr.Dataset, xr.Dataset]:
    """Reports against a reference of 10 m/s from the west; the correction removes every error."""
    number = len(u)
    one, both = ("report",), ("reference", "report")
    headings = xr.Dataset(
        {
            "eastward_wind": (one, np.asarray(u, float)),
            "northward_wind": (one, np.asarray(v, float)),
            "reference_eastward_wind": (both, np.full((1, number), 10.0)),
            "reference_northward_wind": (both, np.zeros((1, number))),
            "pressure": (one, np.asarray(pressure, float) * 100.0),
            "phase": (one, np.asarray(phase, np.int8)),
            "flight": (one, np.asarray(flight, np.int32)),
            "time": (one, np.full(number, np.datetime64("2008-07-01", "ns"))),
            "row_size": ("aircraft", [number]),
            "screening": (one, np.zeros(number, np.int32) + screening),
        },
        coords={"reference": ["rr"], "aircraft": ["N1"]},
    )
    corrected = xr.Dataset(
        {
            "row_size": ("aircraft", [number]),
            "corrected_eastward_wind": (one, np.full(number, 10.0)),
            "corrected_northward_wind": (one, np.zeros(number)),
        }
    )
    return headings, corrected


@pytest.fixture
def profiles():
    headings, corrected = profiled(
        [13.0, 7.0, 13.0, 7.0, 10.0],
        [0.0, 0.0, 4.0, -4.0, 10.0],
        pressure=[650, 650, 650, 650, 850],
        phase=[CRUISE, CRUISE, CRUISE, CRUISE, ASCENT],
        flight=[0, 0, 1, 1, 2],
    )
    return error_profiles(headings, corrected, pools={"rr": ["rr"]})


def test_every_report_lands_in_its_cell(profiles):
    cell = profiles.sel(reference="rr", state="reported", flight_phase="cruise").isel(layer=3)
    assert float(cell["layer_bottom_pressure"]) == 70000.0
    assert float(cell["layer_top_pressure"]) == 60000.0
    assert int(cell["profile_count"]) == 4
    assert int(cell["profile_flights"]) == 2
    assert float(cell["eastward_rms"]) == pytest.approx(3.0)
    # Squares 0, 0, 16, 16: root of 8. By flight the sums of deviations are -16 and +16.
    assert float(cell["northward_rms"]) == pytest.approx(np.sqrt(8.0))
    variance = (16.0**2 + 16.0**2) / 4**2 * 2
    expected = np.sqrt(variance) / (2 * np.sqrt(8.0))
    assert float(cell["northward_rms_standard_error"]) == pytest.approx(expected)
    other = profiles.sel(reference="rr", state="reported", flight_phase="ascent").isel(layer=1)
    assert int(other["profile_count"]) == 1
    assert float(other["direction_rms"]) == pytest.approx(45.0)
    assert np.isnan(other["eastward_rms_standard_error"])
    assert int(profiles["profile_count"].sel(state="reported").sum()) == 5
    after = profiles.sel(state="corrected", flight_phase="cruise").isel(layer=3)
    assert after["eastward_rms"].item() == after["direction_rms"].item() == 0.0
    described = describe(profiles)
    assert described["eastward_rms"].attrs["units"] == "m s-1"
    assert described["direction_rms"].attrs["units"] == "degree"


def test_unusable_reports_and_weak_winds_are_left_out():
    headings, corrected = profiled(
        [13.0, 99.0],
        [0.0, 0.0],
        pressure=[650, 650],
        phase=[CRUISE, CRUISE],
        flight=[0, 1],
        screening=np.array([SCREENING["phase"], SCREENING["gross_error"]]),
    )
    headings["reference_eastward_wind"][:] = 4.0
    found = error_profiles(headings, corrected, pools={"rr": ["rr"]}).sel(state="reported")
    assert int(found["profile_count"].sum()) == 1
    assert np.nanmax(found["eastward_rms"]) == pytest.approx(9.0)
    assert np.isnan(found["direction_rms"]).all()


def test_disagreement_by_hand():
    """Heading east: a northerly error of 3 is across, an easterly one of 4 along."""
    sums = disagreement_sums(
        np.array([[10.0, 14.0], [3.0, 0.0]]),
        np.array([[10.0, 10.0], [0.0, 0.0]]),
        np.full(2, np.pi / 2),
        np.zeros(2, np.int64),
        1,
    )
    found = measures_of(sums[:, 0])
    assert found["reports"] == 2
    assert found["mean_vector"] == pytest.approx(3.5)
    assert found["vector_rms"] == pytest.approx(np.sqrt(12.5))
    assert found["cross_rms"] == pytest.approx(np.sqrt(4.5))
    assert found["along_rms"] == pytest.approx(np.sqrt(8.0))
    assert found["eastward_mean"] == pytest.approx(2.0)
    turned = np.degrees(np.arctan2(3.0, 10.0))
    assert found["direction_rms_deg"] == pytest.approx(turned / np.sqrt(2))


def test_innovations_of_compass_points():
    """Reference: 10 m/s from the west (u = 10). A wind from the north-west is veered by 45."""
    half = 10.0 * np.sqrt(0.5)
    found = innovations(
        np.array([10.0, half, half, 0.0, 12.0, np.nan]),
        np.array([0.0, -half, half, 0.0, 0.0, 0.0]),
        np.array([10.0, 10.0, 10.0, 10.0, 4.0, 10.0]),
        np.zeros(6),
    )
    np.testing.assert_allclose(found["direction"][:3], [0.0, 45.0, -45.0], atol=1e-12)
    np.testing.assert_allclose(found["speed"][:5], [0.0, 0.0, 0.0, -10.0, 8.0], atol=1e-12)
    assert np.isnan(found["direction"][4])  # the reference wind is too weak
    assert np.isnan(found["eastward"][5])


@pytest.fixture
def archive():
    rng = np.random.default_rng(3)
    size = np.array([400, 0, 250])
    number = int(size.sum())
    one, both = ("report",), ("reference", "report")
    headings = xr.Dataset(
        {
            "row_size": ("aircraft", size),
            "time": (
                one,
                np.datetime64("2008-07-01", "ns")
                + rng.integers(0, 3 * 86400, number) * np.timedelta64(1, "s"),
            ),
            "eastward_wind": (one, rng.normal(12, 3, number)),
            "northward_wind": (one, rng.normal(0, 3, number)),
            "reference_eastward_wind": (both, rng.normal(12, 2, (2, number))),
            "reference_northward_wind": (both, rng.normal(0, 2, (2, number))),
            "flight": (one, np.arange(number) // 10),
            "pressure": (one, rng.uniform(21000, 100000, number)),
            "phase": (one, rng.choice(list(PHASE.values()), number).astype(np.int8)),
            "screening": (one, np.where(rng.random(number) < 0.1, SCREENING["gross_error"], 0)),
        },
        coords={"aircraft": ["N1", "N2", "N3"], "reference": ["ruc", "rr"]},
    )
    winds = {f"corrected_{name}": headings[name] + 0.5 for name in ("eastward_wind",)}
    winds["corrected_northward_wind"] = headings["northward_wind"]
    return headings, xr.Dataset(winds).assign(row_size=("aircraft", size))


def test_statistics_are_those_of_numpy(archive):
    headings, corrected = archive
    pools = {"ruc": ["ruc"], "both": ["ruc", "rr"]}
    found = innovation_statistics(headings, corrected, pools=pools)
    whole = combined(found, ["flight_phase", "layer"])
    used = (headings["screening"] == 0).to_numpy() & (np.arange(650) < 400)
    difference = (
        headings["eastward_wind"] - headings["reference_eastward_wind"].mean("reference")
    ).to_numpy()[used]
    cell = whole.sel(aircraft="N1", reference="both", state="reported")
    assert int(cell["innovation_eastward_count"]) == used.sum()
    assert float(cell["innovation_eastward_bias"]) == pytest.approx(difference.mean())
    assert float(cell["innovation_eastward_standard_deviation"]) == pytest.approx(
        difference.std(ddof=1)
    )
    assert float(cell["innovation_eastward_rms"]) == pytest.approx(np.sqrt((difference**2).mean()))
    moved = whole["innovation_eastward_bias"].sel(aircraft="N1", reference="both")
    assert float(moved.sel(state="corrected") - moved.sel(state="reported")) == pytest.approx(0.5)
    assert np.isnan(whole["innovation_speed_bias"].sel(aircraft="N2")).all()
    # days and classes hold the same reports
    daily = found["daily_innovation_count"].sel(reference="ruc", state="reported")
    assert daily.sum("day").values.tolist() == [
        int(n) for n in whole["innovation_eastward_count"].sel(reference="ruc", state="reported")
    ]
    assert int(found["innovation_histogram"].sel(reference="ruc", state="reported").sum()) == int(
        (headings["screening"] == 0).sum()
    )
    mean = found["daily_innovation_eastward"].weighted(found["daily_innovation_count"]).mean("day")
    assert float(mean.sel(reference="both", state="reported", aircraft="N1")) == pytest.approx(
        difference.mean()
    )
    assert describe(found)["innovation_direction_rms"].attrs["units"] == "degree"


def test_blocks_of_aircraft_make_no_difference(archive, monkeypatch):
    pools = {"ruc": ["ruc"]}
    whole = innovation_statistics(*archive, pools=pools)
    monkeypatch.setattr("airswing.products.ragged.BLOCK_REPORTS", 10)
    xr.testing.assert_identical(innovation_statistics(*archive, pools=pools), whole)
