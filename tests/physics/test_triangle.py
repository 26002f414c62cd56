"""The wind triangle by hand, on the compass points and by round trip."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.physics import triangle

angles = st.floats(-50.0, 50.0)
speeds = st.floats(0.1, 300.0)

POINTS = np.arange(0.0, 360.0, 45.0)
H = 0.5**0.5
VECTORS = np.array([[0, H, 1, H, 0, -H, -1, -H], [1, H, 0, -H, -1, -H, 0, H]])
"""Unit vectors (east, north) of the eight compass points."""


def test_eight_compass_points() -> None:
    vectors = triangle.vector_from_bearing(100.0, np.radians(POINTS))
    np.testing.assert_allclose(vectors, 100.0 * VECTORS, atol=1e-12)
    np.testing.assert_allclose(np.degrees(triangle.bearing(*VECTORS)), POINTS, atol=1e-12)
    # a wind from there blows the other way
    wind = triangle.wind_components(10.0, np.radians(POINTS))
    np.testing.assert_allclose(wind, -10.0 * VECTORS, atol=1e-12)
    speed, direction = triangle.wind_from_direction(*wind)
    np.testing.assert_allclose(speed, 10.0)
    np.testing.assert_allclose(np.degrees(direction), POINTS, atol=1e-12)
    np.testing.assert_allclose(triangle.direction_in_degrees(*wind), POINTS, atol=1e-9)


@given(st.floats(-4.0, 7.5), angles)
def test_compass_error_comes_back_with_its_sign(error: float, heading: float) -> None:
    wind = (-12.0, 9.0)
    ground = np.add(triangle.vector_from_bearing(130.0, heading), wind)
    reported = triangle.wind_from_triangle(*ground, 130.0, heading + np.radians(error))
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


def test_wraps_by_hand() -> None:
    degrees = np.array([-540.0, -180.0, -179.0, 0.0, 180.0, 181.0, 360.0, 540.0])
    expected = np.array([180.0, 180.0, -179.0, 0.0, 180.0, -179.0, 0.0, 180.0])
    np.testing.assert_allclose(
        np.degrees(triangle.wrap_signed(np.radians(degrees))), expected, atol=1e-9
    )
    # degrees are open above
    found = triangle.wrap_degrees(degrees.astype(np.float32))
    assert found.tolist() == np.where(expected == 180.0, -180.0, expected).tolist()
    # opposite vectors are half a turn apart, positive whichever way it is asked
    assert triangle.heading_error(0.0, -1.0, 0.0, 1.0) == np.pi
    assert triangle.heading_error(-0.0, -1.0, 0.0, 1.0) == np.pi


def test_single_precision_is_kept() -> None:
    assert triangle.wrap_degrees(np.float32([190.0])).dtype == np.float32
    found = triangle.direction_in_degrees(np.float32([-1.0]), np.float32([0.0]))
    assert found.dtype == np.float32 and found.tolist() == [90.0]


def test_calm_and_unknown_winds_have_no_direction() -> None:
    speed, direction = triangle.wind_from_direction(0.0, 0.0)
    assert speed == 0.0 and np.isnan(direction)
    assert np.isnan(triangle.bearing(0.0, 0.0))
    assert np.isnan(triangle.heading_error(0.0, 0.0, 1.0, 0.0))
    np.testing.assert_array_equal(triangle.wind_components(0.0, np.nan), (0.0, 0.0))
    assert np.isnan(triangle.wind_components(5.0, np.nan)).all()
    assert np.isnan(triangle.direction_in_degrees(np.nan, 1.0))


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
