"""Runs, changes of the inputs, kills, monitoring and exports in any order end in equal products.

Whatever happens to an output folder, a run that reaches its end leaves the products that a run from
scratch on the same inputs would make. The inputs are one file of reports for each day and one model
file for each hour; the archive extends over the end of a month.
"""

from __future__ import annotations

import shutil
import time
from datetime import datetime
from pathlib import Path

import pandas as pd
import pytest
import yaml
from benchmarks import fault_drill
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
from typer.testing import CliRunner

import airswing
from airswing.cli import app
from airswing.errors import InputError
from airswing.synthetic import write_archive

DAYS = 4
HELD_BACK = 6  # model files that arrive late
pytestmark = pytest.mark.usefixtures("blank_cards")
PRODUCTS = ("headings/*.nc", "fits.nc", "corrected/*.nc")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Reports by day and model files of four days at the end of March."""
    folder = tmp_path_factory.mktemp("inputs")
    start = datetime(2009, 3, 30)
    write_archive(folder, days=DAYS, aircraft=2, seed=1, start=start, references=("ruc",))
    reports = pd.concat([pd.read_csv(path, dtype=str) for path in (folder / "reports").iterdir()])
    shutil.rmtree(folder / "reports")
    (folder / "reports").mkdir()
    for day, rows in reports.groupby(reports["time"].str[:10]):
        rows.to_csv(folder / "reports" / f"{day}.csv", index=False)
    return folder


def files_of(folder):
    """Names of all products that every report or aircraft has."""
    return {str(p.relative_to(folder)) for pattern in PRODUCTS for p in folder.glob(pattern)}


class AnyOrder(RuleBasedStateMachine):
    """Operations on one archive and its output folder."""

    inputs: Path
    work: Path

    @initialize()
    def begin(self):
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.inputs, self.work)
        self.output = self.work / "results"
        models = sorted((self.work / "ruc").iterdir())
        self.late = models[20 : 20 + HELD_BACK]
        for path in self.late:
            path.rename(path.with_suffix(".late"))
        config = yaml.safe_load((self.work / "config.yaml").read_text())
        config["reports"] = {"files": str(self.work / "reports" / "*.csv")}
        config["references"] = {"ruc": {"files": str(self.work / "ruc" / "*.grb")}}
        config["output"] = str(self.output)
        self.config = self.work / "config.yaml"
        self.config.write_text(yaml.safe_dump(config))

    def day(self, number):
        days = sorted((self.inputs / "reports").iterdir())
        return self.work / "reports" / days[number % len(days)].name

    @rule(number=st.integers(1, DAYS - 1))
    def remove_reports(self, number):
        self.day(number).unlink(missing_ok=True)

    @rule(number=st.integers(0, DAYS - 1))
    def add_reports(self, number):
        shutil.copy(self.inputs / "reports" / self.day(number).name, self.day(number))

    @rule(number=st.integers(0, DAYS - 1), row=st.integers(0, 200))
    def correct_reports(self, number, row):
        rows = pd.read_csv(self.inputs / "reports" / self.day(number).name, dtype=str)
        rows.loc[rows.index[row % len(rows)], "wind_speed_kt"] = "33"
        rows.to_csv(self.day(number), index=False)

    @rule(number=st.integers(1, DAYS - 1))
    def damage_reports(self, number):
        self.day(number).write_bytes(b"\x00\xff" * 50)

    @rule()
    def late_model_files(self):
        for path in self.late:
            if path.with_suffix(".late").exists():
                path.with_suffix(".late").rename(path)

    @rule()
    def run(self):
        airswing.run(self.config)

    @rule(share=st.floats(0.2, 1.0))
    def run_and_kill(self, share):
        process = fault_drill.start(self.config)
        time.sleep(6.0 * share)
        process.kill()
        process.communicate()

    @rule()
    def monitor(self):
        done = CliRunner().invoke(app, ["monitor", str(self.config), "--quiet"])
        assert done.exception is None or isinstance(done.exception, InputError | SystemExit)

    @rule()
    def export(self):
        if (self.output / "corrected").is_dir():
            target = self.work / "obs" / "OBS_DOMAIN101"
            target.parent.mkdir(exist_ok=True)
            airswing.export(self.output / "corrected", to="obs_domain", path=target, overwrite=True)

    def teardown(self):
        airswing.run(self.config)
        scratch = self.work / "scratch"
        config = yaml.safe_load(self.config.read_text()) | {"output": str(scratch)}
        (self.work / "scratch.yaml").write_text(yaml.safe_dump(config))
        airswing.run(self.work / "scratch.yaml")
        assert files_of(self.output) == files_of(scratch)
        for name in files_of(scratch):
            found = fault_drill.product_differences(self.output / name, scratch / name)
            assert not [one for one in found if not one.startswith("attribute")], name


def check(inputs, work, *, examples, steps):
    AnyOrder.inputs, AnyOrder.work = inputs, work
    chosen = settings(
        max_examples=examples,
        stateful_step_count=steps,
        deadline=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("airswing.report.run.page.write_page", lambda *_, **__: "")
        run_state_machine_as_test(AnyOrder, settings=chosen)


def test_a_few_operations_in_any_order(inputs, tmp_path):
    check(inputs, tmp_path / "work", examples=1, steps=5)


@pytest.mark.slow
def test_many_operations_in_any_order(inputs, tmp_path):
    check(inputs, tmp_path / "work", examples=12, steps=15)
