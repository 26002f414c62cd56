"""Errors of single reports: by leg, layer and aircraft where they are known, else by the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.flags import PHASE
from airswing.handover.wind_errors import table_error
from airswing.products.netcdf import write_product
from tests.conftest import ROOT
from tests.handover import wrfda
from tests.handover.archives import corrected

KNOWN = np.array(
    [
        [[2.5, 2.0, 1.8], [2.0, 1.6, 1.9], [3.0, 2.4, 2.2]],
        [[1.4, 1.1, 0.9], [1.5, 1.2, 0.95], [1.0, 0.8, 0.7]],
    ]
)
"""m/s by state (reported, corrected), phase (all, cruise, descent) and three layers."""
BY_AIRCRAFT = {"N1": (np.nan, np.nan), "N2": (6.0, 1.3), "N3": (1.0, 0.0), "N9": (9.0, 9.0)}


def write_known(folder: Path, *missing: str, known: np.ndarray = KNOWN) -> None:
    ds = xr.Dataset(
        {
            "observation_error_filled": (("state", "flight_phase", "layer"), known),
            "aircraft_observation_error": (("aircraft", "state"), list(BY_AIRCRAFT.values())),
            "layer_bottom_pressure": ("layer", [110000.0, 70000.0, 40000.0]),
            "layer_top_pressure": ("layer", [70000.0, 40000.0, 20000.0]),
        },
        coords={
            "state": ["reported", "corrected"],
            "flight_phase": ["all", "cruise", "descent"],
            "aircraft": list(BY_AIRCRAFT),
        },
    )
    shuffled = ds.transpose("layer", ...).isel(layer=[2, 0, 1], flight_phase=[1, 0, 2])
    write_product(shuffled.drop_vars(missing), folder / "observation_errors.nc", title="test")


def errors(folder: Path, ds: xr.Dataset, **choices: object) -> list[float]:
    write_product(ds, folder / "corrected.nc", title="test")
    result = airswing.export(
        folder / "corrected.nc", to="ob_ascii", path=folder / "f", overwrite=True, **choices
    )
    reports, _ = wrfda.read((folder / "f").read_text())
    assert result["notes"][0].startswith(f"errors of the winds from {result['errors_from']}")
    return [level["error"] for report in reports for level in report["levels"]]


def test_the_table_is_the_one_obsproc_gave_its_reports():
    golden = ROOT.parent / "shared/handover/obsproc_ob.ascii"
    if not golden.exists():
        pytest.skip("golden file absent: ../shared/handover/obsproc_ob.ascii")
    result = [
        (level["p"][0], report["type"] == "airep", level["speed"][2])
        for report in wrfda.read(golden.read_text())[0]
        for level in report["levels"]
        if level["p"][0] > 0
    ]
    pressure, airep, error = (np.array(column) for column in zip(*result, strict=True))
    found = table_error(pressure, np.where(airep, 3, 0).astype(np.int8))
    np.testing.assert_allclose(found, error, atol=0.006)
    assert len(set(error)) >= 5


LEGS = {
    "pressure": [109000.0, 70000.0, 39999.0, 19000.0, 90000.0, 39999.0],
    "phase": [PHASE[name] for name in ("cruise",) * 4 + ("descent", "ascent")],
    "corrected_wind_standard_error": 0.4,
}
N2 = {"pressure": [50000.0, 90000.0], "corrected_wind_standard_error": [0.4, 0.2]}


@pytest.mark.parametrize(
    ("sizes", "columns", "winds", "by_hand"),
    [
        # Corrections of equal uncertainty change nothing; an ascent has no row.
        ({"N1": 6}, LEGS, "corrected", [1.5, 1.2, 0.95, 0.95, 1.0, 0.9]),
        ({"N1": 6}, LEGS, "reported", [2.0, 1.6, 1.9, 1.9, 3.0, 1.8]),
        # 1.2 m/s of the cell holds (0.2^2 + 1.0^2) / 4 = 0.26 of uncertain corrections.
        (
            {"N1": 1, "X": 1},
            {"corrected_wind_standard_error": [0.2, 1.0]},
            "corrected",
            np.sqrt([1.44 - 0.26 + 0.02, 1.44 - 0.26 + 0.5]),
        ),
        # N2 flew cells of 1.44 and 2.25 and has 1.69 itself, 0.155 less than these. Of its
        # corrections, half the squares are 0.08 and 0.02, on the mean 0.05.
        ({"N2": 2}, N2, "corrected", np.sqrt([1.44 - 0.155 + 0.03, 2.25 - 0.155 - 0.03])),
        ({"N2": 2}, N2, "reported", np.sqrt(np.array([2.56, 4.0]) + 36.0 - 3.28)),
        # A variance clipped at zero counts; half of the base of 1.2 m/s is the least.
        ({"N3": 2}, {"corrected_wind_standard_error": 0.4}, "corrected", [0.6, 0.6]),
        ({"N1": 3}, {"corrected_wind_standard_error": [0, 0, 6]}, "corrected", [0.6, 0.6]),
        # No error is below 0.5 m/s.
        (
            {"N1": 3},
            {
                "corrected_wind_standard_error": [0, 0, 6],
                "pressure": 30000.0,
                "phase": PHASE["descent"],
            },
            "corrected",
            [0.5, 0.5],
        ),
        # A unit that corrects itself has the error of its cell.
        ({"N1": 2}, {"corrected_wind_standard_error": [0.5, np.nan]}, "corrected", [1.2, 1.2]),
    ],
)
def test_errors_by_hand(tmp_path, sizes, columns, winds, by_hand):
    write_known(tmp_path)
    found = errors(tmp_path, corrected(sizes, **columns), winds=winds)
    assert found[: len(by_hand)] == pytest.approx(by_hand, abs=0.006)


@pytest.mark.parametrize("winds", ["corrected", "reported"])
def test_a_product_without_finite_errors_is_not_named_as_source(tmp_path, winds):
    write_known(tmp_path, known=np.full_like(KNOWN, np.nan))
    ds = corrected({"N1": 2}, pressure=50000.0, corrected_wind_standard_error=0.0)
    write_product(ds, tmp_path / "corrected.nc", title="test")
    result = airswing.export(
        tmp_path / "corrected.nc", to="ob_ascii", path=tmp_path / "f", winds=winds
    )
    assert result["errors_from"] == "WRFDA's table"
    assert "observation_errors.nc holds none for these" in result["notes"][0]
    assert ("uncertainty of each correction" in result["notes"][0]) == (winds == "corrected")
    (first, *_), _ = wrfda.read((tmp_path / "f").read_text())
    assert first["levels"][0]["error"] == pytest.approx(2.9)
