"""A heading that follows late is told by what turned, and what it costs; turns alone tell none."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.as_sent.late_heading import lag, late_heading_of
from airswing.gap.effects.empirical import grid_of


def flown(headings, seconds):
    """One flight along these headings, a report every so often, degrees."""
    angle = np.radians(np.asarray(headings, float))
    frame = make_frame(seed=1, aircraft=1, days=2).take(np.arange(angle.size))
    ground = 100 * np.stack([np.sin(angle), np.cos(angle)])
    time = seconds * np.arange(angle.size)
    flight = np.zeros(angle.size, int)
    return dataclasses.replace(
        frame, flight=flight, time=time, ground_u=ground[0], ground_v=ground[1]
    )


def turning(frame, lags=0.0, aircraft=()):
    """The frame flown in zigzags of forty degrees, some aircraft's heading lagging."""
    turned = np.radians(40.0) * ((np.arange(frame.size) // 5) % 2)
    track = np.arctan2(frame.ground_u, frame.ground_v) + turned
    speed = np.hypot(frame.ground_u, frame.ground_v)
    right = dataclasses.replace(
        frame, ground_u=speed * np.sin(track), ground_v=speed * np.cos(track)
    )
    air = np.stack([right.ground_u - frame.u_rep, right.ground_v - frame.v_rep])
    heading, airspeed = np.arctan2(*air), np.hypot(*air)
    late = np.isin(frame.aircraft, aircraft) * lag(right, lags or 60.0, evenly=False) * (lags > 0)
    u = right.ground_u - airspeed * np.sin(heading + late)
    v = right.ground_v - airspeed * np.cos(heading + late)
    return dataclasses.replace(
        right, u_rep=u, v_rep=v, heading=np.mod(heading + late, 2 * np.pi), airspeed=airspeed
    )


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=6, aircraft=6, days=14, noise=1.5)


def test_a_memory_forgets_as_it_should():
    made = lag(flown([0, 0, 90, 90, 90], 60.0), 60.0, evenly=False)
    told = -np.radians(90.0) * np.exp(-np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(made, [0, 0, *told], atol=1e-12)
    # turned evenly for a minute: the mean of what each part of the turn has left
    made = lag(flown([0, 90, 90], 60.0), 60.0, evenly=True)
    rest = -np.radians(90.0) * (1 - np.exp(-1.0))
    np.testing.assert_allclose(made, [0, rest, rest * np.exp(-1.0)], atol=1e-12)


def test_turns_alone_are_no_lag(plain):
    assert late_heading_of(plain) is None
    assert late_heading_of(turning(plain)) is None


@pytest.mark.parametrize("seconds", [80.0, 160.0])
def test_a_late_heading_is_found_and_given_back(plain, seconds):
    right, frame = turning(plain), turning(plain, seconds, (1, 4))
    found = late_heading_of(frame)
    assert found is not None
    assert (found.component, found.variables, found.tails) == ("heading_angle", ("turn",), (1, 4))
    true = np.hypot(*frame.residual.T).mean() - np.hypot(*right.residual.T).mean()
    low, high = np.quantile(found.drawn, (0.01, 0.99))
    assert low - 0.03 * true <= true <= high + 0.03 * true
    # to the right the heading is behind to the left
    right_turns, left_turns = found.values[-3], found.values[2]
    assert right_turns < 0 < left_turns
    grid_of({"variables": ["turn"], "edges": [found.edges]})
