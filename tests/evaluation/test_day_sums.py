"""Sums by aircraft and day against hand-made ones, and the spread of days drawn again."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from airswing.evaluation.day_sums import DayPart, DaySums, bootstrap, day_weights

DAY = np.datetime64("2009-10-19")


def part(hours: list[int], row_size: list[int], window: list[int], values: list[float]) -> DayPart:
    ds = xr.Dataset(
        {
            "time": ("report", DAY.astype("M8[ns]") + np.array(hours) * np.timedelta64(1, "h")),
            "row_size": ("aircraft", row_size),
        }
    )
    chosen = np.array(window) >= 0
    return DayPart.of(ds, np.array(values), chosen, np.array(window))


def sums() -> DaySums:
    """Aircraft 0 and 1 in one block, 2 in another; the test starts at noon of the second day."""
    first = part([1, 2, 25, 37, 3, 40], [4, 2], [0, 0, 0, 1, 0, 1], [2.0, 4.0, 9.0, 5.0, 1.0, 7.0])
    second = part([26, 38, 50], [3], [0, 1, -1], [8.0, 6.0, 99.0])
    return DaySums.of([first, second], np.ones(3, bool), np.array([True, False, False]))


def test_a_day_split_by_the_start_counts_once_in_each_window():
    found = sums()
    assert found.during.tolist() == [False, False, True]
    assert found.count.tolist() == [[2, 1, 1], [1, 0, 1], [0, 1, 1]]
    assert found.total.tolist() == [[6, 9, 5], [1, 0, 7], [0, 8, 6]]


def test_means_of_groups_and_levels_of_aircraft_by_hand():
    found = sums()
    assert found.means() == {
        ("controls", "before"): 4.5,
        ("controls", "during"): 6.5,
        ("corrected", "before"): 5.0,
        ("corrected", "during"): 5.0,
    }
    before, during = found.levels()
    assert before.tolist() == [5.0, 1.0, 8.0]
    assert during.tolist() == [5.0, 7.0, 6.0]


def test_aircraft_of_neither_group_are_left_out():
    first = part([1, 2], [1, 1], [0, 0], [2.0, 4.0])
    found = DaySums.of([first], np.array([False, True]), np.array([True]))
    assert found.total.tolist() == [[4.0]]


@pytest.mark.parametrize("days", [3, 10])
def test_days_drawn_again_vary_as_much_as_their_mean_does(days):
    values = np.random.default_rng(1).normal(size=days)
    weights = day_weights(np.random.default_rng(2), 40_000, days)
    assert np.allclose(weights.sum(axis=1), days)
    drawn = weights @ values / days
    assert drawn.var() == pytest.approx(values.var(ddof=1) / days, rel=0.03)


def test_the_bootstrap_draws_around_the_means():
    found = sums()
    drawn = bootstrap(found, draws=50, seed=0)
    assert drawn.shape == (50, 2, 2)
    # one day in the window of the test: there is nothing to vary
    assert np.allclose(drawn[:, :, 1], [6.5, 5.0])
