"""Ragged arrays: the reports of each aircraft."""

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.products.ragged import aircraft_of_report, row_bounds


def test_the_reports_of_each_aircraft():
    ds = xr.Dataset(
        {"time": ("report", np.arange(5)), "row_size": ("aircraft", np.array([2, 0, 3]))},
        coords={"aircraft": ["N1", "N2", "N3"]},
    )
    start, stop = row_bounds(ds["row_size"].to_numpy())
    assert start.tolist() == [0, 2, 2] and stop.tolist() == [2, 2, 5]
    assert aircraft_of_report(ds).tolist() == [0, 0, 2, 2, 2]
    assert airswing.aircraft_reports(ds, "N3")["time"].values.tolist() == [2, 3, 4]
    assert airswing.aircraft_reports(ds, "N2").sizes["report"] == 0
    with pytest.raises(KeyError, match="known: N1, N2, N3"):
        airswing.aircraft_reports(ds, "N9")
