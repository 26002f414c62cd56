"""Acceleration at the reports, cells of variables, recent turns and time since the first report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.gap.toy import make_frame

from airswing.gap.archive.acceleration import (
    acceleration_at_reports,
    expected_acceleration,
    fit_levelling,
    time_since_levelling,
)
from airswing.gap.archive.reported_variables import (
    Variable,
    cells_of,
    flight_time,
    last_turn,
    recent_turn,
    record,
)


def test_time_of_levelling_off_is_extrapolated_from_the_climb():
    # 10 m/s up to 3000 m, reached 30 s after the report at 2700 m; then cruise
    time = np.array([0.0, 60, 120, 180, 300, 420, 540, 660])
    altitude = np.array([1500.0, 2100, 2700, 3000, 3000, 3000, 3000, 3000])
    phase = np.array([1, 1, 1, 2, 2, 2, 2, 2])
    since = time_since_levelling(time, altitude, phase, np.zeros(8, int))
    np.testing.assert_allclose(since[3:], [30, 150, 270, 390, 510])
    assert np.isnan(since[:3]).all()


def _flights(number: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Start, end and mean speed of four chords of flights whose acceleration is known."""
    fine = np.arange(0.0, 1200.0, 0.5)
    gain = np.where(fine < 30, 0.3, 0.3 * np.exp(-(fine - 30) / 45))
    path = np.cumsum(np.cumsum(gain) * 0.5) * 0.5
    first = rng.uniform(0, 60, number)
    edges = first[:, None] + 120.0 * np.arange(5)
    distance = np.interp(edges, fine, path)
    mean = np.diff(distance, axis=1) / 120 + rng.normal(120, 8, (number, 1))
    mean += rng.normal(0, 1.0, mean.shape)
    flight = np.repeat(np.arange(number), 4)
    return edges[:, :-1].ravel(), edges[:, 1:].ravel(), mean.ravel(), flight


def test_acceleration_after_levelling_off_from_longer_chords():
    gain = fit_levelling(*_flights(1500, np.random.default_rng(3)))
    assert gain is not None
    assert fit_levelling(*_flights(20, np.random.default_rng(3))) is None  # too few
    found = np.interp([10.0, 50.0, 90.0, 200.0], [0, 20, 40, 65, 100, 150, 210], gain)
    truth = 0.3 * np.exp(-np.maximum(np.array([10.0, 50.0, 90.0, 200.0]) - 30, 0) / 45)
    np.testing.assert_allclose(found, truth, atol=0.06)


def test_unknown_acceleration_remains_unknown():
    unknown = np.full(6, np.nan)
    time = 60.0 * np.arange(6)
    found = acceleration_at_reports(
        unknown, np.full(6, 5e4), np.full(6, 2), np.zeros(6, int), time, time / 100, time / 100
    )
    assert np.isnan(found).all()


def test_acceleration_is_the_fleets_profile_and_not_the_reports_noise():
    rng = np.random.default_rng(2)
    phase = np.tile(np.repeat([1, 2, 3], 20), 400)
    flight = np.repeat(np.arange(400), 60)
    level = np.tile(
        np.concatenate(
            [np.linspace(11.5, 10.6, 20), np.full(20, 10.6), np.linspace(10.6, 11.5, 20)]
        ),
        400,
    )
    true = np.choose(phase, [0.0, 0.06 - 0.02 * (11.5 - level), 0.0, -0.05])
    found = expected_acceleration(true + rng.normal(0, 0.05, phase.size), level, phase, flight)
    steady = phase != 2
    np.testing.assert_allclose(found[steady], true[steady], atol=0.006)


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
