"""Damaged files give a result or one message: some that once ended a run, and drawn ones."""

import gzip
import json
import os
import time
from collections import Counter

import numpy as np
import pytest
from benchmarks.fuzz.__main__ import COLUMNS, LONG, SHARES, as_text, campaign, drawn

from airswing.config_file import load_config
from airswing.errors import LONGEST, ConfigError, InputError
from airswing.gap.simulation.effects_file import read_effects
from airswing.reference.catalogue import build_catalogue
from airswing.reference.collocate import collocate
from airswing.reference.grib.headers import scan_file
from airswing.reports import read_reports
from airswing.workflow.inspection import inspect_file


@pytest.fixture(scope="session")
def hostile(real):
    """Path of a file below ``../shared/hostile``; skips by name where absent."""
    return lambda name: real(f"../hostile/{name}")


def catalogue_of(path, folder):
    return build_catalogue(str(path), name="ref", cache_dir=folder)


@pytest.fixture
def winds(hostile, tmp_path):
    """Catalogue of a file, reference winds at the reports of another, and what was not read."""

    def find(model, reports, **options):
        catalogue = catalogue_of(hostile(model), tmp_path)
        ds = read_reports(hostile(reports))
        lazy = collocate(ds, {"ref": catalogue}, account=True, **options)
        collocated = lazy.compute(scheduler="synchronous")
        return catalogue, collocated, [reason for _, _, reason in collocated["problems"].item()]

    return find


def test_complex_packing_whose_groups_do_not_add_up(winds):
    _, collocated, problems = winds("crash_grib_a_49", "g2_complex_spatial_differencing.csv")
    assert len(problems) == 1 and problems[0].startswith("message at 2530: not decodable")
    matched = np.isfinite(collocated["reference_eastward_wind"].to_numpy())
    assert 0 < matched.sum() < matched.size


GARBAGE = "garbage: section lengths do not add up"


@pytest.mark.parametrize(
    ("model", "reports", "reasons"),
    [
        ("crash_grib_a_543", "g2_png.csv", {GARBAGE: 1, "u without v": 1}),
        (
            "grib_a_617",
            "g2_ccsds.csv",
            {"damaged: 2,147,484,368 values on a grid of 720 points": 1},
        ),
    ],
)
def test_messages_of_wrong_lengths_are_skipped(winds, model, reports, reasons):
    catalogue, _, problems = winds(model, reports)
    skipped = {entry["reason"]: entry["count"] for entry in catalogue.skipped}
    assert skipped.items() >= reasons.items() and not problems


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("lead_bit.grb2", "damaged: lead time of 44,739,243 days"),
        ("sec7_len.grb2", GARBAGE),
    ],
)
def test_a_message_is_skipped_or_used_never_both(hostile, name, reason):
    contents = scan_file(str(hostile(name)))
    assert len(contents.fields) == 5
    assert contents.skipped["message", reason] == 1
    assert reason in [entry["reason"] for entry in inspect_file(hostile(name))["skipped"]]


def test_a_png_stream_of_another_depth(hostile, tmp_path):
    with pytest.raises(InputError, match=r"damaged: 128 bits a value \(6\)"):
        catalogue_of(hostile("crash_grib_a_497"), tmp_path)


@pytest.mark.parametrize("sparse", [True, False])
def test_second_order_packing_with_a_section_that_lies(winds, sparse):
    _, collocated, _ = winds("crash_grib_a_865", "g1_ll_second.csv", sparse=sparse)
    speed = np.hypot(collocated["reference_eastward_wind"], collocated["reference_northward_wind"])
    assert not (speed > 150.0).any()


def test_a_count_of_records_that_the_file_cannot_hold(hostile):
    began = time.perf_counter()
    with pytest.raises(InputError, match="bytes by its header, of which 2,536 are there"):
        read_reports(hostile("numrecs.nc"))
    assert time.perf_counter() - began < 2.0


@pytest.mark.parametrize(
    ("name", "repaired"),
    [
        ("dup.csv", {"wind_speed_column_repeated": 29}),
        ("hdg.csv", {"reported_heading_wrapped": 14}),
    ],
)
def test_repairs_of_reports_are_counted(hostile, name, repaired):
    audit = json.loads(read_reports(hostile(name)).attrs["reading_audit"])
    assert audit["repaired"].items() >= repaired.items()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("bomb.yaml", "line 2: aliases such as .a0 are not supported"),
        ("date.yaml", "line 3: '2009-06-31' is not a valid timestamp"),
        ("deep.yaml", "nested too deeply"),
    ],
)
def test_yaml_that_is_none(hostile, name, says):
    with pytest.raises(ConfigError, match=says) as caught:
        load_config(hostile(name))
    assert len(str(caught.value)) <= LONGEST
    with pytest.raises(InputError, match=says):
        read_effects(hostile(name))


@pytest.mark.parametrize(
    "value",
    [
        *('!!int "9e9"', '!!float "x"', "2009-01-01T00:00:00+24:00", "2009-02-30", '"\\0"'),
        *("0x" + "f" * 9000, '"\\ud800"', "!!python/object/apply:os.system ['true']"),
        *("&a [*a]", "*b"),
    ],
)
def test_values_of_yaml_that_are_none(value, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(f"reports: {{files: a.csv}}\nreferences: {value}\noutput: {value}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert len(str(caught.value)) <= LONGEST
    assert "\n" not in str(caught.value)
    path.write_text(f"- name: {value}\n")
    with pytest.raises(InputError):
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
"""Kinds of which a case takes milliseconds; the others have a few cases each."""


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
