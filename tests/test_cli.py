"""The command line: exit statuses, one message for bad input, results on standard output."""

import contextlib
import io
import json
import signal
import subprocess
import sys

import pytest

from airswing import __version__, cli


def process(*words, folder):
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "airswing", *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)


def airswing(*words, folder):
    """Run the command here: what a process of its own would add is that it takes its time."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("sys.argv", ["airswing", *map(str, words)])
        try:
            cli.main()
        except SystemExit as end:
            status = int(end.code or 0)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


def test_wrong_usage_is_status_2(tmp_path):
    done = process("run", "--colour", "red", folder=tmp_path)
    assert done.returncode == 2 and "--colour" in done.stderr
    done = airswing("evaluate", "absent.yaml", folder=tmp_path)
    assert done.returncode == 2
    assert "absent.yaml: no such configuration. Check the path" in done.stderr
    shown = airswing("export", "--help", folder=tmp_path).stdout
    assert "reject_list needs it" in " ".join(shown.split())


@pytest.mark.parametrize(
    "words",
    [("run", "x.yaml"), ("gap", "x.yaml"), ("export", "x.yaml", "--to", "gsi"), ("gap-check",)],
    ids=lambda words: words[0],
)
def test_an_empty_output_is_one_error_and_nothing_is_written_here(
    words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["airswing", *words, "--output", ""])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("the path is empty") == 1
    assert not list(tmp_path.iterdir())


def test_a_stage_without_the_product_before_it_says_so(quickstart_config, tmp_path):
    done = airswing("fit", quickstart_config(tmp_path), folder=tmp_path)
    assert done.returncode == 2
    assert "headings" in done.stderr and "airswing run" in done.stderr


def test_stages_one_by_one_and_the_json_summary(blank_cards, quickstart_config, root, tmp_path):
    some = {"files": str(root / "data_samples/reports/N40[1-3].csv")}
    path = quickstart_config(tmp_path, reports=some)
    for stage, product in (("collocate", "headings"), ("fit", "fits.nc"), ("correct", "corrected")):
        how = process if stage == "collocate" else airswing
        done = how(stage, path, "--quiet", folder=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip().endswith(f"/{product}")
        assert done.stderr == ""
    done = airswing("run", path, "--resume", "--json", "--quiet", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"]["ok"] >= 2
    done = airswing("compare", path, "--quiet", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["pairs"][0]["references"] == ["ruc", "rtfdaa"]


def _heed_interrupts():
    """A shell's background jobs, and all they start, ignore interrupts unless set otherwise."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_an_interrupt_is_status_130_and_leaves_no_half_product(quickstart_config, tmp_path):
    command = [sys.executable, "-m", "airswing", "run", str(quickstart_config(tmp_path))]
    started = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, preexec_fn=_heed_interrupts
    )
    while not (line := started.stderr.readline()).startswith("catalogue"):
        assert line, "ended before the collocation"
    started.send_signal(signal.SIGINT)
    _, message = started.communicate(timeout=60)
    assert started.returncode == 130, message
    assert "Traceback" not in message
    left = [p.name for p in (tmp_path / "results").rglob("*.part")]
    assert left == []


def test_a_sample_is_not_mixed_with_what_is_there(tmp_path):
    (tmp_path / "ruc").mkdir()
    (tmp_path / "ruc/old.grb").touch()
    (tmp_path / "notes.txt").touch()
    words = ["sample", tmp_path, "--days", "1", "--aircraft", "1"]
    done = airswing(*words, folder=tmp_path)
    assert done.returncode == 2 and "not empty" in done.stderr and "--overwrite" in done.stderr
    assert not (tmp_path / "reports").exists()
    assert airswing(*words, "--overwrite", folder=tmp_path).returncode == 0
    assert (tmp_path / "notes.txt").exists() and not (tmp_path / "ruc/old.grb").exists()


def test_a_track_without_a_model_says_what_it_needs(tmp_path):
    words = ("collocate", "track.csv", "-o", "out.csv")
    assert "--reference NAME=GLOB" in airswing(*words, folder=tmp_path).stderr
    words += ("--reference", "ruc=none/*.grb")
    assert "track.csv: no such file. Check the path" in airswing(*words, folder=tmp_path).stderr
    (tmp_path / "track.csv").write_text("time,lat,lon,pressure_hPa\n")
    done = airswing(*words, folder=tmp_path)
    assert done.returncode == 2 and "airswing: --reference ruc: no file found" in done.stderr


def test_help_and_version(tmp_path):
    done = airswing("--help", folder=tmp_path)
    assert done.returncode == 0 and "..." not in done.stdout.replace("[ARGS]...", "")
    for command in ("run", "collocate", "fit", "correct", "evaluate", "compare", "sample"):
        assert command in done.stdout
    done = airswing("--version", folder=tmp_path)
    assert (done.returncode, done.stdout) == (0, f"airswing {__version__}\n")
