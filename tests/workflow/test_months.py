"""Months: what is new, late or corrected makes its months anew; the others are kept."""

import json
import os
import random
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from benchmarks import fault_drill, year
from tests.command import airswing as command
from tests.command import configured
from tests.forked import forked

import airswing
from airswing import workflow
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.products import whole_files
from airswing.products.whole_files import workspace
from airswing.reference.collocate import collocate
from airswing.workflow.progress import Progress

HOURS, REPORTS, AIRCRAFT = 24 * 48, 4_000, 4
NEW = "N103"
"""Reports in the last month alone."""
JANUARY, FEBRUARY, MARCH = "2009-01", "2009-02", "2009-03"
ALL = [JANUARY, FEBRUARY, MARCH]
pytestmark = pytest.mark.usefixtures("blank_cards")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """19 January to 8 March, files of three days and of the model every three hours."""
    folder = tmp_path_factory.mktemp("archive")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(year, "LEVELS", (500, 250))  # its wind is that of all levels
        patch.setattr(year, "START", np.datetime64("2009-01-19T00:00:00", "s"))
        year.write_fields(folder / "model", HOURS, step=3)
        year.write_reports(folder / "made", REPORTS, HOURS, AIRCRAFT)
    table = pd.concat([pd.read_parquet(path) for path in (folder / "made").iterdir()])
    table = table[(table["tail"] != NEW) | (table["time"] >= "2009-03-01")]
    across = (table["tail"] == "N100") & (table["time"] >= "2009-01-31T20:00")
    first = table[across]["time"].min()
    # One flight begins in January and ends in February.
    delay, flight = pd.Timestamp("2009-01-31T23:45") - first, first + pd.Timedelta("1 h")
    table.loc[across & (table["time"] < flight), "time"] += delay
    (folder / "days").mkdir()
    first_day = table["time"].dt.normalize() - pd.to_timedelta((table["time"].dt.day - 1) % 3, "D")
    for day, of_days in table.groupby(first_day.dt.date):
        of_days.to_parquet(folder / f"days/{day}.parquet", index=False)
    return folder


@pytest.fixture(autouse=True)
def emptied(archive):
    """Every test begins without results and with all reports; the model is whole again after it."""
    for name in ("reports", "results", "continued", "aside"):
        shutil.rmtree(archive / name, ignore_errors=True)
    (archive / "aside").mkdir()
    shutil.copytree(archive / "days", archive / "reports")
    yield
    for path in (archive / "aside").iterdir():
        path.rename(archive / "model" / path.name)


@pytest.fixture(scope="module")
def complete(archive):
    """Products of a run of all of it, never changed by a test."""
    shutil.copytree(archive / "days", archive / "reports", dirs_exist_ok=True)
    make(archive)
    return (archive / "results").rename(archive / "whole")


def job_of(folder, *, fresh=False, **changes):
    fit = {"harmonics": 1, "min_reports": 50, "shared_error": False}  # for its time
    sections = {"fit": fit, "output": "results"} | changes
    files = folder / "reports/*.parquet", {"small": folder / "model/*.grb"}
    path = configured(folder, *files, **sections)
    return workflow.Job(load_config(path), Progress(quiet=True), fresh)


def make(folder, **changes):
    """Headings, fits and corrected winds; the months of headings that were made."""
    job = job_of(folder, **changes)
    with workspace(job.output):
        headings = workflow.make_headings(job)
        workflow.make_corrected(job, workflow.make_fits(job, headings))
    months = json.loads(headings.attrs["months"])
    stems = [path.stem for path in (folder / "results/corrected").glob("*.nc")]
    assert sorted(months["made"] + months["kept"]) == sorted(stems)
    return months["made"]


def begin_with(archive, complete):
    """Begin with the products of the run of all."""
    shutil.copytree(complete, archive / "results")


def days(folder, *patterns):
    return [path for pattern in patterns for path in (folder / "reports").glob(pattern)]


def test_months_made_night_by_night_are_what_one_run_gives(archive, complete):
    later = {path.name: path.rename(archive / "aside" / path.name) for path in days(archive, "*")}

    def add(first, last):
        for name in sorted(later):
            if first <= name[:10] < last:
                later.pop(name).rename(archive / "reports" / name)

    add("2009-01-01", "2009-02-10")
    assert make(archive) == [JANUARY, FEBRUARY]
    january = (archive / "results/headings/2009-01.nc").stat().st_mtime_ns
    add("2009-02-10", "2009-02-26")
    assert make(archive) == [FEBRUARY]
    add("2009-02-26", "2009-03-04")
    assert make(archive) == [FEBRUARY, MARCH]
    add("2009-03-04", "2009-04-01")
    assert make(archive) == [MARCH]
    assert (archive / "results/headings/2009-01.nc").stat().st_mtime_ns == january
    assert make(archive) == []
    assert fault_drill.differences(complete, archive / "results") == []


