"""A short run of the campaign of damaged input: ``python -m benchmarks.fuzz`` is the long one."""

from __future__ import annotations

import os
import random
from collections import Counter
from pathlib import Path

import pytest
from benchmarks.fuzz.__main__ import COLUMNS, LONG, SHARES, as_text, campaign, drawn
from benchmarks.fuzz.mutations import mutated, sections
from benchmarks.fuzz.seeds import GRIBS, LATLON, fields, grib_message

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


def test_a_case_is_made_again_from_its_number():
    data = b"".join(
        grib_message(2, LATLON, "grid_simple", values, level=500, v=n % 2)
        for n, values in enumerate(fields()[:2])
    )
    for kind in ("grib2 simple", "csv", "yaml", "parquet"):
        made = [mutated(kind, data, b"other" * 20, random.Random(5)) for _ in range(2)]
        assert made[0] == made[1]
    changed = [mutated("grib2", data, data, random.Random(n)) != data for n in range(100)]
    assert sum(changed) > 90


def test_sections_of_both_editions_are_followed():
    for kind, count in (("grib1 simple", 4), ("grib2 simple", 7)):
        edition, _, packing, _ = GRIBS[kind]
        message = grib_message(edition, LATLON, packing, fields()[0], level=500, v=0)
        (found,) = sections(message)
        assert len(found) == count
        start, length = found[-1]
        assert start + length == len(message) - 4


def test_every_kind_is_drawn():
    drawn_kinds = {kind for kind, _ in drawn(5000, 1)}
    assert drawn_kinds == set(SHARES)
