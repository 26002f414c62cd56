"""A kind of model file is one new file: found by `auto`, read, inspected, planned like the others.

The file is written here, into a folder that is made part of the package's; nothing else knows it.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import airswing
from airswing import cli
from airswing.config_file import load_config
from airswing.errors import ConfigError
from airswing.model_formats import unregister
from tests.reference.gridded.datasets import LEVELS, START, by_hand, latlon, points, winds

MODULE = '''
"""Winds as a table of text: hour, hPa, latitude, longitude, u, v in m/s."""

import pandas as pd

from airswing.model_formats import ModelFormat, register

MARK = b"#wind table v1"


def read(path):
    ds = pd.read_csv(path, comment="#").set_index(["time", "level", "latitude", "longitude"])
    ds = ds.to_xarray()
    ds["time"] = pd.DatetimeIndex(ds.time.values)
    for name, way in (("u", "east"), ("v", "north")):
        ds[name].attrs = {"units": "m s-1", "standard_name": f"{way}ward_wind"}
    for name, unit in (("level", "hPa"), ("latitude", "degrees_north"),
                       ("longitude", "degrees_east")):
        ds[name].attrs = {"units": unit}
    return [ds]


register(ModelFormat("wind_table", lambda path, start: start.startswith(MARK), read))
'''
LAT, LON = np.arange(30.0, 50.1, 2.5), np.arange(-110.0, -79.9, 2.5)


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "formats"
    folder.mkdir()
    (folder / "wind_table.py").write_text(MODULE)
    package = importlib.import_module("airswing.reference.gridded.formats")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    yield
    unregister("wind_table")
    sys.modules.pop("airswing.reference.gridded.formats.wind_table", None)


def archive(folder: Path) -> Path:
    table = latlon(latitude=LAT, longitude=LON, hours=2)[["u", "v"]].to_dataframe().reset_index()
    path = folder / "model.txt"
    path.write_text("#wind table v1\n" + table.to_csv(index=False))
    return path


def test_one_new_file_is_a_new_kind(added: None, tmp_path: Path) -> None:
    path = archive(tmp_path)
    where, pressure = np.array([[33.3, 41.7], [-100.1, -84.4]]), np.array([95000.0, 42000.0])
    model = airswing.build_catalogue(path, name="m")
    assert model.engine == "wind_table"
    found = airswing.collocate(points(*where, pressure), {"m": model})
    ds = latlon(latitude=LAT, longitude=LON, hours=2)
    fi, fj = (where[1] - LON[0]) / 2.5, (where[0] - LAT[0]) / 2.5
    expected = by_hand(ds.u.values[0], ds.v.values[0], LEVELS * 100, fi, fj, pressure)
    np.testing.assert_allclose(winds(found), expected, atol=1e-3)
    shown = CliRunner().invoke(cli.app, ["inspect", str(path)])
    assert shown.exit_code == 0 and "model winds" in shown.output
    assert str(START)[:10] in shown.output


def test_the_configuration_knows_it_by_name(added: None, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    for engine in ("wind_table", "wind_tables"):
        path.write_text(
            "reports: {files: x.csv}\n"
            f"references: {{m: {{files: model.txt, engine: {engine}}}}}\noutput: out\n"
        )
        if engine == "wind_table":
            assert load_config(path).references["m"].engine == engine
        else:
            with pytest.raises(ConfigError, match="wind_table"):
                load_config(path)
