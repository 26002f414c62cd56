"""The command line: exit statuses, one message for bad input, results on standard output."""

import functools
import json
import re
import signal
import subprocess
import sys

import pytest

from airswing import __version__
from tests.command import airswing


def process(*words):
    """Run the command in a separate process."""
    words = [sys.executable, "-m", "airswing", *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, timeout=240)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder, in which all runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_wrong_usage_is_status_2():
    done = process("run", "--colour", "red")
    assert done.returncode == 2 and "--colour" in done.stderr
    done = airswing("evaluate", "absent.yaml")
    assert done.returncode == 2
    assert "absent.yaml: no such configuration. Check the path" in done.stderr
    for command, says in (
        ("sample x --seed -1", "--seed"),
        ("collocate c.yaml --columns a=time", "only for a TRACK"),
    ):
        done = airswing(*command.split())
        assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr
    assert "reject_list needs it" in " ".join(airswing("export", "--help").stdout.split())


@pytest.mark.parametrize(
    "words",
    [("run", "x.yaml"), ("gap", "x.yaml"), ("export", "x.yaml", "--to", "gsi"), ("gap-check",)],
    ids=lambda words: words[0],
)
def test_an_empty_output_is_one_error_and_nothing_is_written_here(words, folder):
    done = airswing(*words, "--output", "")
    assert done.returncode == 2 and done.stderr.count("the path is empty") == 1
    assert not list(folder.iterdir())


def test_stages_one_by_one_and_the_json_summary(blank_cards, gap_archive, folder, monkeypatch):
    monkeypatch.setattr("airswing.report.run.page.write_page", lambda *_, **__: "")
    path = folder / "config.yaml"
    path.write_text(re.sub("output: .*", "output: results", gap_archive.read_text()))
    for stage, product in (("collocate", "headings"), ("fit", "fits.nc"), ("correct", "corrected")):
        done = airswing(stage, path, "--quiet")
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.strip().endswith(f"/{product}")
    done = airswing("run", path, "--resume", "--json", "--quiet")
    assert done.returncode == 0, done.stderr
    status = json.loads(done.stdout)["status"]
    assert sum(status.values()) == 6 and status["no_correction_needed"] >= 4
    done = airswing("compare", path, "--quiet")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["pairs"][0]["references"] == ["ruc", "rtfdaa"]


def test_an_interrupt_is_status_130_and_leaves_no_half_product(quickstart_config, folder):
    command = [sys.executable, "-m", "airswing", "run", str(quickstart_config(folder))]
    # A shell's background jobs, and all they start, ignore interrupts unless set otherwise.
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    started = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=heed)
    while not (line := started.stderr.readline()).startswith("catalogue"):
        assert line, "ended before the collocation"
    started.send_signal(signal.SIGINT)
    _, message = started.communicate(timeout=60)
    assert started.returncode == 130, message
    assert "Traceback" not in message
    assert not [*(folder / "results").rglob("*.part")]


def test_a_sample_is_not_mixed_with_what_is_there(folder):
    (folder / "ruc").mkdir()
    (folder / "ruc/old.grb").touch()
    (folder / "notes.txt").touch()
    words = ["sample", folder, "--days", "1", "--aircraft", "1"]
    done = airswing(*words)
    assert done.returncode == 2 and "not empty" in done.stderr and "--overwrite" in done.stderr
    assert not (folder / "reports").exists()
    assert airswing(*words, "--overwrite").returncode == 0
    assert (folder / "notes.txt").exists() and not (folder / "ruc/old.grb").exists()


def test_a_track_without_a_model_says_what_it_needs(folder):
    words = ("collocate", "track.csv", "-o", "out.csv")
    assert "--reference NAME=GLOB" in airswing(*words).stderr
    words += ("--reference", "ruc=none/*.grb")
    assert "track.csv: no such file. Check the path" in airswing(*words).stderr
    (folder / "track.csv").write_text("time,lat,lon,pressure_hPa\n")
    done = airswing(*words)
    assert done.returncode == 2 and "airswing: --reference ruc: no file found" in done.stderr


def test_help_and_version():
    done = airswing("--help")
    assert done.returncode == 0 and "..." not in done.stdout.replace("[ARGS]...", "")
    for command in ("run", "collocate", "fit", "correct", "evaluate", "compare", "sample"):
        assert command in done.stdout
    done = airswing("--version")
    assert (done.returncode, done.stdout) == (0, f"airswing {__version__}\n")
