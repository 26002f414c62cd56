"""Ended between write and rename, torn by a loss of power: the products are made all the same."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from benchmarks import fault_drill
from tests.forked import forked
from tests.test_resume import config_in, job_of, run_stages

from airswing import workflow
from airswing.errors import InputError
from airswing.products import atomic as durable
from airswing.products.whole_files import write_text
from airswing.products.workspace import workspace
from airswing.reference.grib import filecache
from airswing.workflow.progress import Progress


def run_until(config: Path, suffix: str, left: int) -> None:
    """End the process where a file of some suffix, after so many, is about to get its name."""
    replace = os.replace

    def replace_or_end(source: Path, target: Path) -> None:
        nonlocal left
        left -= str(target).endswith(suffix)
        if left < 0:
            os._exit(9)
        replace(source, target)

    def end(self) -> None:
        put = "INSERT OR REPLACE INTO contents VALUES (?, ?, ?)"
        self._database.executemany(put, self._pending)
        os._exit(9)

    durable.os.replace = replace_or_end
    if suffix == "cache":
        filecache.FileCache.flush = end
    run_stages(config)


def make(job: workflow.Job) -> None:
    with workspace(job.output):
        headings = workflow.make_headings(job)
        workflow.make_corrected(job, headings, workflow.make_fits(job, headings))


def messages(job: workflow.Job) -> int:
    return sum(record.messages for record in job.progress.records)


@pytest.fixture(scope="module")
def finished(blank_cards, tmp_path_factory, root):
    """A configuration, its undisturbed products, and the messages they took."""
    folder = tmp_path_factory.mktemp("finished")
    job = job_of(config_in(folder, root))
    make(job)
    truth = job.output.rename(folder / "truth")
    return folder, truth, messages(job)


@pytest.fixture
def again(finished, monkeypatch, tmp_path):
    """The same, with an output folder and a cache of one's own."""
    folder, truth, count = finished
    monkeypatch.setenv("AIRSWING_CACHE", str(tmp_path / "cache"))
    yield folder / "config.yaml", truth, count
    shutil.rmtree(folder / "results", ignore_errors=True)


@pytest.mark.parametrize(
    ("suffix", "before"),
    [
        ("cache", 0),
        (".rows", 0),
        (".json", 0),
        (".npy", 20),
        ("headings.json", 0),
        ("headings.nc", 0),
        ("fits.nc", 0),
    ],
)
def test_ended_between_write_and_rename(again, suffix, before):
    config, truth, count = again
    process = forked(run_until, config, suffix, before)
    process.join(120)
    assert process.exitcode == 9
    output = config.parent / "results"
    assert bool([*output.rglob("*.part")]) == (suffix != "cache")
    job = job_of(config, resume=True)
    make(job)
    assert fault_drill.differences(truth, output) == []
    assert messages(job) == {"fits.nc": 0, "headings.nc": 0}.get(suffix, messages(job))
    assert suffix != ".npy" or messages(job) < count


def torn(path: Path, share: float) -> None:
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


@pytest.mark.parametrize("share", [0.0, 0.999])
@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["fits.nc", "corrected.nc"], "made again"),
        (["headings.nc", ".collocated/*.npy"], "not whole"),
        (["headings.nc", ".collocated/headings.json"], "not whole"),
        (["headings.nc", ".collocated/reports/*.rows"], "not whole"),
        (["headings.nc", ".collocated/reports/*.json"], "not whole"),
    ],
)
def test_files_torn_by_a_loss_of_power_are_said_and_made_again(
    again, names, said, share, caplog, capsys
):
    config, truth, count = again
    output = shutil.copytree(truth, config.parent / "results")
    for name in names:
        for path in sorted(output.glob(name))[:40]:
            torn(path, share)
    job = workflow.Job(job_of(config).config, Progress(), True)
    make(job)
    assert fault_drill.differences(truth, output) == []
    assert said in capsys.readouterr().err + caplog.text
    assert messages(job) < count


def test_what_is_written_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    calls = []
    fsync, replace = os.fsync, os.replace

    def flushed(descriptor: int) -> None:
        calls.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        fsync(descriptor)

    def renamed(source: Path, target: Path) -> None:
        calls.append((str(source), str(target)))
        replace(source, target)

    monkeypatch.setattr(durable.os, "fsync", flushed)
    monkeypatch.setattr(durable.os, "replace", renamed)
    path = tmp_path / "product.json"
    write_text(path, "whole")
    temporary = calls[0]
    assert calls == [temporary, (temporary, str(path)), str(tmp_path)]
    assert temporary.startswith(f"{tmp_path}/.product.json") and path.read_text() == "whole"
    calls.clear()
    with durable.replacing(path, lasting=False) as other:
        other.write_text("newer")
    assert calls == [str(other), (str(other), str(path))]


def test_a_disk_that_fails_while_flushing_leaves_what_was_there(tmp_path, monkeypatch):
    path = write_text(tmp_path / "product.json", "whole")

    def fails(descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(durable.os, "fsync", fails)
    with pytest.raises(InputError, match=r"product\.json.*Input/output error"):
        write_text(path, "newer")
    assert path.read_text() == "whole"
    assert [entry.name for entry in tmp_path.iterdir()] == ["product.json"]
