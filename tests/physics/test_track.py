"""Ground vectors, headings and bank of paths flown exactly; stated against actual errors."""

import numpy as np
import pytest
from pyproj import Geod

import airswing  # noqa: F401
from airswing.flags import ROLL
from airswing.physics.atmosphere import GRAVITY
from airswing.physics.bank import LIMIT, bank_at_reports
from airswing.physics.track import ground_track
from airswing.physics.triangle import along_cross, bearing, wrap_signed
from airswing.physics.turns import near_turns
from airswing.units import KNOT

GEOD = Geod(ellps="WGS84")
TENTH_MINUTE = 0.1 / 60.0


def straight(latitude, longitude, azimuth, speed, seconds):
    """Fixes along one geodesic, and the azimuth at each, in degrees."""
    start = (np.full(seconds.size, x) for x in (longitude, latitude, azimuth))
    lon, lat, back = GEOD.fwd(*start, speed * seconds)
    return np.asarray(lat), np.asarray(lon), np.mod(np.asarray(back) + 180.0, 360.0)


def tracked(lat, lon, seconds, **options):
    options = {"position_step": 0.0, "time_step": 0.0, **options}
    altitude = options.pop("altitude", np.zeros(np.shape(lat)))
    flight = options.pop("flight", np.zeros(np.shape(lat), dtype=int))
    return ground_track(lat, lon, seconds, altitude, flight, **options)


@pytest.mark.parametrize("azimuth", [0.0, 45.0, 90.0, 180.0, 270.0])
def test_a_geodesic_flown_steadily_gives_its_azimuth_at_every_fix(azimuth):
    # those to the east cross the antimeridian
    seconds = np.array([0.0, 165.0, 330.0, 400.0, 700.0])
    lat, lon, expected = straight(45.0, 179.9, azimuth + 1e-9, 128.6, seconds)
    motion = tracked(lat, lon, seconds)
    np.testing.assert_allclose(np.hypot(motion.eastward, motion.northward), 128.6, rtol=1e-9)
    track = np.degrees(bearing(motion.eastward, motion.northward))
    # the azimuth of a geodesic changes along it: by 1 degree here on an east-west leg
    np.testing.assert_allclose((track - expected[: track.size] + 180) % 360, 180.0, atol=1e-6)
    np.testing.assert_array_equal(motion.before, [0, 1, 1, 1, 1])
    np.testing.assert_array_equal(motion.after, [1, 1, 1, 1, 0])
    np.testing.assert_allclose(motion.turn[1:-1], 0.0, atol=1e-8)
    assert np.isnan(motion.turn[[0, -1]]).all()


def test_speeding_up_is_centred_at_the_report_with_unequal_legs():
    # along a meridian at 100 + 0.1 t: chords of 100 s and 200 s
    seconds = np.array([0.0, 100.0, 300.0])
    lat, lon, _ = straight(40.0, -90.0, 0.0, 100.0 + 0.05 * seconds, seconds)
    motion = tracked(lat, lon, seconds, altitude=2.0 * seconds)
    # by hand: chords 105 and 120 m/s, weighted 200 : 100, are 110 = 100 + 0.1 * 100
    assert motion.northward[1] == pytest.approx(110.0, abs=1e-6)
    assert motion.northward[0] == pytest.approx(105.0, abs=1e-6), "one chord, at its middle"
    assert motion.longitudinal_acceleration[1] == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_allclose(motion.climb_rate, 2.0)


def test_a_turn_its_sign_and_its_bank():
    # a circle to the right: 3 degrees in 30 s at 120 m/s
    rate, speed = np.radians(0.1), 120.0
    angle = rate * np.arange(9) * 30.0
    east, north = speed / rate * (1 - np.cos(angle)), speed / rate * np.sin(angle)
    azimuth, distance = np.degrees(np.arctan2(east, north)), np.hypot(east, north)
    lon, lat, _ = map(np.asarray, GEOD.fwd(*np.full((2, 9), [[-90.0], [40.0]]), azimuth, distance))
    motion = tracked(lat, lon, np.arange(9) * 30.0)
    inner = slice(1, -1)
    np.testing.assert_allclose(np.degrees(motion.turn[inner]), 3.0, atol=0.01)
    # tan(bank) = V omega / g = 120 * 0.00174533 / 9.80665: 1.2234 degrees, right wing down
    np.testing.assert_allclose(np.degrees(motion.bank[inner]), 1.2234, atol=0.005)
    track = bearing(motion.eastward, motion.northward)
    np.testing.assert_allclose(np.degrees(track - angle)[inner], 0.0, atol=0.04)
    leftward = tracked(lat, -180.0 - lon, np.arange(9) * 30.0)
    np.testing.assert_allclose(leftward.turn[inner], -motion.turn[inner], atol=1e-9)
    np.testing.assert_allclose(leftward.bank[inner], -motion.bank[inner], atol=1e-9)


