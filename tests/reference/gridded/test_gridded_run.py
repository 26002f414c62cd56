"""The command line on model winds in NetCDF: inspected and collocated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

from airswing import cli
from airswing.products.netcdf import read_product
from tests.reference.gridded.datasets import START, latlon

LAT, LON = np.arange(30.0, 50.1, 2.5), np.arange(-110.0, -79.9, 2.5)


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """An aircraft flying east in cruise for an hour and a half, and three hours of winds."""
    ds = latlon(latitude=LAT, longitude=LON, hours=3)
    for hour in range(3):
        ds.isel(time=[hour]).to_netcdf(tmp_path / f"era5_{hour}.nc")
    minutes = np.arange(0.0, 90.0, 3.0)
    pd.DataFrame(
        {
            "tail": "N1",
            "time": pd.Timestamp(START) + pd.to_timedelta(minutes, unit="min"),
            "latitude": 40.0 + 0.01 * minutes,
            "longitude": -100.0 + 0.12 * minutes,
            "pressure_hPa": 400.0,
            "wind_direction_deg": 270.0,
            "wind_speed_kt": 30.0,
            "temperature_degC": -20.0,
        }
    ).to_csv(tmp_path / "reports.csv", index=False)
    config = {
        "reports": {"files": str(tmp_path / "reports.csv")},
        "references": {"era5": {"files": str(tmp_path / "era5_*.nc")}},
        "output": str(tmp_path / "results"),
    }
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(config))
    return tmp_path


def test_inspect(archive: Path) -> None:
    runner = CliRunner()
    shown = runner.invoke(cli.app, ["inspect", str(archive / "era5_0.nc")])
    assert shown.exit_code == 0 and "6 pressure levels, 200 to 1000 hPa" in shown.output


def test_winds_alone_where_nothing_can_be_screened_or_fitted(archive: Path) -> None:
    """Three points without a wind of their own: `collocate` is a tool for that alone, too."""
    pd.DataFrame(
        {
            "tail": ["A", "B", "C"],
            "time": pd.Timestamp(START) + pd.to_timedelta([10, 20, 30], unit="min"),
            "latitude": [40.0, 41.0, 42.0],
            "longitude": -100.0,
            "pressure_hPa": 400.0,
        }
    ).to_csv(archive / "reports.csv", index=False)
    refused = CliRunner().invoke(cli.app, ["collocate", str(archive / "mine.yaml")])
    assert "for model winds alone" in str(refused.exception)
    text = (archive / "mine.yaml").read_text()
    none = "{wind_direction_deg: {value: .nan}, wind_speed_kt: {value: .nan}}"
    (archive / "mine.yaml").write_text(text.replace("reports:\n", f"reports:\n  columns: {none}\n"))
    shown = CliRunner().invoke(cli.app, ["collocate", str(archive / "mine.yaml")])
    assert shown.exit_code == 0, shown.output
    assert "only model winds at the reports" in shown.output
    found = read_product(archive / "results" / "headings")
    assert np.isfinite(found["reference_eastward_wind"].to_numpy()).all()
    assert np.isnan(found["heading"].to_numpy()).all()
