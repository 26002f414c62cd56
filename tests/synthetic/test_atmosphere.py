"""The true wind, the models' errors and the magnetic field: sizes, correlations, seeds."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from airswing.synthetic.atmosphere import (
    WaveKind,
    random_waves,
)
from airswing.synthetic.instrument import EarthField, declination_of_year

GRID = np.meshgrid(np.arange(-800.0, 801.0, 50.0), np.arange(-600.0, 601.0, 50.0))
BOX = (25.0, 48.0, -124.0, -75.0)


def test_waves_on_a_grid_are_those_at_its_points():
    kind = WaveKind(40, 2.0, (100, 300), 0.4, 6.0, (30.0, 5.0))
    waves = random_waves(np.random.default_rng(3), kind, start=-5.0, end=30.0)
    x, y = GRID
    zeta, hours = np.log([0.8, 0.4]), np.array([0.0, 1.25, 7.5])
    field = waves.on_grid(x, y, zeta, hours)
    for step, level in np.ndindex(3, 2):
        place = np.full(x.size, zeta[level]), np.full(x.size, hours[step])
        points = waves.at_points(x.ravel(), y.ravel(), *place)
        np.testing.assert_allclose(field[step, :, level].reshape(2, -1), points, atol=2e-3)


def test_the_lattice_is_close_to_igrf_and_older_tables_differ_by_the_secular_variation():
    import ppigrf

    earth = EarthField(datetime(2009, 7, 1), 30.0, BOX)
    rng = np.random.default_rng(1)
    lat, lon = rng.uniform(26, 47, 20), rng.uniform(-123, -76, 20)
    east, north, up = (part.ravel() for part in ppigrf.igrf(lon, lat, 4.0, datetime(2009, 7, 16)))
    declination, horizontal, down = earth.at(lat, lon, np.full(20, 15 * 24.0))
    np.testing.assert_allclose(declination, np.arctan2(east, north), atol=np.radians(0.03))
    np.testing.assert_allclose(horizontal, np.hypot(east, north), rtol=2e-3)
    np.testing.assert_allclose(down, -up, rtol=2e-3)
    lat, lon = np.array([44.9]), np.array([-93.2])
    old = declination_of_year(lat, lon, 1995.0, BOX) - earth.at(lat, lon, np.zeros(1))[0]
    assert 1.0 < np.degrees(old[0]) < 2.5
