"""A killed run goes on to the same products; a change remakes what depends on it and no more."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import dask
import numpy as np
import pytest
import xarray as xr
import yaml
from benchmarks import fault_drill

from airswing import workflow
from airswing.compass.correction import correct
from airswing.compass.kept_headings import Record
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.products.workspace import LOCK, workspace
from airswing.workflow import collocating
from airswing.workflow import fits as fits_stage
from airswing.workflow import headings_stage as stages
from airswing.workflow.compute import scheduler
from airswing.workflow.progress import Progress
from tests.forked import forked

FLOWN = [("2009-09-16", "2009-09-21"), ("2009-10-08", "2009-10-12")]
"""Days of the shipped sample that are enough here: both months, and what is added later."""


def config_in(folder: Path, root: Path, **changes) -> Path:
    """Configuration of half the shipped sample's aircraft against one reference, files copied."""
    if not (folder / "reports").exists():
        (folder / "reports").mkdir()
        for path in root.glob("data_samples/reports/N40[146].csv"):
            header, *rows = path.read_text().splitlines(keepends=True)
            when = header.rstrip("\n").split(",").index("time")
            days = [(row, row.split(",")[when]) for row in rows]
            few = [row for row, day in days if any(a <= day < b for a, b in FLOWN)]
            (folder / "reports" / path.name).write_text("".join([header, *few]))
        shutil.copytree(root / "data_samples/ruc", folder / "ruc")
    content = {
        "reports": {"files": str(folder / "reports/*.csv")},
        "references": {"ruc": {"files": str(folder / "ruc/*.grb")}},
        "fit": {"shared_error": False, "harmonics": 1},
        "output": str(folder / "results"),
    } | changes
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def job_of(path: Path, *, resume: bool = False) -> workflow.Job:
    return workflow.Job(load_config(path), Progress(quiet=True), resume)


def decoded(job: workflow.Job) -> int:
    return sum(record.messages for record in job.progress.records)


def samples_of(job: workflow.Job) -> set[str]:
    return {path.name for path in job.store.glob("*.npy")}


def run_stages(config: Path, *, resume: bool = False) -> None:
    """Run the stages that write the main products, without the page."""
    job = job_of(config, resume=resume)
    with scheduler(job.config.compute, job.progress), workspace(job.output):
        headings = workflow.make_headings(job)
        workflow.make_corrected(job, headings, workflow.make_fits(job, headings))


def kill_when(config: Path, reached, *, resume: bool = False) -> None:
    """Kill a run as soon as a condition on its output folder holds."""
    process = forked(run_stages, config, resume=resume)
    while not reached(config.parent / "results"):
        assert process.is_alive(), process.exitcode
        time.sleep(0.01)
    process.kill()
    process.join()


def test_a_killed_run_goes_on_to_the_same_products(blank_cards, tmp_path, root, monkeypatch):
    monkeypatch.setenv("AIRSWING_CACHE", str(tmp_path / "cache"))
    config = config_in(tmp_path, root)
    run_stages(config)
    truth, output = tmp_path / "undisturbed", tmp_path / "results"
    output.rename(truth)
    kill_when(config, lambda folder: len(list(folder.glob(".collocated/*.npy"))) > 20)
    (output / ".headings.nc.1-abc.part").write_text("half")
    (output / ".collocated/tmpx.part").write_text("half")
    left = {path.name for path in output.glob(".collocated/*.npy")}
    assert left and not (output / workflow.HEADINGS).exists()
    kill_when(config, lambda folder: (folder / workflow.HEADINGS).exists(), resume=True)
    run_stages(config, resume=True)
    assert fault_drill.differences(truth, output) == []


