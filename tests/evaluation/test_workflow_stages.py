"""The evaluation's stages on products, and every configuration that is shipped."""

import csv
import json
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from airswing.compass.correction import add_tables
from airswing.compass.fit.deviation import fit_deviation
from airswing.config import Config
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.evaluation.monitoring.changes import add_changes, watch_compasses
from airswing.evaluation.monitoring.events import read_events, tables_differ, tables_of
from airswing.products.netcdf import write_product
from airswing.products.ragged import some_reports
from airswing.workflow import make_monitoring, record_printed, stages
from airswing.workflow.job import Job
from airswing.workflow.progress import Progress
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet, with_change

ROOT = Path(__file__).resolve().parents[2]
MADE = {"config_json": "{}", "source_uuids": []}


@pytest.fixture(scope="module")
def headings():
    return fleet(8, Setting(aircraft=3, days=40), amplitude=5.0)[0]


@pytest.fixture(scope="module")
def fits(headings):
    tables = add_tables(fit_deviation(headings), headings)
    return add_changes(tables, watch_compasses(headings, members=["ruc"]).changes)


def job_in(output, **sections):
    content = {"reports": {"files": "none"}, "references": {"ruc": {"files": "none"}}}
    config = Config.model_validate(content | {"output": str(output)} | sections)
    return Job(config, Progress(quiet=True))


NAMES = ("ruc_rr", "rtfdaa", "pooled", "field_test_2009")
PAPER = {ROOT / f"configs/{name}.yaml" for name in NAMES}
SHIPPED = sorted(PAPER.union((ROOT / "configs").glob("*.yaml")))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_configuration_is_valid(path):
    config = load_config(path)
    assert str(config.output).startswith("results/")
    assert path.read_text().startswith("#")
    if path in PAPER:
        assert all(reference.lead == ">= 1 h" for reference in config.references.values())
        assert all("nam" not in members for members in config.pool.values())
    if path.stem == "field_test_2009":
        assert config.field_test.start == date(2009, 10, 20)
        assert config.field_test.roll == "require_good"


def test_fits_of_windows_before_the_first_new_month_are_kept(tmp_path, headings, fits):
    job = job_in(tmp_path)

    def night(new, unchanged):
        months = json.dumps({"made": new, "kept": unchanged})
        return stages.make_stability(job, headings.assign_attrs(months=months), fits)

    first = night(["2008-07", "2008-08"], [])
    assert [entry["aircraft"] for entry in first["changes"]] == ["N000", "N001", "N002"]
    assert {entry["window"] for entry in first["windows"]} == {"2008-07-01", "2008-08-01"}
    marked = json.loads((job.output / "stability.json").read_text())
    marked["windows"] = [entry | {"reports": -1} for entry in marked["windows"]]
    marked["windows"] = [entry for entry in marked["windows"] if entry["aircraft"] != "N002"]
    (job.output / "stability.json").write_text(json.dumps(marked))
    second = night(["2008-08"], ["2008-07"])
    for before, after in zip(first["windows"], second["windows"], strict=True):
        july = before["window"] == "2008-07-01"
        if july and before["aircraft"] == "N002":  # a new aircraft had no report then
            before = {**dict.fromkeys(("aircraft", "window")), "reports": 0}
            before |= {name: after[name] for name in ("aircraft", "window", "status")}
        assert after == before | ({"reports": -1} if july and after["reports"] else {})
    assert night(["2008-07"], ["2008-08"])["windows"] == first["windows"]


def test_the_ranking_is_a_table_a_spreadsheet_reads(tmp_path, headings):
    job = job_in(tmp_path)
    ranking = stages.make_ranking(job, headings, fit_deviation(headings))
    rows = list(csv.DictReader((job.output / "ranking.csv").open()))
    assert [row["aircraft"] for row in rows] == [entry["aircraft"] for entry in ranking]
    expected = pytest.approx(ranking[0]["expected_gain_kt"], abs=6e-4)
    assert float(rows[0]["expected_gain_kt"]) == expected
    assert float(rows[0]["expected_gain_low_kt"]) < float(rows[0]["expected_gain_high_kt"])


def test_the_virtual_field_test_is_written_or_gives_its_reason(tmp_path, headings, fits):
    job = job_in(tmp_path)
    ranking = stages.make_ranking(job, headings, fits)
    content = stages.make_virtual(job, headings, fits, ranking)
    assert content["later"]["learned_until"] == "2008-07-27"  # two thirds of the days
    assert content["held_out"]["folds"] == 10
    assert abs(content["later"]["difference_kt"]) < 1.5
    assert json.loads((job.output / "virtual_field_test.json").read_text())["held_out"]["agree"]
    none = headings.assign(screening=("report", np.ones(headings.sizes["report"], np.int32)))
    assert "no screened report" in stages.make_virtual(job, none, fits, ranking)["later"]["why"]


def test_monitoring_reads_the_products_and_reports_events_once(tmp_path, headings, fits):
    table = "aircraft,reference,heading_deg,table_correction_deg,standard_error_deg,sign\n"
    table += "".join(f"N001,ruc,{45 * k},12.5,0.2,subtract_error\n" for k in range(8))
    job = job_in(tmp_path / "out", monitoring={"tables_in_use": str(tmp_path / "board.csv")})
    write_product(fits, job.output / "fits.nc", title="fits", **MADE)
    for missing in ("board.csv", "headings.*: no such product"):
        with pytest.raises(InputError, match=missing):
            make_monitoring(job)
        (tmp_path / "board.csv").write_text(table)
    write_product(headings, job.output / "headings/2008-07.nc", title="headings", **MADE)
    assert not (job.output / "events.json").exists()
    monitoring = make_monitoring(job)
    assert monitoring == read_events(job.output / "events.json")
    assert monitoring.differing == ["N001"] and "another table for: N001" in monitoring.text
    assert (job.output / "report" / "monitoring.html").exists()
    assert make_monitoring(job).new_events == []


def test_after_a_change_the_table_is_that_of_the_reports_since(tmp_path):
    change = np.zeros((6, 5))
    change[2, 0] = 3.0
    setting = Setting(aircraft=6, days=45, reports_a_flight=10)
    headings = with_change(3, setting, day=30, change=change)
    mixed = add_tables(fit_deviation(headings), headings)
    job = job_in(tmp_path)
    write_product(mixed, job.output / "fits.nc", title="fits", **MADE)
    write_product(headings, job.output / "headings/2008-07.nc", title="headings", **MADE)
    monitoring = make_monitoring(job)
    (event,) = monitoring.new_events
    assert (event.kind, event.aircraft) == ("compass_changed", "N002")
    before = tables_of(mixed.isel(reference=0))
    assert "N002" not in before  # refused: the halves of the period disagree
    late = headings["time"].to_numpy() >= np.datetime64(event.evidence["date_ci"][1])
    since = some_reports(headings, late)
    now = tables_of(add_tables(fit_deviation(since), since).isel(reference=0))
    assert tables_differ(monitoring.states[2].table_now, now["N002"])[1] < 0.3
    assert monitoring.states[3].table_now == before["N003"]
    # stopped before the line was printed: it is reported again, until it was
    assert make_monitoring(job).new_events == [event]
    record_printed(job, len(monitoring.events))
    assert make_monitoring(job).new_events == []
