"""A short blind check by the public command, with lower limits of its scores."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from airswing.blind_check import Plan, gap_check
from airswing.blind_check.check import run_command
from airswing.cli import app
from airswing.synthetic.sealed.cases import Size


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
