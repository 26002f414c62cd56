"""What turned before a report: over two minutes, and by the last turn."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.archive.recent_turns import last_turn, turn


@pytest.fixture(scope="module")
def frame():
    """Two flights of a report a minute: north, east from the fourth on, west from the seventh."""
    made = make_frame(seed=1, aircraft=1, days=2).take(np.arange(20))
    track = np.radians(np.tile([0.0, 0, 0, 90, 90, 90, -30, -30, -30, -35], 2))
    flight = np.repeat([1, 2], 10)
    return dataclasses.replace(
        made,
        flight=flight,
        time=60.0 * np.arange(20) + 7200.0 * flight,
        ground_u=100 * np.sin(track),
        ground_v=100 * np.cos(track),
    )


def test_what_turned_in_two_minutes(frame):
    first = [0, 0, 0, 90, 90, 0, -120, -120, 0, -5]
    np.testing.assert_allclose(turn(frame), [*first, *first], atol=1e-9)


def test_the_last_turn_is_held_until_the_next(frame):
    first = [0, 0, 0, 90, 90, 90, -120, -120, -120, -120]
    np.testing.assert_allclose(last_turn(frame), [*first, *first], atol=1e-9)


def test_order_of_reports_changes_nothing(frame):
    order = np.random.default_rng(0).permutation(frame.size)
    for of in (turn, last_turn):
        np.testing.assert_allclose(of(frame.take(order)), of(frame)[order], atol=1e-9)
