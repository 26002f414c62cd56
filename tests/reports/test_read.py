"""Finding files, telling formats by content, and refusing with a clear message."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from airswing.errors import InputError
from airswing.reports import read_reports
from airswing.reports.read import _format_of as _detect_format
from airswing.reports.read import expand
from tests.reports.tables import flight, row, write


def test_an_empty_glob_says_pattern_and_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as error:
        read_reports("reports/*.csv")
    assert "reports/*.csv" in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_no_files_at_all_and_a_folder_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match="names no file"):
        read_reports([])
    with pytest.raises(InputError, match=r"is a folder.*/\*"):
        read_reports(tmp_path)
    (tmp_path / "tail=N1").mkdir()
    (tmp_path / "tail=N1" / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"is a folder.*/\*\*/\*\.parquet"):
        read_reports(tmp_path)


def test_a_file_named_twice_is_read_once(tmp_path: Path):
    path = write(tmp_path / "a.csv", flight())
    assert expand([path, str(tmp_path / "*.csv")]) == [path]


def test_a_name_with_glob_characters_is_found(tmp_path: Path):
    path = write(tmp_path / "a[1].csv", flight())
    assert expand(str(path)) == [path]


@pytest.mark.parametrize("target", ["absent", "b.csv"])
def test_a_link_that_leads_nowhere_or_to_itself_is_named(tmp_path: Path, target: str):
    write(tmp_path / "a.csv", flight())
    (tmp_path / "b.csv").symlink_to(tmp_path / target)
    audit = json.loads(read_reports(tmp_path / "*.csv").attrs["reading_audit"])
    (left_out,) = audit["files_skipped"]
    assert left_out["file"] == str(tmp_path / "b.csv")
    assert "cannot be opened" in left_out["reason"]


def test_an_unknown_format_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="auto, bufr, dart, flightradar24, g1000"):
        read_reports(write(tmp_path / "a.csv", flight()), format="excel")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"GRIB\x00\x00\x00\x01", "GRIB"),
        (bytes(range(256)) * 4, "known format"),
        (b"\x1f\x8bbroken", "cannot be opened"),
        (b"CDF\x01garbage", "NetCDF"),
        (b"BUFR\x00\x00\x10\x03" + b"x" * 40, "decoded"),
    ],
)
def test_a_file_that_is_no_report_file_is_named(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "thing.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_reports(path)
    assert "thing.csv" in str(error.value)


def test_one_unreadable_file_among_many_is_skipped_and_counted(tmp_path: Path):
    write(tmp_path / "a.csv", flight())
    write(tmp_path / "b.csv", flight(start="2009-01-06T12:00:00"))
    (tmp_path / "bad.csv").write_bytes(b"\x00\x01\x02")
    write(tmp_path / "short.csv", flight().drop(columns="latitude"))
    audit = json.loads(read_reports(str(tmp_path / "*.csv")).attrs["reading_audit"])
    assert (audit["files"], audit["reports_kept"]) == (2, 20)
    skipped = {Path(entry["file"]).name: entry["reason"] for entry in audit["files_skipped"]}
    assert set(skipped) == {"bad.csv", "short.csv"}
    assert "latitude" in skipped["short.csv"]
    with pytest.raises(InputError, match=r"bad\.csv"):
        read_reports(str(tmp_path / "*.csv"), on_bad_file="fail")


def test_a_file_broken_halfway_counts_not_at_all(tmp_path: Path):
    write(tmp_path / "a.csv", flight())
    broken = write(tmp_path / "b.csv", flight(tail="HALF"))
    broken.write_bytes(broken.read_bytes() + b"\xff\xfe\xfd,,,,,,\n")
    ds = read_reports(str(tmp_path / "*.csv"))
    assert ds["aircraft"].to_numpy().tolist() == ["N412XJ"]
    assert json.loads(ds.attrs["reading_audit"])["reports_read"] == 10


def test_all_files_unreadable_is_one_message(tmp_path: Path):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match=r"none of the 2 report files.*a\.csv: is empty"):
        read_reports(str(tmp_path / "*.csv"))


def test_no_usable_report_says_why(tmp_path: Path):
    with pytest.raises(InputError, match="2 reports read, dropped for: missing_tail 2"):
        read_reports(write(tmp_path / "a.csv", [row(tail=""), row(tail="")]))


def test_a_bad_mapping_is_refused_even_where_files_are_skipped(tmp_path: Path):
    with pytest.raises(InputError, match="hPa"):
        read_reports(
            write(tmp_path / "a.csv", flight()),
            columns={"wind_speed_kt": {"name": "wind_speed_kt", "unit": "hPa"}},
        )


def test_format_is_told_by_content(tmp_path: Path, real: Callable[[str], Path]):
    for name, kind in (
        ("reports/acars_19990209_14z.nc", "madis"),
        ("reports/amdar_20090123_europe.bufr", "bufr"),
    ):
        disguised = tmp_path / f"{kind}.csv"
        shutil.copy(real(name), disguised)
        assert _detect_format(disguised) == kind
    assert _detect_format(write(tmp_path / "table.nc", flight())) == "csv"


def test_a_table_that_mentions_a_format_is_still_a_table(tmp_path: Path):
    for word in ("BUFR", "GRIB"):
        path = write(tmp_path / "a.csv", flight(source=word))
        assert read_reports(path).sizes["report"] == 10
