"""Regression to the mean by hand: chosen in the first half of the window, watched in the second."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.evaluation.day_sums import DaySums
from airswing.evaluation.robustness import scrutinise

NAMES = np.array(["a", "b", "c", "d"])


def made(total: list[list[float]], corrected: list[bool]) -> DaySums:
    """One report a day; the last two days are the test's."""
    days = len(total[0])
    during = np.arange(days) >= days - 2
    return DaySums(np.ones((4, days)), np.array(total), np.array(corrected), during)


def test_the_worst_of_the_first_half_fall_by_themselves():
    sums = made(
        [[9, 9, 5, 5, 5, 5], [8, 8, 6, 6, 5, 5], [5, 5, 6, 6, 5, 5], [4, 4, 4, 4, 5, 5]],
        [False, True, True, False],
    )
    found = scrutinise(sums, NAMES, draws=50, seed=0)
    # a and b are worst: they fall by 4 and 2, mean 3; c and d rise by 1 and 0, mean -0.5
    regression = found["regression_to_the_mean"]
    assert regression["spurious_reduction_kt"] == pytest.approx(3.5)
    assert regression["rule"].startswith("the 2 aircraft")
    assert found["by_aircraft"][1] == {
        "aircraft": "b",
        "group": "corrected",
        "before_kt": 7.0,
        "during_kt": 5.0,
    }


def test_too_few_aircraft_to_choose_from_is_said():
    sums = made([[5.0] * 6] * 4, [True] * 4)
    assert "too few" in scrutinise(sums, NAMES, draws=20, seed=0)["regression_to_the_mean"]["why"]
