"""The kind of a file is recognised by its first bytes, not by words in it."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr
from tests.reports.tables import row, write

from airswing.errors import InputError
from airswing.products.netcdf import write_product
from airswing.workflow.inspection import as_text, inspect_file


def product(path: Path) -> Path:
    """A small product whose first bytes contain the word GRIB."""
    ds = xr.Dataset({"row_size": ("aircraft", [1], {"comment": "from GRIB/*"})})
    return write_product(ds, path, title="T")


def test_a_product_of_grib_files_is_a_product(tmp_path):
    path = product(tmp_path / "a.nc")
    assert b"GRIB" in path.read_bytes()[:4096]
    found = inspect_file(path)
    assert (found["kind"], found["title"]) == ("product", "T")


def test_a_table_that_speaks_of_grib_is_reports(tmp_path):
    found = inspect_file(write(tmp_path / "a.csv", [row(tail="GRIB1"), row(tail="N2")]))
    assert (found["kind"], found["aircraft"]) == ("reports", 2)


def test_text_omits_what_is_empty_and_rounds_numbers():
    grid = {"kind": "latlon", "range": [38.28880756535601, 46.0], "gaps": {}}
    found = {"grids": [grid], "skipped": [], "names": ["a", "b"], "format": None}
    expected = "grids:\n  kind: latlon, range: [38.28881, 46]\nnames: a, b"
    assert as_text(found | {"audit": {"dropped": {}}}) == expected


def test_half_a_product_is_named(tmp_path):
    path = product(tmp_path / "a.nc")
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"a\.nc.*a damaged NetCDF file"):
        inspect_file(path)
