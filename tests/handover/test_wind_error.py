"""Errors of single reports: by leg, layer and aircraft where they are known, else by the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.config import Handover
from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.records.wind_error import table_error
from airswing.products.netcdf import write_product
from tests.conftest import ROOT
from tests.handover import wrfda
from tests.handover.archives import corrected

KNOWN = np.array([[[2.0, 1.6, np.nan], [3.0, 2.4, 2.2]], [[1.5, 1.2, np.nan], [1.0, 0.8, 0.7]]])
"""m/s by state (reported, corrected), phase (cruise, descent) and three layers."""


def write_known(folder: Path, **changes: object) -> None:
    ds = xr.Dataset(
        {
            "wind_component_error": (("state", "flight_phase", "layer"), KNOWN),
            "layer_bottom_pressure": ("layer", [110000.0, 70000.0, 40000.0]),
            "layer_top_pressure": ("layer", [70000.0, 40000.0, 20000.0]),
        },
        coords={"state": ["reported", "corrected"], "flight_phase": ["cruise", "descent"]},
        attrs={"uuid": "x"},
    )
    ds.transpose("layer", "flight_phase", "state").drop_vars(changes).to_netcdf(
        folder / "observation_errors.nc"
    )


def errors(folder: Path, ds: xr.Dataset, **choices: object) -> list[float]:
    write_product(ds, folder / "corrected.nc", title="test")
    told = airswing.export(folder / "corrected.nc", to="ob_ascii", path=folder / "f",
                           overwrite=True, **choices)  # fmt: skip
    reports, _ = wrfda.read((folder / "f").read_text())
    assert told["notes"][0].startswith(f"errors of the winds from {told['errors_from']}")
    return [level["error"] for report in reports for level in report["levels"]]


def test_the_table_is_the_one_obsproc_gave_its_reports():
    golden = ROOT.parent / "shared/handover/obsproc_ob.ascii"
    if not golden.exists():
        pytest.skip("golden file absent: ../shared/handover/obsproc_ob.ascii")
    told = [
        (level["p"][0], report["type"] == "airep", level["speed"][2])
        for report in wrfda.read(golden.read_text())[0]
        for level in report["levels"]
        if level["p"][0] > 0
    ]
    pressure, airep, error = (np.array(column) for column in zip(*told, strict=True))
    found = table_error(pressure, np.where(airep, 3, 0).astype(np.int8))
    np.testing.assert_allclose(found, error, atol=0.006)
    assert len(set(error)) >= 5


def test_errors_by_leg_and_layer(tmp_path):
    """Corrections all as uncertain as each other change nothing."""
    write_known(tmp_path)
    ds = corrected(
        {"N1": 5},
        pressure=[90000.0, 70000.0, 39999.0, 90000.0, 39999.0],
        phase=[PHASE[name] for name in ("cruise", "cruise", "cruise", "descent", "ascent")],
        corrected_wind_standard_error=0.4,
    )
    # no cell for cruise in the third layer nor for ascents: the table's, and half of 0.16 more
    apart = np.sqrt([3.0**2 + 0.08, 3.0**2 + 0.08])
    assert errors(tmp_path, ds) == pytest.approx([1.5, 1.2, apart[0], 1.0, apart[1]], abs=0.006)
    by_table = [3.0, 3.0]
    assert errors(tmp_path, ds, winds="reported") == pytest.approx(
        [2.0, 1.6, by_table[0], 3.0, by_table[1]], abs=0.006
    )


def test_a_compass_hardly_known_weighs_less(tmp_path):
    """By hand: 1.2 m/s of the cell holds (0.2^2 + 1.0^2) / 4 = 0.26 of uncertain corrections."""
    write_known(tmp_path)
    ds = corrected({"N1": 1, "N2": 1}, corrected_wind_standard_error=[0.2, 1.0])
    by_hand = np.sqrt([1.44 - 0.26 + 0.02, 1.44 - 0.26 + 0.5])
    assert errors(tmp_path, ds) == pytest.approx(by_hand, abs=0.006)


def test_no_error_falls_below_half_its_cells(tmp_path):
    write_known(tmp_path)
    ds = corrected({"N1": 3}, corrected_wind_standard_error=[0.0, 0.0, 6.0])
    assert errors(tmp_path, ds)[:2] == pytest.approx([0.6, 0.6])


def test_a_unit_that_corrects_itself_has_the_error_of_its_cell(tmp_path):
    write_known(tmp_path)
    ds = corrected({"N1": 2}, corrected_wind_standard_error=[0.5, np.nan])
    assert errors(tmp_path, ds) == pytest.approx([1.2, 1.2], abs=0.006)


def test_a_product_that_tells_no_errors_is_refused(tmp_path):
    write_known(tmp_path, wind_component_error=None)
    write_product(corrected({"N1": 2}), tmp_path / "corrected.nc", title="test")
    with pytest.raises(InputError, match=r"observation_errors.nc: wind_component_error"):
        airswing.export(tmp_path / "corrected.nc", to="ob_ascii", path=tmp_path / "f")


def test_the_table_where_nothing_is_known(tmp_path):
    ds = corrected({"N1": 2}, pressure=[15000.0, 95000.0], corrected_wind_standard_error=1.0)
    found = errors(tmp_path, ds, settings=Handover(platform="TAMDAR"))
    assert found == pytest.approx([np.sqrt(3.6**2 + 0.5), np.sqrt(2.3**2 + 0.5)], abs=0.006)
