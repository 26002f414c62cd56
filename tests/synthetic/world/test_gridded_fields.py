"""Gridded references: rotation, interpolation, gradients and what effects do to them."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from airswing.synthetic.atmosphere import World, WorldParameters
from airswing.synthetic.fields import (
    GRIB1_RADIUS,
    GriddedReference,
    LambertGrid,
    ReferenceChange,
    build_references,
    centred_grid,
    sample_reference,
)

GRID = centred_grid(42.0, -85.0, columns=25, rows=21, spacing=40000.0, radius=GRIB1_RADIUS)
LEVELS = np.array([900.0, 700.0, 500.0, 400.0])
HOURS = np.arange(0.0, 7.0)
POINTS = {
    "latitude": np.array([40.3, 42.0, 43.7, 44.1]),
    "longitude": np.array([-88.1, -85.0, -82.3, -86.6]),
    "pressure": np.array([850.0, 640.0, 512.0, 433.0]),
    "hours": np.array([0.2, 2.5, 4.75, 5.0]),
}


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldParameters(), 8, 24.0)


def stored(world: World, flag: bool = True, **change: float) -> GriddedReference:
    made = build_references(
        world,
        GRID,
        names=("ruc",),
        grid_relative={"ruc": flag},
        levels=LEVELS,
        hours=HOURS,
        changes={"ruc": ReferenceChange(**change)},  # type: ignore[arg-type]
    )
    return made["ruc"]


def test_convergence_is_pyproj_s_own() -> None:
    projection = pyproj.Proj(proj="lcc", lat_1=25, lat_2=25, lat_0=25, lon_0=-95, R=6367470)
    for lon in (-125.0, -95.0, -84.5, -75.0):
        factors = projection.get_factors(lon, 40.0)
        turn = np.degrees(GRID.convergence(np.array([lon])))[0]
        assert turn == pytest.approx(-factors.meridian_convergence, abs=1e-6) or turn == (
            pytest.approx(factors.meridian_convergence, abs=1e-6)
        )
    assert np.degrees(GRID.convergence(np.array([-75.0])))[0] == pytest.approx(8.45, abs=0.01)
    assert np.degrees(GRID.convergence(np.array([-125.0])))[0] == pytest.approx(-12.68, abs=0.01)


def test_grid_components_point_where_the_grid_does(world: World) -> None:
    """Moving along the stored vector on the map goes the wind's way on the earth."""
    along = stored(world, True)
    earth = stored(world, False)
    lat, lon = GRID.coordinates
    row, column = 15, 22
    grid_u, grid_v = along.wind[3, :, 2, row, column]
    true_u, true_v = earth.wind[3, :, 2, row, column]
    projection = pyproj.Proj(proj="lcc", lat_1=25, lat_2=25, lat_0=25, lon_0=-95, R=6367470)
    x, y = projection(lon[row, column], lat[row, column])
    lon2, lat2 = projection(x + 50 * grid_u, y + 50 * grid_v, inverse=True)
    azimuth = pyproj.Geod(a=6367470, b=6367470).inv(lon[row, column], lat[row, column], lon2, lat2)
    assert azimuth[0] == pytest.approx(np.degrees(np.arctan2(true_u, true_v)), abs=0.05)


@pytest.mark.parametrize("flag", [True, False])
def test_sampling_returns_the_true_wind_at_grid_points(world: World, flag: bool) -> None:
    here = stored(world, flag)
    lat, lon = GRID.coordinates
    found = sample_reference(
        here, lat[4:6, 7], lon[4:6, 7], np.array([700.0, 500.0]), np.array([2.0, 3.0])
    )
    truth = stored(world, False).wind
    np.testing.assert_allclose(found["u"], [truth[2, 0, 1, 4, 7], truth[3, 0, 2, 5, 7]], atol=0.08)
    np.testing.assert_allclose(found["v"], [truth[2, 1, 1, 4, 7], truth[3, 1, 2, 5, 7]], atol=0.08)


def test_gradients_agree_with_differences_of_the_sampling(world: World) -> None:
    here = stored(world)
    centre = sample_reference(here, **POINTS)
    geod = pyproj.Geod(a=6367470, b=6367470)

    def moved(**by: np.ndarray) -> np.ndarray:
        return sample_reference(here, **{**POINTS, **by})["u"]

    seconds = 30.0
    rate = (moved(hours=POINTS["hours"] + seconds / 3600) - centre["u"]) / seconds
    np.testing.assert_allclose(rate, centre["dudt"], rtol=1e-3, atol=1e-7)
    deeper = moved(pressure=POINTS["pressure"] * np.exp(1e-3))
    np.testing.assert_allclose(
        (deeper - centre["u"]) / 1e-3, centre["dudlnp"], rtol=1e-3, atol=1e-2
    )
    for name, azimuth in (("dudx", 90.0), ("dudy", 0.0)):
        lon, lat, _ = geod.fwd(POINTS["longitude"], POINTS["latitude"], [azimuth] * 4, [200.0] * 4)
        slope = (moved(latitude=np.array(lat), longitude=np.array(lon)) - centre["u"]) / 200.0
        np.testing.assert_allclose(slope, centre[name], rtol=0.1, atol=4e-6)


def test_nothing_is_extrapolated(world: World) -> None:
    here = stored(world)
    outside = {
        "latitude": np.array([60.0, 42, 42, 42]),
        "longitude": np.full(4, -85.0),
        "pressure": np.array([500.0, 950.0, 300.0, 500.0]),
        "hours": np.array([1.0, 1.0, 1.0, 6.5]),
    }
    assert np.isnan(sample_reference(here, **outside)["u"]).all()


def test_speed_bias_acts_above_its_level_only(world: World) -> None:
    plain, strong = stored(world, False), stored(world, False, speed_percent=10.0, above_hpa=500.0)
    ratio = strong.wind / np.where(np.abs(plain.wind) > 5, plain.wind, np.nan)
    np.testing.assert_allclose(np.nanmean(ratio, axis=(0, 1, 3, 4)), [1, 1, 1.1, 1.1], atol=1e-3)


def test_time_offset_shows_the_later_field(world: World) -> None:
    plain, late = stored(world), stored(world, offset_hours=2.0)
    np.testing.assert_allclose(late.wind[0], plain.wind[2], atol=2e-3)


def test_unrotated_winds_differ_by_the_convergence(world: World) -> None:
    plain, wrong = (
        sample_reference(stored(world, flag, unrotated=part), **POINTS)
        for flag, part in ((True, 0.0), (True, 1.0))
    )
    turn = np.arctan2(wrong["v"], wrong["u"]) - np.arctan2(plain["v"], plain["u"])
    expected = GRID.convergence(POINTS["longitude"])
    np.testing.assert_allclose((turn - expected + np.pi) % (2 * np.pi) - np.pi, 0, atol=2e-3)
    speed = [np.hypot(wind["u"], wind["v"]) for wind in (plain, wrong)]
    np.testing.assert_allclose(*speed, rtol=1e-3)


def test_indices_and_coordinates_are_inverse() -> None:
    grid = LambertGrid(37.0, -97.0, 12, 9, 40635.0)
    lat, lon = grid.coordinates
    row, column = grid.indices(lat, lon)
    np.testing.assert_allclose(row[:, 0], np.arange(9), atol=1e-6)
    np.testing.assert_allclose(column[0], np.arange(12), atol=1e-6)
