"""What headings.nc costs on disk, and that rounding stays where it is harmless."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from benchmarks import __main__ as benchmarks

from airswing.products.netcdf import (
    REPORTS_A_CHUNK,
    STORED_STEP,
    as_stored,
    read_product,
    write_product,
)
from airswing.vocabulary import VARIABLES


def fleet(count: int) -> xr.Dataset:
    rng = np.random.default_rng(3)
    return xr.Dataset(
        {
            "heading": ("report", rng.uniform(0, 360, count)),
            "heading_error": (("reference", "report"), rng.normal(size=(2, count))),
            "latitude": ("report", rng.uniform(30, 50, count)),
            "eastward_wind": ("report", rng.normal(0, 20, count)),
        },
        coords={"reference": ["a", "b"]},
    )


def test_derived_variables_are_rounded_and_what_was_reported_is_not():
    exact = fleet(1000)
    stored = as_stored(exact)
    for name in ("heading", "heading_error"):
        apart = np.abs(stored[name].astype("f8") - exact[name])
        assert 0 < apart.max() <= STORED_STEP[name] / 2
        assert (stored[name] % STORED_STEP[name] == 0).all()
    np.testing.assert_array_equal(stored["latitude"], exact["latitude"])
    np.testing.assert_array_equal(stored["eastward_wind"], exact["eastward_wind"].astype("f4"))
    assert exact["heading"].dtype == np.float64


def test_what_is_stored_is_what_is_read_back(tmp_path):
    stored = as_stored(fleet(1000))
    write_product(stored, tmp_path / "a.nc", title="test")
    found = read_product(tmp_path / "a.nc")
    for name in stored.data_vars:
        np.testing.assert_array_equal(found[name], stored[name])
    assert found["heading"].attrs["stored_step"] == STORED_STEP["heading"]


def test_steps_belong_to_derived_variables_alone():
    reported = {"time", "latitude", "longitude", "pressure", "eastward_wind", "northward_wind"}
    assert set(STORED_STEP) <= set(VARIABLES)
    assert not reported & set(STORED_STEP)
    assert all(np.log2(step).is_integer() for step in STORED_STEP.values())


def test_one_aircraft_lies_in_few_chunks(tmp_path):
    write_product(fleet(REPORTS_A_CHUNK + 5), tmp_path / "a.nc", title="test")
    with xr.open_dataset(tmp_path / "a.nc", engine="netcdf4") as ds:
        assert ds["heading"].encoding["chunksizes"] == (REPORTS_A_CHUNK,)
        assert ds["heading_error"].encoding["chunksizes"] == (1, REPORTS_A_CHUNK)


def test_rounding_saves_a_third_of_the_noise(tmp_path):
    exact = fleet(200_000)[["heading", "heading_error"]]
    sizes = []
    for number, content in enumerate((exact, as_stored(exact))):
        path = write_product(content, tmp_path / f"{number}.nc", title="test")
        sizes.append(path.stat().st_size)
    assert sizes[1] < 0.67 * sizes[0]


def test_one_command_runs_every_benchmark(root):
    files = {path.stem for path in Path(root, "benchmarks").glob("[a-z]*.py")}
    assert set(benchmarks.names()) == files >= {"collocation", "fault_drill", "storage", "year"}
    assert set(benchmarks.LONG) <= files
