from __future__ import annotations

import numpy as np
import pytest

from airswing.physics.splines import hats, hats_not_zero

KNOTS = np.array([0.0, 1.0, 3.0])


def test_hats_by_hand():
    values = np.array([-5.0, 0.0, 0.25, 1.0, 2.0, 3.0, 9.0, np.nan])
    expected = [
        [1, 1, 0.75, 0, 0, 0, 0, 0],
        [0, 0, 0.25, 1, 0.5, 0, 0, 0],
        [0, 0, 0, 0, 0.5, 1, 1, 0],
    ]
    np.testing.assert_array_equal(hats(values, KNOTS), expected)


@pytest.mark.parametrize("count", [2, 3, 9])
def test_the_two_that_are_not_zero_are_those_of_all(count):
    rng = np.random.default_rng(count)
    knots = np.sort(rng.uniform(-1.0, 1.0, count))
    values = np.r_[rng.uniform(-1.5, 1.5, 200), knots]
    index, value = hats_not_zero(values, knots)
    whole = np.zeros((count, values.size))
    np.add.at(whole, (index.T, np.arange(values.size)), value.T)
    np.testing.assert_array_equal(whole, hats(values, knots))


def test_one_knot_is_one_everywhere():
    index, value = hats_not_zero(np.array([-3.0, 7.0]), np.zeros(1))
    assert index.tolist() == [[0], [0]] and value.tolist() == [[1.0], [1.0]]
