"""Innovations: values worked by hand, error profiles and statistics that agree with numpy's."""

import numpy as np
import pytest
import xarray as xr

from airswing.evaluation.innovations import (
    combined,
    error_profiles,
    innovation_statistics,
    innovations,
)
from airswing.flags import PHASE, SCREENING
from airswing.vocabulary import describe
from tests.ragged import ragged

POOLS = {"ruc": ["ruc"], "both": ["ruc", "rr"]}


def test_innovations_of_compass_points():
    """Reference: 10 m/s from the west (u = 10). A wind from the north-west is veered by 45."""
    half = 10.0 * np.sqrt(0.5)
    omb = innovations(
        np.array([10.0, half, half, -10.0, 0.0, 12.0, np.nan]),
        np.array([0.0, -half, half, 0.0, 0.0, 0.0, 0.0]),
        np.array([10.0, 10.0, 10.0, 10.0, 10.0, 4.0, 10.0]),
        np.zeros(7),
    )
    np.testing.assert_allclose(omb["direction"][:4], [0.0, 45.0, -45.0, 180.0], atol=1e-12)
    np.testing.assert_allclose(omb["speed"][:6], [0.0, 0.0, 0.0, 0.0, -10.0, 8.0], atol=1e-12)
    assert np.isnan(omb["direction"][4:6]).all()  # calm, and a reference wind that is too weak
    assert np.isnan(omb["eastward"][6])


@pytest.fixture
def archive():
    rng = np.random.default_rng(3)
    size = np.array([400, 0, 250])
    number = int(size.sum())
    seconds = rng.integers(0, 3 * 86400, number) * np.timedelta64(1, "s")
    columns = {
        "time": np.datetime64("2008-07-01", "ns") + seconds,
        "eastward_wind": rng.normal(12, 3, number),
        "northward_wind": rng.normal(0, 3, number),
        "reference_eastward_wind": rng.normal(12, 2, (2, number)),
        "reference_northward_wind": rng.normal(0, 2, (2, number)),
        "flight": np.arange(number) // 10,
        "pressure": rng.uniform(21000, 100000, number),
        "phase": rng.choice(list(PHASE.values()), number).astype(np.int8),
        "screening": np.where(rng.random(number) < 0.1, SCREENING["gross_error"], 0),
    }
    headings = ragged(columns, size, ["N1", "N2", "N3"], ["ruc", "rr"])
    winds = {
        "corrected_eastward_wind": headings["eastward_wind"] + 0.5,
        "corrected_northward_wind": headings["northward_wind"],
    }
    return headings, xr.Dataset(winds).assign(row_size=("aircraft", size))


def test_profiles_are_root_mean_squares_with_errors_by_flight(archive):
    headings, corrected = archive
    # a report that only the phase removes from the fit counts
    phase_only = headings["screening"].copy(data=np.full(650, SCREENING["phase"]))
    headings["screening"] = headings["screening"].where(np.arange(650) > 100, phase_only)
    profiles = error_profiles(headings, corrected, pools=POOLS)
    cell = profiles.sel(reference="both", state="reported", flight_phase="cruise").isel(layer=3)
    assert [float(cell[f"layer_{end}_pressure"]) for end in ("bottom", "top")] == [70000, 60000]
    pressure, phase = headings["pressure"], headings["phase"]
    inside = (headings["screening"] != SCREENING["gross_error"]) & (phase == PHASE["cruise"])
    inside &= (pressure <= 70000) & (pressure > 60000)
    difference = headings["northward_wind"] - headings["reference_northward_wind"].mean("reference")
    square = (difference**2).to_series()[inside.to_numpy()]
    flight = headings["flight"].to_series()[inside.to_numpy()]
    assert int(cell["profile_count"]) == square.size
    assert int(cell["profile_flights"]) == flight.nunique()
    rms = np.sqrt(square.mean())
    assert float(cell["northward_rms"]) == pytest.approx(rms)
    rest = (square - square.mean()).groupby(flight).sum()
    variance = (rest**2).sum() / square.size**2 * rest.size / (rest.size - 1)
    expected = np.sqrt(variance) / (2 * rms)
    assert float(cell["northward_rms_standard_error"]) == pytest.approx(expected)
    assert describe(profiles)["direction_rms"].attrs["units"] == "degree"


def test_statistics_are_those_of_numpy(archive):
    headings, corrected = archive
    stats = innovation_statistics(headings, corrected, pools=POOLS)
    by_aircraft = combined(stats, ["flight_phase", "layer"])
    used = (headings["screening"] == 0).to_numpy() & (np.arange(650) < 400)
    difference = headings["eastward_wind"] - headings["reference_eastward_wind"].mean("reference")
    difference = difference.to_numpy()[used]
    cell = by_aircraft.sel(aircraft="N1", reference="both", state="reported")
    rms = np.sqrt((difference**2).mean())
    expected = [used.sum(), difference.mean(), difference.std(ddof=1), rms]
    names = ("count", "bias", "standard_deviation", "rms")
    assert [float(cell[f"innovation_eastward_{name}"]) for name in names] == pytest.approx(expected)
    bias = by_aircraft["innovation_eastward_bias"].sel(aircraft="N1", reference="both")
    assert float(bias.sel(state="corrected") - bias.sel(state="reported")) == pytest.approx(0.5)
    assert np.isnan(by_aircraft["innovation_speed_bias"].sel(aircraft="N2")).all()
    # days and classes hold the same reports
    reported = stats.sel(reference="ruc", state="reported")
    count = by_aircraft["innovation_eastward_count"].sel(reference="ruc", state="reported")
    assert (reported["daily_innovation_count"].sum("day") == count).all()
    assert int(reported["innovation_histogram"].sum()) == int((headings["screening"] == 0).sum())
    mean = stats["daily_innovation_eastward"].weighted(stats["daily_innovation_count"]).mean("day")
    of_pool = mean.sel(reference="both", state="reported", aircraft="N1")
    assert float(of_pool) == pytest.approx(difference.mean())
