"""Statistics of the innovations: values worked by hand, and sums that agree with numpy's."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from airswing.evaluation.disagreement import innovations
from airswing.evaluation.innovations import combined, innovation_statistics
from airswing.flags import PHASE, SCREENING
from airswing.vocabulary import describe


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
