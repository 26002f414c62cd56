"""Speed and direction on the compass points, by hand and beside MetPy."""

from __future__ import annotations

import numpy as np
import pytest
from metpy.calc import wind_components
from metpy.units import units

from airswing.handover.fixed_columns import speed_and_direction

POINTS = [
    (0.0, -10.0, 360.0),
    (-10.0, -10.0, 45.0),
    (-10.0, 0.0, 90.0),
    (-10.0, 10.0, 135.0),
    (0.0, 10.0, 180.0),
    (10.0, 10.0, 225.0),
    (10.0, 0.0, 270.0),
    (10.0, -10.0, 315.0),
    (0.0, 0.0, 360.0),
    (-0.0, -5.0, 360.0),
]


@pytest.mark.parametrize(("u", "v", "direction"), POINTS)
def test_on_the_compass_points(u, v, direction):
    speed, found = speed_and_direction([u], [v])
    assert speed[0] == pytest.approx(np.hypot(u, v)) and found[0] == pytest.approx(direction)


def test_components_come_back_through_metpy():
    rng = np.random.default_rng(1)
    u, v = rng.normal(0.0, 20.0, (2, 500))
    speed, direction = speed_and_direction(u, v)
    back = wind_components(speed * units("m/s"), direction * units.degree)
    np.testing.assert_allclose([part.magnitude for part in back], [u, v], atol=1e-9)


def test_what_is_hardly_east_of_north_is_north():
    _, direction = speed_and_direction([-1e-5, -1e-5, 1e-5], [-1.0, -1.0, -1.0], least=0.001)
    assert direction[:2] == pytest.approx([360.0, 360.0]) and direction[2] > 359.999
    assert speed_and_direction([-1e-5], [-1.0])[1] == pytest.approx([5.73e-4], rel=1e-3)
