"""What is new is taken up by month: what stands then is what a run of all of it gives."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from benchmarks import year

import airswing
from airswing import workflow
from airswing.config import Correction
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.evaluation.backtest.virtual_field_test import virtual_field_test
from airswing.flags import STATUS
from airswing.products.ragged_product import write_joined
from airswing.products.workspace import workspace
from airswing.workflow import fits
from airswing.workflow.evaluation_stage import make_field_test
from airswing.workflow.progress import Progress
from airswing.workflow.update import judged, month_fits, taking_up

CURVE = Correction(method="curve")
HOURS, REPORTS, AIRCRAFT = 24 * 66, 6_000, 4
NEW = "N103"
"""Reports in the last month alone."""
JANUARY, FEBRUARY, MARCH = "2009-01", "2009-02", "2009-03"


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    """January to early March, a file of reports a day and of the model an hour; a run of all."""
    folder = tmp_path_factory.mktemp("archive")
    year.write_fields(folder / "model", HOURS)
    for number, path in enumerate(sorted((folder / "model").iterdir())):
        if number % 3:
            path.unlink()  # every three hours is enough
    year.write_reports(folder / "twelfths", REPORTS, HOURS, AIRCRAFT)
    table = pd.concat([pd.read_parquet(path) for path in (folder / "twelfths").iterdir()])
    table = table[(table["tail"] != NEW) | (table["time"] >= "2009-03-01")]
    across = (table["tail"] == "N100") & (table["time"] >= "2009-01-31T20:00")
    first = table[across]["time"].min()
    # One flight begins in January and ends in February.
    table.loc[across & (table["time"] < first + pd.Timedelta("1 h")), "time"] += (
        pd.Timestamp("2009-01-31T23:45") - first
    )
    (folder / "days").mkdir()
    for day, part in table.groupby(table["time"].dt.date):
        part.to_parquet(folder / f"days/{day}.parquet", index=False)
    shutil.copytree(folder / "days", folder / "reports")
    job = job_in(folder, "scratch")
    headings = workflow.make_headings(job)
    workflow.make_corrected(job, headings, workflow.make_fits(job, headings)).close()
    headings.close()
    return folder


@pytest.fixture(autouse=True)
def emptied(archive, monkeypatch) -> Iterator[None]:
    """Every test begins without reports and results; no cards are drawn."""
    monkeypatch.setattr(fits, "draw_cards", lambda job, found, near: None)
    for name in ("reports", "results", "aside"):
        shutil.rmtree(archive / name, ignore_errors=True)
        (archive / name).mkdir()
    yield
    for path in (archive / "aside").iterdir():
        path.rename(archive / "model" / path.name)


def job_in(folder: Path, output: str = "results", **changes) -> workflow.Job:
    content = {
        "reports": {"files": str(folder / "reports/*.parquet")},
        "references": {"small": {"files": str(folder / "model/*.grb")}},
        "output": str(folder / output),
        "fit": {"harmonics": 1, "min_reports": 50},
    }
    path = folder / "config.json"
    path.write_text(json.dumps(content | changes))
    return workflow.Job(load_config(path), Progress(quiet=True))


def update(folder: Path, **changes) -> dict[str, list[str]]:
    """Take up what is new; which months were made and corrected."""
    job = replace(job_in(folder, **changes), resume=True)
    with workspace(job.output):
        return taking_up.take_up(job).months


def update_with_all(folder: Path) -> None:
    """All reports taken up at once, made the first time alone."""
    add(folder, "*")
    made = folder / "taken_up"
    if made.is_dir():
        shutil.copytree(made, folder / "results", dirs_exist_ok=True)
    else:
        update(folder)
        shutil.copytree(folder / "results", made)


def add(folder: Path, *patterns: str) -> None:
    for pattern in patterns:
        for path in (folder / "days").glob(pattern):
            shutil.copy2(path, folder / "reports")


def stamps(folder: Path, month: str) -> list[tuple[int, int]]:
    """What would change if a month's products were written again."""
    files = [folder / f"results/{name}/{month}.nc" for name in ("headings", "gap_inputs")]
    return [(path.stat().st_ino, path.stat().st_mtime_ns) for path in files]


def alike(folder: Path) -> None:
    """The headings are those of the run, bit for bit; the fits within a tenth of their errors."""
    months = airswing.read_product(folder / "results/headings")
    whole = airswing.read_product(folder / "scratch/headings.nc")
    assert set(months.variables) == set(whole.variables)
    for name in whole.variables:
        if name != "flight":
            np.testing.assert_array_equal(months[name], whole[name], err_msg=str(name))
    begins = [np.diff(one["flight"], prepend=-1) != 0 for one in (months, whole)]
    np.testing.assert_array_equal(*begins)
    found, wanted = (
        airswing.read_product(folder / name / "fits.nc") for name in ("results", "scratch")
    )
    np.testing.assert_array_equal(found["status"], wanted["status"])
    error = np.sqrt(np.einsum("rkii->rki", wanted["deviation_covariance"].to_numpy()))
    apart = np.abs(found["deviation"] - wanted["deviation"]).to_numpy()
    known = np.isfinite(error)
    np.testing.assert_array_equal(np.isfinite(apart), known)
    assert known.any() and np.all(apart[known] <= 0.1 * error[known])


