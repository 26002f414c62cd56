"""Kernels by hand, by round trip, and against pyproj, scipy, IGRF and printed tables."""

from datetime import datetime

import numpy as np
import ppigrf
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod
from scipy.stats import median_abs_deviation

from airswing.physics import triangle
from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    airspeed_from_mach,
    altitude_from_pressure,
    pressure_from_altitude,
    speed_of_sound,
    standard_temperature,
)
from airswing.physics.geomagnetism import GeomagneticField, geomagnetic_field
from airswing.physics.great_circle import central_angle
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats, hats_not_zero
from airswing.units import KNOT

angles = st.floats(-50.0, 50.0)
speeds = st.floats(0.1, 300.0)

POINTS = np.arange(0.0, 360.0, 45.0)
H = 0.5**0.5
VECTORS = np.array([[0, H, 1, H, 0, -H, -1, -H], [1, H, 0, -H, -1, -H, 0, H]])
"""Unit vectors (east, north) of the eight compass points."""


def test_eight_compass_points():
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


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_a_wind_from_just_west_of_north_is_below_360_degrees(precision):
    direction = triangle.direction_in_degrees(*np.array([[1e-17], [-10.0]], precision))
    assert direction.dtype == precision and direction[0] == 0.0


@given(st.floats(-4.0, 7.5), angles)
def test_compass_error_comes_back_with_its_sign(error, heading):
    wind = (-12.0, 9.0)
    ground = np.add(triangle.vector_from_bearing(130.0, heading), wind)
    reported = triangle.wind_from_triangle(*ground, 130.0, heading + np.radians(error))
    used = triangle.air_vector(*ground, *reported)
    implied = triangle.air_vector(*ground, *wind)
    recovered = triangle.heading_error(*used, *implied)
    assert np.degrees(recovered) == pytest.approx(error, abs=1e-9)
    assert triangle.airspeed_error(*used, *implied) == pytest.approx(0.0, abs=1e-9)


def test_triangle_worked_by_hand():
    # heading 090 at 100 m/s true, wind from 360 at 20 m/s (blows south): the aircraft
    # makes 100 east and 20 south, a track of atan2(100, -20) = 101.3099 degrees at 101.980
    wind, ground = (0.0, -20.0), (100.0, -20.0)
    assert np.degrees(triangle.bearing(*ground)) == pytest.approx(101.309932, abs=1e-6)
    assert triangle.wind_from_direction(*ground)[0] == pytest.approx(101.980390, abs=1e-6)
    vector = triangle.wind_from_triangle(*ground, 100.0, np.pi / 2)
    np.testing.assert_allclose(vector, wind, atol=1e-12)
    # a compass reading 091 makes 100 (sin 91, cos 91) = (99.98477, -1.745241) of air vector,
    # a wind of (0.01523, -18.254759): 1.745 m/s of error to the left of the heading
    vector = triangle.wind_from_triangle(*ground, 100.0, np.radians(91.0))
    np.testing.assert_allclose(vector, (0.0152305, -18.2547594), atol=1e-6)
    along, cross = triangle.along_cross(vector[0] - wind[0], vector[1] - wind[1], np.pi / 2)
    assert cross == pytest.approx(-1.745241, abs=1e-5)
    assert along == pytest.approx(0.0152305, abs=1e-6)


def test_wraps_by_hand():
    degrees = np.array([-540.0, -180.0, -179.0, 0.0, 180.0, 181.0, 360.0, 540.0])
    expected = np.array([180.0, 180.0, -179.0, 0.0, 180.0, -179.0, 0.0, 180.0])
    signed = np.degrees(triangle.wrap_signed(np.radians(degrees)))
    np.testing.assert_allclose(signed, expected, atol=1e-9)
    # degrees are open above
    wrapped = triangle.wrap_degrees(degrees.astype(np.float32))
    assert wrapped.tolist() == np.where(expected == 180.0, -180.0, expected).tolist()
    # opposite vectors are half a turn apart, positive whichever way it is asked
    assert triangle.heading_error(0.0, -1.0, 0.0, 1.0) == np.pi
    assert triangle.heading_error(-0.0, -1.0, 0.0, 1.0) == np.pi


