"""Values against numpy's least squares, errors against what days drawn again come to."""

import numpy as np
import pytest

from airswing.gap.as_sent.day_regression import regressed


def drawn(seed, days=40, each=20):
    """Two columns, two values with errors that a day's reports share."""
    rng = np.random.default_rng(seed)
    day = np.repeat(np.arange(days), each)
    x = np.stack([np.ones(day.size), rng.normal(size=days)[day] + rng.normal(size=day.size)], -1)
    shared = rng.normal(size=(days, 2))[day]
    y = x @ np.array([[1.0, -2.0], [0.5, 0.0]]) + shared + 0.1 * rng.normal(size=shared.shape)
    return x, y, day


def test_values_are_those_of_least_squares_in_any_order():
    x, y, day = drawn(0)
    value, error = regressed(x, y, day)
    np.testing.assert_allclose(value, np.linalg.lstsq(x, y, rcond=None)[0], atol=1e-12)
    turned = np.random.default_rng(1).permutation(day.size)
    again = regressed(x[turned], y[turned], 7 * day[turned] + 3)
    np.testing.assert_allclose(again, (value, error), atol=1e-12)


def test_errors_are_as_large_as_values_scatter():
    made = [regressed(*drawn(seed)) for seed in range(300)]
    scatter = np.std([value for value, _ in made], axis=0)
    stated = np.sqrt(np.mean([error**2 for _, error in made], axis=0))
    np.testing.assert_allclose(stated, scatter, rtol=0.15)


def test_a_column_that_copies_another_shares():
    x, y, day = drawn(2)
    value, _ = regressed(np.column_stack([x, x[:, 1]]), y, day)
    assert value[1:].sum(axis=0) == pytest.approx(regressed(x, y, day)[0][1])
