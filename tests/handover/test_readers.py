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


def assert_same(found, golden_records, *, close=1e-6):
    for name, value in golden_records.items():
        if name in ("record", "n", "lev"):
            continue
        if isinstance(value, float | list) and not isinstance(value, bool):
            np.testing.assert_allclose(found[name], value, rtol=close, atol=1e-9, err_msg=name)
        else:
            assert found[name] == value, name


@pytest.mark.parametrize(
    ("reader", "name", "made"),
    [
        (wrf_nudging, "OBS_DOMAIN101", "obsdomain.raw.jsonl"),
        (obsproc, "obs.test.little_r", "littler_dump.jsonl"),
    ],
)
def test_values_are_read_as_wrf_and_obsproc_read_them(reader, name, made):
    found = reader.raw(golden(name).read_text())
    reports, levels = (records(made, kind) for kind in ("report", "level"))
    assert len(found) == len(reports) == records(made, "end")[0]["reports"]
    for one, other in zip(found, reports, strict=True):
        assert_same(one, other)
        chosen = [level for level in levels if level["n"] == other["n"]]
        assert len(chosen) == len(one["levels"])
        for values, level in zip(one["levels"], chosen, strict=True):
            pairs = values.values() if isinstance(values, dict) else values
            assert_same(dict(zip(reader.NAMES, pairs, strict=True)), level)


def test_little_r_is_processed_as_by_obsproc():
    text = golden("obs.test.little_r").read_text()
    found = obsproc.processed(text, datetime(2008, 7, 15, 11), NOON, datetime(2008, 7, 15, 13))
    golden_records, whole = wrfda.read(golden("obsproc_ob.ascii").read_text())
    assert whole and len(found) == len(golden_records)
    for one, other in zip(found, golden_records, strict=True):
        assert one["platform"][:12] == other["platform"]
        assert one["time"] == datetime.strptime(other["date"], "%Y-%m-%d_%H:%M:%S")
        assert (one["name"], one["id"]) == (other["name"], other["id"])
        if other["type"] == "tamdar_sfc":
            continue
        for level, again in zip(one["levels"], other["levels"], strict=True):
            for name in ("speed", "dir"):
                assert level[name] == pytest.approx(again[name][:2], rel=1e-6), one["name"]
            assert level["t"][0] == pytest.approx(again["t"][0], abs=2e-3)
            assert level["p"][0] == pytest.approx(again["p"][0], abs=2.0)  # of constants


@pytest.mark.parametrize("name", ["ob", "obsproc_ob"])
def test_ob_ascii_is_read_as_wrfda_reads_it(name):
    text = golden(f"{name}.ascii").read_text()
    found, whole = wrfda.read(text)
    golden_records, levels = (records(f"{name}.read.jsonl", kind) for kind in ("report", "level"))
    head = records(f"{name}.read.jsonl", "header")[0]
    end = records(f"{name}.read.jsonl", "end")[0]
    formats = wrfda.formats(Lines(text))
    assert [formats[part] for part in ("info", "srfc", "each")] == [
        head[f"fmt_{part}"] for part in ("info", "srfc", "each")
    ]
    assert whole is end["clean_end_of_file"] and len(found) == end["reports"] == len(golden_records)
    for one, other in zip(found, golden_records, strict=True):
        same = {name: name for name in ("platform", "fm", "date", "name", "id")}
        for mine, theirs in (same | {"count": "levels", "type": "wrfda_type"}).items():
            assert one[mine] == other[theirs]
        for name_ in ("lat", "lon", "elv"):
            assert one[name_] == pytest.approx(other[name_])
        chosen = [level for level in levels if level["n"] == other["n"]]
        for mine, level in zip(one["levels"], chosen, strict=True):
            for part in wrfda.COLUMNS:
                assert mine[part] == pytest.approx(level[part], rel=1e-6), part
            assert mine["vertical"] == level["vertical"]
            assert mine["wind_used"] is level["wind_used"]
            assert (mine["qc"], mine["error"]) == pytest.approx(tuple(level["iv_u"][1:]))
            speed = np.hypot(level["iv_u"][0], level["iv_v"][0])
            assert np.hypot(*mine["earth"]) == pytest.approx(speed, abs=2e-3)