def test_calm_and_unknown_winds_have_no_direction():
    speed, direction = triangle.wind_from_direction(0.0, 0.0)
    assert speed == 0.0 and np.isnan(direction)
    assert np.isnan(triangle.bearing(0.0, 0.0))
    assert np.isnan(triangle.heading_error(0.0, 0.0, 1.0, 0.0))
    np.testing.assert_array_equal(triangle.wind_components(0.0, np.nan), (0.0, 0.0))
    assert np.isnan(triangle.wind_components(5.0, np.nan)).all()
    assert np.isnan(triangle.direction_in_degrees(np.nan, 1.0))


@given(angles)
def test_wraps_stay_in_range_and_keep_the_angle(angle):
    signed, positive = triangle.wrap_signed(angle), triangle.wrap_positive(angle)
    assert -np.pi < signed <= np.pi
    assert 0.0 <= positive < 2 * np.pi
    for wrapped in (signed, positive):
        turns = (wrapped - angle) / (2 * np.pi)
        assert turns == pytest.approx(round(float(turns)), abs=1e-9)


@given(speeds, angles, angles)
def test_along_cross_round_trip_and_length(speed, direction, heading):
    vector = triangle.vector_from_bearing(speed, direction)
    turned = triangle.along_cross(*vector, heading)
    assert np.hypot(*turned) == pytest.approx(speed)
    # the turn is a reflection: made twice it leaves the vector as it was
    np.testing.assert_allclose(triangle.along_cross(*turned, heading), vector, atol=1e-9)
    # 'cross' is the part to the right
    right = triangle.along_cross(*triangle.vector_from_bearing(1.0, heading + np.pi / 2), heading)
    np.testing.assert_allclose(right, (0.0, 1.0), atol=1e-12)


def test_printed_standard():
    # ICAO Doc 7488/3 tables, geopotential altitude in m against hPa
    altitude = [0.0, 1000.0, 5000.0, 11000.0, 12000.0, 15000.0, 20000.0]
    pressure = [1013.25, 898.746, 540.199, 226.321, 193.304, 120.446, 54.7489]
    computed = pressure_from_altitude(np.array(altitude)) / 100.0
    np.testing.assert_allclose(computed, pressure, rtol=2e-5)
    temperature = standard_temperature(np.array([0.0, 11e3, 15e3]))
    np.testing.assert_allclose(temperature, [288.15, 216.65, 216.65])


@given(st.floats(-4000.0, 20000.0) | st.just(np.nan))
def test_round_trip(altitude):
    back = altitude_from_pressure(pressure_from_altitude(altitude))
    assert back == pytest.approx(altitude, abs=1e-6, nan_ok=True)


def test_values_without_physical_meaning_give_nan():
    assert np.isnan(altitude_from_pressure(np.array([0.0, -5.0]))).all()
    assert np.isnan(speed_of_sound(-1.0))


def test_mach_one_is_the_speed_of_sound_of_the_standard_atmosphere():
    """ICAO Doc 7488/3: 340.294 m/s at sea level, 295.069 in the lower stratosphere."""
    assert airspeed_from_mach(1.0, 288.15) == pytest.approx(340.294, abs=1e-3)
    assert airspeed_from_mach(0.5, 216.65) == pytest.approx(0.5 * 295.069, abs=1e-3)


def test_true_airspeed_by_hand():
    """250 kt at sea level is 250 kt; at FL350 the pitot equation is worked by hand.

    Impact pressure 101325 ((1 + 0.2 (250/661.479)^2)^3.5 - 1) over 23842 Pa gives the Mach number,
    and 576.42 kt is the speed of sound at 218.81 K.
    """
    assert airspeed_from_calibrated(250 * KNOT, 101325.0, 288.15) == pytest.approx(250 * KNOT)
    air = pressure_from_altitude(35000 * 0.3048), standard_temperature(35000 * 0.3048)
    airspeed = airspeed_from_calibrated(250 * KNOT, *air)
    impact = 101325.0 * ((1 + 0.2 * (250 / 661.4786) ** 2) ** 3.5 - 1)
    mach = np.sqrt(5 * ((1 + impact / 23842.3) ** (2 / 7) - 1))
    assert airspeed / KNOT == pytest.approx(mach * 576.42, abs=0.05)


MID_2009 = float(np.datetime64("2009-07-01", "s").astype(np.int64))


def field_at(latitude, longitude, height=3000.0, seconds=MID_2009):
    return geomagnetic_field(latitude, longitude, height, seconds)


