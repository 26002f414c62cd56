"""The wind triangle by hand, on the compass points, by round trip and on a research aircraft."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from airswing.physics import triangle

angles = st.floats(-50.0, 50.0)
speeds = st.floats(0.1, 300.0)

POINTS = [  # heading in degrees, unit vector (east, north)
    (0.0, (0.0, 1.0)),
    (45.0, (0.5**0.5, 0.5**0.5)),
    (90.0, (1.0, 0.0)),
    (135.0, (0.5**0.5, -(0.5**0.5))),
    (180.0, (0.0, -1.0)),
    (225.0, (-(0.5**0.5), -(0.5**0.5))),
    (270.0, (-1.0, 0.0)),
    (315.0, (-(0.5**0.5), 0.5**0.5)),
]


@pytest.mark.parametrize(("degrees", "vector"), POINTS)
def test_eight_compass_points(degrees: float, vector: tuple[float, float]) -> None:
    east, north = triangle.vector_from_bearing(100.0, np.radians(degrees))
    np.testing.assert_allclose((east, north), 100.0 * np.array(vector), atol=1e-12)
    assert np.degrees(triangle.bearing(*vector)) == pytest.approx(degrees, abs=1e-12)
    # a wind from there blows the other way
    u, v = triangle.wind_components(10.0, np.radians(degrees))
    np.testing.assert_allclose((u, v), -10.0 * np.array(vector), atol=1e-12)
    speed, direction = triangle.wind_from_direction(-vector[0], -vector[1])
    assert speed == pytest.approx(1.0)
    assert np.degrees(direction) == pytest.approx(degrees, abs=1e-12)


@pytest.mark.parametrize(("degrees", "vector"), POINTS)
@pytest.mark.parametrize("error", [-4.0, 0.0, 7.5])
def test_compass_error_comes_back_with_its_sign(
    degrees: float, vector: tuple[float, float], error: float
) -> None:
    true_heading, airspeed = np.radians(degrees), 130.0
    wind = (-12.0, 9.0)
    ground = np.array(vector) * airspeed + wind
    reported = triangle.wind_from_triangle(*ground, airspeed, true_heading + np.radians(error))
    used = triangle.air_vector(*ground, *reported)
    implied = triangle.air_vector(*ground, *wind)
    found = triangle.heading_error(*used, *implied)
    assert np.degrees(found) == pytest.approx(error, abs=1e-9)
    assert triangle.airspeed_error(*used, *implied) == pytest.approx(0.0, abs=1e-9)


def test_triangle_worked_by_hand() -> None:
    # heading 090 at 100 m/s true, wind from 360 at 20 m/s (blows south): the aircraft
    # makes 100 east and 20 south, a track of atan2(100, -20) = 101.3099 degrees at 101.980
    wind = triangle.wind_components(20.0, 0.0)
    np.testing.assert_allclose(wind, (0.0, -20.0), atol=1e-12)
    ground = (100.0, -20.0)
    assert np.degrees(triangle.bearing(*ground)) == pytest.approx(101.309932, abs=1e-6)
    assert triangle.speed_of_vector(*ground) == pytest.approx(101.980390, abs=1e-6)
    np.testing.assert_allclose(
        triangle.wind_from_triangle(*ground, 100.0, np.pi / 2), wind, atol=1e-12
    )
    # a compass reading 091 makes 100 (sin 91, cos 91) = (99.98477, -1.745241) of air vector,
    # a wind of (0.01523, -18.254759): 1.745 m/s of error to the left of the heading
    found = triangle.wind_from_triangle(*ground, 100.0, np.radians(91.0))
    np.testing.assert_allclose(found, (0.0152305, -18.2547594), atol=1e-6)
    along, cross = triangle.along_cross(found[0] - wind[0], found[1] - wind[1], np.pi / 2)
    assert cross == pytest.approx(-1.745241, abs=1e-5)
    assert along == pytest.approx(0.0152305, abs=1e-6)


def test_signed_wrap_is_open_below_and_closed_above() -> None:
    degrees = np.array([-540.0, -180.0, -179.0, 0.0, 180.0, 181.0, 360.0, 540.0])
    expected = [180.0, 180.0, -179.0, 0.0, 180.0, -179.0, 0.0, 180.0]
    np.testing.assert_allclose(
        np.degrees(triangle.wrap_signed(np.radians(degrees))), expected, atol=1e-9
    )
    # opposite vectors are half a turn apart, positive whichever way it is asked
    assert triangle.heading_error(0.0, -1.0, 0.0, 1.0) == np.pi
    assert triangle.heading_error(-0.0, -1.0, 0.0, 1.0) == np.pi


def test_calm_has_no_direction() -> None:
    speed, direction = triangle.wind_from_direction(0.0, 0.0)
    assert speed == 0.0 and np.isnan(direction)
    assert np.isnan(triangle.bearing(0.0, 0.0))
    assert np.isnan(triangle.heading_error(0.0, 0.0, 1.0, 0.0))
    np.testing.assert_array_equal(triangle.wind_components(0.0, np.nan), (0.0, 0.0))
    assert np.isnan(triangle.wind_components(5.0, np.nan)).all()


def test_degrees_go_the_short_way_round() -> None:
    angles = np.array([-180.0, 180.0, 190.0, -190.0, 540.0, 0.0], dtype=np.float32)
    found = triangle.wrap_degrees(angles)
    assert found.tolist() == [-180.0, -180.0, -170.0, 170.0, -180.0, 0.0]
    assert found.dtype == np.float32


@given(angles)
def test_wraps_stay_in_range_and_keep_the_angle(angle: float) -> None:
    signed, positive = triangle.wrap_signed(angle), triangle.wrap_positive(angle)
    assert -np.pi < signed <= np.pi
    assert 0.0 <= positive < 2 * np.pi
    for wrapped in (signed, positive):
        turns = (wrapped - angle) / (2 * np.pi)
        assert turns == pytest.approx(round(float(turns)), abs=1e-9)


@given(speeds, angles, angles)
def test_along_cross_round_trip_and_length(speed: float, direction: float, heading: float) -> None:
    vector = triangle.vector_from_bearing(speed, direction)
    along, cross = triangle.along_cross(*vector, heading)
    assert np.hypot(along, cross) == pytest.approx(speed)
    # the turn is a reflection: made twice it leaves the vector as it was
    np.testing.assert_allclose(triangle.along_cross(along, cross, heading), vector, atol=1e-9)
    # 'cross' is the part to the right
    right = triangle.along_cross(*triangle.vector_from_bearing(1.0, heading + np.pi / 2), heading)
    np.testing.assert_allclose(right, (0.0, 1.0), atol=1e-12)


def test_signs_on_a_research_aircraft(real: Callable[[str], Path]) -> None:
    """Recorded heading, airspeed and ground velocity give the recorded wind."""
    with xr.open_dataset(real("heading/ncar_gv_20131001.nc"), engine="netcdf4") as ds:
        flight = ds.load()
    u, v = triangle.wind_components(flight.WSC.to_numpy(), np.radians(flight.WDC.to_numpy()))
    level = np.abs(flight.ROLL.to_numpy()) < 2.0
    course = np.radians(flight.THDG.to_numpy())
    found = triangle.wind_from_triangle(
        flight.GGVEW.to_numpy(), flight.GGVNS.to_numpy(), flight.TASX.to_numpy(), course
    )
    miss = np.hypot(found[0] - u, found[1] - v)[level]
    assert level.sum() > 100
    assert np.median(miss) < 0.5, "wind within half a metre a second at 225 m/s"
    # each wrong sign is an error of tens of metres a second
    wrong = np.hypot(found[0] + u, found[1] + v)[level]
    assert np.median(wrong) > 50.0


def test_direction_in_degrees_at_the_compass_points_and_its_precision():
    points = np.arange(0.0, 360.0, 45.0)
    u, v = triangle.wind_components(10.0, np.radians(points))
    np.testing.assert_allclose(triangle.direction_in_degrees(u, v), points, atol=1e-9)
    single = triangle.direction_in_degrees(np.float32([-1.0]), np.float32([0.0]))
    assert single.dtype == np.float32 and single.tolist() == [90.0]
    assert np.isnan(triangle.direction_in_degrees(np.nan, 1.0))
