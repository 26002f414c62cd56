"""Headings and bank near turns against flights whose heading is known at every second."""

import numpy as np
import pytest

import airswing  # noqa: F401
from airswing.flags import ROLL
from airswing.physics.atmosphere import GRAVITY
from airswing.physics.bank import LIMIT, bank_at_reports
from airswing.physics.triangle import wrap_signed
from airswing.physics.turns import near_turns

SPEED = 100.0


def flown(heading, *, interval=60, wind=(0.0, 0.0), noise=0.0, seed=0):
    """Reports of a flight with its heading (rad) given for every second."""
    air = SPEED * np.sin(heading), SPEED * np.cos(heading)
    at = np.arange(0, heading.size, interval)
    rng = np.random.default_rng(seed)
    leg = []
    for part, blown in zip(air, wind, strict=True):
        place = np.r_[0.0, np.cumsum(part + blown)]  # second by second
        fix = place[at] + rng.normal(0.0, noise, at.size)
        leg.append(np.r_[np.diff(fix) / interval, np.nan])
    error = np.full(at.size, np.sqrt(2.0) * noise / interval)
    centred = [0.5 * (np.r_[np.nan, part[:-1]] + part) for part in leg]
    for part, chord in zip(centred, leg, strict=True):
        part[0], part[-1] = chord[0], chord[-2]
    one = np.ones(at.size)
    return {
        "leg": (*leg, error),
        "wind": (wind[0] * one, wind[1] * one),
        "straight": (*centred, 0.5 * one, 0.5 * one),
        "seconds": at.astype(float),
        "flight": np.zeros(at.size, int),
        "truth": heading[at],
        "parabola": np.arctan2(centred[0] - wind[0], centred[1] - wind[1]),
    }


def estimated(made, **options):
    values = [made[name] for name in ("leg", "wind", "straight", "seconds", "flight")]
    return near_turns(*values, **options)


def turn(begin, end, degrees, *, seconds=900):
    return np.radians(np.interp(np.arange(seconds), [begin, end], [0.0, degrees]))


def test_a_turn_within_a_leg_is_between_its_two_reports():
    made = flown(turn(435, 465, 60.0), interval=60, wind=(12.0, -5.0))
    found = estimated(made)
    assert {6, 7, 8, 9} <= set(found.report)
    off = wrap_signed(found.heading - made["truth"][found.report])
    assert np.degrees(np.abs(off)).max() < 3.0
    assert found.airspeed == pytest.approx(np.full(found.report.size, SPEED), rel=0.02)
    # the mean of both legs was off by a quarter of the turn
    assert np.degrees(np.abs(wrap_signed(made["parabola"] - made["truth"]))).max() > 10.0


def test_a_turn_across_a_report_is_divided_between_both_legs():
    # 40 s before the report at 480 s, 20 s after it: 60 of 90 degrees are made there
    made = flown(turn(440, 500, 90.0))
    found = estimated(made)
    at = np.flatnonzero(found.report == 8)[0]
    assert np.degrees(found.heading[at]) == pytest.approx(60.0, abs=6.0)
    assert np.degrees(found.heading_error[at]) < 15.0


@pytest.mark.parametrize(("flag", "low", "high"), [("good", 0.0, 12.0), ("bad", 5.0, 60.0)])
def test_the_roll_flag_shows_whether_the_turn_had_begun(flag, low, high):
    made = flown(turn(470, 510, 60.0), noise=50.0, seed=3)
    roll = np.full(15, ROLL["good"])
    roll[8] = ROLL[flag]
    found = estimated(made, roll_flag=roll)
    heading = np.degrees(wrap_signed(found.heading[found.report == 8]))[0]
    assert low - 3.0 < heading < high


