"""Error profiles and disagreement: hand-made numbers in their cells, and the contract."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from airswing.evaluation.disagreement import disagreement_sums, measures_of, reference_mean
from airswing.evaluation.innovations import error_profiles
from airswing.flags import PHASE, SCREENING
from airswing.vocabulary import describe

CRUISE, ASCENT = PHASE["cruise"], PHASE["ascent"]


def archive(u, v, *, pressure, phase, flight, screening=0) -> tuple[xr.Dataset, xr.Dataset]:
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
            "screening": (one, np.zeros(number, np.int32) + screening),
        },
        coords={"reference": ["rr"]},
    )
    corrected = xr.Dataset(
        {
            "corrected_eastward_wind": (one, np.full(number, 10.0)),
            "corrected_northward_wind": (one, np.zeros(number)),
        }
    )
    return headings, corrected


@pytest.fixture
def profiles():
    headings, corrected = archive(
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


def test_a_complete_correction_leaves_no_error(profiles):
    after = profiles.sel(state="corrected", flight_phase="cruise").isel(layer=3)
    assert float(after["eastward_rms"].item()) == 0.0
    assert float(after["direction_rms"].item()) == 0.0


def test_unusable_reports_and_weak_winds_are_left_out():
    headings, corrected = archive(
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


def test_every_variable_is_in_the_vocabulary(profiles):
    described = describe(profiles)
    assert described["eastward_rms"].attrs["units"] == "m s-1"
    assert described["direction_rms"].attrs["units"] == "degree"


def test_the_standard_error_has_its_size_when_flights_share_errors():
    rng = np.random.default_rng(1)
    scores = []
    flight = np.repeat(np.arange(80), 10)
    for _ in range(100):
        error = rng.normal(0, 1.5, 80)[flight] + rng.normal(0, 1.0, 800)
        headings, corrected = archive(
            10.0 + error, 0 * error, pressure=0 * error + 650, phase=0 * flight + 2, flight=flight
        )
        found = error_profiles(headings, corrected, pools={"rr": ["rr"]})
        cell = found.sel(reference="rr", state="reported", flight_phase="cruise").isel(layer=3)
        scores.append(
            float(
                (cell["eastward_rms"] - np.sqrt(1.5**2 + 1)) / cell["eastward_rms_standard_error"]
            )
        )
    assert 0.8 < np.std(scores) < 1.25


def test_disagreement_by_hand():
    """Heading east: a northerly error of 3 is across, an easterly one of 4 along."""
    sums = disagreement_sums(
        np.array([10.0, 14.0]),
        np.array([3.0, 0.0]),
        np.array([10.0, 10.0]),
        np.zeros(2),
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


def test_a_pool_is_the_mean_of_the_members_that_have_a_value():
    both = ("reference", "report")
    ds = xr.Dataset(
        {
            "reference_eastward_wind": (both, [[1.0, 5.0], [3.0, np.nan]]),
            "reference_northward_wind": (both, [[0.0, 1.0], [2.0, np.nan]]),
        },
        coords={"reference": ["ruc", "rr"]},
    )
    found = reference_mean(ds, ["ruc", "rr"])
    assert found["reference_eastward_wind"].to_numpy().tolist() == [2.0, 5.0]
    assert found["reference_northward_wind"].to_numpy().tolist() == [1.0, 1.0]
