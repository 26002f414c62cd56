"""A report format is one new file: read, named in messages, inspected, configured and run."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from airswing import cli
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.reports.formats import unregister
from airswing.reports.read import read_reports

MODULE = '''
"""Winds as a station prints them: tail, minutes since 2009, place, feet, knots, degrees."""

import pandas as pd

from airswing.reports.formats import ReportFormat, register

MARK = b"%station printout"


def pieces(path, mapping, audit):
    names = ["tail", "minutes", "latitude", "longitude", "feet", "knots", "wind_direction"]
    table = pd.read_csv(path, skiprows=1, names=names)
    start = pd.Timestamp("2009-01-01")
    table["time"] = start + pd.to_timedelta(table.pop("minutes"), unit="min")
    table["pressure_altitude"] = 0.3048 * table.pop("feet")
    table["wind_speed"] = table.pop("knots") * 1852 / 3600
    yield table


register(ReportFormat("printout", lambda start: start.startswith(MARK), pieces))
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The file written into a folder that is made part of the package's."""
    folder = tmp_path / "formats"
    folder.mkdir()
    (folder / "station_printout.py").write_text(MODULE)
    package = importlib.import_module("airswing.reports.formats")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    yield
    unregister("printout")
    sys.modules.pop("airswing.reports.formats.station_printout", None)


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    path = tmp_path / "any.name"
    rows = [f"N9,{k},{40 + k / 10},-90,21000,{30 + k},270" for k in range(5)]
    path.write_text("\n".join(["%station printout", *rows, ""]))
    return path


def test_its_files_are_told_by_their_content_and_read(added: None, archive: Path) -> None:
    reports = read_reports(archive)
    assert reports["aircraft"].values.tolist() == ["N9"]
    np.testing.assert_allclose(reports["eastward_wind"] * 3600 / 1852, [30, 31, 32, 33, 34], 1e-5)
    assert pd.Timestamp(reports["time"].values[1]) == pd.Timestamp("2009-01-01T00:01")
    assert read_reports(archive, format="printout").equals(reports)


def test_the_command_and_the_configuration_know_it(added: None, archive: Path) -> None:
    shown = CliRunner().invoke(cli.app, ["inspect", str(archive)])
    assert shown.exit_code == 0, shown.output
    assert "printout" in shown.output
    path = archive.parent / "c.yaml"
    path.write_text(
        f"reports: {{files: {archive}, format: printout}}\n"
        "references: {m: {files: m.grb}}\noutput: out\n"
    )
    assert load_config(path).reports.format == "printout"


def test_messages_name_it_while_it_is_there(added: None, archive: Path) -> None:
    with pytest.raises(InputError, match="printout"):
        read_reports(archive, format="printed")


def test_without_its_file_it_is_unknown(archive: Path) -> None:
    with pytest.raises(InputError, match="auto, bufr"):
        read_reports(archive, format="printout")
