from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod

from airswing.physics.great_circle import central_angle


def test_a_quarter_half_and_nothing():
    pole, equator = (np.pi / 2, 0.3), (0.0, 1.2)
    assert central_angle(*pole, *equator) == pytest.approx(np.pi / 2)
    assert central_angle(0.0, 0.0, 0.0, np.pi) == pytest.approx(np.pi)
    assert central_angle(0.7, -2.0, 0.7, -2.0) == 0.0
    assert np.isnan(central_angle(np.nan, 0.0, 0.0, 0.0))


def test_as_pyproj_on_a_sphere_both_sides_of_the_antimeridian():
    rng = np.random.default_rng(0)
    lat, to_lat = rng.uniform(-89.0, 89.0, (2, 500))
    lon, to_lon = rng.uniform(170.0, 190.0, (2, 500))
    expected = Geod(a=1.0, b=1.0).inv(lon, lat, to_lon, to_lat)[2]
    found = central_angle(*map(np.radians, (lat, lon, to_lat, to_lon)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_metres_apart():
    step = 1e-9
    assert central_angle(0.5, 1.0, 0.5 + step, 1.0) == pytest.approx(step, rel=1e-6)