@pytest.mark.parametrize(
    ("north", "south", "west", "east"),
    [
        (50.0, 24.0, -130.0, -65.0),
        (72.0, 50.0, -180.0, -130.0),
        (72.0, 35.0, -12.0, 40.0),
        (15.0, -60.0, -180.0, 180.0),
    ],
)
def test_declination_within_a_hundredth_of_a_degree_of_igrf(north, south, west, east):
    rng = np.random.default_rng(7)
    latitude, longitude = rng.uniform(south, north, 300), rng.uniform(west, east, 300)
    height = rng.uniform(-200.0, 13500.0, 300)
    for date in (datetime(2008, 7, 3), datetime(2011, 3, 1, 6)):
        field = field_at(latitude, longitude, height, (date - datetime(1970, 1, 1)).total_seconds())
        e, n, up = (x[0] for x in ppigrf.igrf(longitude, latitude, height / 1000.0, date))
        horizontal = np.hypot(e, n)
        strong = horizontal > 5000.0
        miss = np.degrees(np.abs(field.declination - np.arctan2(e, n)))[strong]
        assert strong.sum() > 210
        assert miss.max() < 0.01
        assert np.abs(field.horizontal - horizontal).max() < 1.0
        assert np.degrees(np.abs(field.dip - np.arctan2(-up, horizontal))).max() < 0.01


def test_one_reports_field_does_not_depend_on_the_others():
    rng = np.random.default_rng(11)
    size = 70_001  # more than two blocks, and no multiple of one
    # from pole to pole across the 180th meridian and two five-year intervals
    latitude, longitude = rng.uniform(-89.9, 89.9, size), rng.uniform(150.0, 210.0, size)
    height = rng.uniform(0.0, 13000.0, size)
    seconds = rng.uniform(1.2e9, 1.3e9, size)
    fields = geomagnetic_field(latitude, longitude, height, seconds)
    for subset in (slice(0, 1), slice(5, 12), slice(40_000, 40_777), slice(65_000, size)):
        arguments = latitude[subset], longitude[subset], height[subset], seconds[subset]
        alone = geomagnetic_field(*arguments)
        for name in GeomagneticField._fields:
            np.testing.assert_array_equal(getattr(alone, name), getattr(fields, name)[subset])
    signed = (longitude + 180.0) % 360.0 - 180.0
    of_signed = geomagnetic_field(latitude, signed, height, seconds)
    np.testing.assert_allclose(of_signed.declination, fields.declination, atol=1e-9)


def test_unknown_places_and_times_outside_the_epochs_have_no_field():
    latitude = np.array([np.nan, 45.0, 45.0, 91.0, 45.0])
    longitude = np.array([10.0, np.nan, 10.0, 10.0, 10.0])
    seconds = np.array([MID_2009, MID_2009, np.nan, MID_2009, 3.0e9])
    field = field_at(latitude, longitude, 3000.0, seconds)
    assert np.isnan(field.declination).all()
    assert np.isnan(field.horizontal).all()
    assert np.isfinite(field_at(45.0, 10.0).dip)
    assert geomagnetic_field([], [], [], []).declination.shape == (0,)


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
    angle = central_angle(*map(np.radians, (lat, lon, to_lat, to_lon)))
    np.testing.assert_allclose(angle, expected, rtol=1e-9)


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
    rows = [[1, 1, 0.75, 0, 0, 0, 0, 0], [0, 0, 0.25, 1, 0.5, 0, 0, 0], [0, 0, 0, 0, 0.5, 1, 1, 0]]
    np.testing.assert_array_equal(hats(values, np.array([0.0, 1.0, 3.0])), rows)


@pytest.mark.parametrize("knots", [1, 2, 3, 9])
def test_the_hats_that_are_not_zero_are_those_of_all(knots):
    rng = np.random.default_rng(knots)
    knots = np.sort(rng.uniform(-1.0, 1.0, knots))
    values = np.r_[rng.uniform(-1.5, 1.5, 200), knots]
    index, value = hats_not_zero(values, knots)
    dense = np.zeros((knots.size, values.size))
    np.add.at(dense, (index.T, np.arange(values.size)), value.T)
    expected = hats(values, knots) if knots.size > 1 else np.ones((1, values.size))
    np.testing.assert_array_equal(dense, expected)
