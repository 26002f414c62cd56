"""Reports added to a run: headings of what did not change are taken up, and nothing tells."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from benchmarks import year
from benchmarks.fault_drill import product_differences

from airswing import workflow
from airswing.compass import kept_headings as pieces
from airswing.config_file import load_config
from airswing.products.checked import note, noted
from airswing.workflow import collocating
from airswing.workflow import headings_stage as stages
from airswing.workflow.progress import Progress

HOURS, REPORTS, AIRCRAFT = 24 * 66, 6_000, 5
NEW = "N104"
"""Reports in the last month alone."""
PRODUCTS = (workflow.HEADINGS, workflow.FITS, workflow.CORRECTED)
OPTIONS = {"fit": {"shared_error": False, "harmonics": 1, "min_reports": 50}}


@pytest.fixture(scope="module")
def archive(blank_cards, tmp_path_factory) -> Path:
    """January to early March in a file a month, and the products of all three from scratch."""
    folder = tmp_path_factory.mktemp("archive")
    year.write_fields(folder / "model", HOURS)
    for number, path in enumerate(sorted((folder / "model").iterdir())):
        if number % 3:
            path.unlink()  # every three hours is enough
    year.write_reports(folder / "twelfths", REPORTS, HOURS, AIRCRAFT)
    table = pd.concat([pd.read_parquet(path) for path in (folder / "twelfths").iterdir()])
    table = table[(table["tail"] != NEW) | (table["time"] >= "2009-03-01")]
    (folder / "months").mkdir()
    for month, part in table.groupby(table["time"].dt.month):
        part.to_parquet(folder / f"months/{month}.parquet", index=False)
    shutil.copytree(folder / "months", folder / "reports")
    run(folder)
    (folder / "results").rename(folder / "scratch")
    return folder


@pytest.fixture(autouse=True)
def emptied(archive) -> Iterator[None]:
    """Every test begins without reports and results."""
    for name in ("reports", "results", "aside"):
        shutil.rmtree(archive / name, ignore_errors=True)
        (archive / name).mkdir()
    yield
    for path in (archive / "aside").iterdir():
        path.rename(archive / "model" / path.name)


@pytest.fixture
def derived(monkeypatch) -> list[np.ndarray]:
    """Times of the reports whose headings are derived."""
    times: list[np.ndarray] = []
    derive = pieces.derive_columns

    def noted(reports, winds, **options):
        times.append(reports["time"].to_numpy())
        return derive(reports, winds, **options)

    monkeypatch.setattr(pieces, "derive_columns", noted)
    return times


def job_in(folder: Path, *, resume: bool = False, **changes) -> workflow.Job:
    content = {
        "reports": {"files": str(folder / "reports/*.parquet")},
        "references": {"small": {"files": str(folder / "model/*.grb")}},
        "output": str(folder / "results"),
    }
    path = folder / "config.json"
    path.write_text(json.dumps(content | OPTIONS | changes))
    return workflow.Job(load_config(path), Progress(quiet=True), resume)


def run(folder: Path, **changes) -> None:
    """The stages that write the main products."""
    job = job_in(folder, **changes)
    headings = workflow.make_headings(job)
    workflow.make_corrected(job, headings, workflow.make_fits(job, headings)).close()
    headings.close()


def add(folder: Path, *months: int) -> None:
    for month in months:
        shutil.copy2(folder / f"months/{month}.parquet", folder / "reports")


def run_of(folder: Path, *months: int) -> None:
    """Reports of the first months and the products of their run, made the first time alone."""
    add(folder, *months)
    made = folder / ("scratch" if len(months) == 3 else "begun")
    if made.is_dir():
        shutil.copytree(made, folder / "results", dirs_exist_ok=True)
    else:
        run(folder)
        shutil.copytree(folder / "results", made)


def different(folder: Path, scratch: str = "scratch") -> list[str]:
    return [
        f"{name}: {what}"
        for name in PRODUCTS
        for what in product_differences(folder / "results" / name, folder / scratch / name)
    ]


def reports_of(folder: Path, *months: int) -> int:
    return sum(len(pd.read_parquet(folder / f"months/{month}.parquet")) for month in months)


def months_of(times: list[np.ndarray]) -> set[int]:
    """Months some reports are of; a flight over midnight belongs where it began."""
    found = np.concatenate(times) - np.timedelta64(1, "h")
    return set((found.astype("M8[M]").astype(int) % 12 + 1).tolist())


@pytest.mark.parametrize("month", [1, 2, 3])
def test_a_month_added_costs_its_own_headings(archive, derived, month):
    """In front, in the middle and, with an aircraft that is new, at the end."""
    if month == 3:
        run_of(archive, 1, 2)
    else:
        add(archive, *({1, 2, 3} - {month}))
        run(archive)
    derived.clear()
    add(archive, month)
    run(archive, resume=True)
    new = sum(times.size for times in derived)
    # besides its own: flights that cross into the next month, at most one an aircraft and seam
    assert reports_of(archive, month) <= new <= reports_of(archive, month) + 2 * AIRCRAFT * year.LEG
    assert different(archive) == []


def test_the_plan_of_an_addition_tells_what_it_will_read(archive, monkeypatch):
    def planned(resume: bool) -> tuple[int, int, float]:
        found = workflow.plan_run(job_in(archive, resume=resume))
        one = found["references"]["small"]
        return one["messages"], one["messages"] - one["kept_messages"], found["seconds"]

    run_of(archive, 1, 2)
    assert planned(resume=True)[1] == 0
    add(archive, 3)
    whole, left, seconds = planned(resume=True)
    everything = planned(resume=False)
    assert everything[:2] == (whole, whole) and seconds < everything[2]
    read = []
    monkeypatch.setattr(collocating, "_account", lambda stage, winds: read.append(winds))
    run(archive, resume=True)
    assert sum(int(winds["decoded_messages"].sum()) for winds in read) == left
    assert 0 < left < whole / 2


def test_a_month_taken_away_costs_nothing(archive, derived):
    run_of(archive, 1, 2, 3)
    (archive / "reports/2.parquet").unlink()
    derived.clear()
    run(archive, resume=True)
    assert sum(times.size for times in derived) <= 2 * AIRCRAFT * year.LEG
    (archive / "results").rename(archive / "taken")
    run(archive)
    assert different(archive, "taken") == []
    shutil.rmtree(archive / "taken")


def test_a_setting_that_changes_no_wind_leaves_the_headings(archive, derived):
    add(archive, 1, 2, 3)
    run(archive, collocation={"max_time_gap": "4 h"})
    derived.clear()
    run(archive, resume=True)
    assert derived == []
    assert different(archive) == []


def test_a_model_month_that_changes_costs_that_month(archive, derived):
    add(archive, 1, 2, 3)
    missing = sorted((archive / "model").glob("2009021*"))
    for path in missing:
        path.rename(archive / "aside" / path.name)
    run(archive)
    for path in missing:
        (archive / "aside" / path.name).rename(path)
    derived.clear()
    run(archive, resume=True)
    assert months_of(derived) == {2}
    assert different(archive) == []


@pytest.mark.parametrize("change", ["code", "no resume", "nothing kept"])
def test_what_no_key_answers_for_is_derived_again(archive, derived, monkeypatch, change):
    if change == "nothing kept":
        add(archive, 1, 2)
        run(archive, compute={"keep_samples": False})
    else:
        run_of(archive, 1, 2)
    if change == "code":
        monkeypatch.setattr(pieces, "code_digest", lambda *names: "changed")
    derived.clear()
    add(archive, 3)
    run(archive, resume=change != "no resume")
    assert sum(times.size for times in derived) == reports_of(archive, 1, 2, 3)
    assert different(archive) == []


def test_a_changed_screening_hands_the_record_on(archive, derived):
    add(archive, 1, 2)
    run(archive, screening={"max_turn": "3 deg"})
    run(archive, resume=True)
    derived.clear()
    add(archive, 3)
    run(archive, resume=True)
    assert sum(times.size for times in derived) < 1.2 * reports_of(archive, 3)
    assert different(archive) == []


def cut_short(folder: Path) -> None:
    path = folder / "results/.collocated/headings.json"
    path.write_bytes(path.read_bytes()[:-20])


def of_another_product(folder: Path) -> None:
    path = folder / "results/.collocated/headings.json"
    path.write_text(note(noted(path.read_text()) | {"product": "another"}))


def overwritten(folder: Path) -> None:
    """The product's data are not what they were, its head is."""
    path = folder / "results" / workflow.HEADINGS
    content = bytearray(path.read_bytes())
    for start in range(len(content) // 4, len(content) - 64, 512):
        content[start : start + 64] = bytes(64)
    path.write_bytes(content)


def half(folder: Path) -> None:
    path = folder / "results" / workflow.HEADINGS
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize("damage", [cut_short, of_another_product, overwritten, half])
def test_what_is_not_whole_is_made_again(archive, derived, damage: Callable[[Path], None]):
    run_of(archive, 1, 2)
    damage(archive)
    derived.clear()
    add(archive, 3)
    run(archive, resume=True)
    assert sum(times.size for times in derived) == reports_of(archive, 1, 2, 3)
    assert different(archive) == []


def test_a_run_that_changes_nothing_derives_nothing(archive, derived, monkeypatch):
    """As after a change of code that reads reports: all is read again, no heading derived."""
    run_of(archive, 1, 2, 3)
    monkeypatch.setattr(stages, "code_digest", lambda *names: "changed")
    derived.clear()
    run(archive, resume=True)
    assert derived == []
    assert different(archive) == []
