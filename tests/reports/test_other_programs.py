"""Reports of aircraft that tell heading and airspeed, tables of other programs, high rates."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from pyproj import Geod

from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.flags import WIND_SOURCE
from airswing.physics.geomagnetism import FieldLattice
from airswing.reports.assembly import _average as averaged
from airswing.reports.audit import Audit
from airswing.reports.read import read_reports
from airswing.units import KNOT
from airswing.workflow.inspection import inspect_file

GEOD = Geod(ellps="WGS84")
REAL = Path(__file__).resolve().parents[3] / "shared" / "real"
MODES = REAL / "modes" / "mpm_20170111_12z_aggregated.csv"
THEIR_WINDS = REAL / "modes" / "mpm_20170111_12z_wind.csv"
TAMDAR = REAL / "reports" / "madis_acars_20050826_00z.nc.gz"
SOUNDINGS = REAL / "reports" / "madis_rawin_20050826_00z.nc.gz"


def real(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"{path.name} is not here")
    return path


def rows(**columns) -> pd.DataFrame:
    base = {
        "tail": ["N1"] * 4,
        "time": [f"2017-01-11T12:{minute:02d}:00Z" for minute in range(4)],
        "latitude": [52.0, 52.1, 52.2, 52.3],
        "longitude": [4.0] * 4,
        "pressure_altitude_ft": [30000.0] * 4,
    }
    return pd.DataFrame(base | columns)


def read(folder: Path, table: pd.DataFrame, **options):
    path = folder / "table.csv"
    table.to_csv(path, index=False)
    return read_reports(path, **options)


def test_the_wind_of_a_triangle_worked_by_hand(tmp_path):
    """North at 400 kt through air, over ground 400 kt north and 30 kt east: wind from 270 at 30."""
    reports = read(
        tmp_path,
        rows(
            heading_deg=[0.0] * 4,
            true_airspeed_kt=[400.0] * 4,
            ground_speed_kt=[np.hypot(400.0, 30.0)] * 4,
            track_deg=[np.degrees(np.arctan2(30.0, 400.0))] * 4,
        ),
    )
    np.testing.assert_allclose(reports["eastward_wind"], 30.0 * KNOT, atol=1e-3)
    np.testing.assert_allclose(reports["northward_wind"], 0.0, atol=1e-3)
    assert (reports["wind_source"] == WIND_SOURCE["derived"]).all()


def test_a_magnetic_heading_is_turned_by_the_declination(tmp_path):
    table = rows(
        magnetic_heading_deg=[-10.0] * 4,
        true_airspeed_kt=[400.0] * 4,
        ground_speed_kt=[400.0] * 4,
        track_deg=[350.0] * 4,
    )
    reports = read(tmp_path, table)
    seconds = reports["time"].to_numpy().astype("datetime64[ns]").astype(float) / 1e9
    place = (table["latitude"], table["longitude"], 9144.0, seconds)
    declination = np.degrees(FieldLattice.covering(*place).at(*place).declination)
    assert np.all(np.abs(declination) > 0.3)
    np.testing.assert_allclose(reports["reported_heading"], 350.0 + declination, atol=1e-4)


def test_a_reported_wind_stands_before_a_derived_one(tmp_path):
    reports = read(
        tmp_path,
        rows(
            wind_direction_deg=[180.0] * 4,
            wind_speed_kt=[20.0, 20.0, np.nan, 20.0],
            heading_deg=[0.0] * 4,
            mach=[0.7] * 4,
            temperature_degC=[-44.0] * 4,
            ground_speed_kt=[430.0] * 4,
            track_deg=[0.0] * 4,
        ),
    )
    assert reports["wind_source"].values.tolist() == [0, 0, WIND_SOURCE["derived"], 0]
    np.testing.assert_allclose(reports["northward_wind"].values[[0, 1, 3]], 20 * KNOT, atol=1e-4)


def test_an_airspeed_without_a_temperature_is_said(tmp_path):
    reports = read(
        tmp_path,
        rows(
            heading_deg=[0.0] * 4,
            indicated_airspeed_kt=[250.0] * 4,
            ground_speed_kt=[430.0] * 4,
            track_deg=[0.0] * 4,
        ),
    )
    assert (reports["wind_source"] == WIND_SOURCE["derived_at_standard_temperature"]).all()


def test_heading_without_airspeed_is_refused(tmp_path):
    with pytest.raises(InputError, match="wind_direction_deg"):
        read(tmp_path, rows(heading_deg=[0.0] * 4, ground_speed_kt=[430.0] * 4))


def test_a_constant_several_names_and_a_time_of_two_columns(tmp_path):
    table = pd.DataFrame(
        {
            "Date": ["2009-07-01"] * 3,
            "UTC": ["12:00:00", "12:03:00", "12:06:00"],
            "lat": [40.0, None, 40.4],
            "LAT": [np.nan, 40.2, 41.0],
            "longitude": [-90.0] * 3,
            "pressure_hPa": [500.0] * 3,
            "wind_direction_deg": [270.0] * 3,
            "wind_speed_kt": [30.0] * 3,
        }
    )
    columns = {
        "tail": {"value": "N510"},
        "time": {"date": "Date", "time": "UTC"},
        "latitude": ["lat", "LAT", "Latitude"],
    }
    reports = read(tmp_path, table, columns=columns)
    assert reports["aircraft"].values.tolist() == ["N510"]
    np.testing.assert_allclose(reports["latitude"], [40.0, 40.2, 40.4])
    assert str(reports["time"].values[1])[:19] == "2009-07-01T12:03:00"


def test_an_offset_from_utc_is_taken_off(tmp_path):
    table = rows(wind_direction_deg=[270.0] * 4, wind_speed_kt=[30.0] * 4).drop(columns="time")
    table = table.assign(d="2009-07-01", t=[f"07:0{n}:00" for n in range(4)], o="-05:00")
    columns = {"time": {"date": "d", "time": "t", "offset": "o"}}
    assert str(read(tmp_path, table, columns=columns)["time"].values[0])[:16] == "2009-07-01T12:00"


def test_remarks_before_the_header(tmp_path):
    path = tmp_path / "remarks.csv"
    body = rows(wind_direction_deg=[270.0] * 4, wind_speed_kt=[30.0] * 4).to_csv(index=False)
    path.write_text("# made by a program\n# of 2009\n" + body)
    assert read_reports(path).sizes["report"] == 4
    path.write_text("#" + body.replace("N1,", "1,"))
    assert read_reports(path).sizes["report"] == 4


def test_only_what_is_wanted(tmp_path):
    table = rows(wind_direction_deg=[270.0] * 4, wind_speed_kt=[30.0] * 4, kind=list("ABAB"))
    reports = read(tmp_path, table, columns={"kind": {"only": ["A"]}})
    assert reports.sizes["report"] == 2
    assert json.loads(reports.attrs["reading_audit"])["dropped"] == {"not_wanted": 2}


def test_a_bad_form_of_a_mapping_is_one_message(tmp_path):
    with pytest.raises(InputError, match="value"):
        read(tmp_path, rows(), columns={"tail": {"values": "N510"}})
    with pytest.raises(InputError, match="is no number"):
        read(tmp_path, rows(), columns={"wind_speed_kt": {"value": "fast"}})


def test_only_in_the_configuration(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(
        "reports: {files: a.csv, only: {source: TAMDAR}, interval: 60 s,"
        " columns: {tail: {value: N1}, latitude: [lat, LAT]}}\n"
        "references: {ruc: {files: a.grb}}\noutput: out\n"
    )
    reports = load_config(path).reports
    assert reports.mapping["source"] == {"only": "TAMDAR"}
    assert reports.interval == 60.0


def test_real_mode_s_winds_are_the_authors_with_declination_zero(tmp_path):
    """They took the magnetic heading for true, indicated airspeed at the standard temperature."""
    raw = pd.read_csv(real(MODES))
    theirs = pd.read_csv(real(THEIR_WINDS)).drop_duplicates(["ts", "icao"])
    columns = {
        "icao": "tail",
        "ts": "time",
        "lat": "latitude",
        "lon": "longitude",
        "alt": "pressure_altitude_ft",
        "hdg": "heading_deg",
        "ias": "indicated_airspeed_kt",
        "gs_adsb": "ground_speed_kt",
        "trk_adsb": "track_deg",
    }
    raw = raw.drop_duplicates(["ts", "icao"]).drop(columns=["mach", "tas", "gs", "trk"])
    raw = raw.rename(columns={"hdg": "told"})
    path = tmp_path / "as_true.csv"
    raw.to_csv(path, index=False)
    columns["told"] = columns.pop("hdg")
    ours = read_reports(path, columns=columns)
    frame = pd.DataFrame(
        {
            "icao": np.repeat(ours["aircraft"].values, ours["row_size"].values),
            "ts": ours["time"].values.astype("datetime64[ns]").astype(float) / 1e9,
            "u": ours["eastward_wind"].values,
            "v": ours["northward_wind"].values,
        }
    )
    both = theirs.assign(ts=theirs["ts"].round(1)).merge(
        frame.assign(ts=frame["ts"].round(1)), on=["ts", "icao"]
    )
    apart = np.hypot(both["u"] - both["vwx"], both["v"] - both["vwy"]).dropna()
    assert apart.size > 39_000
    assert np.median(apart) < 0.015  # they round to 0.01 m/s
    assert np.quantile(apart, 0.9) < 0.04


def test_real_mode_s_is_understood_as_it_stands():
    reports = read_reports(real(MODES))
    assert reports.sizes["aircraft"] == 296
    derived = reports["wind_source"].values > 0
    assert derived.sum() > 40_000
    heading = reports["reported_heading"].values
    assert np.isfinite(heading[derived]).all()


def test_real_tamdar_among_other_data_of_the_hour():
    reports = read_reports(real(TAMDAR), columns={"source": {"only": "TAMDAR"}})
    assert (reports.sizes["aircraft"], reports.sizes["report"]) == (43, 878)


def test_real_tamdar_winds_are_those_of_the_soundings_of_the_same_hour(tmp_path):
    """878 reports of summer's weak winds, 473 of them within 150 km of a sounding."""
    reports = read_reports(real(TAMDAR), columns={"source": {"only": "TAMDAR"}})
    theirs, ours = [], []
    for _, one in sounding_winds(real(SOUNDINGS), tmp_path):
        place = (one["latitude"], one["longitude"])
        _, _, away = GEOD.inv(
            reports.longitude.values.astype(float),
            reports.latitude.values.astype(float),
            np.full(reports.sizes["report"], place[1]),
            np.full(reports.sizes["report"], place[0]),
        )
        height = np.log(reports.pressure.values.astype(float))
        near = (away < 150e3) & (height >= one["ln_p"][0]) & (height <= one["ln_p"][-1])
        for wind in ("eastward_wind", "northward_wind"):
            theirs.append(np.interp(height[near], one["ln_p"], one[wind]))
            ours.append(reports[wind].values[near])
    truth, found = np.concatenate(theirs), np.concatenate(ours)
    known = np.isfinite(found)
    truth, found = truth[known], found[known]
    assert found.size > 2 * 400
    assert abs((found - truth).mean()) < 0.3
    # over 100 km apart on the whole: winds from the opposite direction would differ by 6.9 m/s
    assert np.sqrt(((found - truth) ** 2).mean()) < 4.0
    assert np.sqrt(((found + truth) ** 2).mean()) > 6.0
    assert np.corrcoef(found, truth)[0, 1] > 0.6