def test_a_flight_over_the_end_of_a_month_is_whole_in_the_month_it_began_in(complete):
    months = [airswing.open_product(complete / f"headings/{month}.nc") for month in ALL]
    january, february, _ = months
    assert january["time"].max() > np.datetime64("2009-02-01")
    assert february["time"].min() > january["time"].max() - np.timedelta64(1, "D")
    joined = airswing.open_product(complete / "headings")
    assert joined.sizes["report"] == sum(month.sizes["report"] for month in months)
    for name in joined["aircraft"].to_numpy():
        reports = airswing.aircraft_reports(joined, name)
        assert (np.diff(reports["time"]) >= np.timedelta64(0)).all()
        assert (np.diff(reports["flight"]) >= 0).all()


def test_changed_reports_remake_their_month(archive, complete):
    """Late, corrected and withdrawn reports; not the same reports in other files."""
    begin_with(archive, complete)
    files = days(archive, "2009-02*")
    pd.concat(map(pd.read_parquet, files)).to_parquet(archive / "reports/all.parquet", index=False)
    for path in files:
        path.unlink()
    assert make(archive) == []
    day, late_day = min(days(archive, "2009-01-1*")), max(days(archive, "2009-03*"))
    table = pd.read_parquet(day)
    delayed = table.iloc[:30].assign(time=table["time"].iloc[:30] + pd.Timedelta("20 min"))
    delayed.to_parquet(archive / "reports/late.parquet", index=False)
    assert make(archive) == [JANUARY]
    table = pd.read_parquet(late_day)
    table.assign(wind_speed_kt=table["wind_speed_kt"] + 1).to_parquet(late_day, index=False)
    assert make(archive) == [MARCH]
    day.unlink()
    assert make(archive) == [JANUARY]
    for path in days(archive, "2009-03*"):
        path.unlink()
    (archive / "results/headings/2009-03.nc").unlink()  # and not corrected/2009-03.nc
    assert make(archive) == [FEBRUARY]  # its neighbour is gone
    assert make(archive) == []
    names = sorted(path.name for path in (archive / "results").rglob("*2009-*.nc"))
    assert names == [f"{month}.nc" for month in (JANUARY, JANUARY, FEBRUARY, FEBRUARY)]


def test_new_model_files_remake_their_month_and_removed_files_do_not(archive, complete):
    begin_with(archive, complete)
    some = sorted((archive / "model").glob("200902*"))[40:60]
    for path in some:
        path.rename(archive / "aside" / path.name)
    assert make(archive) == []
    for path in some:
        shutil.copy2(archive / "aside" / path.name, path)
        os.utime(path)  # written anew: another time of change
    assert make(archive) == [FEBRUARY]


def test_model_files_that_vanish_in_a_run_are_read_later(archive, complete, monkeypatch, capsys):
    lost = sorted((archive / "model").glob("200902*"))[40:60]

    def meanwhile(reports, *args, **options):
        if reports["time"].min() > np.datetime64("2009-02-01"):
            for path in lost:
                if path.exists():
                    path.rename(archive / "aside" / path.name)
        return collocate(reports, *args, **options)

    monkeypatch.setattr("airswing.workflow.months.collocate", meanwhile)
    job = job_of(archive)
    with workspace(job.output):
        holed = workflow.make_headings(workflow.Job(job.config, Progress()))
    assert "model files that vanished or changed before they were read" in capsys.readouterr().err
    whole_headings = airswing.open_product(complete / "headings")
    missing = holed["reference_eastward_wind"].isnull().sum()
    assert missing > whole_headings["reference_eastward_wind"].isnull().sum()
    monkeypatch.undo()
    for path in lost:
        (archive / "aside" / path.name).rename(path)
    assert FEBRUARY in make(archive)
    assert fault_drill.differences(complete, archive / "results") == []


def test_changed_settings_remake_the_dependent_months(archive, complete):
    begin_with(archive, complete)
    assert make(archive, fit={"harmonics": 2}) == []
    assert make(archive, collocation={"max_time_gap": "4 h"}) == ALL
    assert make(archive, collocation={"max_time_gap": "4 h"}, fresh=True) == ALL


def test_a_changed_screening_reads_no_model_file(archive, complete, monkeypatch):
    begin_with(archive, complete)
    strict = {"screening": {"max_turn": "3 deg"}}
    with monkeypatch.context() as patch:
        patch.setattr("airswing.workflow.months.collocate", None)
        headings = workflow.make_headings(job_of(archive, **strict))
    assert json.loads(headings.attrs["months"])["made"] == ALL
    shutil.copytree(archive / "results", archive / "aside/screened")
    workflow.make_headings(job_of(archive, fresh=True, **strict))
    rescreened, anew = archive / "aside/screened/headings", archive / "results/headings"
    assert not fault_drill.differences(rescreened, anew)
    shutil.rmtree(archive / "aside/screened")


