"""Ragged rows laid out and back."""

from __future__ import annotations

import numpy as np
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from airswing.ragged import aircraft_of_report, padded, row_bounds, unpadded


def test_hand_worked():
    row_size = np.array([2, 0, 1])
    start, stop = row_bounds(row_size)
    assert start.tolist() == [0, 2, 2] and stop.tolist() == [2, 2, 3]
    rows = padded(np.array([1.0, 2.0, 3.0]), row_size)
    np.testing.assert_array_equal(rows, [[1, 2], [np.nan, np.nan], [3, np.nan]])
    ds = xr.Dataset({"row_size": ("aircraft", row_size)})
    assert aircraft_of_report(ds).tolist() == [0, 0, 2]


@given(st.lists(st.integers(0, 5), min_size=1, max_size=6))
def test_round_trip(sizes):
    values = np.arange(float(sum(sizes)))
    np.testing.assert_array_equal(
        unpadded(padded(values, np.array(sizes)), np.array(sizes)), values
    )
