"""Damaged files give a result or one message."""

import gzip
import os
from collections import Counter

import pytest
from benchmarks.fuzz.__main__ import COLUMNS, LONG, SHARES, as_text, campaign, drawn

from airswing.config_file import load_config
from airswing.errors import LONGEST, ConfigError, InputError
from airswing.gap.simulation.effects_file import read_effects
from airswing.reports import read_reports
from airswing.workflow.inspection import inspect_file


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("&a [*a]", "aliases such as .a are not supported"),
        ("2009-02-30", "'2009-02-30' is not a valid timestamp"),
        ("[" * 3000 + "]" * 3000, "nested too deeply"),
        *((text, "") for text in ('!!int "9e9"', '!!float "x"', "2009-01-01T00:00:00+24:00")),
        *((text, "") for text in ('"\\0"', "0x" + "f" * 9000, '"\\ud800"', "*b")),
        ("!!python/object/apply:os.system ['true']", ""),
    ],
)
def test_invalid_yaml_values_are_refused(value, says, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(f"reports: {{files: a.csv}}\nreferences: {value}\noutput: {value}\n")
    with pytest.raises(ConfigError, match=says) as caught:
        load_config(path)
    assert len(str(caught.value)) <= LONGEST
    assert "\n" not in str(caught.value)
    path.write_text(f"- name: {value}\n")
    with pytest.raises(InputError, match=says):
        read_effects(path)


def test_damaged_gzip_files_are_one_message(tmp_path):
    """Every byte after the header changed in turn: also those that zlib alone refuses."""
    path = tmp_path / "r.csv.gz"
    content = gzip.compress(b"tail,time,latitude\n" + b"N1,2009-01-01T00:00:00Z,40.5\n" * 40)
    for at in range(10, len(content)):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :])
        with pytest.raises(InputError):
            inspect_file(path)
        with pytest.raises(InputError):
            read_reports(path)


QUICK = {kind: share for kind, share in SHARES.items() if kind not in LONG}


@pytest.mark.parametrize("count", [140, pytest.param(500, marks=pytest.mark.slow)])
def test_damaged_files_give_a_result_or_one_message(monkeypatch, tmp_path, count):
    """The same cases on every machine, with a few of those that take long."""
    monkeypatch.setenv("AIRSWING_CACHE", os.environ.get("AIRSWING_CACHE", ""))  # set anew by cases
    few = [(kind, 11_000_000) for kind in sorted(LONG)]
    cases = drawn(count - len(few), 11, QUICK) + few
    table = campaign(cases, tmp_path)
    together = sum(table.values(), Counter[str]())
    assert together.total() == count
    assert set(table) == set(SHARES)
    assert together["result"] > count / 5
    assert together["refused"] > count / 5
    assert not [end for end in COLUMNS if together[end]], as_text(table)
