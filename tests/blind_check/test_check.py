"""The check on tiny archives with a diagnosis that reads the labels, and by the command."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.blind_check.made_up import informed
from typer.testing import CliRunner

from airswing.blind_check import Plan, gap_check, write_report
from airswing.blind_check.check import run_command
from airswing.blind_check.score import draws
from airswing.blind_check.summary import summary_table
from airswing.cli import app
from airswing.synthetic.sealed.cases import Size

NAMES = ("compass_offset", "hard_iron", "tas_scale", "outliers")
PLAN = Plan(10, 4, True, rungs=(1, 3), names=NAMES)


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """A tiny check, and what its diagnosis received."""
    root = tmp_path_factory.mktemp("check")
    tiny = Size(days=3, aircraft=3, sizes=(0.8, 1.6), coarse=True)
    seen: list[dict] = []

    def oracle(config, output, without):
        digest = (root / "sealed.sha256").read_text().split()[0]
        seen.append({"config": config, "digest": digest})
        return informed(root)(config, output, without)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Size, "fast", classmethod(lambda cls: tiny))
        check = gap_check(root, PLAN, diagnoser=oracle, workers=2)
        yield root, check, seen


def test_a_diagnosis_that_knows_the_labels_is_right(checked):
    _, check, _ = checked
    effects = [score for score in check.scores if score["kind"] != "null"]
    assert effects and all(s["first_right"] and s["all_named"] for s in effects)
    assert all(s["closure_error"] < 1e-9 and s["closure_covered"] for s in check.scores)
    assert not any(score["false_names"] for score in check.scores)


def test_the_digest_is_published_before_every_diagnosis(checked):
    root, check, seen = checked
    assert len(seen) == 10 and {one["digest"] for one in seen} == {check.digest}
    labels = (root / "sealed" / "labels.json").read_bytes()
    assert hashlib.sha256(labels).hexdigest() == check.digest


def test_the_diagnosis_receives_nothing_that_names_the_effect(checked):
    root, _, seen = checked
    for one in seen:
        folder = one["config"].parent
        paths = " ".join(str(path.relative_to(root)) for path in folder.rglob("*"))
        text = one["config"].read_text() + paths
        assert not any(name in text for name in (*draws(), "outside", "null", "sealed"))
        assert not (folder / "truth").exists()


def test_cases_of_a_world_share_their_winds(checked):
    root, check, seen = checked
    references = {json.dumps(yaml.safe_load(s["config"].read_text())["references"]) for s in seen}
    nulls = sum(score["kind"] == "null" for score in check.scores)
    assert len(references) == nulls == len(list((root / "winds").iterdir())) < len(seen) // 2


def test_a_finished_check_is_kept_and_failures_are_stated(checked):
    root, check, _ = checked

    def never(config, output, without):
        raise AssertionError("diagnosed again")

    again = gap_check(root, PLAN, diagnoser=never)
    assert again.scores == check.scores and again.digest == check.digest
    missing = root / "diagnosed" / "case_001" / "gap.json"
    content = missing.read_text()
    missing.unlink()

    def broken(config, output, without):
        raise RuntimeError("exit status 1: no")

    failed = gap_check(root, PLAN, diagnoser=broken)
    assert [s["failure"] for s in failed.scores if s["failure"]] == ["exit status 1: no"]
    missing.unlink(missing_ok=True)
    assert len(gap_check(root, PLAN, diagnoser=never, so_far=True).scores) == 9
    missing.write_text(content)


def test_the_report_lists_every_figure_and_case(checked, tmp_path):
    _, check, _ = checked
    text = write_report(tmp_path, check, command=PLAN.command).read_text()
    assert check.digest in text and "airswing gap-check --cases 10 --seed 4 --fast" in text
    assert all(score["name"] in text for score in check.scores)
    assert summary_table(check) in text and (tmp_path / "gap_check.png").stat().st_size > 10_000


def diagnosed(config: Path, output: Path, without: Sequence[str]) -> Mapping[str, Any]:
    """Run the public command: in a new process for the first archive, else in this one."""
    if config.parent.name == "case_001":
        return run_command(config, output, without)
    words = ["gap", str(config), "--output", str(output), "--quiet"]
    done = CliRunner().invoke(app, [*words, *(f"--without={name}" for name in without)])
    assert done.exit_code == 0, done.output
    content: Mapping[str, Any] = json.loads((output / "gap.json").read_text())
    return content


@pytest.mark.slow
def test_a_short_check_by_the_public_command(tmp_path, monkeypatch, no_gap_page):
    short = Size(days=12, aircraft=5, sizes=(1.6,), coarse=True)
    monkeypatch.setattr(Size, "fast", classmethod(lambda cls: short))
    plan = Plan(4, 2, True, rungs=(1,), names=("compass_offset", "hard_iron", "tas_scale"))
    check = gap_check(tmp_path, plan, diagnoser=diagnosed)
    assert not any(score["failure"] for score in check.scores)
    nulls = [score for score in check.scores if score["kind"] == "null"]
    effects = [score for score in check.scores if score["kind"] == "single"]
    assert len(nulls) == 1 and len(effects) == 3
    assert not any(score["claimed"] or score["unknown"] for score in nulls)
    assert all(score["closure_true"] >= 0.1 and score["detected"] for score in effects)
    assert sum(score["in_set"] for score in effects) >= 2
    assert sum(score["first_right"] for score in effects) >= 2
    assert max(score["closure_error"] for score in check.scores) < 0.15