def test_turns_of_all_sizes_are_found_within_their_standard_error():
    rng = np.random.default_rng(1)
    error, parabola, beyond = [], [], []
    for seed in range(150):
        begin = rng.uniform(330.0, 570.0)
        bank = np.radians(12.0 * np.exp(rng.normal(0.0, 0.4)))
        size = rng.uniform(20.0, 120.0) * rng.choice([-1, 1])
        lasts = np.radians(abs(size)) * SPEED / (9.80665 * np.tan(bank))
        made = flown(turn(begin, begin + lasts, size), noise=50.0, seed=seed, wind=(20.0, 10.0))
        found = estimated(made)
        inside = (found.report > 1) & (found.report < 13)
        off = wrap_signed(found.heading - made["truth"][found.report])[inside]
        error.append(off)
        beyond.append(np.abs(off) > 2.0 * found.heading_error[inside])
        parabola.append(wrap_signed(made["parabola"] - made["truth"])[found.report[inside]])
    rms = np.degrees(np.sqrt(np.mean(np.concatenate(error) ** 2)))
    before = np.degrees(np.sqrt(np.mean(np.concatenate(parabola) ** 2)))
    assert rms < 0.4 * before
    assert np.mean(np.concatenate(beyond)) < 0.05


def test_straight_flight_is_unchanged_except_at_its_ends():
    made = flown(turn(0, 1, 0.0) + 0.7, wind=(5.0, 5.0))
    found = estimated(made)
    np.testing.assert_array_equal(found.report, [0, 14])
    np.testing.assert_allclose(found.heading, 0.7, atol=np.radians(0.1))
    np.testing.assert_allclose(found.airspeed, SPEED, rtol=1e-3)


def test_the_estimate_of_a_flight_does_not_depend_on_other_flights():
    one, two = flown(turn(400, 460, 70.0), noise=50.0), flown(turn(300, 330, -40.0), noise=50.0)
    parts = ("leg", "wind", "straight")
    both = {name: tuple(map(np.concatenate, zip(one[name], two[name]))) for name in parts}  # noqa: B905
    both["seconds"] = np.r_[one["seconds"], two["seconds"] + 5000.0]
    both["flight"] = np.r_[one["flight"], two["flight"] + 1]
    alone, together = estimated(two), estimated(both)
    later = together.report >= 15
    np.testing.assert_array_equal(together.report[later] - 15, alone.report)
    for name in ("heading", "airspeed", "heading_error", "airspeed_error"):
        np.testing.assert_array_equal(getattr(together, name)[later], getattr(alone, name))


TAS, STEP, METRES = 120.0, 60.0, 111195.0
BANK = float(np.radians(10.0))


def flights_with_one_turn(flights=60, seconds=40.0, bank=BANK, seed=1):
    """Straight flights near the equator with one turn each, at a random time: exact bank."""
    rng = np.random.default_rng(seed)
    parts = []
    for number in range(flights):
        time = np.arange(0.0, 900.0)
        start = rng.uniform(240.0, 600.0)
        turning = (time >= start) & (time < start + seconds)
        side = rng.choice([-1.0, 1.0])
        track = rng.uniform(0, 2 * np.pi) + side * np.cumsum(turning) * GRAVITY * np.tan(bank) / TAS
        places = np.cumsum(TAS * np.stack([np.cos(track), np.sin(track)]), axis=1) / METRES
        at = np.arange(0, 900, int(STEP))
        chords = np.diff(places[:, at], axis=1)
        course = np.arctan2(chords[1], chords[0])
        turn = np.full(at.size, np.nan)
        turn[1:-1] = np.mod(np.diff(course) + np.pi, 2 * np.pi) - np.pi
        seen = np.arctan(TAS * turn / STEP / GRAVITY)
        true, which = side * bank * turning[at], np.full(at.size, number)
        parts.append((seen, true, which, time[at], places[0, at], places[1, at]))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def test_mean_bank_comes_from_the_angle_turned_and_the_time_flagged():
    seen, true, flight, time, latitude, longitude = flights_with_one_turn()
    flag = np.where(np.abs(true) > LIMIT, 2, 1)
    found = bank_at_reports(seen, flag, flight, time, latitude=latitude, longitude=longitude)
    banked = flag == 2
    assert np.abs(seen[banked]).mean() < 0.8 * np.radians(10.0)
    np.testing.assert_allclose(np.abs(found[banked]).mean(), np.radians(10.0), rtol=0.15)
    np.testing.assert_array_equal(np.sign(found[banked]), np.sign(true[banked]))
    assert np.nanmax(np.abs(found[~banked])) < 0.2 * LIMIT
