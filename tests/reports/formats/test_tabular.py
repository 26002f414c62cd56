"""CSV and Parquet: text stays text, broken rows are counted, broken files are named."""

import bz2
import gzip
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.reports.tables import audit_of, flight, row, write

from airswing.errors import InputError
from airswing.reports import read_reports

CSV = flight().to_csv(index=False)


def test_tails_stay_text(tmp_path):
    tails = ["NA", "007", "7", "1E5", "nan", "None", "TRUE", "N412XJ", "-"]
    ds = read_reports(write(tmp_path / "a.csv", [row(tail=tail) for tail in tails]))
    assert sorted(ds["aircraft"].to_numpy()) == sorted(tails)
    assert audit_of(ds)["dropped"] == {}


def test_rows_of_another_length(tmp_path):
    lines = CSV.splitlines()
    lines[1] += ",1"
    lines[5] += ",1,2,3"
    lines[7] += ","
    lines[10] = lines[10].rsplit(",", 2)[0]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    ds = read_reports(tmp_path / "a.csv")
    audit = audit_of(ds)
    assert audit["dropped"] == {"ragged_row": 2}
    assert (audit["reports_read"], audit["reports_kept"]) == (10, 8)
    assert np.isnan(ds["eastward_wind"]).values.tolist() == [False] * 7 + [True]
    assert audit["missing"]["eastward_wind"] == 1


def test_lines_of_garbage_are_no_reports_without_a_time(tmp_path):
    lines = CSV.splitlines()
    lines[3:3] = ["the receiver was down", ",,,,,,", "N412XJ,,41.5,-87.0,20000,270,40"]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    audit = audit_of(read_reports(tmp_path / "a.csv"))
    assert audit["dropped"] == {"ragged_row": 2, "missing_time": 1}
    assert (audit["reports_read"], audit["reports_kept"]) == (13, 10)


def test_a_repeated_column_is_counted_and_its_first_values_are_used(tmp_path):
    header, *rows = CSV.splitlines()
    repeated = [f"{header},wind_speed_kt", *(f"{row},99" for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(repeated))
    ds = read_reports(tmp_path / "a.csv")
    np.testing.assert_allclose(ds["eastward_wind"], 40 * 1852 / 3600, rtol=1e-5)
    assert audit_of(ds)["repaired"]["wind_speed_column_repeated"] == 10


def test_unreadable_numbers_are_missing_and_counted(tmp_path):
    table = flight().astype({"wind_speed_kt": object, "latitude": object})
    table.loc[[2, 3], "wind_speed_kt"] = ["fast", "M"]
    table.loc[4, "latitude"] = "41.5N"
    audit = audit_of(read_reports(write(tmp_path / "a.csv", table)))
    assert audit["repaired"]["wind_speed_unparsable"] == 1
    assert audit["repaired"]["latitude_unparsable"] == 1
    assert audit["dropped"] == {"missing_position": 1}
    assert audit["missing"]["eastward_wind"] == 2


def parquet_without_rows(path):
    flight().iloc[:0].to_parquet(path)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"tail,time\xff\xfe\n1,2\n", "not UTF-8"),
        (CSV.encode() + b"\xe9t\xe9,,,,,,\n", "not UTF-8"),
        (CSV.split("\n")[0].encode() + b"\n", "no reports"),
        (b"\n\n", "no header"),
        (CSV.encode() + b'"N1,2009', "cannot be read as CSV"),
        (gzip.compress(CSV.encode())[:-20], "cannot be"),
        (bz2.compress(CSV.encode())[:-20], "cannot be"),
        (b"PAR1" + b"garbage" * 20, "cannot be read as Parquet"),
        (parquet_without_rows, "no reports"),
    ],
)
def test_a_broken_file_is_named(tmp_path, content, message):
    path = tmp_path / "fleet.csv"
    path.write_bytes(content if isinstance(content, bytes) else content(path))
    with pytest.raises(InputError, match=rf"fleet\.csv.*{message}"):
        read_reports(path)


