"""CSV and Parquet: text stays text, broken rows are counted, broken files are named."""

from __future__ import annotations

import bz2
import gzip
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.reports.tables import flight, row, write

from airswing.errors import InputError
from airswing.reports import read_reports
from airswing.reports.formats import tabular


def audit_of(ds: xr.Dataset) -> dict[str, Any]:
    return json.loads(ds.attrs["reading_audit"])


def test_tails_stay_text(tmp_path: Path):
    tails = ["NA", "007", "7", "1E5", "nan", "None", "TRUE", "N412XJ", "-"]
    ds = read_reports(write(tmp_path / "a.csv", [row(tail=tail) for tail in tails]))
    assert sorted(ds["aircraft"].to_numpy()) == sorted(tails)
    assert audit_of(ds)["dropped"] == {}


def test_rows_with_too_many_fields_are_dropped_and_counted(tmp_path: Path):
    path = write(tmp_path / "a.csv", flight())
    lines = path.read_text().splitlines()
    lines[1] += ",1"
    lines[5] += ",1,2,3"
    lines[7] += ","
    path.write_text("\n".join(lines))
    audit = audit_of(read_reports(path))
    assert audit["dropped"] == {"ragged_row": 2}
    assert (audit["reports_read"], audit["reports_kept"]) == (10, 8)


def test_a_row_cut_short_loses_only_what_is_missing(tmp_path: Path):
    path = write(tmp_path / "a.csv", flight())
    path.write_text(path.read_text().rstrip("\n").rsplit(",", 2)[0])
    ds = read_reports(path)
    assert ds.sizes["report"] == 10
    assert np.isnan(ds["eastward_wind"][-1])
    assert audit_of(ds)["missing"]["eastward_wind"] == 1


def test_unreadable_numbers_are_missing_and_counted(tmp_path: Path):
    table = flight().astype({"wind_speed_kt": object, "latitude": object})
    table.loc[2, "wind_speed_kt"] = "fast"
    table.loc[3, "wind_speed_kt"] = "M"
    table.loc[4, "latitude"] = "41.5N"
    audit = audit_of(read_reports(write(tmp_path / "a.csv", table)))
    assert audit["repaired"]["wind_speed_unparsable"] == 1
    assert audit["repaired"]["latitude_unparsable"] == 1
    assert audit["dropped"] == {"missing_position": 1}
    assert audit["missing"]["eastward_wind"] == 2


