"""Doubt about the heading at reports in a turn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from airswing.gap.turning import heading_doubt, turn_at_reports


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