def test_parquet_is_read_as_csv(tmp_path, monkeypatch):
    table = flight(tail="007", roll_flag="G", icing=1)
    table.to_parquet(tmp_path / "a.parquet")
    ds = read_reports(write(tmp_path / "a.csv", table)).drop_attrs(deep=False)
    xr.testing.assert_identical(read_reports(tmp_path / "a.parquet").drop_attrs(deep=False), ds)
    table = flight(tail=7, flight=3.0).astype({"tail": "category"})
    table["time"] = table["time"].dt.tz_localize("UTC").dt.tz_convert("America/Chicago")
    table["wind_speed_kt"] = table["wind_speed_kt"].astype("float32").where(table.index != 2)
    table.to_parquet(tmp_path / "a.parquet")
    ds = read_reports(tmp_path / "a.parquet")
    assert ds["aircraft"].to_numpy().tolist() == ["7"]
    assert ds["time"].to_numpy()[0] == np.datetime64("2009-01-05T12:00:00")
    assert int(np.isnan(ds["eastward_wind"]).sum()) == 1
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r"airswing\[parquet\]"):
        read_reports(tmp_path / "a.parquet")


def test_columns_that_stand_in_the_names_of_folders(tmp_path):
    table = pd.concat([flight(tail="N 1/2"), flight(tail="007")])
    table.to_parquet(tmp_path / "archive", partition_cols=["tail"])
    divided = read_reports(tmp_path / "archive/**/*.parquet")
    table.to_parquet(tmp_path / "whole.parquet")
    assert sorted(divided["aircraft"].to_numpy()) == ["007", "N 1/2"]
    xr.testing.assert_equal(divided, read_reports(tmp_path / "whole.parquet"))


def test_forms_of_a_mapping(tmp_path):
    table = pd.DataFrame(
        {
            "Date": ["2009-07-01"] * 3,
            "UTC": ["07:00:00", "07:03:00", "07:06:00"],
            "ahead": "-05:00",
            "lat": [40.0, None, 40.4],
            "LAT": [np.nan, 40.2, 41.0],
            "longitude": -90.0,
            "pressure_hPa": 500.0,
            "wind_direction_deg": 270.0,
            "FF": 20.0,
            "kind": list("ABA"),
        }
    )
    columns = {
        "tail": {"value": "N510"},
        "time": {"date": "Date", "time": "UTC", "offset": "ahead"},
        "latitude": ["lat", "LAT", "Latitude"],
        "FF": {"name": "wind_speed_kt", "unit": "m/s"},
    }
    path = write(tmp_path / "a.csv", table)
    ds = read_reports(path, columns=columns)
    assert ds["aircraft"].values.tolist() == ["N510"]
    np.testing.assert_allclose(ds["latitude"], [40.0, 40.2, 40.4])
    np.testing.assert_allclose(ds["eastward_wind"], 20.0, rtol=1e-6)
    assert str(ds["time"].values[1])[:19] == "2009-07-01T12:03:00"
    only = read_reports(path, columns={**columns, "kind": {"only": ["A"]}})
    assert audit_of(only)["dropped"] == {"not_wanted": 1}
    canonical = write(tmp_path / "b.csv", [row(tail="N1"), row(tail="N2")])
    only = read_reports(canonical, columns={"tail": {"only": ["N1"]}})
    assert only["aircraft"].values.tolist() == ["N1"]
    with pytest.raises(InputError, match="stream: the mapped column is not in the file"):
        read_reports(path, columns={**columns, "stream": {"only": "A"}})


def test_times_in_another_notation(tmp_path):
    table = flight(time="01.03.2009 09:30").rename(columns={"time": "when"})
    path = write(tmp_path / "a.csv", table)
    with pytest.raises(InputError, match=r"unparsable_time.*01\.03\.2009.*format: "):
        read_reports(path, columns={"when": "time"})
    mapped = {"when": {"name": "time", "format": "%d.%m.%Y %H:%M"}}
    expected = read_reports(path, columns=mapped)["time"].values
    assert str(expected[0])[:19] == "2009-03-01T09:30:00"
    path = write(tmp_path / "b.csv", table.assign(when="01.03.2009", clock="930"))
    mapped = {"time": {"date": "when", "time": "clock", "format": "%d.%m.%Y %H%M"}}
    assert (read_reports(path, columns=mapped)["time"].values == expected).all()


@pytest.mark.parametrize(
    "content", ["# made by a program\n# of 2009\n" + CSV, "#" + CSV.replace("N412XJ,", "1,")]
)
def test_comments_before_the_header(tmp_path, content):
    (tmp_path / "comments.csv").write_text(content)
    assert read_reports(tmp_path / "comments.csv").sizes["report"] == 10
