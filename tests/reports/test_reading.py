"""Finding files, recognising formats, clear refusals, and the two steps of reading."""

import importlib
import json
import sys
import zipfile
from itertools import count, pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.reports import Audit, assemble, expand, read_file, read_reports, reports_summary
from tests.reports.tables import audit_of, flight, row, write


def notes_of(reports):
    return " ".join(audit_of(reports)["notes"])


def test_read_reports_is_each_file_read_and_assembled(tmp_path):
    days = [flight(start=f"2009-01-0{day}T12:00", tail=f"N{day % 2}") for day in range(5, 9)]
    paths = [write(tmp_path / f"{n}.csv", day) for n, day in enumerate(days)]
    tables, audits = zip(*(read_file(path) for path in paths), strict=True)
    assert [len(table) for table in tables] == [counts.usable for counts in audits] == [10] * 4
    expected = read_reports(paths)
    xr.testing.assert_identical(assemble(tables[::-1]).drop_attrs(), expected.drop_attrs())
    assert Audit.from_dict(audits[0].as_dict()) == audits[0]


def test_flights_of_a_month_are_those_that_begin_in_it(tmp_path):
    starts = ("2009-01-31T12:00", "2009-01-31T23:59", "2009-02-01T09:00")
    table = pd.concat([flight(start=start) for start in starts])
    table_read, _ = read_file(write(tmp_path / "a.csv", table))
    months = np.arange("2009-01", "2009-05", dtype="M8[M]").astype("M8[ns]")
    by_month = [assemble([table_read], begins=begins) for begins in pairwise(months)]
    assert [month.sizes["report"] for month in by_month] == [20, 10, 0]
    assert by_month[0]["time"].to_numpy()[-1] > months[1]
    assert by_month[0]["flight"].to_numpy().tolist() == [0] * 10 + [1] * 10
    for month, begins in zip(by_month, pairwise(months), strict=True):
        audit = Audit()  # an interval of 7 minutes begins at 23:59
        averaged = assemble([table_read], interval=420.0, begins=begins, audit=audit)
        assert averaged.sizes["report"] + audit.dropped["averaged"] == month.sizes["report"]


def test_no_file_is_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=rf"reports/\*\.csv' in folder {tmp_path}"):
        read_reports("reports/*.csv")
    with pytest.raises(InputError, match="names no file"):
        read_reports([])
    with pytest.raises(InputError, match=r"is a folder.*/\*"):
        read_reports(tmp_path)
    (tmp_path / "tail=N1").mkdir()
    (tmp_path / "tail=N1" / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"is a folder.*/\*\*/\*\.parquet"):
        read_reports(tmp_path)
    monkeypatch.setattr(Path, "rglob", lambda *_: (tmp_path / "b.nc" for _ in count()))
    with pytest.raises(InputError, match="is a folder"):
        read_reports(tmp_path)


def test_names_twice_names_with_brackets_and_broken_links(tmp_path):
    path = write(tmp_path / "a[1].csv", flight())
    assert expand([path, str(path), str(tmp_path / "*.csv")]) == [path]
    (tmp_path / "b.csv").symlink_to(tmp_path / "absent")
    (left_out,) = audit_of(read_reports(tmp_path / "*.csv"))["files_skipped"]
    assert left_out["file"] == str(tmp_path / "b.csv")
    assert "cannot be opened" in left_out["reason"]


def archive(folder, name):
    with zipfile.ZipFile(folder / "archive", "w") as file:
        file.writestr(name, "x")
    return (folder / "archive").read_bytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"GRIB\x00\x00\x00\x01", "GRIB"),
        (bytes(range(256)) * 4, "known format"),
        (b"\x1f\x8bbroken", "cannot be opened"),
        (b"CDF\x01garbage", "NetCDF"),
        (b"BUFR\x00\x00\x10\x03" + b"x" * 40, "decoded"),
        (b"<!DOCTYPE html><html>", "page of HTML.*download failed"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:a\n", "Git LFS pointer"),
        (b"36, 1001\nSmith, J.\n", "ICARTT file.*36 lines"),
        (b'{"type": "FeatureCollection"}', "JSON of no known layout"),
        (b'<?xml version="1.0"?><kml/>', "XML"),
        (b"\xfd7zXZ\x00\x00", "compressed with xz"),
        (b"\x80\x04\x95" + b"x" * 40, "pickle"),
        (b"SQLite format 3\x00", "SQLite"),
        ("xl/workbook.xml", "Excel workbook"),
        ("reports.csv", "zip archive"),
    ],
)
@pytest.mark.parametrize("format", ["auto", "g1000"])
def test_a_file_that_holds_no_reports_is_named(tmp_path, content, message, format):
    path = tmp_path / "thing.csv"
    path.write_bytes(content if isinstance(content, bytes) else archive(tmp_path, content))
    with pytest.raises(InputError, match=f"thing.csv.*{message if format == 'auto' else ''}"):
        read_reports(path, format=format)


