"""Daily sums against plain algebra."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet

from airswing.evaluation.monitoring.changes import (
    FLIGHT_BIAS_PRECISION,
    compass_days,
    compass_design,
    normal_equations_by_day,
)
from airswing.evaluation.monitoring.events import wind_days
from airswing.products.ragged import aircraft_of_report


@pytest.fixture
def reports():
    """Reports of one aircraft: cross and along errors of a known deviation."""
    rng = np.random.default_rng(8)
    heading = rng.uniform(0, 2 * np.pi, 1400)
    magnetic, airspeed = heading + 0.05, rng.normal(120, 5, heading.size)
    one, two = compass_design(magnetic, heading, airspeed)
    truth = np.r_[np.radians([1.0, 2.0, -1.0, 0, 0, 0.5, 0, 0, 0.3]), 0.004, 0.5, -0.3]
    noise = rng.normal(0, 2, (2, heading.size))
    return magnetic, heading, airspeed, one @ truth + noise[0], two @ truth + noise[1]


def test_sums_are_weighted_by_the_covariance_of_a_flights_reports(reports):
    """A day of two flights: X' S^-1 X with the covariance S of reports that share a bias."""
    magnetic, heading, airspeed, cross, along = (column[:7] for column in reports)
    flight, day = np.array([4, 9, 4, 9, 4, 4, 9]), np.array([0, 0, 0, 0, 0, 1, 1])
    days, normal, right = normal_equations_by_day(
        magnetic, heading, airspeed, cross, along, day, flight
    )
    x = np.vstack(compass_design(magnetic, heading, airspeed))
    y, bias = np.r_[cross, along], x[:, -2:]
    group = np.tile(10 * day + flight, 2)
    shared = (bias @ bias.T) * (group[:, None] == group) / FLIGHT_BIAS_PRECISION
    for number, rows in enumerate((np.r_[0:5, 7:12], np.r_[5:7, 12:14])):
        precision = np.linalg.inv(np.eye(rows.size) + shared[np.ix_(rows, rows)])
        np.testing.assert_allclose(normal[number], x[rows].T @ precision @ x[rows], atol=1e-6)
        np.testing.assert_allclose(right[number], x[rows].T @ precision @ y[rows], atol=1e-6)
    assert days.tolist() == [0, 1]


def test_gross_errors_are_left_out(reports):
    magnetic, heading, airspeed, cross, along = reports
    number = np.arange(cross.size)
    wrong = number % 50 == 0
    gross = np.where(wrong, 80.0, cross)
    day, flight = number // 100, number // 25
    with_gross = normal_equations_by_day(magnetic, heading, airspeed, gross, along, day, flight)
    without = normal_equations_by_day(
        *(column[~wrong] for column in (magnetic, heading, airspeed, cross, along, day, flight))
    )
    for one, other in zip(with_gross, without, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_blocks_of_aircraft_make_no_difference_and_counts_are_those_of_days(monkeypatch):
    ds = fleet(2, Setting(aircraft=4, days=6))[0]
    screening = np.where(np.arange(ds.sizes["report"]) % 7 == 0, 2, 0)
    ds = ds.assign(screening=("report", screening.astype(np.int32)))
    whole = compass_days(ds, ["ruc"], abscissa="magnetic"), wind_days(ds, ["ruc"])
    monkeypatch.setattr("airswing.products.ragged.BLOCK_REPORTS", 10)
    parts = compass_days(ds, ["ruc"], abscissa="magnetic"), wind_days(ds, ["ruc"])
    for name in whole[0].__dataclass_fields__:
        np.testing.assert_array_equal(getattr(whole[0], name), getattr(parts[0], name))
    pd.testing.assert_frame_equal(whole[1], parts[1])
    winds = whole[1]
    assert winds["count"].sum() == (screening == 0).sum()
    du, dv = (
        (ds[f"{name}_wind"] - ds[f"reference_{name}_wind"].isel(reference=0)).to_numpy()
        for name in ("eastward", "northward")
    )
    third = (aircraft_of_report(ds) == 2) & (screening == 0)
    assert winds["difference"][winds["aircraft"] == 2].sum() == pytest.approx(
        np.hypot(du, dv)[third].sum()
    )
