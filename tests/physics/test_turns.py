"""Doubt about the heading at reports in a turn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from airswing.physics.turns import ground_at_fixes, heading_doubt, turn_at_reports


def test_the_turn_at_a_report_is_the_larger_of_its_two_sides():
    track = np.radians([0.0, 0.0, 90.0, 90.0, 350.0, 10.0])
    flight = np.array([1, 1, 1, 1, 2, 2])
    found = np.degrees(turn_at_reports(track, flight, np.arange(6.0)))
    np.testing.assert_allclose(found, [0, 90, 90, 0, 20, 20], atol=1e-9)


def test_rows_in_any_order_give_the_same():
    rng = np.random.default_rng(0)
    track, flight, time = (
        rng.uniform(0, 6, 40),
        np.repeat([3, 1], 20),
        rng.permutation(40).astype(float),
    )
    order = rng.permutation(40)
    found = turn_at_reports(track, flight, time)
    again = turn_at_reports(track[order], flight[order], time[order])
    np.testing.assert_allclose(again, found[order])


def test_only_a_deviated_aircraft_is_doubted_and_only_in_a_turn():
    heading = np.radians([0.0, 0.0, 60.0, 60.0] * 2)
    frame = SimpleNamespace(
        tails=("N1", "N2"),
        aircraft=np.repeat([0, 1], 4),
        flight=np.repeat([0, 1], 4),
        time=np.arange(8.0),
        ground_u=100 * np.sin(heading),
        ground_v=100 * np.cos(heading),
        u_ref=np.zeros(8),
        v_ref=np.zeros(8),
    )
    deviated = np.repeat([0.0, np.radians(3.0)], 4)
    columns = SimpleNamespace(heading=heading + deviated, airspeed=np.full(8, 100.0))
    doubt = heading_doubt(frame, columns)
    np.testing.assert_allclose(doubt[:4], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[[4, 7]], 0.0, atol=1e-9)
    np.testing.assert_allclose(doubt[5:7], 100 * np.radians(3.0) * np.radians(60.0), rtol=1e-6)


def flown(legs, *, minutes=3.0, reported=None):
    """Reports of one flight: a speed east and north for each leg between them, no wind."""
    east, north = (np.r_[0.0, np.cumsum(part)] * minutes * 60 for part in np.transpose(legs))
    latitude = np.degrees(north / 6371008.8)
    longitude = np.degrees(east / 6371008.8)
    n = len(legs) + 1
    middle = np.array([legs[0], *np.add(legs[1:], legs[:-1]) / 2, legs[-1]], float).T
    heading = np.arctan2(*middle) % (2 * np.pi)
    return {
        "latitude": latitude, "longitude": longitude, "time": np.arange(n) * minutes * 60.0,
        "flight": np.zeros(n, int), "ground_u": middle[0], "ground_v": middle[1],
        "u_rep": np.zeros(n), "v_rep": np.zeros(n), "airspeed": np.hypot(*middle),
        "heading": heading if reported is None else reported,
        "magnetic_heading": heading if reported is None else reported,
    }  # fmt: skip


def test_a_turn_within_a_leg_stands_between_its_two_reports():
    # 80 m/s north, a turn within one leg (flown at 45 degrees on average), then east
    made = ground_at_fixes(flown([(0, 80)] * 3 + [(50, 50)] + [(80, 0)] * 3))
    heading = np.degrees(made["heading"])
    np.testing.assert_allclose(heading[:4], 0.0, atol=1.0)
    np.testing.assert_allclose(heading[4:], 90.0, atol=1.0)
    np.testing.assert_allclose(made["airspeed"], 80.0, rtol=0.01)


def test_a_straight_flight_keeps_its_ground_vector():
    values = flown([(30, 70)] * 6)
    made = ground_at_fixes(values)
    for name in ("ground_u", "ground_v", "airspeed", "heading"):
        np.testing.assert_allclose(made[name], values[name], rtol=1e-4)


def test_a_heading_the_unit_reported_stays():
    told = np.full(8, 0.3)
    values = flown([(0, 80)] * 3 + [(50, 50)] + [(80, 0)] * 3, reported=told)
    made = ground_at_fixes(values)
    np.testing.assert_array_equal(made["heading"][:6], told[:6])


def test_one_report_alone_keeps_what_it_has():
    values = {name: array[:1] for name, array in flown([(0, 80)]).items()}
    made = ground_at_fixes(values)
    assert all(made[name][0] == values[name][0] for name in made)
