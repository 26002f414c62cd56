"""Sums by cluster against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.compass.fit.sandwich import group_sums


@pytest.mark.parametrize("ordered", [True, False])
@pytest.mark.parametrize("shape", [(3,), (2, 2)])
def test_rows_are_summed_by_group_in_any_order_and_with_empty_groups(ordered, shape):
    rng = np.random.default_rng(0)
    group = rng.choice([0, 2, 3, 6], 40)
    group = np.sort(group) if ordered else group
    values = rng.normal(size=(40, *shape))
    expected = np.array([values[group == k].sum(axis=0) for k in range(8)])
    np.testing.assert_allclose(group_sums(values, group, 8), expected, atol=1e-12)


def test_no_rows_make_no_sums():
    assert group_sums(np.zeros((0, 3)), np.zeros(0, int), 2).tolist() == [[0, 0, 0], [0, 0, 0]]