def test_flights_do_not_touch_and_a_lone_report_has_no_value():
    seconds = np.array([0.0, 165.0, 330.0, 400.0, 0.0, 165.0])
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, seconds)
    motion = tracked(lat, lon, seconds, flight=np.array([4, 4, 4, 9, 2, 2]))
    assert np.isnan(motion.eastward[3]) and np.isnan(motion.cross_error[3])
    np.testing.assert_array_equal(motion.before, [0, 1, 1, 0, 0, 1])
    np.testing.assert_array_equal(motion.after, [1, 1, 0, 0, 1, 0])
    alone = tracked(lat[4:], lon[4:], seconds[4:])
    np.testing.assert_array_equal(motion.eastward[4:], alone.eastward)


def test_no_time_no_velocity_and_broken_chords():
    seconds = np.array([0.0, 165.0, 165.0, 330.0, 495.0, 660.0, 4000.0, 4165.0])
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, seconds)
    motion = tracked(lat, lon, seconds, widen=False)
    assert np.isnan(motion.eastward[[1, 2]]).all(), "two fixes at one time"
    assert np.isfinite(motion.eastward[[0, 3, 4, 5, 6, 7]]).all()
    assert motion.after[5] == 0 and motion.before[6] == 0, "no chord over 56 minutes"
    assert np.isfinite(motion.along_error[np.isfinite(motion.eastward)]).all()
    # one fix a degree off: neither of its chords is an aircraft's
    bad = np.arange(6) * 165.0
    lat, lon, _ = straight(45.0, -93.0, 70.0, 130.0, bad)
    lat[3] += 1.0
    motion = tracked(lat, lon, bad)
    assert np.isnan(motion.northward[3])
    np.testing.assert_allclose(np.hypot(motion.eastward, motion.northward)[[0, 1, 2, 4, 5]], 130.0)
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
    velocity = speed * np.stack([np.sin(azimuth), np.cos(azimuth)], -1) + np.cumsum(kick, axis=1)
    wobble = np.sqrt(density * change**3 / 12.0) * rng.normal(size=kick.shape)
    place = np.cumsum((velocity - kick / 2.0) * change + wobble, axis=1)
    place += rng.uniform(-2e4, 2e4, (flights, 1, 2)) - place[:, fixes // 2 : fixes // 2 + 1]
    place = place / [111319.49, 110574.28]  # metres a degree on the WGS84 equator
    lon, lat = np.moveaxis(np.round(place / position) * position, -1, 0).reshape(2, -1)
    seconds = (np.floor(seconds / tick) * tick).ravel()
    arguments = {"lat": lat, "lon": lon, "seconds": seconds}
    arguments["flight"] = np.repeat(np.arange(flights), fixes)
    return arguments, *velocity.reshape(-1, 2).T


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
    narrow = tracked(**arguments, **steps, acceleration_density=density, widen=False)
    centred = (wide.before > 0) & (wide.after > 0)
    ends = (wide.before > 0) ^ (wide.after > 0)
    assert ends.sum() == 2 * 150 and centred.sum() == 38 * 150
    before, miss = (
        along_cross(motion.eastward - east, motion.northward - north, bearing(east, north))
        for motion in (narrow, wide)
    )
    for rows in (centred, ends):
        for error, stated in zip(miss, (wide.along_error, wide.cross_error), strict=True):
            assert rms(error[rows]) == pytest.approx(rms(stated[rows]), rel=0.15)
    assert rms(np.hypot(*miss)[centred]) <= gain * rms(np.hypot(*before)[centred]) + 0.01
    assert abs(np.mean(miss[0][centred])) < 0.35, "and the bias of rounded times is gone"


def test_no_window_reaches_over_a_turn():
    seconds = np.arange(21) * 20.0
    along = 130.0 * (seconds - 200.0)  # from a corner
    lat, lon = np.minimum(along, 0.0) / 110574.28, np.maximum(along, 0.0) / 111319.49
    motion = tracked(lat, lon, seconds, position_step=TENTH_MINUTE, time_step=1.0)
    reach = np.arange(21)
    assert np.all((reach + motion.after)[reach < 10] <= 10)
    assert np.all((reach - motion.before)[reach > 10] >= 10)
    assert motion.before[10] == 1 and motion.after[10] == 1
    assert np.degrees(motion.turn[10]) == pytest.approx(90.0, abs=0.5)
    track = np.degrees(bearing(motion.eastward, motion.northward)) % 360.0
    np.testing.assert_allclose((track[:10] + 180.0) % 360.0, 180.0, atol=0.1)
    np.testing.assert_allclose(track[11:], 90.0, atol=0.1)
    assert motion.after[3] > 1, "but it does widen on the straight"


SPEED = 100.0


def flown(heading, *, interval=60, wind=0j, noise=0.0, seed=0):
    """Reports of a flight with its heading (rad) given for every second; wind is east + i north."""
    at = np.arange(0, heading.size, interval)
    air = SPEED * (np.sin(heading) + 1j * np.cos(heading))
    place = np.r_[0.0, np.cumsum(air + wind)][at]  # second by second
    place += [1, 1j] @ np.random.default_rng(seed).normal(0.0, noise, (2, at.size))
    leg = np.r_[np.diff(place) / interval, np.nan]
    centred = 0.5 * (np.r_[np.nan, leg[:-1]] + leg)
    centred[0], centred[-1] = leg[0], leg[-2]
    half, calm = np.full(at.size, 0.5), np.zeros(at.size)
    return {
        "leg": (leg.real, leg.imag, np.full(at.size, np.sqrt(2.0) * noise / interval)),
        "wind": (calm + wind.real, calm + wind.imag),
        "straight": (centred.real, centred.imag, half, half),
        "seconds": at.astype(float),
        "flight": np.zeros(at.size, int),
        "truth": heading[at],
        "parabola": np.pi / 2 - np.angle(centred - wind),
    }


def estimated(flight, **options):
    values = [flight[name] for name in ("leg", "wind", "straight", "seconds", "flight")]
    return near_turns(*values, **options)


def turn(begin, end, degrees, *, seconds=900):
    return np.radians(np.interp(np.arange(seconds), [begin, end], [0.0, degrees]))


def test_a_turn_within_a_leg_is_between_its_two_reports():
    flight = flown(turn(435, 465, 60.0), wind=12.0 - 5.0j)
    estimate = estimated(flight)
    assert {6, 7, 8, 9} <= set(estimate.report)
    off = wrap_signed(estimate.heading - flight["truth"][estimate.report])
    assert np.degrees(np.abs(off)).max() < 3.0
    assert estimate.airspeed == pytest.approx(np.full(estimate.report.size, SPEED), rel=0.02)
    # the mean of both legs was off by a quarter of the turn
    assert np.degrees(np.abs(wrap_signed(flight["parabola"] - flight["truth"]))).max() > 10.0


def test_a_turn_across_a_report_is_divided_between_both_legs():
    # 40 s before the report at 480 s, 20 s after it: 60 of 90 degrees are made there
    estimate = estimated(flown(turn(440, 500, 90.0)))
    at = np.flatnonzero(estimate.report == 8)[0]
    assert np.degrees(estimate.heading[at]) == pytest.approx(60.0, abs=6.0)
    assert np.degrees(estimate.heading_error[at]) < 15.0


@pytest.mark.parametrize(("flag", "low", "high"), [("good", 0.0, 12.0), ("bad", 5.0, 60.0)])
def test_the_roll_flag_shows_whether_the_turn_had_begun(flag, low, high):
    flight = flown(turn(470, 510, 60.0), noise=50.0, seed=3)
    roll = np.full(15, ROLL["good"])
    roll[8] = ROLL[flag]
    estimate = estimated(flight, roll_flag=roll)
    heading = np.degrees(wrap_signed(estimate.heading[estimate.report == 8]))[0]
    assert low - 3.0 < heading < high


def test_turns_of_all_sizes_are_found_within_their_standard_error():
    rng = np.random.default_rng(1)
    parts = []
    for seed in range(150):
        begin = rng.uniform(330.0, 570.0)
        bank = np.radians(12.0 * np.exp(rng.normal(0.0, 0.4)))
        size = rng.uniform(20.0, 120.0) * rng.choice([-1, 1])
        lasts = np.radians(abs(size)) * SPEED / (GRAVITY * np.tan(bank))
        flight = flown(turn(begin, begin + lasts, size), noise=50.0, seed=seed, wind=20.0 + 10.0j)
        estimate = estimated(flight)
        truth = flight["truth"][estimate.report]
        off = estimate.heading - truth, flight["parabola"][estimate.report] - truth
        inside = *map(wrap_signed, off), estimate.heading_error
        parts.append(np.stack(inside)[:, (estimate.report > 1) & (estimate.report < 13)])
    error, parabola, stated = np.concatenate(parts, axis=1)
    assert rms(error) < 0.4 * rms(parabola)
    assert np.mean(np.abs(error) > 2.0 * stated) < 0.05


def test_straight_flight_is_unchanged_except_at_its_ends():
    flight = flown(turn(0, 1, 0.0) + 0.7, wind=5.0 + 5.0j)
    estimate = estimated(flight)
    np.testing.assert_array_equal(estimate.report, [0, 14])
    np.testing.assert_allclose(estimate.heading, 0.7, atol=np.radians(0.1))
    np.testing.assert_allclose(estimate.airspeed, SPEED, rtol=1e-3)


def test_the_estimate_of_a_flight_does_not_depend_on_other_flights():
    single, two = flown(turn(400, 460, 70.0), noise=50.0), flown(turn(300, 330, -40.0), noise=50.0)
    parts = ("leg", "wind", "straight")
    joint = {name: tuple(map(np.concatenate, zip(single[name], two[name]))) for name in parts}  # noqa: B905
    joint["seconds"] = np.r_[single["seconds"], two["seconds"] + 5000.0]
    joint["flight"] = np.r_[single["flight"], two["flight"] + 1]
    alone, together = estimated(two), estimated(joint)
    later = together.report >= 15
    np.testing.assert_array_equal(together.report[later] - 15, alone.report)
    for name in ("heading", "airspeed", "heading_error", "airspeed_error"):
        np.testing.assert_array_equal(getattr(together, name)[later], getattr(alone, name))


TAS, STEP, METRES = 120.0, 60.0, 111195.0
BANK = float(np.radians(10.0))


def flights_with_one_turn():
    """Straight flights by the equator with one turn of 40 s each, at a random time; exact bank."""
    rng, parts, time = np.random.default_rng(1), [], np.arange(0.0, 900.0)
    for number in range(60):
        start = rng.uniform(240.0, 600.0)
        turning = (time >= start) & (time < start + 40.0)
        side = rng.choice([-1.0, 1.0])
        track = rng.uniform(0, 2 * np.pi) + side * np.cumsum(turning) * GRAVITY * np.tan(BANK) / TAS
        place = np.cumsum(TAS * np.exp(1j * track)) / METRES  # north + i east
        at = np.arange(0, 900, int(STEP))
        turn = np.r_[np.nan, wrap_signed(np.diff(np.angle(np.diff(place[at])))), np.nan]
        seen = np.arctan(TAS * turn / STEP / GRAVITY)
        true, flight = side * BANK * turning[at], np.full(at.size, number)
        parts.append((seen, true, flight, time[at], place[at].real, place[at].imag))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def test_mean_bank_comes_from_the_angle_turned_and_the_time_flagged():
    seen, true, flight, time, latitude, longitude = flights_with_one_turn()
    flag = np.where(np.abs(true) > LIMIT, 2, 1)
    bank = bank_at_reports(seen, flag, flight, time, latitude=latitude, longitude=longitude)
    banked = flag == 2
    assert np.abs(seen[banked]).mean() < 0.8 * np.radians(10.0)
    np.testing.assert_allclose(np.abs(bank[banked]).mean(), np.radians(10.0), rtol=0.15)
    np.testing.assert_array_equal(np.sign(bank[banked]), np.sign(true[banked]))
    assert np.nanmax(np.abs(bank[~banked])) < 0.2 * LIMIT
