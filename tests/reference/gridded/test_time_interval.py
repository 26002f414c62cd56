"""What an interval of three or six hours costs: winds of a known course in time."""

import numpy as np
import pytest

import airswing
from airswing.evaluation.time_interval import interval_cost
from tests.reference.gridded.datasets import START, latlon, points

LAT, LON = np.arange(30.0, 50.1, 5.0), np.arange(-110.0, -79.9, 5.0)


def model(course):
    """u follows a course in time, v is still."""
    ds = latlon(latitude=LAT, longitude=LON, hours=course.size)
    ds["u"] = ds.u.copy(data=np.broadcast_to(course[:, None, None, None], ds.u.shape).astype("f4"))
    ds["v"] = ds.v * 0
    return ds


def reports(hours):
    found = points(np.full(hours.size, 40.0), -95.0, 50000.0)
    return found.assign(time=("report", START + (hours * 3600e9).astype("m8[ns]")))


def test_a_parabola_by_hand():
    """u = t2: over an interval h the chord lies (t - t0)(t1 - t) above the curve."""
    hours = np.arange(25.0)
    catalogue = airswing.build_catalogue(model(0.1 * hours**2), name="m")
    whole = np.arange(1.0, 24.0)  # at whole hours the hourly reference is exact
    for row, step in zip(interval_cost(reports(whole), catalogue), (3.0, 6.0), strict=True):
        past = np.mod(whole, step)
        error = 0.1 * past * (step - past)
        middle = np.abs(past - step / 2) <= 0.5
        assert row["interval_h"] == step and row["reports"] == whole.size
        assert row["reports_at_middle"] == middle.sum()
        for name, some in (("", error), ("_at_middle", error[middle])):
            rms = row[f"rms_vector_difference{name}_m_s"]
            assert rms == pytest.approx(np.sqrt(np.mean(some**2)), abs=1e-3)


def test_steady_change_costs_nothing_and_three_hourly_winds_cannot_tell():
    steady = airswing.build_catalogue(model(np.arange(13.0)), name="m")
    some = reports(np.linspace(0.5, 11.5, 40))
    assert all(row["rms_vector_difference_m_s"] < 1e-3 for row in interval_cost(some, steady))
    sparse = airswing.build_catalogue(model(np.arange(13.0)).isel(time=slice(0, 13, 3)), name="m")
    assert interval_cost(some, sparse) == []
