"""Ground vectors of paths flown exactly, then rounded; stated against actual errors."""

import numpy as np
import pytest
from pyproj import Geod

from airswing.physics.track import ground_track
from airswing.physics.triangle import along_cross, bearing

GEOD = Geod(ellps="WGS84")
KNOT = 1852.0 / 3600.0
TENTH_MINUTE = 0.1 / 60.0


def straight(latitude, longitude, azimuth, speed, seconds):
    """Fixes along one geodesic, and the azimuth at each, in degrees."""
    size = seconds.size
    lon, lat, back = GEOD.fwd(
        np.full(size, longitude), np.full(size, latitude), np.full(size, azimuth), speed * seconds
    )
    return np.asarray(lat), np.asarray(lon), np.mod(np.asarray(back) + 180.0, 360.0)


def tracked(lat, lon, seconds, **options):
    given = {"position_step": 0.0, "time_step": 0.0, **options}
    altitude = given.pop("altitude", np.zeros(np.shape(lat)))
    flight = given.pop("flight", np.zeros(np.shape(lat), dtype=int))
    return ground_track(lat, lon, seconds, altitude, flight, **given)


@pytest.mark.parametrize("azimuth", [0.0, 45.0, 90.0, 180.0, 270.0])
def test_a_geodesic_flown_steadily_gives_its_azimuth_at_every_fix(azimuth):
    # those to the east cross the antimeridian
    seconds = np.array([0.0, 165.0, 330.0, 400.0, 700.0])
    lat, lon, expected = straight(45.0, 179.9, azimuth + 1e-9, 128.6, seconds)
    found = tracked(lat, lon, seconds)
    np.testing.assert_allclose(np.hypot(found.eastward, found.northward), 128.6, rtol=1e-9)
    track = np.degrees(bearing(found.eastward, found.northward))
    # the azimuth of a geodesic changes along it: by 1 degree here on an east-west leg
    np.testing.assert_allclose((track - expected[: track.size] + 180) % 360, 180.0, atol=1e-6)
    np.testing.assert_array_equal(found.before, [0, 1, 1, 1, 1])
    np.testing.assert_array_equal(found.after, [1, 1, 1, 1, 0])
    np.testing.assert_allclose(found.turn[1:-1], 0.0, atol=1e-8)
    assert np.isnan(found.turn[[0, -1]]).all()


def test_speeding_up_is_centred_at_the_report_with_unequal_legs():
    # along a meridian at 100 + 0.1 t: chords of 100 s and 200 s
    seconds = np.array([0.0, 100.0, 300.0])
    path = 100.0 * seconds + 0.05 * seconds**2
    lon, lat, _ = GEOD.fwd(np.full(3, -90.0), np.full(3, 40.0), np.zeros(3), path)
    found = tracked(np.asarray(lat), np.asarray(lon), seconds, altitude=2.0 * seconds)
    # by hand: chords 105 and 120 m/s, weighted 200 : 100, are 110 = 100 + 0.1 * 100
    assert found.northward[1] == pytest.approx(110.0, abs=1e-6)
    assert found.northward[0] == pytest.approx(105.0, abs=1e-6), "one chord, at its middle"
    assert found.longitudinal_acceleration[1] == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_allclose(found.climb_rate, 2.0)


def test_a_turn_its_sign_and_its_bank():
    # a circle to the right: 3 degrees in 30 s at 120 m/s
    rate, speed = np.radians(0.1), 120.0
    angle = rate * np.arange(9) * 30.0
    east, north = speed / rate * (1 - np.cos(angle)), speed / rate * np.sin(angle)
    lon, lat, _ = GEOD.fwd(
        np.full(9, -90.0),
        np.full(9, 40.0),
        np.degrees(np.arctan2(east, north)),
        np.hypot(east, north),
    )
    found = tracked(np.asarray(lat), np.asarray(lon), np.arange(9) * 30.0)
    inner = slice(1, -1)
    np.testing.assert_allclose(np.degrees(found.turn[inner]), 3.0, atol=0.01)
    # tan(bank) = V omega / g = 120 * 0.00174533 / 9.80665: 1.2234 degrees, right wing down
    np.testing.assert_allclose(np.degrees(found.bank[inner]), 1.2234, atol=0.005)
    track = bearing(found.eastward, found.northward)
    np.testing.assert_allclose(np.degrees(track - angle)[inner], 0.0, atol=0.04)
    left = tracked(np.asarray(lat), -180.0 - np.asarray(lon), np.arange(9) * 30.0)
    np.testing.assert_allclose(left.turn[inner], -found.turn[inner], atol=1e-9)
    np.testing.assert_allclose(left.bank[inner], -found.bank[inner], atol=1e-9)


def test_flights_do_not_touch_and_a_lone_report_has_no_value():
    seconds = np.array([0.0, 165.0, 330.0, 400.0, 0.0, 165.0])
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, seconds)
    flight = np.array([4, 4, 4, 9, 2, 2])
    found = tracked(lat, lon, seconds, flight=flight)
    assert np.isnan(found.eastward[3]) and np.isnan(found.cross_error[3])
    np.testing.assert_array_equal(found.before, [0, 1, 1, 0, 0, 1])
    np.testing.assert_array_equal(found.after, [1, 1, 0, 0, 1, 0])
    alone = tracked(lat[4:], lon[4:], seconds[4:])
    np.testing.assert_array_equal(found.eastward[4:], alone.eastward)


