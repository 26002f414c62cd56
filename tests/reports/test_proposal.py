"""`airswing inspect` on a table nobody has seen: the mapping it proposes reads it."""

import numpy as np
import pandas as pd
import pytest
import yaml

from airswing.reports.mapping_proposal import propose_mapping
from airswing.reports.read import read_reports
from tests.command import airswing

TIMES = pd.date_range("2017-01-11T12:00:00", periods=4, freq="30s")
TRUTH = {
    "pressure_altitude": [10668.0, 10668.0, 10058.4, 9448.8],
    "direction": [310.0, 311.0, 350.0, 10.0],
    "speed": [41.0, 40.0, 39.0, 38.0],
    "latitude": [52.0, 52.02, 52.04, 52.06],
    "longitude": [4.3, 4.35, 4.4, 4.45],
}


def european():
    """Date and time apart, units in brackets, semicolons, a column of no use."""
    return pd.DataFrame(
        {
            "Registration": "D-ABCD",
            "Date": TIMES.strftime("%Y-%m-%d"),
            "UTC": TIMES.strftime("%H:%M:%S"),
            "Lat": TRUTH["latitude"],
            "Lng": TRUTH["longitude"],
            "Alt (m)": TRUTH["pressure_altitude"],
            "Wdir": TRUTH["direction"],
            "WSpd [m/s]": TRUTH["speed"],
            "OAT": -55.0,
            "Remark: none": "x",
            "temperature_qc": "pass",
        }
    )


def levels():
    """Flight levels, epoch milliseconds, wind as components, kelvin, no aircraft."""
    angle = np.radians(TRUTH["direction"])
    return pd.DataFrame(
        {
            "when": (TIMES - pd.Timestamp(0)) // pd.Timedelta("1ms"),
            "y": TRUTH["latitude"],
            "x": TRUTH["longitude"],
            "FL": np.array(TRUTH["pressure_altitude"]) / 30.48,
            "u_m_s": -np.array(TRUTH["speed"]) * np.sin(angle),
            "v_m_s": -np.array(TRUTH["speed"]) * np.cos(angle),
            "temp": 218.0,
        }
    )


def test_a_date_and_an_hour_make_the_time(tmp_path):
    """Both as numbers without a first zero."""
    (tmp_path / "letter.txt").write_text("Dear colleague,\nhere is nothing of use.\n")
    assert propose_mapping(tmp_path / "letter.txt") is None
    times = TIMES - pd.Timedelta("5h")
    clock = {"obs_date": times.strftime("%Y%m%d"), "obs_hour": times.strftime("%H%M%S")}
    table = european().drop(columns=["Date", "UTC"]).assign(T="N1", **clock)
    table.astype(dict.fromkeys(clock, int)).to_csv(tmp_path / "a.csv", index=False)
    proposed = propose_mapping(tmp_path / "a.csv")
    assert proposed is not None
    assert proposed["columns"]["time"] == {"date": "obs_date", "time": "obs_hour"}
    assert proposed["unused"] == ["Remark: none", "T"]  # no temperature
    reports = read_reports(tmp_path / "a.csv", columns=proposed["columns"])
    assert reports["time"].to_numpy().tolist() == times.to_numpy().astype("M8[ns]").tolist()
    assert "format" not in proposed["yaml"]
    table["obs_date"] = times.strftime("%d.%m.%Y")
    table.to_csv(tmp_path / "b.csv", index=False)
    proposed = propose_mapping(tmp_path / "b.csv")
    assert proposed is not None and "no ISO 8601 date: add a format" in proposed["yaml"]


@pytest.mark.parametrize("make", [european, levels])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_the_proposed_mapping_reads_the_table(make, kind, tmp_path):
    path = tmp_path / f"theirs.{kind}"
    table = make()
    table.to_csv(path, index=False, sep=";") if kind == "csv" else table.to_parquet(path)
    proposed = propose_mapping(path)
    assert proposed is not None and not proposed["missing"]
    columns = yaml.safe_load(proposed["yaml"])["columns"]
    assert columns == proposed["columns"]
    reports = read_reports(path, columns=columns)
    assert reports["time"].to_numpy().tolist() == TIMES.to_numpy().astype("M8[ns]").tolist()
    speed = np.hypot(reports["eastward_wind"], reports["northward_wind"])
    for column, name in (
        *((reports[name], name) for name in ("latitude", "longitude", "pressure_altitude")),
        (speed, "speed"),
    ):
        assert column.to_numpy() == pytest.approx(TRUTH[name], abs=0.01)
    if make is european:
        assert proposed["unused"] == ["Remark: none"]
        assert reports["aircraft"].to_numpy().tolist() == ["D-ABCD"]


@pytest.mark.parametrize("name", ["AltM", "ALT_M", "Altitude (m)", "alt[M]"])
def test_the_unit_in_a_name_is_understood_in_any_case(name, tmp_path):
    """Values that could be feet do not change it."""
    table = european().rename(columns={"Alt (m)": name, "OAT": "TempC"})
    table[name] = 16000.0
    table.to_csv(tmp_path / "theirs.csv", index=False)
    proposed = propose_mapping(tmp_path / "theirs.csv")
    assert proposed is not None and not proposed["missing"]
    reports = read_reports(tmp_path / "theirs.csv", columns=proposed["columns"])
    assert reports["pressure_altitude"].to_numpy() == pytest.approx(16000.0)
    assert reports["air_temperature"].to_numpy() == pytest.approx(218.15)


def test_guesses_are_marked_and_missing_columns_are_listed(tmp_path):
    path = tmp_path / "recorder.csv"
    table = european()[["Date", "UTC", "Lat", "Lng"]].assign(hdg=10.0, gs=400.0, trk=11.0, mach=0.7)
    table.to_csv(path, index=False)
    shown = airswing("inspect", path).stdout
    for line in (
        "hdg: magnetic_heading_deg   # magnetic is a guess",
        "gs: {name: ground_speed_kt, unit: kt}   # kt or m/s guessed from its values",
        "tail: {value: recorder}   # one aircraft a file is a guess",
        "still missing: pressure_altitude_ft or pressure_hPa",
    ):
        assert line in shown
    table.assign(alt=33000).to_csv(path, index=False)
    shown = airswing("inspect", path).stdout
    assert "reports: 4" in shown and "alt: {name: pressure_altitude_ft, unit: ft}" in shown