def test_unreadable_files_are_skipped_and_counted_or_refused(tmp_path):
    write(tmp_path / "a.csv", flight(source="BUFR GRIB"))
    write(tmp_path / "b.csv", flight(start="2009-01-06T12:00:00"))
    (tmp_path / "bad.csv").write_bytes(b"\x00\x01\x02")
    write(tmp_path / "short.csv", flight().drop(columns="latitude"))
    broken = write(tmp_path / "half.csv", flight(tail="HALF"))
    broken.write_bytes(broken.read_bytes() + b"\xff\xfe\xfd,,,,,,\n")
    reports = read_reports(str(tmp_path / "*.csv"))
    audit = audit_of(reports)
    assert (audit["files"], audit["reports_read"], audit["reports_kept"]) == (2, 20, 20)
    assert reports["aircraft"].to_numpy().tolist() == ["N412XJ"]
    skipped = {Path(entry["file"]).name: entry["reason"] for entry in audit["files_skipped"]}
    assert set(skipped) == {"bad.csv", "short.csv", "half.csv"}
    assert "latitude" in skipped["short.csv"]
    with pytest.raises(InputError, match=r"bad\.csv"):
        read_reports(str(tmp_path / "*.csv"), on_bad_file="fail")
    with pytest.raises(InputError, match=r"none of the 2 report files.*bad\.csv"):
        read_reports([tmp_path / "bad.csv", tmp_path / "short.csv"])
    mapping = {"wind_speed_kt": {"name": "wind_speed_kt", "unit": "hPa"}}
    with pytest.raises(InputError, match="hPa"):  # a bad mapping is no fault of the files
        read_reports(tmp_path / "a.csv", columns=mapping)
    with pytest.raises(InputError, match="auto, bufr, g1000"):
        read_reports(tmp_path / "a.csv", format="excel")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tail": ""}, "2 reports read, dropped for: missing_tail 2"),
        ({"time": 0}, "time_out_of_range 2; cannot be read: time such as 0"),
        ({"wind_speed_kt": "14 kt"}, r"wind_speed_kt: holds no numbers \(found: '14 kt'\)"),
    ],
)
def test_the_reason_is_given_where_no_report_is_usable(tmp_path, values, message):
    with pytest.raises(InputError, match=message):
        read_reports(write(tmp_path / "a.csv", [row(**values)] * 2), format="csv")


@pytest.mark.parametrize(
    ("values", "note"),
    [
        ({"wind_speed_kt": np.nan}, "none of the 10 reports has a wind"),
        ({"temperature_degC": 250.0}, "values of air_temperature are impossible"),
        ({}, ""),
    ],
)
def test_notes_name_missing_and_impossible_columns(tmp_path, values, note):
    notes = notes_of(read_reports(write(tmp_path / "b.csv", flight(**values))))
    assert note in notes if note else notes == ""


@pytest.mark.parametrize("labels", [("KLM12", "BAW7"), ("", "BAW7"), ("", "")])
def test_two_aircraft_under_one_address_are_separated(tmp_path, labels):
    """Three days of two aircraft; on one day each flies alone, on another they meet in place."""
    days = [
        flight(flight=label, longitude=east + place, start=f"2009-01-0{day}T{clock}:00:{second}")
        for label, east, second in zip(labels, (-87.0, 10.0), ("00", "40"), strict=True)
        for day, clock, place in ((5, "12", 0.0), (5, "15", 4.0), (6, "12", 2.0))
    ]
    alone = flight(flight=labels[0], longitude=-86.0, start="2009-01-08T12:00:00")
    reports = read_reports(write(tmp_path / "a.csv", pd.concat([*days, alone])))
    assert reports["aircraft"].values.tolist() == ["N412XJ-1", "N412XJ-2"]
    assert reports["row_size"].values.tolist() == [40, 30]
    assert (reports["longitude"].values[:40] < -80.0).all()
    assert set(np.diff(reports["flight"])) == {0, 1}
    assert "two aircraft seem to share one identifier" in notes_of(reports)


def test_the_summary_of_a_file(tmp_path, real):
    summary = reports_summary(write(tmp_path / "a.csv", flight(roll_flag=["G"] * 9 + [""])))
    assert (summary["format"], summary["reports"], summary["aircraft"]) == ("csv", 10, 1)
    assert (summary["first"], summary["last"]) == ("2009-01-05T12:00:00Z", "2009-01-05T12:27:00Z")
    assert summary["bounding_box"]["south"] == summary["bounding_box"]["north"] == 41.5
    assert summary["columns"] == {"pressure": 10, "eastward_wind": 10, "roll_flag": 9}
    assert summary["flags"] == {"roll_flag": {"G": 9, "blank": 1}}
    json.dumps(summary)
    summary = reports_summary(real("reports/acars_19990209_14z.nc"))
    assert (summary["format"], summary["reports"], summary["aircraft"]) == ("madis", 2304, 298)
    assert summary["flags"]["rollFlag"] == {"B": 120, "G": 388, "N": 1796}


MODULE = """
import pandas as pd

from airswing.reports.formats import ReportFormat


def read(path, mapping, audit):
    names = ["tail", "latitude", "pressure_altitude", "wind_speed", "wind_direction"]
    table = pd.read_csv(path, skiprows=1, names=names)
    yield table.assign(time=pd.Timestamp("2009-01-01"), longitude=-90.0)


FORMATS = (ReportFormat("printout", lambda start: start.startswith(b"%station"), read),)
"""


def test_a_format_is_one_new_file(tmp_path, monkeypatch):
    """The folder of the file is made part of the package's."""
    (tmp_path / "station_printout.py").write_text(MODULE)
    package = importlib.import_module("airswing.reports.formats")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    (tmp_path / "any.name").write_text("%station printout\nN8,40,6000,30,270\nN9,41,6000,31,270\n")
    reports = read_reports(tmp_path / "any.name")
    assert reports["aircraft"].values.tolist() == ["N8", "N9"]
    np.testing.assert_allclose(reports["eastward_wind"], [30, 31])
    with pytest.raises(InputError, match="printout"):
        read_reports(tmp_path / "any.name", format="printed")
    sys.modules.pop("airswing.reports.formats.station_printout")