def test_finished_model_times_are_not_read_again(tmp_path, root):
    config = config_in(tmp_path, root)
    first = job_of(config)
    workflow.make_headings(first)
    some = sorted(first.store.glob("*.npy"))
    for path in some[: len(some) // 4]:
        path.unlink()
    (first.output / workflow.HEADINGS).unlink()
    second = job_of(config, resume=True)
    workflow.make_headings(second)
    assert 0 < decoded(second) < 0.5 * decoded(first)


@pytest.mark.parametrize("comes_back", [True, False])
def test_a_model_file_lost_during_the_run_is_read_by_the_next(
    tmp_path, root, monkeypatch, capsys, comes_back
):
    """Away while it was to be read and back as it was: nothing but the problem met tells it."""
    config = config_in(tmp_path, root)
    whole = workflow.make_headings(job_of(config)).load()
    lost = sorted((tmp_path / "ruc").glob("*.grb"))[3::5]
    find, aside = collocating.collocate_places, tmp_path / "aside"
    aside.mkdir()

    def meanwhile(*args, **options):
        for path in lost:
            path.rename(aside / path.name)
        return find(*args, **options)

    monkeypatch.setattr(collocating, "collocate_places", meanwhile)
    first = workflow.Job(load_config(config), Progress())
    holed = workflow.make_headings(first)
    assert int(holed["reference_eastward_wind"].isnull().sum()) > 0
    assert "model files that vanished or changed before" in capsys.readouterr().err
    monkeypatch.undo()
    if comes_back:
        for path in aside.iterdir():
            path.rename(tmp_path / "ruc" / path.name)
    again = job_of(config, resume=True)
    mended = workflow.make_headings(again).load()
    expected = whole if comes_back else workflow.make_headings(job_of(config))
    for name in expected.variables:
        np.testing.assert_array_equal(mended[name].to_numpy(), expected[name].to_numpy(), str(name))
    third = job_of(config, resume=True)
    workflow.make_headings(third)
    assert not third.progress.records  # whole now, and kept


def test_a_changed_screening_keeps_the_model_winds(tmp_path, root, monkeypatch):
    first = job_of(config_in(tmp_path, root))
    workflow.make_headings(first)
    changed = config_in(tmp_path, root, screening={"max_turn": "3 deg"})
    job = job_of(changed, resume=True)
    again = workflow.make_headings(job)
    assert [record.name for record in job.progress.records] == ["screen"]
    # its headings are those a later run can take up
    kept = Record.read(job.record)
    assert kept is not None and kept.product == again.attrs["uuid"]
    shutil.rmtree(job.output)
    scratch = workflow.make_headings(job_of(changed))
    for name in scratch.variables:
        np.testing.assert_array_equal(again[name].to_numpy(), scratch[name].to_numpy(), str(name))
    assert set(again.attrs) == set(scratch.attrs)


def test_the_curve_corrects_in_place_of_the_table_where_asked(tmp_path, root, monkeypatch):
    monkeypatch.setattr(fits_stage, "draw_cards", lambda job, found, near: None)
    run_stages(config_in(tmp_path, root))
    job = job_of(config_in(tmp_path, root, correction={"method": "curve"}), resume=True)
    corrected = workflow.make_corrected(job)
    assert "correct" in [record.name for record in job.progress.records]
    assert corrected.attrs["correction_method"] == "curve"
    with (
        xr.open_dataset(job.output / "headings.nc") as headings,
        xr.open_dataset(job.output / "fits.nc") as fits,
    ):
        for name in ("corrected_eastward_wind", "corrected_wind_standard_error"):
            alone = correct(headings, fits, method="curve")[name]
            np.testing.assert_allclose(corrected[name], alone, atol=0.01, err_msg=name)
            by_table = correct(headings, fits, method="table")[name]
            assert not np.allclose(corrected[name], by_table, atol=0.01, equal_nan=True)


@pytest.mark.parametrize("change", ["report", "reference", "collocation", "code"])
def test_a_changed_input_option_or_code_is_collocated_anew(tmp_path, root, monkeypatch, change):
    config = config_in(tmp_path, root)
    workflow.make_headings(job_of(config))
    if change == "report":
        with next((tmp_path / "reports").glob("*.csv")).open("a") as file:
            file.write("\n")
    elif change == "reference":
        sorted((tmp_path / "ruc").iterdir())[0].unlink()
    elif change == "collocation":
        config = config_in(tmp_path, root, collocation={"max_time_gap": "2 h"})
    else:
        digest = stages.code_digest
        monkeypatch.setattr(stages, "code_digest", lambda *names: f"new {digest(*names)}")
    job, called = job_of(config, resume=True), []

    def stop(*words, **options):
        called.append(options)
        raise InputError("stopped")

    monkeypatch.setattr(stages, "collocated_blocks", stop)
    with pytest.raises(InputError, match="stopped"):
        workflow.make_headings(job)
    assert called


def test_code_of_one_stage_leaves_the_others(tmp_path, root, monkeypatch):
    """What each product depends on, with the code of the fit as it is and changed."""
    job, marks = job_of(config_in(tmp_path, root)), []
    headings = workflow.make_headings(job)

    def note(job, name, make, *, depends, **options):
        marks.append((name, stages.fingerprint(name, *depends)))
        raise InputError("noted")

    monkeypatch.setattr(stages, "ragged_product", note)
    monkeypatch.setattr(fits_stage, "product", note)
    digest = stages.code_digest
    for addition in ("", "new"):

        def changed(*names: str, addition: str = addition) -> str:
            return digest(*names) + (addition if names == workflow.FITTING else "")

        for module in (stages, fits_stage):
            monkeypatch.setattr(module, "code_digest", changed)
        for stage in (workflow.make_headings, lambda job: workflow.make_fits(job, headings)):
            with pytest.raises(InputError, match="noted"):
                stage(job)
    assert marks[0] == marks[2]
    assert marks[1][0] == marks[3][0] == workflow.FITS and marks[1] != marks[3]


def test_a_month_is_added_at_the_cost_of_its_own_messages(tmp_path, root):
    """The fits equal those from scratch, bit for bit."""
    config = config_in(tmp_path, root)
    later = tmp_path / "later"
    later.mkdir()
    for table in (tmp_path / "reports").glob("*.csv"):
        header, *rows = table.read_text().splitlines(keepends=True)
        when = header.rstrip("\n").split(",").index("time")
        new = [row for row in rows if row.split(",")[when] >= "2009-10-10"]
        table.write_text(header + "".join(row for row in rows if row not in set(new)))
        (later / table.name).write_text(header + "".join(new))
    first = job_of(config)
    workflow.make_headings(first)
    for table in later.iterdir():
        table.rename(tmp_path / "reports" / f"later_{table.name}")
    added = job_of(config, resume=True)
    grown = workflow.make_fits(added, workflow.make_headings(added))
    (reading,) = (record for record in added.progress.records if record.name == "reports")
    tables = [path.read_bytes() for path in (tmp_path / "reports").glob("later_*")]
    new = sum(len(table) for table in tables if table.count(b"\n") > 1)
    assert reading.octets == new  # no file of the first run was read again
    used = samples_of(added)
    shutil.rmtree(added.output)
    scratch = job_of(config)
    whole = workflow.make_fits(scratch, workflow.make_headings(scratch))
    assert 0 < decoded(added) < 1.1 * (decoded(scratch) - decoded(first)) + 40
    assert used == samples_of(scratch)  # none is left that no run uses any more
    for name in whole.variables:
        np.testing.assert_array_equal(grown[name].to_numpy(), whole[name].to_numpy(), str(name))


def test_a_full_disk_under_the_work_under_way_is_one_message(tmp_path, root, monkeypatch):
    from airswing.reference.places import Places

    def full(*words: object) -> None:
        raise OSError(28, "No space left on device")

    config = config_in(tmp_path, root)
    monkeypatch.setattr(Places, "put", full)
    with pytest.raises(InputError, match=r"collocated.*work under way.*No space left.*--resume"):
        workflow.make_headings(job_of(config))
    monkeypatch.undo()
    job, scratch = job_of(config, resume=True), job_of(config)
    workflow.make_headings(job)
    workflow.make_headings(scratch)
    assert decoded(job) < decoded(scratch)


@pytest.mark.parametrize("kept", [True, False])
def test_what_a_later_run_adds_to_is_kept_or_not(tmp_path, root, kept):
    job = job_of(config_in(tmp_path, root, compute={"keep_samples": kept}))
    workflow.make_headings(job)
    assert bool(samples_of(job)) == job.store.exists() == kept
    assert not (job.store / "blocks").exists()


def test_a_run_from_scratch_takes_nothing_up(tmp_path, root):
    config = config_in(tmp_path, root)
    jobs = [job_of(config), job_of(config)]
    for job in jobs:
        workflow.make_headings(job)
    assert decoded(jobs[0]) == decoded(jobs[1]) > 0


def test_one_run_at_a_time_holds_a_folder(tmp_path):
    with workspace(tmp_path / "out"):
        with pytest.raises(InputError, match="another run"), workspace(tmp_path / "out"):
            pass
        assert (tmp_path / "out" / LOCK).exists()
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match=r"out.*--output"), workspace(tmp_path / "out"):
        pass


def test_a_full_disk_ends_collocation_in_one_message(tmp_path, root, monkeypatch):
    from airswing.products import atomic as durable

    replace = durable.os.replace

    def full(source: Path, target: Path) -> None:
        if target.suffix == ".npy":
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(durable.os, "replace", full)
    # One task at a time: with threads another may be about to clear its own temporary file.
    with (
        dask.config.set(scheduler="synchronous"),
        pytest.raises(InputError, match=r"finished model time.*No space left"),
    ):
        workflow.make_headings(job_of(config_in(tmp_path, root)))
    assert not list(tmp_path.rglob("*.part"))
