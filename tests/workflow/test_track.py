"""Tables with model winds, what files hold, and the summary of a run."""

import math
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from tests.command import airswing as command
from tests.reference.gridded.datasets import latlon
from tests.reports.tables import row, write

import airswing
from airswing.errors import InputError
from airswing.workflow.inspection import inspect_file
from airswing.workflow.main import summary_text
from airswing.workflow.track import collocate_track


@pytest.fixture
def model():
    """Winds linear in place, so that interpolation adds nothing."""
    latitude, longitude = np.arange(40.0, 45.1, 0.5), np.arange(-92.0, -83.9, 0.5)
    ds = latlon(latitude=latitude, longitude=longitude, hours=4)
    ds["u"][:], ds["v"][:] = ds["latitude"] - 42.0, ds["longitude"] + 88.0
    return ds


def track(**changes):
    columns = {
        "name": ["007", "b", "c"],
        "time": ["2022-11-11T00:30:00Z", "2022-11-11T02:00:00Z", "2023-01-01T00:00:00Z"],
        "lat": [42.0, 43.0, 43.0],
        "lon": [-90.0, -88.0, -88.0],
        "pressure_hPa": [500.0, 400.0, 400.0],
    }
    return pd.DataFrame(columns | changes)


def test_winds_of_the_model_at_the_places(model):
    table = airswing.append_winds(track(), {"m": model})
    pd.testing.assert_frame_equal(table[track().columns], track())
    np.testing.assert_allclose(table["m_eastward_wind_m_s"], [0.0, 1.0, np.nan], atol=1e-6)
    np.testing.assert_allclose(table["m_northward_wind_m_s"], [-2.0, 0.0, np.nan], atol=1e-6)
    # from the north; from the west; after the model's last time there is none
    np.testing.assert_allclose(table["m_wind_direction_deg"], [0.0, 270.0, np.nan], atol=1e-4)
    np.testing.assert_allclose(table["m_wind_speed_kt"] * 0.514444, [2.0, 1.0, np.nan], rtol=1e-5)


def test_levels_in_feet_and_names_of_the_user(model):
    feet = [18289.0, 23574.0, 23574.0]  # 500 and 400 hPa of the standard atmosphere
    table = track(fl=feet).drop(columns="pressure_hPa")
    extended = airswing.append_winds(table, {"m": model}, columns={"fl": "pressure_altitude_ft"})
    np.testing.assert_allclose(extended["m_northward_wind_m_s"], [-2.0, 0.0, np.nan], atol=1e-6)


def test_the_altitude_is_used_in_rows_without_a_pressure(model):
    table = track(pressure_hPa=[500.0, np.nan, 400.0], pressure_altitude_ft=[0.0, 23574.0, 0.0])
    extended = airswing.append_winds(table, {"m": model})
    np.testing.assert_allclose(extended["m_eastward_wind_m_s"], [0.0, 1.0, np.nan], atol=1e-6)


def test_numbers_of_a_parquet_track_are_not_rounded_in_csv(model, tmp_path):
    model.to_netcdf(tmp_path / "m.nc")
    track(lat=[42.123456, 43.0, 43.0]).to_parquet(tmp_path / "track.parquet")
    for source in ("track.parquet", "out.csv"):  # again from its own output
        collocate_track(tmp_path / source, [f"m={tmp_path}/m.nc"], tmp_path / "out.csv")
        written = pd.read_csv(tmp_path / "out.csv", dtype=str)
        assert written["lat"][0] == "42.123456"
        assert written["m_eastward_wind_m_s"][1] == "1.000"
        assert written["m_eastward_wind_m_s"].isna()[2]


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (track().drop(columns="pressure_hPa"), "pressure_hPa or pressure_altitude_ft"),
        (track().drop(columns="time"), "time"),
        (track(time=["noon", "then", ""]), "a time cannot be read.*noon"),
    ],
)
def test_missing_columns_are_named(model, table, says):
    with pytest.raises(InputError, match=says):
        airswing.append_winds(table, {"m": model})
    with pytest.raises(InputError, match="no such column"):
        airswing.append_winds(track(), {"m": model}, columns={"x": "time"})


