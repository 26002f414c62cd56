"""The command line on model winds in NetCDF: inspected and collocated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from typer.testing import CliRunner

from airswing import cli
from airswing.products.netcdf import read_product
from tests.reference.gridded.datasets import START, latlon


def test_winds_alone_where_nothing_can_be_screened_or_fitted(tmp_path: Path) -> None:
    """Three points without reported winds: `collocate` is a tool for that alone, too."""
    lat, lon = np.arange(30.0, 50.1, 2.5), np.arange(-110.0, -79.9, 2.5)
    latlon(latitude=lat, longitude=lon).to_netcdf(tmp_path / "era5.nc")
    shown = CliRunner().invoke(cli.app, ["inspect", str(tmp_path / "era5.nc")])
    assert shown.exit_code == 0 and "6 pressure levels, 200 to 1000 hPa" in shown.output
    columns = {
        "tail": ["A", "B", "C"],
        "time": pd.Timestamp(START) + pd.to_timedelta([10, 20, 30], unit="min"),
        "latitude": [40.0, 41.0, 42.0],
        "longitude": -100.0,
        "pressure_hPa": 400.0,
    }
    pd.DataFrame(columns).to_csv(tmp_path / "reports.csv", index=False)
    config = {
        "reports": {"files": str(tmp_path / "reports.csv")},
        "references": {"era5": {"files": str(tmp_path / "era5.nc")}},
        "output": str(tmp_path / "results"),
    }
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(config))
    refused = CliRunner().invoke(cli.app, ["collocate", str(path)])
    assert "for model winds alone" in str(refused.exception)
    unknown = {name: {"value": np.nan} for name in ("wind_direction_deg", "wind_speed_kt")}
    config["reports"]["columns"] = unknown
    path.write_text(yaml.safe_dump(config))
    shown = CliRunner().invoke(cli.app, ["collocate", str(path)])
    assert shown.exit_code == 0, shown.output
    assert "only model winds at the reports" in shown.output
    found = read_product(tmp_path / "results" / "headings")
    assert np.isfinite(found["reference_eastward_wind"].to_numpy()).all()
    assert np.isnan(found["heading"].to_numpy()).all()