def sounding_winds(path: Path, folder: Path):
    """Winds on the mandatory levels of every sounding, from the lowest pressure up."""
    plain = folder / "soundings.nc"
    plain.write_bytes(gzip.decompress(path.read_bytes()))
    with xr.open_dataset(plain, decode_times=False) as ds:
        table = {name: ds[name].values for name in ("staLat", "staLon", "prMan", "wsMan", "wdMan")}
    for number in range(table["staLat"].size):
        p, speed, angle = (table[name][number] for name in ("prMan", "wsMan", "wdMan"))
        good = (p > 1) & (p < 1200) & (speed < 150) & (angle <= 360)
        if good.sum() < 2:
            continue
        order = np.flatnonzero(good)[np.argsort(p[good])]
        turn = np.radians(angle[order])
        yield (
            number,
            {
                "latitude": float(table["staLat"][number]),
                "longitude": float(table["staLon"][number]),
                "ln_p": np.log(p[order] * 100.0),
                "eastward_wind": -speed[order] * np.sin(turn),
                "northward_wind": -speed[order] * np.cos(turn),
            },
        )


def log(path: Path, *, roll: float = 1.0) -> Path:
    """A G1000 log: five minutes north at 120 kt true, wind 20 kt from the west, 10 deg W."""
    lines = [
        '#airframe_info,log_version="1.00",airframe_name="Cessna 172S",system_id="0A1B2C"',
        "#yyy-mm-dd, hh:mm:ss,   hh:mm,  ident, degrees, degrees, ft Baro, inch, deg C, kt, kt,"
        " deg, deg, deg, kt",
        "  Lcl Date, Lcl Time, UTCOfst, AtvWpt, Latitude, Longitude, AltB, BaroA, OAT, IAS,"
        " GndSpd, Roll, HDG, TRK, TAS",
    ]
    place = (42.0, -71.0, 1500.0, 1.3e9)
    declination = np.degrees(FieldLattice.covering(*place).at(*place).declination)
    for second in range(300):
        clock = f"2011-03-13, 03:{6 + second // 60:02d}:{second % 60:02d},  -04:00"
        if second < 5:
            lines.append(f"{clock},      ,            ,             ,,,,,,,,,")
            continue
        latitude = 42.0 + second * 120 * KNOT / 111_195
        heading = (0.0 - declination) % 360.0
        track = (np.degrees(np.arctan2(20.0, 120.0)) - declination) % 360.0
        lines.append(
            f"{clock}, KBOS, {latitude:.7f}, -71.0000000, 4000.0, 30.12, 5.0, 112.0,"
            f" {np.hypot(120, 20):.2f}, {roll}, {heading:.3f}, {track:.3f}, 120.0"
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_flight_decks_log(tmp_path):
    reports = read_reports(log(tmp_path / "log_110313_030600_KBOS.csv"))
    assert reports["aircraft"].values.tolist() == ["0A1B2C"]
    assert reports.sizes["report"] == 295
    assert str(reports["time"].values[0])[:19] == "2011-03-13T07:06:05"
    np.testing.assert_allclose(reports["eastward_wind"], 20 * KNOT, atol=0.02)
    np.testing.assert_allclose(reports["northward_wind"], 0.0, atol=0.02)
    # 30.12 inHg is 185 ft below standard: indicated 4,000 ft is 3,815 ft of pressure altitude
    np.testing.assert_allclose(reports["pressure_altitude"] / 0.3048, 3815.0, atol=3.0)


def test_a_second_is_brought_to_an_interval(tmp_path):
    path = log(tmp_path / "log.csv")
    reports = read_reports(path, interval=60.0)
    assert reports.sizes["report"] == 5
    np.testing.assert_allclose(reports["eastward_wind"], 20 * KNOT, atol=0.02)
    assert json.loads(reports.attrs["reading_audit"])["dropped"]["averaged"] == 290


def trace(path: Path) -> Path:
    points = [
        [0, 52.0, 4.0, "ground", 12.0, 90.0, 0, 0, None],
        [
            10,
            52.1,
            4.0,
            30000,
            450.0,
            0.0,
            0,
            0,
            {"mag_heading": 358.0, "tas": 430, "oat": -45, "roll": 0.5, "flight": "KLM1 "},
        ],
        [20, 52.12, 4.0, 30000, 450.0, 0.0, 0, 0, None],
        [30, 52.14, 4.0, 30000, 450.0, 0.0, 1, 0, {"mag_heading": 358.0, "tas": 430}],
        [40, 52.16],
    ]
    content = {"icao": "484b5a", "timestamp": 1484136000.0, "trace": points}
    path.write_bytes(gzip.compress(json.dumps(content).encode()))
    return path


def test_a_receivers_trace(tmp_path):
    reports = read_reports(trace(tmp_path / "trace_full_484b5a.json"))
    assert reports["aircraft"].values.tolist() == ["484B5A"]
    assert np.isfinite(reports["eastward_wind"].values).tolist() == [True, False]
    audit = json.loads(reports.attrs["reading_audit"])
    assert audit["dropped"] == {"on_ground_or_stale": 2, "ragged_row": 1}
    assert inspect_file(tmp_path / "trace_full_484b5a.json")


def test_a_mean_over_straight_flight_and_the_middle_of_a_turn():
    count = 8
    columns = {
        "tail": np.zeros(count, np.int32),
        "flight": np.full(count, -1, np.int32),
        "time": np.datetime64("2009-07-01T00:00:00", "ns")
        + np.arange(count) * np.timedelta64(15, "s"),
        "latitude": np.linspace(40, 40.7, count),
        "longitude": np.array([179.9, 179.95, -180.0, -179.95, 10.0, 10.0, 10.0, 10.0]),
        "reported_heading": np.array([359.0, 1, 359, 1, 0, 40, 80, 120], np.float32),
        **{
            name: np.arange(count, dtype=np.float32)
            for name in ("pressure", "pressure_altitude", "eastward_wind", "northward_wind")
        },
        **{
            name: np.full(count, np.nan, np.float32)
            for name in ("air_temperature", "reported_airspeed")
        },
    }
    audit = Audit()
    averaged(columns, 60.0, audit)
    np.testing.assert_allclose(columns["eastward_wind"], [1.5, 6.0])
    assert columns["longitude"][0] == pytest.approx(179.975)
    assert float(columns["reported_heading"][0]) % 360 == pytest.approx(0.0, abs=1e-4)
    assert columns["reported_heading"][1] == 80.0
    assert audit.dropped["averaged"] == 6
