"""A short run of the campaign of damaged input: ``python -m benchmarks.fuzz`` is the long one."""

from __future__ import annotations

import os
import random
from collections import Counter
from pathlib import Path

import pytest
from benchmarks.fuzz.__main__ import COLUMNS, SHARES, as_text, campaign, drawn
from benchmarks.fuzz.mutations import mutated, sections
from benchmarks.fuzz.seeds import GRIBS, LATLON, fields, grib_message

CASES, SECONDS = 500, 45.0


@pytest.fixture
def own_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "AIRSWING_CACHE", os.environ.get("AIRSWING_CACHE", ""))


def test_five_hundred_cases_or_a_minute(own_cache, tmp_path: Path):
    table = campaign(drawn(CASES, 11), tmp_path, SECONDS)
    together = sum(table.values(), Counter[str]())
    assert together.total() >= 10
    assert together["result"] > 0
    assert together["refused"] > 0
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
