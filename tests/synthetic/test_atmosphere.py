"""The true wind, the models' errors and the magnetic field: sizes, correlations, seeds."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from airswing.synthetic.atmosphere import (
    WaveKind,
    World,
    WorldParameters,
    model_wind,
    random_waves,
)
from airswing.synthetic.instrument import EarthField, declination_of_year

GRID = np.meshgrid(np.arange(-800.0, 801.0, 50.0), np.arange(-600.0, 601.0, 50.0))
BOX = (25.0, 48.0, -124.0, -75.0)


def errors(world, name):
    """Model minus the large scale, (T, 2, L, rows, columns)."""
    zeta, hours = np.log([0.7, 0.5]), np.arange(0.0, 480.0, 3.0)
    large = world.large_scale_on_grid(*GRID, zeta, hours)
    return model_wind(world, name, *GRID, zeta, hours, large) - large


def correlation(a, b):
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


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


def test_waves_have_the_size_and_the_correlation_asked_for():
    """A Gaussian spectrum of one length L gives the covariance exp(-r^2 / 2 L^2)."""
    kind = WaveKind(60, 2.0, (200.0, 200.001), 0.5, 6.0, rotational=0.0)
    points = np.array([[0, 200.0, 0, 0], [0, 0, 0, 0], [0, 0, 0.5, 0], [1, 1, 1, 7.0]])
    drawn = (
        random_waves(np.random.default_rng(seed), kind, start=0.0, end=8.0) for seed in range(200)
    )
    sample = np.concatenate([waves.at_points(*points) for waves in drawn])
    covariance = sample.T @ sample / len(sample)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(2.0, rel=0.08)
    expected = [np.exp(-0.5), np.exp(-0.5), np.exp(-1.0)]
    np.testing.assert_allclose(covariance[0, 1:] / covariance[0, 0], expected, atol=0.12)


def test_errors_of_models_are_shared_in_part_and_correlated():
    world = World(WorldParameters(), 4, 480.0)
    first, second = (errors(world, name)[:, 0, 1] for name in ("ruc", "rtfdaa"))
    near, far = (correlation(first[:, :, :-n], first[:, :, n:]) for n in (2, 16))
    assert near > 0.75 and abs(far) < 0.25
    soon, late = (correlation(first[:-n], first[n:]) for n in (1, 16))
    assert soon > 0.3 and abs(late) < 0.3
    assert 0.2 < correlation(first, second) < 0.75
    assert 1.6 < first.std() < 2.9


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