def test_pieces_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write(tmp_path / "a.csv", flight(seconds=np.arange(50) * 60.0))
    whole = read_reports(path)
    monkeypatch.setattr(tabular, "ROWS_PER_PIECE", 7)
    xr.testing.assert_identical(read_reports(path), whole)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"tail,time\xff\xfe\n1,2\n", "not UTF-8"),
        (flight().to_csv(index=False).encode() + b"\xe9t\xe9,,,,,,\n", "not UTF-8"),
        (flight().to_csv(index=False).split("\n")[0].encode() + b"\n", "no reports"),
        (b"\n\n", "no header"),
        (flight().to_csv(index=False).encode() + b'"N1,2009', "cannot be read as CSV"),
        (gzip.compress(flight().to_csv(index=False).encode())[:-20], "cannot be"),
        (bz2.compress(flight().to_csv(index=False).encode())[:-20], "cannot be"),
    ],
)
def test_a_broken_file_is_named(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "fleet.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_reports(path)
    assert "fleet.csv" in str(error.value)


class TestParquet:
    """Skipped where pyarrow is not installed, apart from the message that says so."""

    def test_same_as_csv(self, tmp_path: Path):
        pytest.importorskip("pyarrow")
        table = flight(tail="007", roll_flag="G", icing=1)
        table.to_parquet(tmp_path / "a.parquet")
        xr.testing.assert_identical(
            read_reports(tmp_path / "a.parquet").drop_attrs(deep=False),
            read_reports(write(tmp_path / "a.csv", table)).drop_attrs(deep=False),
        )

    def test_zones_numbers_and_categories(self, tmp_path: Path):
        pytest.importorskip("pyarrow")
        table = flight(tail=7, flight=3.0)
        table["tail"] = table["tail"].astype("category")
        table["time"] = table["time"].dt.tz_localize("UTC").dt.tz_convert("America/Chicago")
        table["wind_speed_kt"] = table["wind_speed_kt"].astype("float32").where(table.index != 2)
        table.to_parquet(tmp_path / "a.parquet")
        ds = read_reports(tmp_path / "a.parquet")
        assert ds["aircraft"].to_numpy().tolist() == ["7"]
        assert ds["time"].to_numpy()[0] == np.datetime64("2009-01-05T12:00:00")
        assert int(np.isnan(ds["eastward_wind"]).sum()) == 1

    def test_a_broken_or_empty_file_is_named(self, tmp_path: Path):
        pytest.importorskip("pyarrow")
        (tmp_path / "a.parquet").write_bytes(b"PAR1" + b"garbage" * 20)
        with pytest.raises(InputError, match=r"a\.parquet.*cannot be read as Parquet"):
            read_reports(tmp_path / "a.parquet")
        flight().iloc[:0].to_parquet(tmp_path / "b.parquet")
        with pytest.raises(InputError, match=r"b\.parquet.*no reports"):
            read_reports(tmp_path / "b.parquet")

    def test_without_pyarrow_the_extra_is_named(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        (tmp_path / "a.parquet").write_bytes(b"PAR1" + b"x" * 20)
        monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
        with pytest.raises(InputError, match=r"airswing\[parquet\]"):
            read_reports(tmp_path / "a.parquet")


def test_columns_that_stand_in_the_names_of_folders(tmp_path: Path):
    pytest.importorskip("pyarrow")
    table = pd.concat([flight(tail="N 1/2"), flight(tail="007")])
    table.to_parquet(tmp_path / "archive", partition_cols=["tail"])
    divided = read_reports(tmp_path / "archive/**/*.parquet")
    table.to_parquet(tmp_path / "whole.parquet")
    whole = read_reports(tmp_path / "whole.parquet")
    assert sorted(divided["aircraft"].to_numpy()) == ["007", "N 1/2"]
    xr.testing.assert_equal(divided, whole)


def test_forms_of_a_mapping(tmp_path: Path):
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
    with pytest.raises(InputError, match="stream: the mapped column is not in the file"):
        read_reports(path, columns={**columns, "stream": {"only": "A"}})


def test_times_in_another_notation(tmp_path: Path):
    whole = flight().drop(columns="time").assign(when="01.03.2009 09:30")
    path = write(tmp_path / "a.csv", whole)
    with pytest.raises(InputError, match=r"unparsable_time.*01\.03\.2009.*format: ") as error:
        read_reports(path, columns={"when": "time"})
    assert "no unit" not in str(error.value)
    mapped = {"when": {"name": "time", "format": "%d.%m.%Y %H:%M"}}
    expected = read_reports(path, columns=mapped)["time"].values
    assert str(expected[0])[:19] == "2009-03-01T09:30:00"
    apart = whole.assign(when="01.03.2009", clock="930")
    path = write(tmp_path / "b.csv", apart)
    mapped = {"time": {"date": "when", "time": "clock", "format": "%d.%m.%Y %H%M"}}
    assert (read_reports(path, columns=mapped)["time"].values == expected).all()


def test_comments_before_the_header(tmp_path: Path):
    path = tmp_path / "comments.csv"
    body = flight().to_csv(index=False)
    path.write_text("# made by a program\n# of 2009\n" + body)
    assert read_reports(path).sizes["report"] == 10
    path.write_text("#" + body.replace("N412XJ,", "1,"))
    assert read_reports(path).sizes["report"] == 10
