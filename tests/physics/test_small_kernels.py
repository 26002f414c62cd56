"""Great circles, robust standard deviation, linear B-splines."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod
from scipy.stats import median_abs_deviation

from airswing.physics.great_circle import central_angle
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats, hats_not_zero


def test_angles_on_a_sphere_by_hand():
    assert central_angle(np.pi / 2, 0.3, 0.0, 1.2) == pytest.approx(np.pi / 2)
    assert central_angle(0.0, 0.0, 0.0, np.pi) == pytest.approx(np.pi)
    assert central_angle(0.7, -2.0, 0.7, -2.0) == 0.0
    assert np.isnan(central_angle(np.nan, 0.0, 0.0, 0.0))
    step = 1e-9  # a few millimetres
    assert central_angle(0.5, 1.0, 0.5 + step, 1.0) == pytest.approx(step, rel=1e-6)


def test_angles_are_those_of_pyproj_on_both_sides_of_the_antimeridian():
    rng = np.random.default_rng(0)
    lat, to_lat = rng.uniform(-89.0, 89.0, (2, 500))
    lon, to_lon = rng.uniform(170.0, 190.0, (2, 500))
    expected = Geod(a=1.0, b=1.0).inv(lon, lat, to_lon, to_lat)[2]
    found = central_angle(*map(np.radians, (lat, lon, to_lat, to_lon)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_robust_standard_deviation():
    # median 3, deviations 2 1 0 1 97, of which the median is 1
    assert robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 100.0])) == 1.4826
    assert robust_sd(np.array([1.0, -2.0, 3.0]), 0.0) == 2 * 1.4826  # deviations from zero
    assert robust_sd(np.array([])) == 0.0
    values = np.random.default_rng(5).normal(4.0, 2.5, 400)
    scipy = median_abs_deviation(values, scale="normal")
    assert robust_sd(values) == pytest.approx(scipy, rel=1e-4)


def test_hats_by_hand():
    values = np.array([-5.0, 0.0, 0.25, 1.0, 2.0, 3.0, 9.0, np.nan])
    expected = [
        [1, 1, 0.75, 0, 0, 0, 0, 0],
        [0, 0, 0.25, 1, 0.5, 0, 0, 0],
        [0, 0, 0, 0, 0.5, 1, 1, 0],
    ]
    np.testing.assert_array_equal(hats(values, np.array([0.0, 1.0, 3.0])), expected)


@pytest.mark.parametrize("knots", [1, 2, 3, 9])
def test_the_hats_that_are_not_zero_are_those_of_all(knots):
    rng = np.random.default_rng(knots)
    knots = np.sort(rng.uniform(-1.0, 1.0, knots))
    values = np.r_[rng.uniform(-1.5, 1.5, 200), knots]
    index, value = hats_not_zero(values, knots)
    whole = np.zeros((knots.size, values.size))
    np.add.at(whole, (index.T, np.arange(values.size)), value.T)
    expected = hats(values, knots) if knots.size > 1 else np.ones((1, values.size))
    np.testing.assert_array_equal(whole, expected)
