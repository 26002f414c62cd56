"""The readers of these tests give what the readers of WRF gave, record by record.

The golden files are what WRF 4.7's in4dob, OBSPROC and WRFDA's reader made of reports built for the
purpose, some of them faulty; without them next to the repository the tests are skipped.
"""

import json
from datetime import datetime

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.handover import obsproc, wrf_nudging, wrfda
from tests.handover.fortran import Lines

GOLDEN = ROOT.parent / "shared" / "handover"
NOON = datetime(2008, 7, 15, 12)


def golden(name):
    path = GOLDEN / name
    if not path.exists():
        pytest.skip(f"golden file absent: ../shared/handover/{name}")
    return path


def records(name, kind):
    lines = golden(name).read_text().splitlines()
    return [record for record in map(json.loads, lines) if record["record"] == kind]


def assert_same(record, golden_record, *, close=1e-6):
    for name, value in golden_record.items():
        if name in ("record", "n", "lev"):
            continue
        if isinstance(value, float | list) and not isinstance(value, bool):
            np.testing.assert_allclose(record[name], value, rtol=close, atol=1e-9, err_msg=name)
        else:
            assert record[name] == value, name


@pytest.mark.parametrize(
    ("reader", "name", "dump"),
    [
        (wrf_nudging, "OBS_DOMAIN101", "obsdomain.raw.jsonl"),
        (obsproc, "obs.test.little_r", "littler_dump.jsonl"),
    ],
)
def test_values_are_read_as_wrf_and_obsproc_read_them(reader, name, dump):
    read = reader.raw(golden(name).read_text())
    golden_reports, levels = (records(dump, kind) for kind in ("report", "level"))
    assert len(read) == len(golden_reports) == records(dump, "end")[0]["reports"]
    for report, golden_report in zip(read, golden_reports, strict=True):
        assert_same(report, golden_report)
        golden_levels = [level for level in levels if level["n"] == golden_report["n"]]
        assert len(golden_levels) == len(report["levels"])
        for values, level in zip(report["levels"], golden_levels, strict=True):
            pairs = values.values() if isinstance(values, dict) else values
            assert_same(dict(zip(reader.NAMES, pairs, strict=True)), level)


def test_little_r_is_processed_as_by_obsproc():
    text = golden("obs.test.little_r").read_text()
    processed = obsproc.processed(text, datetime(2008, 7, 15, 11), NOON, datetime(2008, 7, 15, 13))
    golden_records, complete = wrfda.read(golden("obsproc_ob.ascii").read_text())
    assert complete and len(processed) == len(golden_records)
    for report, golden_report in zip(processed, golden_records, strict=True):
        assert report["platform"][:12] == golden_report["platform"]
        assert report["time"] == datetime.strptime(golden_report["date"], "%Y-%m-%d_%H:%M:%S")
        assert (report["name"], report["id"]) == (golden_report["name"], golden_report["id"])
        if golden_report["type"] == "tamdar_sfc":
            continue
        for level, golden_level in zip(report["levels"], golden_report["levels"], strict=True):
            for name in ("speed", "dir"):
                assert level[name] == pytest.approx(golden_level[name][:2], rel=1e-6)
            assert level["t"][0] == pytest.approx(golden_level["t"][0], abs=2e-3)
            assert level["p"][0] == pytest.approx(golden_level["p"][0], abs=2.0)  # of constants


@pytest.mark.parametrize("name", ["ob", "obsproc_ob"])
def test_ob_ascii_is_read_as_wrfda_reads_it(name):
    text = golden(f"{name}.ascii").read_text()
    reports, complete = wrfda.read(text)
    golden_records, levels = (records(f"{name}.read.jsonl", kind) for kind in ("report", "level"))
    head = records(f"{name}.read.jsonl", "header")[0]
    end = records(f"{name}.read.jsonl", "end")[0]
    formats = wrfda.formats(Lines(text))
    for section in ("info", "srfc", "each"):
        assert formats[section] == head[f"fmt_{section}"]
    assert complete is end["clean_end_of_file"]
    assert len(reports) == end["reports"] == len(golden_records)
    for report, golden_report in zip(reports, golden_records, strict=True):
        same = {name: name for name in ("platform", "fm", "date", "name", "id")}
        for mine, theirs in (same | {"count": "levels", "type": "wrfda_type"}).items():
            assert report[mine] == golden_report[theirs]
        for name_ in ("lat", "lon", "elv"):
            assert report[name_] == pytest.approx(golden_report[name_])
        golden_levels = [level for level in levels if level["n"] == golden_report["n"]]
        for mine, level in zip(report["levels"], golden_levels, strict=True):
            for column in wrfda.COLUMNS:
                assert mine[column] == pytest.approx(level[column], rel=1e-6), column
            assert mine["vertical"] == level["vertical"]
            assert mine["wind_used"] is level["wind_used"]
            assert (mine["qc"], mine["error"]) == pytest.approx(tuple(level["iv_u"][1:]))
            speed = np.hypot(level["iv_u"][0], level["iv_v"][0])
            assert np.hypot(*mine["earth"]) == pytest.approx(speed, abs=2e-3)
