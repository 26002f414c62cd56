"""Cells of variables, recent turns, and time since the first report of a flight."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.gap.toy import make_frame

from airswing.gap.archive.reported_variables import (
    Variable,
    cells_of,
    flight_time,
    last_turn,
    recent_turn,
    record,
)


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=3, aircraft=3, days=3)


def test_cells_are_quantiles_sectors_or_categories():
    linear = Variable("airspeed", "linear", np.arange(100.0)).edges(4)
    np.testing.assert_allclose(linear, [0, 24.75, 49.5, 74.25, 99])
    sectors = Variable("track", "circular", np.array([10.0, 350.0])).edges(12)
    np.testing.assert_allclose(sectors, 30.0 * np.arange(13))
    assert cells_of(np.array([29.9, 30.0, 359.0, np.nan]), sectors).tolist() == [0, 1, 11, -1]
    assert Variable("icing", "category", np.zeros(2)).edges(2).tolist() == [-0.5, 0.5, 1.5]


def test_cells_where_most_values_are_equal():
    """Nine of ten banks are near zero: quantiles of all would make two cells."""
    rng = np.random.default_rng(4)
    level = rng.normal(0.0, 0.01, 9_000)
    turning = rng.choice([-1.0, 1.0], 1_000) * rng.gamma(2.0, 8.0, 1_000)
    bank = Variable("bank", "linear", np.r_[level, np.zeros(9_000), turning])
    for count in (6, 12):
        edges = bank.edges(count)
        assert 0.75 * count <= edges.size - 1 <= 2 * count
        held = np.bincount(bank.cells(edges), minlength=edges.size - 1)
        assert np.sort(held)[:-1].max() < 500
        assert held.min() > 0


@given(
    values=st.lists(st.sampled_from([0.0, 0.0, 0.0, 1.0, 2.5, -40.0, 7.0]) | st.floats(-50, 50)),
    count=st.integers(2, 40),
)
def test_every_value_has_a_cell_and_edges_ascend(values, count):
    values = np.array([*values, -60.0, 60.0])
    variable = Variable("bank", "linear", values)
    edges = variable.edges(count)
    assert (np.diff(edges) > 0).all()
    assert (edges[0], edges[-1]) == (-60.0, 60.0)
    cells = variable.cells(edges)
    assert cells.min() >= 0 and cells.max() <= edges.size - 2


def test_constant_values_are_no_variable(frame):
    same = replace(frame, icing=np.zeros(frame.size, np.int64))
    assert "icing" not in record(same, same)
    assert {"track", "airspeed", "hour", "wind_direction"} <= set(record(frame, frame))


@pytest.fixture(scope="module")
def turning():
    """Two flights of a report a minute: north, east from the fourth on, west from the seventh."""
    made = make_frame(seed=1, aircraft=1, days=2).take(np.arange(20))
    track = np.radians(np.tile([0.0, 0, 0, 90, 90, 90, -30, -30, -30, -35], 2))
    flight = np.repeat([1, 2], 10)
    return replace(
        made,
        flight=flight,
        time=60.0 * np.arange(20) + 7200.0 * flight,
        ground_u=100 * np.sin(track),
        ground_v=100 * np.cos(track),
    )


def test_turn_of_the_last_two_minutes_last_turn_and_flight_time(turning):
    recent = [0, 0, 0, 90, 90, 0, -120, -120, 0, -5]
    np.testing.assert_allclose(recent_turn(turning), [*recent, *recent], atol=1e-9)
    last = [0, 0, 0, 90, 90, 90, -120, -120, -120, -120]
    np.testing.assert_allclose(last_turn(turning), [*last, *last], atol=1e-9)
    minutes = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    np.testing.assert_allclose(flight_time(turning), [*minutes, *minutes])
    days = flight_time(replace(turning, time=np.where(turning.time > 15000, 1e6, turning.time)))
    assert np.isnan(days[turning.time > 15000]).all()
    order = np.random.default_rng(0).permutation(turning.size)
    for function in (recent_turn, last_turn, flight_time):
        shuffled = function(turning.take(order))
        np.testing.assert_allclose(shuffled, function(turning)[order], atol=1e-9)
        assert function(turning.take(slice(0, 0))).size == 0