def test_no_time_no_velocity_and_broken_chords():
    seconds = np.array([0.0, 165.0, 165.0, 330.0, 495.0, 660.0, 4000.0, 4165.0])
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, seconds)
    found = tracked(lat, lon, seconds, widen=False)
    assert np.isnan(found.eastward[[1, 2]]).all(), "two fixes at one time"
    assert np.isfinite(found.eastward[[0, 3, 4, 5, 6, 7]]).all()
    assert found.after[5] == 0 and found.before[6] == 0, "no chord over 56 minutes"
    assert np.isfinite(found.along_error[np.isfinite(found.eastward)]).all()
    # one fix a degree off: neither of its chords is an aircraft's
    bad = np.arange(6) * 165.0
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, bad)
    lat[3] += 1.0
    found = tracked(lat, lon, bad)
    assert np.isnan(found.northward[3])
    np.testing.assert_allclose(np.hypot(found.eastward, found.northward)[[0, 1, 2, 4, 5]], 130.0)
    lat[3] = np.nan
    assert np.isnan(tracked(lat, lon, bad).northward[3])


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def rounded_flights(leg, *, position, tick, density):
    """Flights whose velocity is a random walk, rounded; and the velocity at each fix.

    All on the equator near the origin of a tangent plane, where the plane is true to 1e-4.
    """
    flights, fixes, speed, rng = 150, 40, 250.0 * KNOT, np.random.default_rng(5)
    duration = leg * rng.uniform(0.9, 1.1, (flights, fixes))
    seconds = np.cumsum(duration, axis=1) + rng.uniform(0.0, 3600.0, (flights, 1))
    change = np.diff(seconds, axis=1, prepend=seconds[:, :1])[..., np.newaxis]
    kick = np.sqrt(density * change) * rng.normal(size=(flights, fixes, 2))
    azimuth = rng.uniform(0.0, 2 * np.pi, (flights, 1))
    start = speed * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    velocity = start + np.cumsum(kick, axis=1)
    wobble = np.sqrt(density * change**3 / 12.0) * rng.normal(size=kick.shape)
    place = np.cumsum((velocity - kick / 2.0) * change + wobble, axis=1)
    place += rng.uniform(-2e4, 2e4, (flights, 1, 2)) - place[:, fixes // 2 : fixes // 2 + 1]
    scale = np.array([111319.49, 110574.28])  # metres a degree on the WGS84 equator
    lon, lat = np.moveaxis(place / scale, -1, 0)
    arguments = {
        "lat": (np.round(lat / position) * position).ravel(),
        "lon": (np.round(lon / position) * position).ravel(),
        "seconds": (np.floor(seconds / tick) * tick).ravel(),
        "altitude": np.zeros(seconds.size),
        "flight": np.repeat(np.arange(flights), fixes),
    }
    return arguments, velocity[..., 0].ravel(), velocity[..., 1].ravel()


@pytest.mark.parametrize(
    ("leg", "position", "tick", "gain"),
    [
        (165.0, TENTH_MINUTE, 1.0, 0.99),
        (20.0, TENTH_MINUTE, 1.0, 0.45),
        (120.0, TENTH_MINUTE, 60.0, 0.30),
        (420.0, 0.01, 60.0, 0.65),
    ],
)
def test_stated_errors_are_the_actual_ones_and_widening_lowers_them(leg, position, tick, gain):
    density = 0.011
    arguments, east, north = rounded_flights(leg, position=position, tick=tick, density=density)
    steps = {"position_step": position, "time_step": tick}
    wide = tracked(**arguments, **steps, acceleration_density=density)
    plain = tracked(**arguments, **steps, acceleration_density=density, widen=False)
    centred = (wide.before > 0) & (wide.after > 0)
    ends = (wide.before > 0) ^ (wide.after > 0)
    assert ends.sum() == 2 * 150 and centred.sum() == 38 * 150
    before, miss = (
        along_cross(one.eastward - east, one.northward - north, bearing(east, north))
        for one in (plain, wide)
    )
    for which in (centred, ends):
        for error, stated in zip(miss, (wide.along_error, wide.cross_error), strict=True):
            assert rms(error[which]) == pytest.approx(rms(stated[which]), rel=0.15)
    assert rms(np.hypot(*miss)[centred]) <= gain * rms(np.hypot(*before)[centred]) + 0.01
    assert abs(np.mean(miss[0][centred])) < 0.35, "and the bias of rounded times is gone"


def test_no_window_reaches_over_a_turn():
    size = 21
    seconds = np.arange(size) * 20.0
    along = 130.0 * seconds
    corner = along[10]
    north = np.minimum(along, corner)
    east = np.maximum(along - corner, 0.0)
    lat, lon = north / 110574.28, east / 111319.49
    found = tracked(lat, lon, seconds, position_step=TENTH_MINUTE, time_step=1.0)
    reach = np.arange(size)
    assert np.all((reach + found.after)[reach < 10] <= 10)
    assert np.all((reach - found.before)[reach > 10] >= 10)
    assert found.before[10] == 1 and found.after[10] == 1
    assert np.degrees(found.turn[10]) == pytest.approx(90.0, abs=0.5)
    straight_legs = (reach < 10) | (reach > 10)
    expected = np.where(reach < 10, 0.0, 90.0)
    track = np.degrees(bearing(found.eastward, found.northward))
    miss = (track - expected + 180.0) % 360.0 - 180.0
    assert np.abs(miss[straight_legs]).max() < 0.1
    assert found.after[3] > 1, "but it does widen on the straight"
