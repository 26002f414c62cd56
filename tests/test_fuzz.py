"""A short run of the campaign of damaged input: ``python -m benchmarks.fuzz`` is the long one."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest
from benchmarks.fuzz.__main__ import COLUMNS, LONG, SHARES, as_text, campaign, drawn

QUICK = {kind: share for kind, share in SHARES.items() if kind not in LONG}
"""Kinds of which a case takes milliseconds; the others have a few cases each."""


@pytest.fixture
def own_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "AIRSWING_CACHE", os.environ.get("AIRSWING_CACHE", ""))


@pytest.mark.parametrize("count", [150, pytest.param(500, marks=pytest.mark.slow)])
def test_damaged_files_give_a_result_or_one_message(own_cache, tmp_path: Path, count: int):
    """The same cases on every machine, with a few of those that take long."""
    few = [(kind, 11_000_000 + n) for kind in sorted(LONG) for n in range(2)][:-1]  # one command
    cases = drawn(count - len(few), 11, QUICK) + few
    table = campaign(cases, tmp_path)
    together = sum(table.values(), Counter[str]())
    assert together.total() == count
    assert set(table) == set(SHARES)
    assert together["result"] > count / 5
    assert together["refused"] > count / 5
    assert not [end for end in COLUMNS if together[end]], as_text(table)
