"""The short blind check through the public command itself, with floors on its scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from typer.testing import CliRunner

from airswing.blind_check import Plan, Size, gap_check
from airswing.blind_check.check_run import run_public_command
from airswing.cli import app
from airswing.gap.result.schema import GapReport


def diagnosed(config: Path, output: Path, without: Sequence[str]) -> GapReport:
    """Run the public command: in a process of its own for the first archive, else in this one."""
    if config.parent.name == "case_001":
        return run_public_command(config, output, without)
    words = ["gap", str(config), "--output", str(output), "--quiet"]
    done = CliRunner().invoke(app, [*words, *(f"--without={name}" for name in without)])
    assert done.exit_code == 0, done.output
    return GapReport.read(output / "gap.json")


def test_a_short_check_by_the_public_command(tmp_path, monkeypatch, no_gap_page):
    short = Size(days=12, aircraft=5, sizes=(1.6,), coarse=True)
    monkeypatch.setattr(Size, "fast", classmethod(lambda cls: short))
    plan = Plan(4, 2, True, rungs=(1,), names=("compass_offset", "hard_iron", "tas_scale"))
    check = gap_check(tmp_path, plan, baselines=False, diagnoser=diagnosed)
    assert check.failures == {}
    nulls = [s for s in check.scores if s["kind"] == "null"]
    effects = [s for s in check.scores if s["kind"] == "single"]
    assert len(nulls) == 1 and len(effects) == 3
    assert not any(s["claimed"] or s["unknown"] for s in nulls)
    assert all(s["closure_true"] >= 0.1 for s in effects)
    assert all(s["detected"] for s in effects)
    assert sum(s["in_set"] for s in effects) >= 2
    assert sum(s["first_right"] for s in effects) >= 2
    named = [s for s in effects if s["all_named"]]
    assert sum(s["jaccard"] for s in named) >= 0.6 * len(named)
    assert max(s["closure_error"] for s in check.scores) < 0.15
