"""A failed export ends in one message and status 2, with nothing half-written."""

from __future__ import annotations

import json
import resource

import pytest

import airswing
from airswing import cli
from airswing.errors import InputError
from airswing.products.netcdf import write_product
from tests.handover.archives import corrected

FORMATS = ("obs_domain", "little_r", "ob_ascii")
CONFIG = "reports: {files: r.csv}\nreferences: {ruc: {files: x}}\noutput: out\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a configuration and the product of a run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(CONFIG)
    write_product(corrected({"N1": 5}), tmp_path / "out/corrected.nc", title="test")
    return tmp_path


def call(monkeypatch, capsys, *words):
    monkeypatch.setattr("sys.argv", ["airswing", "export", "c.yaml", *words])
    status = 0
    try:
        cli.main()
    except SystemExit as end:
        status = end.code
    result = capsys.readouterr()
    return status, result.out, result.err


def left(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--to", "grib", "-o", "f"), ("no such export format", "grib", "obs_domain")),
        (("--to", "obs_domain", "-o", "f", "--winds", "best"), ("--winds", "best")),
        (("--to", "obs_domain", "-o", "f", "--window", "soon"), ("--window", "soon")),
        (("--to", "obs_domain", "-o", "f", "--window", "0.5 s"), ("--window", "0.5 s")),
        (("--to", "obs_domain", "-o", "f", "--domain", "12"), ("--domain", "12")),
        (("--to", "obs_domain", "-o", "f", "--platform", "BOAT"), ("--platform", "BOAT")),
        (("--to", "obs_domain", "-o", "f", "--start", "noon"), ("--start", "noon")),
        (
            ("--to", "little_r", "-o", "f", "--start", "2020-01-01", "--end", "2020-01-02"),
            ("no report", "before_the_period 5"),
        ),
        (
            ("--to", "little_r", "-o", "f", "--start", "2020-01-02", "--end", "2020-01-01"),
            ("end must be later",),
        ),
        (("--to", "obs_domain", "-o", "OBS_DOMAIN301"), ("OBS_DOMAIN301", "--domain 3")),
        (("--to", "ob_ascii", "-o", "c.yaml"), ("c.yaml", "--overwrite")),
        (("--to", "ob_ascii", "-o", "c.yaml/sub/f"), ("c.yaml/sub/f",)),
    ],
)
def test_bad_requests(folder, monkeypatch, capsys, words, said):
    before = left(folder)
    status, out, err = call(monkeypatch, capsys, *words, "--quiet")
    assert status == 2 and out == ""
    assert err.startswith("airswing: ") and len(err) < 2000 and err.count("\n") == 1
    assert all(word in err for word in said), err
    assert left(folder) == before and (folder / "c.yaml").read_text() == CONFIG


def test_without_a_product_the_run_is_named(folder, monkeypatch, capsys):
    (folder / "out/corrected.nc").unlink()
    status, _, err = call(monkeypatch, capsys, "--to", "little_r", "-o", "f")
    assert status == 2 and "out/corrected: no such product" in err and "airswing run" in err


def test_the_command_writes_and_reports(folder, monkeypatch, capsys):
    words = ("--to", "ob_ascii", "-o", "w/", "--window", "2 min", "--quiet")
    status, out, err = call(monkeypatch, capsys, *words, "--json")
    assert (status, err) == (0, "")
    result = json.loads(out)
    assert result["reports"] == 5 and [file["reports"] for file in result["files"]] == [2, 2, 1]
    assert all((folder / file["path"]).is_file() for file in result["files"])
    status, _, err = call(monkeypatch, capsys, *words)
    assert status == 2 and "ob.ascii" in err and "already exists" in err
    status, out, _ = call(monkeypatch, capsys, *words, "--overwrite")
    assert status == 0 and "5 reports, 5 winds as corrected, in 3 files" in out
    assert not [*folder.rglob(".airswing*")]


@pytest.mark.parametrize("name", ["x" * 41, "Ä1", "N1\nN2", "N\t1"])
@pytest.mark.parametrize("to", FORMATS)
def test_identifiers_no_format_can_hold(tmp_path, name, to):
    with pytest.raises(InputError, match=r"identifier.*40 characters"):
        airswing.export(corrected({"N1": 2, name: 2}), to=to, path=tmp_path / "f")
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "name", ["correction_applied", "screening", "corrected_eastward_wind", "flight", "pressure"]
)
def test_a_variable_that_is_needed_is_named(tmp_path, name):
    with pytest.raises(InputError, match=name):
        airswing.export(corrected({"N1": 2}).drop_vars(name), to="obs_domain", path=tmp_path / "f")


@pytest.mark.parametrize("to", FORMATS)
def test_a_full_disk_leaves_nothing(folder, to, monkeypatch, capsys):
    write_product(corrected({"N1": 900}), folder / "out/corrected.nc", title="test")
    before = left(folder)
    largest = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, largest[1]))
    try:
        status, _, result = call(monkeypatch, capsys, "--to", to, "-o", "new/f")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, largest)
    assert status == 2, result
    assert "Traceback" not in result and "cannot write the export" in result
    assert left(folder) == before
