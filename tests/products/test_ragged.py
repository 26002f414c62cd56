"""Ragged rows: where each aircraft's reports stand."""

from __future__ import annotations

import numpy as np
import xarray as xr

from airswing.products.ragged import aircraft_of_report, row_bounds


def test_hand_worked():
    row_size = np.array([2, 0, 1])
    start, stop = row_bounds(row_size)
    assert start.tolist() == [0, 2, 2] and stop.tolist() == [2, 2, 3]
    ds = xr.Dataset({"row_size": ("aircraft", row_size)})
    assert aircraft_of_report(ds).tolist() == [0, 0, 2]