@pytest.fixture
def looked_at(monkeypatch) -> list[int]:
    """Reports that aircraft are fitted to anew."""
    found: list[int] = []
    whole = month_fits.sum_aircraft

    def noted(headings, **options):
        found.append(headings.sizes["report"])
        return whole(headings, **options)

    monkeypatch.setattr(month_fits, "sum_aircraft", noted)
    return found


def judged_as_by_reports(folder: Path) -> None:
    """February judged by the sums of January is February judged by a fit to January's reports."""
    job = replace(job_in(folder), resume=True)
    headings = airswing.read_product(folder / "results/headings", lazy=True)
    fitted = airswing.read_product(folder / "results/fits.nc")
    found = judged._virtual(job, [JANUARY, FEBRUARY], headings, fitted)["later"]
    both = judged._of(job, [JANUARY, FEBRUARY], fitted)
    wanted = virtual_field_test(
        both,
        learned_until=date(2009, 2, 1),
        pools=job.config.pools(),
        reference="small",
        **job.config.fit.model_dump(),
    )
    assert [one["aircraft"] for one in found["by_aircraft"]] == ["N100", "N101", "N102"]
    assert found["reports"] == wanted["reports"]
    error = wanted["predicted_standard_error_kt"]
    for key in ("predicted_gain_kt", "realised_gain_kt"):
        assert found[key] == pytest.approx(wanted[key], abs=0.25 * error)
    assert found["learned_until"] == "2009-02-01"


def test_months_taken_up_one_by_one_are_what_a_run_of_all_gives(archive, looked_at):
    add(archive, "2009-01*", "2009-02-0*")
    assert update(archive)["made"] == [JANUARY, FEBRUARY]
    january, february = stamps(archive, JANUARY), stamps(archive, FEBRUARY)
    add(archive, "2009-02-1*", "2009-02-2*")
    assert update(archive)["made"] == [FEBRUARY]
    add(archive, "2009-03-0[1-4]*")
    assert update(archive)["made"] == [MARCH]
    assert stamps(archive, JANUARY) == january and stamps(archive, FEBRUARY) != february
    add(archive, "2009-03*")
    assert sum(looked_at) < 2 * REPORTS  # a month that begins asks for no fit of all
    looked_at.clear()
    assert update(archive)["made"] == [MARCH]
    assert sum(looked_at) < REPORTS / 10  # the fit looks at what the sums do not tell alone
    alike(archive)
    judged_as_by_reports(archive)
    assert update(archive) == {"all": [JANUARY, FEBRUARY, MARCH], "made": [], "corrected": []}


FIELD = {
    "before_start": "2009-01-10",
    "start": "2009-02-05",
    "end": "2009-02-20",
    "corrected": ["N100"],
    "controls": ["N101", "N102"],
}


def test_a_field_test_that_is_kept_is_that_of_a_run_of_all(archive, monkeypatch):
    def judge() -> dict:
        job = replace(job_in(archive, field_test=FIELD), resume=True)
        with workspace(job.output):
            taken = taking_up.take_up(job)
            months = taken.months["all"]
            return judged._Monthly(job, months).kept(
                judged.FIELD_TEST,
                lambda: judged._field_test(job, months, taken.headings, taken.fits),
            )

    add(archive, "2009-01*", "2009-02*", "2009-03-0[1-4]*")
    first = judge()
    written = (archive / "results/field_test.json").stat().st_mtime_ns
    add(archive, "*")
    monkeypatch.setattr(judged, "make_field_test", None)  # nothing is tested again
    np.testing.assert_equal(judge(), first)
    assert (archive / "results/field_test.json").stat().st_mtime_ns == written
    job = job_in(archive, "aside", field_test=FIELD)
    with workflow.make_headings(job) as headings:
        wanted = plain(make_field_test(job, headings))
    shutil.rmtree(archive / "aside")
    (archive / "aside").mkdir()
    assert np.isfinite(wanted["adjusted_reduction_kt"]) and wanted["predicted_reduction_kt"] != 0
    np.testing.assert_equal(plain(first), wanted)


def plain(found: dict) -> dict:
    """To nine places, as JSON holds it."""
    text = json.dumps(found, default=lambda value: value.tolist())
    return json.loads(text, parse_float=lambda number: float(f"{float(number):.9g}"))