def test_the_command_keeps_the_table_as_it_is(model, tmp_path):
    model.to_netcdf(tmp_path / "m.nc")

    def collocate(*options, reference=f"m={tmp_path}/*.nc"):
        words = ("collocate", tmp_path / "track.csv", "--reference", reference)
        return command(*words, "-o", tmp_path / "out.csv", *options)

    track().to_csv(tmp_path / "track.csv", index=False)
    done = collocate()
    assert done.returncode == 0, done.stderr
    written = pd.read_csv(tmp_path / "out.csv", dtype=str)
    assert list(written["name"]) == ["007", "b", "c"]
    assert written["m_eastward_wind_m_s"].iloc[1] == "1.000"
    assert "2 of 3 rows have a wind of m" in done.stderr + done.stdout
    assert "covers 2022-11-11T00:00Z to 2022-11-11T03:00Z" in done.stderr + done.stdout
    for separator in ",;\t":
        text = track(name=["b #2", "", "c"]).to_csv(index=False, sep=separator)
        (tmp_path / "track.csv").write_text(f"# a comment\n{text}")
        assert collocate().returncode == 0
        assert pd.read_csv(tmp_path / "out.csv")["name"].tolist()[::2] == ["b #2", "c"]
    (tmp_path / "track.csv").write_bytes(b"time,lat\xff\n")
    assert "track.csv: is not UTF-8 text" in collocate().stderr
    track().rename(columns={"time": "when"}).to_csv(tmp_path / "track.csv", index=False)
    assert "--columns" in collocate().stderr
    assert collocate("--columns", "when=time").returncode == 0
    assert collocate(reference="m.nc").returncode == 2


@pytest.mark.parametrize("names", [("t.parquet", "out.csv"), ("t.csv", "out.parquet")])
def test_parquet_without_its_library_is_named(tmp_path, monkeypatch, names):
    track().to_csv(tmp_path / "t.csv", index=False)
    track().to_parquet(tmp_path / "t.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    source, output = (tmp_path / name for name in names)
    with pytest.raises(InputError, match=r"parquet: Parquet needs pyarrow\. .*airswing\[parquet\]"):
        collocate_track(source, ["m=m/*.nc"], output)


# --- inspection --------------------------------------------------------------------------------


def test_a_product_of_grib_files_is_a_product_and_half_of_it_is_named(tmp_path):
    ds = xr.Dataset({"row_size": ("aircraft", [1], {"comment": "from GRIB/*"})})
    path = airswing.write_product(ds, tmp_path / "a.nc", title="T")
    assert b"GRIB" in path.read_bytes()[:4096]
    summary = inspect_file(path)
    assert (summary["kind"], summary["title"]) == ("product", "T")
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"a\.nc.*a damaged NetCDF file"):
        inspect_file(path)


def test_a_table_that_mentions_grib_is_read_as_reports(tmp_path):
    summary = inspect_file(write(tmp_path / "a.csv", [row(tail="GRIB1"), row(tail="N2")]))
    assert (summary["kind"], summary["aircraft"]) == ("reports", 2)


def test_a_parquet_table_without_rows_is_named(tmp_path):
    table = pd.DataFrame({"Registration": ["N1"], "Lat": [41.5], "Lon": [-87.0]})
    table.iloc[:0].to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"a\.parquet.*tail: a required column is missing"):
        inspect_file(tmp_path / "a.parquet")


FITTED = {"offset": 0.82, "amplitude": 5.83, "phase": 33.8, "before_kt": 17.4, "after_kt": 6.2}
ERRORS = {"amplitude_standard_error": 0.1, "offset_standard_error": 0.05}


def fit(aircraft, status="ok", **changes):
    return {"aircraft": aircraft, "status": status, "reports": 4979} | FITTED | ERRORS | changes


def test_the_summary_has_95_percent_intervals_and_dashes_for_missing_fits():
    alone = ("amplitude", "phase", "amplitude_standard_error")
    summary = {
        "reference": "ruc",
        "reports": {"read": 30796, "usable": 30796, "kept": 22991},
        "aircraft": 3,
        "status": {"ok": 1, "no_correction_needed": 0, "offset_only": 1, "too_few_reports": 1},
        "disagreement_kt": {"before": 11.3, "after": 5.9},
        "fits": [
            fit("N401"),
            fit("N406", "too_few_reports", **dict.fromkeys(FITTED | ERRORS, math.nan)),
            fit("N407", "offset_only", **dict.fromkeys(alone, math.nan)),
        ],
    }
    text = summary_text(summary, Path("out"))
    assert "11.30 kt before, 5.90 kt after" in text
    assert "nan" not in text and "95 % intervals" in text
    assert "Compass deviation fitted for 1 of 3 aircraft, offset only for 1\n" in text
    fitted, none, offset = (line for line in text.splitlines() if line.startswith("N4"))
    assert "5.83 +- 0.20" in fitted
    assert len(fitted.split("ok")[0]) == len(none.split("too_few")[0])
    assert "0.82 +- 0.10" in offset and offset.count("+-") == 1
