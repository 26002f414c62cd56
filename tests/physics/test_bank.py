"""Bank at reports from the roll flag and the angle turned."""

from __future__ import annotations

import numpy as np

import airswing  # noqa: F401
from airswing.physics.atmosphere import GRAVITY
from airswing.physics.bank import LIMIT, bank_at_reports

SPEED, STEP, METRES = 120.0, 60.0, 111195.0
BANK = float(np.radians(10.0))


def flown(flights=60, seconds=40.0, bank=BANK, seed=1):
    """Straight flights near the equator with one turn each, at a random time: exact bank."""
    rng = np.random.default_rng(seed)
    parts = []
    for number in range(flights):
        time = np.arange(0.0, 900.0)
        start = rng.uniform(240.0, 600.0)
        turning = (time >= start) & (time < start + seconds)
        side = rng.choice([-1.0, 1.0])
        track = (
            rng.uniform(0, 2 * np.pi) + side * np.cumsum(turning) * GRAVITY * np.tan(bank) / SPEED
        )
        places = np.cumsum(SPEED * np.stack([np.cos(track), np.sin(track)]), axis=1) / METRES
        at = np.arange(0, 900, int(STEP))
        chords = np.diff(places[:, at], axis=1)
        course = np.arctan2(chords[1], chords[0])
        turn = np.full(at.size, np.nan)
        turn[1:-1] = np.mod(np.diff(course) + np.pi, 2 * np.pi) - np.pi
        seen = np.arctan(SPEED * turn / STEP / GRAVITY)
        true, which = side * bank * turning[at], np.full(at.size, number)
        parts.append((seen, true, which, time[at], places[0, at], places[1, at]))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def test_mean_bank_comes_from_the_angle_turned_and_the_time_flagged():
    seen, true, flight, time, latitude, longitude = flown()
    flag = np.where(np.abs(true) > LIMIT, 2, 1)
    found = bank_at_reports(seen, flag, flight, time, latitude=latitude, longitude=longitude)
    banked = flag == 2
    assert np.abs(seen[banked]).mean() < 0.8 * np.radians(10.0)
    np.testing.assert_allclose(np.abs(found[banked]).mean(), np.radians(10.0), rtol=0.15)
    np.testing.assert_array_equal(np.sign(found[banked]), np.sign(true[banked]))
    assert np.nanmax(np.abs(found[~banked])) < 0.2 * LIMIT