def test_a_day_twice_changes_nothing_and_a_day_corrected_its_month(archive):
    update_with_all(archive)
    before = {month: stamps(archive, month) for month in (JANUARY, FEBRUARY, MARCH)}
    again = archive / "reports/again.parquet"
    of_a_day = sorted((archive / "days").glob("2009-02-1*"))[-1]
    shutil.copy2(of_a_day, again)
    assert update(archive)["made"] == []
    assert before == {month: stamps(archive, month) for month in before}
    again.unlink()
    day = archive / "reports" / of_a_day.name
    table = pd.read_parquet(day)
    table.assign(wind_speed_kt=table["wind_speed_kt"] + 3).to_parquet(day, index=False)
    assert update(archive)["made"] == [FEBRUARY]
    shutil.copy2(of_a_day, day)
    os.utime(day)
    assert update(archive)["made"] == [FEBRUARY]
    assert {month: stamps(archive, month) for month in (JANUARY, MARCH)} == {
        month: before[month] for month in (JANUARY, MARCH)
    }
    alike(archive)


def test_an_aircraft_without_a_curve_is_fitted_once(archive, looked_at):
    update_with_all(archive)
    job = job_in(archive, fit={"harmonics": 1, "min_reports": 500})
    months = month_fits.MonthlyFits([JANUARY, FEBRUARY, MARCH])
    headings = airswing.read_product(archive / "results/headings", lazy=True)
    first = months(job, headings).fits
    assert first["status"].sel(aircraft=NEW).item() == STATUS["too_few_reports"]
    assert max(looked_at) > 500
    looked_at.clear()
    again = months(job, headings).fits
    assert set(looked_at) == {0}  # nothing is fitted to reports
    for name in ("deviation", "status", "report_count", "condition_number"):
        np.testing.assert_array_equal(first[name], again[name])


def test_a_sample_is_another_one_when_reports_have_grown_by_a_quarter():
    alike = month_fits._same_sample
    assert alike(3_000, 7_999) and alike(100, 3_999) and not alike(8_056, 7_942)
    assert alike(160_000, 199_999) and alike(199_999, 160_000)
    assert not alike(160_000, 204_000) and not alike(204_000, 160_000)


def test_late_reports_and_late_model_files_touch_their_month(archive):
    add(archive, "*")
    of_a_day = sorted((archive / "reports").glob("2009-01-2*"))[0]
    of_a_day.unlink()
    late = sorted((archive / "model").glob("2009021[01]*"))
    for path in late:
        path.rename(archive / "aside" / path.name)
    update(archive)
    add(archive, of_a_day.name)
    assert update(archive)["made"] == [JANUARY]
    for path in late:
        (archive / "aside" / path.name).rename(path)
    assert update(archive)["made"] == [FEBRUARY]
    for path in (archive / "model").glob("200901*"):
        path.rename(archive / "aside" / path.name)
    assert update(archive)["made"] == []  # what went away takes no wind away
    alike(archive)


def test_what_a_changed_setting_asks_for_is_said_and_made(archive):
    add(archive, "2009-01*")
    update(archive)
    job = replace(job_in(archive, screening={"max_turn": "3 deg"}), resume=True)
    said: list[str] = []
    object.__setattr__(job.progress, "say", said.append)
    with workspace(job.output):
        assert taking_up.take_up(job).months["made"] == [JANUARY]
    assert any("changed since the last time: screening; 1 months" in line for line in said)
    for name in ("headings", "corrected"):  # what a loss of power may leave is made again
        (archive / f"results/{name}/{JANUARY}.nc").write_bytes(b"\x89HDF half")
    with workspace(job.output):
        assert taking_up.take_up(job).months["corrected"] == [JANUARY]
    by_curve = replace(job, config=job.config.model_copy(update={"correction": CURVE}))
    with workspace(job.output):
        assert taking_up.take_up(by_curve).months["corrected"] == [JANUARY]
    with workspace(job.output), pytest.raises(InputError, match="another run"):
        taking_up.update(job)  # two at once
    (archive / "results/headings.nc").touch()
    with pytest.raises(InputError, match="airswing run"):
        update(archive)


def test_months_open_as_one_dataset(archive):
    update_with_all(archive)
    lazy = airswing.read_product(archive / "results/headings", lazy=True)
    whole = airswing.read_product(archive / "scratch/headings.nc")
    size = whole.sizes["report"]
    for part in (slice(0, 5), slice(size // 3, size // 2), slice(size - 3, size), slice(9, 900, 7)):
        for name in ("time", "heading_error"):
            one, other = (ds[name].isel(report=part) for ds in (lazy, whole))
            np.testing.assert_array_equal(one, other)
    some = np.array([size - 1, 3, 3, size // 2])
    np.testing.assert_array_equal(lazy["time"].isel(report=some), whole["time"].isel(report=some))
    flat = xr.open_mfdataset(
        str(archive / "results/headings/*.nc"),
        preprocess=airswing.by_report,
        combine="nested",
        concat_dim="report",
        decode_timedelta=False,
    )
    written = write_joined(archive / "results/headings", archive / "aside/whole.nc")
    xr.testing.assert_equal(airswing.read_product(written), lazy.load())
    written.unlink()
    with flat:
        order = np.lexsort((flat["time"], flat["aircraft"]))
        names = np.repeat(whole["aircraft"].to_numpy().astype(str), whole["row_size"])
        np.testing.assert_array_equal(flat["aircraft"].to_numpy()[order], names)
        np.testing.assert_array_equal(flat["time"].to_numpy()[order], whole["time"])
