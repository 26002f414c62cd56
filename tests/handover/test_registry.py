"""The export formats are found by name, and adding one is adding one file."""

from __future__ import annotations

import json
import sys

import pytest

import airswing
from airswing import cli, handover
from airswing.errors import InputError
from airswing.handover.records import registry
from airswing.products.netcdf import write_product
from tests.handover.archives import corrected

MODULE = """
from airswing.handover.records.registry import ExportFormat, register


def write(request):
    request.path.write_text(f"{request.corrected.sizes['report']} {request.winds}")
    return {"files": [{"path": str(request.path)}], "notes": ["as counted"]}


register(ExportFormat("tally", "how many reports there are", write))
"""


@pytest.fixture
def added(tmp_path, monkeypatch):
    """A format whose file stands beside those of the package."""
    folder = tmp_path / "more_formats"
    folder.mkdir()
    (folder / "tally_of_reports.py").write_text(MODULE)
    monkeypatch.setattr(handover, "__path__", [*handover.__path__, str(folder)])
    yield
    registry.unregister("tally")
    del sys.modules["airswing.handover.tally_of_reports"]


def test_the_formats_of_reports_are_there():
    assert {"obs_domain", "little_r", "ob_ascii"} <= set(registry.formats())
    assert all(found.summary for found in registry.formats().values())


def test_adding_a_format_is_one_file(added, tmp_path, monkeypatch, capsys):
    (tmp_path / "c.yaml").write_text(
        "reports: {files: r.csv}\nreferences: {ruc: {files: x}}\noutput: out\n"
    )
    write_product(corrected({"N1": 3}), tmp_path / "out/corrected.nc", title="test")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "sys.argv",
        ["airswing", "export", "c.yaml", "--to", "tally", "-o", "n.txt", "--json", "--quiet"],
    )
    cli.main()
    told = json.loads(capsys.readouterr().out)
    assert told["format"] == "tally" and told["notes"] == ["as counted"]
    assert (tmp_path / "n.txt").read_text() == "3 corrected"
    monkeypatch.setattr("sys.argv", ["airswing", "export", "--help"])
    cli.main()
    assert "tally: how many reports there are" in capsys.readouterr().out


def test_an_unknown_format_names_the_known_ones(tmp_path):
    with pytest.raises(InputError, match=r"bufr7.*obs_domain"):
        airswing.export(corrected({"N1": 1}), to="bufr7", path=tmp_path / "x")


def test_two_formats_cannot_have_one_name():
    with pytest.raises(ValueError, match="obs_domain"):
        registry.register(registry.ExportFormat("obs_domain", "again", lambda request: {}))