def test_truncated_files_are_made_again(archive, complete):
    begin_with(archive, complete)
    for note, share, made in (("2009-01", 0, [JANUARY, FEBRUARY]), ("reports", 0.999, [FEBRUARY])):
        for name in ("headings/2009-02.nc", f".airswing/{note}.json"):
            path = archive / "results" / name
            path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
        assert make(archive) == made
        assert fault_drill.differences(complete, archive / "results") == []


def end_before(folder, name):
    """Make the products, and end the process where a file is about to get its name."""
    replace = os.replace

    def replace_or_end(source, target):
        if str(target).endswith(name):
            os._exit(9)
        replace(source, target)

    whole_files.os.replace = replace_or_end
    make(folder)


@pytest.mark.parametrize("name", ["headings/2009-02.nc", "corrected/2009-02.nc", "2009-02.json"])
def test_a_run_that_ended_between_write_and_rename_can_be_continued(archive, complete, name):
    begin_with(archive, complete)
    (archive / "results/headings/2009-02.nc").unlink()
    process = forked(end_before, archive, name)
    process.join(120)
    assert process.exitcode == 9
    assert [*(archive / "results").rglob("*.part")]
    assert make(archive) == ([] if "corrected" in name else [FEBRUARY])
    assert fault_drill.differences(complete, archive / "results") == []


OPERATIONS = ["run", "kill", "monitor", "export", "remove", "add", "correct", "damage", "late"]


@pytest.mark.parametrize(
    ("seed", "steps"),
    [(44, 4), *(pytest.param(seed, 15, marks=pytest.mark.slow) for seed in range(1, 12))],
)
def test_operations_in_any_order_end_in_the_products_of_one_run(archive, tmp_path, seed, steps):
    """Reports that come, go, change and break; late model files; kills, monitoring and exports."""
    pick, config = random.Random(seed), archive / "config.yaml"
    for path in sorted((archive / "model").glob("200902*"))[40:60]:
        path.rename(archive / "aside" / path.name)
    make(archive)
    for _ in range(steps):
        operation = pick.choice(OPERATIONS)
        name = pick.choice(sorted((archive / "days").iterdir())).name
        day, original = archive / "reports" / name, archive / "days" / name
        if operation == "run":
            make(archive)
        elif operation == "kill":
            process = forked(make, archive)
            process.join(pick.uniform(0.2, 4.0))
            process.kill()
            process.join()
        elif operation == "monitor":
            assert command("monitor", config, "--quiet").returncode in (0, 2)
        elif operation == "export":
            words = ("--to", "obs_domain", "-o", tmp_path / "OBS_DOMAIN101", "--overwrite")
            assert command("export", config, *words, "--quiet").returncode in (0, 2)
        elif operation == "remove":
            day.unlink(missing_ok=True)
        elif operation == "add":
            shutil.copy(original, day)
        elif operation == "correct":
            pd.read_parquet(original).assign(wind_speed_kt=33.0).to_parquet(day, index=False)
        elif operation == "damage":
            day.write_bytes(b"\x00\xff" * 50)
        else:
            for path in (archive / "aside").iterdir():
                path.rename(archive / "model" / path.name)
    make(archive)
    (archive / "results").rename(archive / "continued")
    make(archive)
    shutil.rmtree(archive / "continued/report", ignore_errors=True)
    differences = fault_drill.differences(archive / "continued", archive / "results")
    assert not [line for line in differences if ": attribute" not in line]


def test_a_folder_of_months_of_different_references_is_refused(archive, complete, tmp_path):
    shutil.copytree(complete / "headings", tmp_path / "headings")
    path = tmp_path / "headings/2009-02.nc"
    renamed = airswing.read_product(path).assign_coords(reference=["other"])
    airswing.write_product(renamed, path, title="other")
    with pytest.raises(InputError, match="different variables or references"):
        airswing.open_product(tmp_path / "headings")


def test_all_products_open_as_one_tree(complete, tmp_path):
    shutil.copytree(complete, tmp_path / "run")
    shutil.copy(complete / "fits.nc", tmp_path / "run/gap.nc")
    (tmp_path / "run/gap").mkdir()  # of the page, no product
    tree = airswing.open_results(tmp_path / "run")
    assert set(tree.children) == {"headings", "fits", "corrected", "gap"}
    assert tree["headings"]["heading"].chunks is not None
    for name in ("headings", "corrected"):
        opened = airswing.open_product(complete / name).load()
        xr.testing.assert_identical(opened, airswing.read_product(complete / name))


def test_duplicates_around_the_end_of_a_month_are_counted_once(archive):
    (day,) = days(archive, "2009-01-31*")
    pd.read_parquet(day).iloc[:20].to_parquet(archive / "reports/again.parquet", index=False)
    headings = workflow.make_headings(job_of(archive))
    audit = json.loads(headings.attrs["reading_audit"])
    assert audit["dropped"] == {"exact_duplicate": 20}
    assert audit["reports_kept"] == headings.sizes["report"]
