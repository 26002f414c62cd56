"""Bad input, by the command itself: one clear message, the status, earlier products intact.

Each case runs the command in this process on a small archive; any exception but its exit fails the
test.
"""

import hashlib
import json
import resource
import shutil
from pathlib import Path

import pandas as pd
import pytest

from airswing.products.netcdf import open_product
from airswing.products.whole_files import workspace
from tests import perfect
from tests.command import airswing, configured
from tests.forked import forked


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """Reports and model files, and the products of one run over them."""
    folder = tmp_path_factory.mktemp("archive")
    place = perfect.PLACES["ruc_grib1"]
    perfect.write_model(place, folder / "model")
    perfect.write_reports(perfect.fly(place, flights=18), folder / "r.csv")
    path = configure(folder, folder)
    for stage in ("collocate", "fit"):
        assert airswing(stage, path).returncode == 0
    return folder


def configure(archive, folder, **changes):
    inputs = {"reports": archive / "r.csv", "references": {"model": archive / "model/*"}}
    return configured(folder, **inputs | changes)


def refused(*words, says):
    """One message, with these words, status 2 and nothing half-written."""
    done = airswing(*words)
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("airswing: ")]
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip().endswith(line)
    assert all(word in line for word in says), line
    assert not [*Path(str(words[1])).parent.rglob("*.part")]


def with_products(archive, folder):
    shutil.copytree(archive / "out", folder / "out")
    return digests(folder / "out")


def digests(folder):
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*.nc")
    }


TABLES = {
    "missing column": (
        lambda t: t.drop(columns="wind_speed_kt"),
        ("r.csv", "wind_speed_kt", "required column is missing", "reports.columns"),
    ),
    "no overlap in time": (
        lambda t: t.assign(time=t["time"].str.replace("2009", "2013")),
        ("outside its times", "2013-02-27", "2009-03-01", "references.model"),
    ),
    "all rolled": (lambda t: t.assign(roll_flag="B"), ("screening", "roll 648", "648 reports")),
    "one report": (lambda t: t.iloc[:1], ("no_ground_vector 1",)),
}


#: What is read and collocated, and of which screening keeps nothing.
KEPT_NOTHING = ("all rolled", "one report")


@pytest.mark.parametrize("name", TABLES)
def test_reports_that_cannot_be_used(archive, tmp_path, name):
    change, says = TABLES[name]
    table = pd.read_csv(archive / "r.csv", dtype={"tail": str})
    perfect.write_reports(change(table), tmp_path / "r.csv")
    path = configure(archive, tmp_path, reports={"files": str(tmp_path / "r.csv")})
    before = with_products(archive, tmp_path)
    refused("run" if name in KEPT_NOTHING else "collocate", path, says=says)
    if name in KEPT_NOTHING:
        done = airswing("collocate", path)
        assert done.returncode == 0
        assert all(word in done.stderr for word in says), done.stderr
        with open_product(tmp_path / "out/headings") as headings:
            assert (headings["screening"] != 0).all()
    changed = set(before.items()) ^ set(digests(tmp_path / "out").items())
    # winds at reports are of use where nothing can be fitted
    assert all(name in KEPT_NOTHING and path.startswith("headings") for path, _ in changed)


GROUPS = {"start": "2009-02-28", "before_start": "2009-02-27"}
GROUPS |= {"corrected": ["S1"], "controls": ["S2", "S3"]}
ABSENT = {"references": {"model": {"files": "none/*"}}}
CONFIGURATIONS = {
    "wrong unit": (
        {"reports": {"files": "r.csv", "columns": {"ff": {"name": "wind_speed_kt", "unit": "kg"}}}},
        ("config.yaml: reports.columns.ff", "kg", "m/s"),
    ),
    "empty model glob": (ABSENT, ("config.yaml", "references.model.files", "none/*")),
    "an aircraft without reports": (
        {"field_test": GROUPS | {"controls": ["N999"]}} | ABSENT,
        ("config.yaml", "field_test", "N999", "S1, S2, S3"),
    ),
    "output in a file": ({"output": "config.yaml/out"}, ("config.yaml/out", "output")),
}


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_configurations_that_cannot_be_used(archive, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    changes, says = CONFIGURATIONS[name]
    shutil.copy(archive / "r.csv", tmp_path / "r.csv")
    refused("run", configure(archive, tmp_path, **changes), says=says)
    assert not [*tmp_path.rglob("*.nc")]


def test_bad_model_files_among_good_ones_are_counted_and_named(archive, tmp_path):
    model = tmp_path / "model"
    shutil.copytree(archive / "model", model)
    (model / "p012.grb").write_bytes((model / "p012.grb").read_bytes()[:7000])
    (model / "p015.grb").write_bytes(b"\x93x" * 9000)
    (model / "readme.txt").write_text("hello")
    (model / "link").symlink_to(model / "absent")
    path = configure(archive, tmp_path, references={"model": {"files": f"{model}/*"}})
    assert airswing("collocate", path, "--quiet").returncode == 0
    with open_product(tmp_path / "out/headings") as headings:
        audit = json.loads(headings.attrs["reference_audit"])["model"]
    reasons = {Path(entry["file"]).name: entry["reason"] for entry in audit["skipped"]}
    for name, reason in {
        "p012.grb": "truncated",
        "p015.grb": "no whole GRIB message",
        "readme.txt": "is text, not model data",
        "link": "cannot be opened",
    }.items():
        assert reason in reasons.pop(name)
    assert not reasons


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"x" * 300, "not a product"), (b"\x89HDF\r\n\x1a\njunk", "a damaged NetCDF file")],
)
def test_damaged_products_are_refused(archive, tmp_path, content, says):
    with_products(archive, tmp_path)
    (place,) = (tmp_path / "out/headings").glob("*.nc")
    place.write_bytes(content)
    refused("fit", configure(archive, tmp_path), says=(place.name, says))


def run_on_a_small_disk(config, message):
    """Run where no file may grow as long as a month of headings is."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
    done = airswing("run", config)
    message.write_text(done.stderr)
    raise SystemExit(done.returncode)


def test_a_disk_full_midway_leaves_the_earlier_products(archive, tmp_path):
    before = with_products(archive, tmp_path)
    done = forked(run_on_a_small_disk, configure(archive, tmp_path), tmp_path / "message")
    done.join(240)
    message = (tmp_path / "message").read_text()
    assert done.exitcode == 2, message
    assert "Traceback" not in message
    last = message.splitlines()[-1]
    assert "cannot write the product" in last and str(tmp_path / "out") in last
    assert digests(tmp_path / "out") == before
    assert not [*tmp_path.rglob("*.part")]


def test_a_sample_in_an_impossible_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    refused("sample", tmp_path / "file" / "sub", says=(str(tmp_path / "file"),))


@pytest.mark.parametrize("stage", ["collocate", "fit", "correct", "gap", "run"])
def test_a_folder_locked_by_another_run_is_refused(archive, tmp_path, stage):
    config, before = configure(archive, tmp_path), with_products(archive, tmp_path)
    note = tmp_path / "out" / ".airswing" / "finished"
    note.parent.mkdir(exist_ok=True)
    note.touch()
    with workspace(tmp_path / "out"):
        refused(stage, config, says=("another run", str(tmp_path / "out")))
    assert note.exists()
    assert digests(tmp_path / "out") == before
