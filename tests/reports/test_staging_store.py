"""Reports set down by aircraft: the same rows and counts however they are set down, read once."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from airswing.errors import InputError
from airswing.reports import read_reports
from airswing.reports import report_blocks as archive
from airswing.reports import staging_store as spool
from airswing.reports.report_blocks import Archive
from airswing.reports.staging_store import Spool
from tests.reports.tables import flight, row, write


def fleet() -> pd.DataFrame:
    """Three aircraft over a month's end: duplicates, a conflict, no phases, few reports of one."""
    tables = [
        flight(tail=tail, start=f"2009-01-{day}T{hour}:50:00", flight=name, altitude_ft=29000.0)
        for tail, name in (("B2", "MES1"), ("A1", ""), ("C3", "XJ7"))
        for day, hour in (("30", "12"), ("31", "23"))
        if (tail, day) != ("C3", "31")
    ]
    table = pd.concat(tables)
    again = table.iloc[[3, 17]]
    apart = table.iloc[[5]].assign(latitude=44.0)
    few = pd.DataFrame([row(tail="D4", time="2009-01-31T23:59:30"), row(tail="", time="x")])
    few["time"] = few["time"].astype(str)
    table["time"] = table["time"].astype(str)
    return pd.concat([table, again.astype({"time": str}), apart.astype({"time": str}), few])


def files_of(folder: Path, cuts: tuple[int, ...]) -> Path:
    """The fleet in several files, cut by rows."""
    folder.mkdir(parents=True, exist_ok=True)
    table, start = fleet(), 0
    for number, stop in enumerate([*sorted(cuts), len(table)]):
        if stop > start:
            write(folder / f"{number}.csv", table.iloc[start:stop])
            start = stop
    return folder


def set_down(files: Path, folder: Path, *, limit: int = 1000) -> Archive:
    one = Spool(folder / "reports", key="k")
    one.fill(str(files / "*.csv"))
    return Archive(one, folder / "blocks", limit=limit)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    cuts=st.lists(st.integers(1, 52), max_size=4, unique=True),
    limit=st.integers(1, 60),
    segment=st.integers(1, 60),
)
def test_blocks_are_what_reading_at_once_gives(tmp_path_factory, cuts, limit, segment):
    folder = tmp_path_factory.mktemp("spool")
    files = files_of(folder / "in", tuple(cuts))
    whole = read_reports(str(files / "*.csv"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spool, "SEGMENT_REPORTS", segment)
        found = set_down(files, folder / "out", limit=limit)
    assert json.loads(found.audit.as_json()) == json.loads(whole.attrs["reading_audit"])
    assert (found.reports, found.aircraft) == (whole.sizes["report"], whole.sizes["aircraft"])
    first = 0
    for block in found:
        aircraft = slice(first, first + block.sizes["aircraft"])
        start = int(whole["row_size"][:first].sum())
        reports = slice(start, start + block.sizes["report"])
        wanted = whole.isel(aircraft=aircraft, report=reports)
        xr.testing.assert_identical(block.drop_attrs(deep=False), wanted.drop_attrs(deep=False))
        assert block.sizes["report"] <= limit or block.sizes["aircraft"] == 1
        first = aircraft.stop
    assert first == whole.sizes["aircraft"]


def test_files_set_down_are_not_read_again(tmp_path, monkeypatch):
    files = files_of(tmp_path / "in", (20, 40))
    first = set_down(files, tmp_path / "out")
    read: list[str] = []
    reader = spool.file_frames

    def noted(path: Path, *words):
        read.append(path.name)
        return reader(path, *words)

    monkeypatch.setattr(spool, "file_frames", noted)
    again = set_down(files, tmp_path / "out")
    assert read == [] and again.audit.as_json() == first.audit.as_json()
    write(files / "9.csv", flight(tail="NEW"))
    more = set_down(files, tmp_path / "out")
    assert read == ["9.csv"] and more.aircraft == first.aircraft + 1
    scratch = set_down(files, tmp_path / "scratch")
    assert more.audit.as_json() == scratch.audit.as_json()
    for one, other in zip(more, scratch, strict=True):
        xr.testing.assert_identical(one, other)


@pytest.mark.parametrize("change", ["file", "gone", "key", "torn"])
def test_what_does_not_hold_any_more_is_read_anew(tmp_path, change):
    files = files_of(tmp_path / "in", (20,))
    set_down(files, tmp_path / "out")
    key = "k"
    if change == "file":
        write(files / "0.csv", flight(tail="OTHER"))
    elif change == "gone":
        (files / "0.csv").unlink()
    elif change == "key":
        key = "other"
    else:
        rows = next((tmp_path / "out/reports").glob("*.rows"))
        rows.write_bytes(rows.read_bytes()[:-1])
    one = Spool(tmp_path / "out/reports", key=key)
    one.fill(str(files / "*.csv"))
    whole = read_reports(str(files / "*.csv"))
    found = Archive(one, tmp_path / "out/blocks")
    assert json.loads(found.audit.as_json()) == json.loads(whole.attrs["reading_audit"])
    (block,) = found
    xr.testing.assert_identical(block.drop_attrs(deep=False), whole.drop_attrs(deep=False))
    assert not list((tmp_path / "out").rglob("*.part"))


def test_a_file_broken_halfway_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(spool, "SEGMENT_REPORTS", 2)
    monkeypatch.setattr("airswing.reports.formats.tabular.ROWS_PER_PIECE", 3)
    files = tmp_path / "in"
    files.mkdir()
    write(files / "a.csv", flight())
    broken = write(files / "b.csv", flight(tail="HALF"))
    broken.write_bytes(broken.read_bytes() + b"\xff\xfe\xfd,,,,,,\n")
    found = set_down(files, tmp_path / "out")
    assert [str(name) for block in found for name in block["aircraft"].to_numpy()] == ["N412XJ"]
    assert [Path(entry["file"]).name for entry in found.audit.files_skipped] == ["b.csv"]
    one = Spool(tmp_path / "strict")
    with pytest.raises(InputError, match=r"b\.csv"):
        one.fill(str(files / "*.csv"), on_bad_file="fail")


def test_one_aircraft_is_never_divided(tmp_path):
    files = files_of(tmp_path / "in", ())
    assert archive.BLOCK_REPORTS > 100_000
    found = set_down(files, tmp_path / "out", limit=1)
    assert [block.sizes["aircraft"] for block in found] == [1] * found.aircraft
