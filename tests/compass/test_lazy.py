"""All stages are lazy on dask arrays and equal to the eager result for any chunks and scheduler."""

from __future__ import annotations

import dask
import numpy as np
import pytest
import xarray as xr

from airswing.compass.correction import add_tables, correct
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.headings import derive_headings
from airswing.compass.screening import audit, mark_corrected_units, screen
from tests.compass.test_headings import flown, model

POOLS = {"both": ["ruc", "rtfdaa"]}


def refuse(*_, **__):
    raise AssertionError("something was computed")


def stages(reports: xr.Dataset, winds: xr.Dataset) -> list[xr.Dataset]:
    """Every stage on what the stage before returned."""
    headings = screen(derive_headings(reports, winds))
    headings = mark_corrected_units(
        headings, aircraft=["N001"], start=np.datetime64("2009-04-01", "ns")
    )
    fits = add_tables(fit_deviation(headings, pools=POOLS, min_reports=100), headings)
    return [headings, audit(headings), fits, correct(headings, fits)]


@pytest.fixture(scope="module")
def archive():
    reports = flown(flights=24, aircraft=3)
    reports = reports.assign_attrs(truth="").drop_attrs()
    # aircraft of different sizes: the last keeps a third of its reports
    kept = np.arange(reports.sizes["report"]) < reports.sizes["report"] - 144
    sizes = reports["row_size"].to_numpy().copy()
    sizes[-1] -= 144
    reports = reports.isel(report=kept).assign(row_size=("aircraft", sizes))
    winds = model(reports, noise=1.5, names=("ruc", "rtfdaa"))
    return reports, winds, stages(reports, winds)


@pytest.mark.parametrize("row_size", ["in memory", "lazy"])
@pytest.mark.parametrize("chunks", [{"report": 50}, {"report": 300, "aircraft": 2}, {"report": -1}])
def test_nothing_is_computed_and_the_result_is_the_eager_one(archive, chunks, row_size):
    reports, winds, eager = archive
    lazy_reports, lazy_winds = reports.chunk(chunks), winds.chunk({"report": 70})
    if row_size == "in memory":
        lazy_reports = lazy_reports.assign(row_size=reports["row_size"])
    with dask.config.set(scheduler=refuse):
        lazy = stages(lazy_reports, lazy_winds)
    for scheduler in ("synchronous", "threads"):
        for expected, found in zip(eager, dask.compute(*lazy, scheduler=scheduler), strict=True):
            xr.testing.assert_identical(found, expected)


def test_blocks_are_whole_aircraft_and_processes_give_the_same(archive):
    reports, winds, eager = archive
    lazy = reports.chunk({"report": 50}).assign(row_size=reports["row_size"])
    found = stages(lazy, winds)
    assert found[0]["heading"].chunks == (tuple(reports["row_size"].to_numpy().tolist()),)
    with dask.config.set(scheduler="processes", num_workers=2):
        xr.testing.assert_identical(found[2].compute(), eager[2])


def test_lazy_winds_make_lazy_headings(archive):
    reports, winds, eager = archive
    with dask.config.set(scheduler=refuse):
        found = screen(derive_headings(reports, winds.chunk(report=-1)))
    assert dask.is_dask_collection(found["heading_error"].data)
    xr.testing.assert_equal(found["heading_error"].compute(), eager[0]["heading_error"])


def test_lazy_fits_are_applied_lazily(archive):
    _, _, (headings, _, fits, corrected) = archive
    with dask.config.set(scheduler=refuse):
        found = correct(headings, fits.chunk())
    xr.testing.assert_identical(found.compute(), corrected)
