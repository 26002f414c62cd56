"""Garmin logs, receivers' traces, Mode-S messages and IODA."""

import json

import netCDF4
import numpy as np
import pandas as pd
import pytest
from tests.reports.tables import audit_of, write

from airswing.reports import read_file, read_reports
from airswing.reports.cleaning import declination
from airswing.units import FOOT, KNOT

NORTH_AT_120 = (np.hypot(120, 20), np.degrees(np.arctan2(20.0, 120.0)))
"""Ground speed (kt) and track of 120 kt north in a wind of 20 kt from the west."""


def g1000_log(path, *, altitude="AltB", version="1.00", bad_lines=0):
    """Five minutes north at 120 kt true, wind 20 kt from the west, declination 14 W."""
    lines = [
        f'#airframe_info,log_version="{version}",airframe_name="Cessna 172S",system_id="0A1B2C"',
        "#yyy-mm-dd, hh:mm:ss, hh:mm, ident, degrees, degrees, ft, inch, deg C, kt, kt, deg, deg",
        f"  Lcl Date, Lcl Time, UTCOfst, AtvWpt, Latitude, Longitude, {altitude}, BaroA, OAT, IAS,"
        " GndSpd, Roll, HDG, TRK, TAS",
    ]
    seconds = np.datetime64("2011-03-13", "s").astype(float)
    east = float(declination(*(np.array([v]) for v in (42.0, -71.0, 1200.0, seconds)))[0])
    speed, track = NORTH_AT_120
    for second in range(300):
        clock = f"2011-03-13, 03:{6 + second // 60:02d}:{second % 60:02d},  -04:00"
        if second < 5:  # before the receiver has a position
            lines.append(f"{clock},      ,            ,             ,,,,,,,,,")
            continue
        latitude = 42.0 + second * 120 * KNOT / 111_195
        lines.append(
            f"{clock}, KBOS, {latitude:.7f}, -71.0, 4000.0, 30.12, 5.0, 112.0, {speed:.2f}, 1.0,"
            f" {-east % 360:.3f}, {(track - east) % 360:.3f}, 120.0"
        )
    lines[20:20] = [lines[-1] + ", 1, 2, 3"] * bad_lines
    path.write_text("\n".join(lines) + "\n")
    return path


def test_bad_lines_of_a_log_are_counted(tmp_path):
    _, audit = read_file(g1000_log(tmp_path / "log.csv", bad_lines=2))
    assert audit.dropped == {"ragged_row": 2, "missing_position": 5}
    assert (audit.read, audit.usable) == (302, 295)


@pytest.mark.parametrize("variant", [{}, {"altitude": "AltInd", "version": "1.03"}])
def test_a_log_of_a_g1000(tmp_path, variant):
    reports = read_reports(g1000_log(tmp_path / "log_110313_030600_KBOS.csv", **variant))
    assert reports["aircraft"].values.tolist() == ["0A1B2C"]
    assert reports.sizes["report"] == 295
    assert str(reports["time"].values[0])[:19] == "2011-03-13T07:06:05"
    np.testing.assert_allclose(reports["eastward_wind"], 20 * KNOT, atol=0.05)
    np.testing.assert_allclose(reports["northward_wind"], 0.0, atol=0.05)
    # 30.12 inches of mercury are 182 ft above the standard: pressure altitude is lower by that
    np.testing.assert_allclose(reports["pressure_altitude"] / FOOT, 4000.0 - 185.0, atol=10.0)
    assert (reports["roll_flag"] == 1).all()


G5 = """#info,log_version="1.00",serial_number="0000000"
UTC Date (yyyy-mm-dd),UTC Time (hh:mm:ss),Latitude (WGS84 deg),Longitude (WGS84 deg),\
GPS Ground Speed (kt),GPS Ground Track (deg true),Magnetic Heading (deg),Pressure Altitude (ft),\
True Airspeed (kt)
UTC Date,UTC Time,Latitude,Longitude,GndSpd,TRK,HDG,AltMSL,TAS
2018-09-29,15:00:00,47.9,-97.1,123.69,94.04,76.0,5000,120.0
2018-09-29,15:00:01,47.9,-97.09915,123.69,94.04,76.0,5000,120.0
"""


def test_a_log_of_a_g5_has_a_true_track_and_a_magnetic_heading(tmp_path):
    (tmp_path / "g5.csv").write_text(G5)
    reports = read_reports(tmp_path / "g5.csv", columns={"tail": {"value": "N5"}})
    assert reports["aircraft"].values.tolist() == ["N5"]
    np.testing.assert_allclose(reports["reported_heading"], 79.2, atol=0.1)
    speed = np.hypot(reports["eastward_wind"], reports["northward_wind"]) / KNOT
    np.testing.assert_allclose(speed, 31.8, atol=0.1)


def trace():
    details = {"mag_heading": 0.0, "ias": 250.0, "tas": 400.0, "oat": -44.0, "flight": "KLM1 "}
    points = [[10.0 * k, 52.0 + 0.02 * k, 4.0, 30000, 400.0, 0.9, 0, 0, details] for k in range(5)]
    points += [[60.0, 52.2, 4.0, "ground", 0.0, 0.0, 0, 0, None]]
    points += [[70.0, 52.2, 4.0, 30000, 400.0, 0.9, 1, 0, None], [80.0, 52.2]]
    return {"icao": "~4840d6", "timestamp": 1484136000.0, "trace": points}


def test_a_receivers_trace(tmp_path):
    content = trace()
    (tmp_path / "trace.json").write_text(json.dumps(content))
    reports = read_reports(tmp_path / "trace.json")
    assert reports["aircraft"].values.tolist() == ["4840D6"]
    assert audit_of(reports)["dropped"] == {"on_ground_or_stale": 2, "ragged_row": 1}
    np.testing.assert_allclose(reports["reported_airspeed"], 400 * KNOT, rtol=1e-6)
    assert np.isfinite(reports["eastward_wind"]).all()
    content["trace"][2][4] = 10**400  # too large for a float: one wind is missing
    (tmp_path / "trace.json").write_text(json.dumps(content))
    reports = read_reports(tmp_path / "trace.json")
    assert reports["eastward_wind"].count() == 4


def messages():
    """Positions, ground vectors and headings of two aircraft, each in separate rows."""
    rows = []
    for tail in ("4840d6", "3c6444"):
        for k in range(30):
            begin = 1484136000.0 + 4 * k
            where = {"latitude": 52.0 + 0.0074 * k, "longitude": 4.0, "altitude": 30000.0}
            over_ground = {"groundspeed": 400.0, "track": 1.0 if k % 2 else 359.0}
            bds60 = {"heading": 0.0, "IAS": 250.0, "Mach": 0.7, "TAS": 410.0}
            rows += [
                {"timestamp": begin, "icao24": tail, **where, **over_ground},
                {"timestamp": begin + 1.5, "icao24": tail, "callsign": "KLM1"},
                {"timestamp": begin + 2.0, "icao24": tail, **bds60},
            ]
    return pd.DataFrame(rows)


def saved(folder, kind):
    path, table = folder / f"messages.{kind}", messages()
    if kind == "parquet":
        time = pd.to_datetime(table["timestamp"], unit="s", utc=True)
        table.assign(timestamp=time).to_parquet(path)
    elif kind == "csv":
        table.to_csv(path, index=False)
    elif kind in ("records", "columns"):
        table.to_json(path, orient=kind)
    else:  # rs1090 and jet1090: registers within the message
        with path.open("w") as file:
            for row in table.to_dict("records"):
                row = {key: value for key, value in row.items() if value == value}
                if "heading" in row:
                    row["bds60"] = {key: row.pop(key) for key in ("heading", "IAS", "Mach", "TAS")}
                    row |= {"df": "20", "bds50": None}
                file.write(json.dumps(row) + "\n")
    return path


@pytest.mark.parametrize("kind", ["parquet", "csv", "records", "columns", "jsonl"])
def test_messages_of_one_aircraft_are_merged(tmp_path, kind):
    frame, audit = read_file(saved(tmp_path, kind))
    assert sorted(frame["tail"].unique()) == ["3c6444", "4840d6"]
    # After the last position there is none to interpolate to.
    assert audit.dropped == {"merged_message": 120, "missing_position": 2}
    assert (len(frame), audit.read) == (58, 180)
    inner = frame[(frame["time"] < frame["time"].max())]
    assert inner["eastward_wind"].notna().all()
    np.testing.assert_allclose(inner["latitude"].iloc[0], 52.0 + 0.0037, atol=1e-6)
    # Track 359 to 1 the short way: north at 400 kt over ground, 410 kt through air.
    through_air = 410 * KNOT * np.cos(np.radians(inner["reported_heading"]))
    np.testing.assert_allclose(inner["northward_wind"], 400 * KNOT - through_air, atol=0.1)
    assert set(frame["flight"].astype(str).iloc[1:29]) == {"KLM1"}


def test_directions_and_longitudes_are_interpolated_the_short_way_round(tmp_path):
    """350 to 10 degrees and across the antimeridian, the message with the heading at 3/4."""
    rows = [
        (0.0, -179.9, 350.0, None),
        (3.0, None, None, 0.0),
        (4.0, 179.9, 10.0, None),
        (5.0, None, None, 0.0),
        (8.0, -179.9, 350.0, None),
    ]
    names = ("timestamp", "longitude", "track", "heading")
    table = pd.DataFrame(rows, columns=names).assign(icao24="4840d6", TAS=400.0)
    table["timestamp"] += 1484136000.0
    moving = table["track"].notna()
    for name, value in {"latitude": 52.0, "altitude": 30000.0, "groundspeed": 400.0}.items():
        table[name] = np.where(moving, value, np.nan)
    table.to_csv(tmp_path / "messages.csv", index=False)
    frame, audit = read_file(tmp_path / "messages.csv")
    np.testing.assert_allclose(frame["longitude"], [179.95, 179.95])
    heading = np.radians(frame["reported_heading"])
    north = frame["northward_wind"] + 400 * KNOT * np.cos(heading)
    east = frame["eastward_wind"] + 400 * KNOT * np.sin(heading)
    np.testing.assert_allclose(np.degrees(np.arctan2(east, north)), 5.0, atol=1e-3)
    assert not any(name.endswith("out_of_range") for name in (*audit.dropped, *audit.repaired))


def ioda(path, *, old=False):
    """Three reports of two aircraft, in the groups of today or in names of earlier versions."""
    variables = {
        "latitude": ("MetaData", "latitude", "f4", [40.0, 40.1, 41.0]),
        "longitude": ("MetaData", "longitude", "f4", [260.0, 260.1, 261.0]),
        "dateTime": ("MetaData", "datetime", "i8", [1, 180, 360]),
        "pressure": ("MetaData", "air_pressure", "f4", [3e4, 3e4, 5e4]),
        "windEastward": ("ObsValue", "eastward_wind", "f4", [10.0, 11.0, 9e36]),
        "windNorthward": ("ObsValue", "northward_wind", "f4", [1.0, 2.0, 3.0]),
        "stationIdentification": ("MetaData", "station_id", str, ["A1", "A1", "B2"]),
    }
    if old:
        times = ["2020-12-15T00:00:01Z", "2020-12-15T00:03:00Z", "2020-12-15T00:06:00Z"]
        variables["dateTime"] = ("MetaData", "datetime", str, times)
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("Location", 3)
        for name, (group, earlier, kind, values) in variables.items():
            where = file if old else file.createGroup(group)
            theirs = f"{earlier}@{group}" if old else name
            variable = where.createVariable(theirs, kind, ("Location",))
            variable[:] = np.array(values, dtype=object if kind is str else None)
        if not old:
            file["MetaData/dateTime"].units = "seconds since 2020-12-15"
            marker = file.createGroup("QualityMarker")
            marker.createVariable("windEastward", "i4", ("Location",))[:] = [2, 9, 2]
            marker.createVariable("airTemperature", "i4", ("Location",))[:] = [9, 2, 2]
    return path


@pytest.mark.parametrize("old", [False, True])
def test_an_ioda_file_is_read_in_both_layouts(tmp_path, old):
    frame, audit = read_file(ioda(tmp_path / "aircraft.nc4", old=old))
    assert audit.formats == {"ioda": 1}
    assert frame["tail"].tolist() == ["A1", "A1", "B2"]
    assert frame["time"].iloc[0] == pd.Timestamp("2020-12-15T00:00:01")
    np.testing.assert_allclose(frame["longitude"], [-100.0, -99.9, -99.0], atol=1e-4)
    np.testing.assert_allclose(frame["eastward_wind"], [10.0, 11.0, np.nan])
    assert frame["wind_qc"].tolist() == ([0, 0, 0] if old else [0, 2, 0])
    assert frame["temperature_qc"].tolist() == ([0, 0, 0] if old else [2, 0, 0])


def test_times_of_ioda_in_any_unit(tmp_path):
    with netCDF4.Dataset(ioda(tmp_path / "aircraft.nc4"), "a") as file:
        file["MetaData/dateTime"].units = "minute since 2020-12-15"
    frame, _ = read_file(tmp_path / "aircraft.nc4")
    assert frame["time"].iloc[1] == pd.Timestamp("2020-12-15T03:00")


def test_real_mode_s_winds_are_the_authors_with_declination_zero(tmp_path, real):
    """They took the magnetic heading for true, indicated airspeed at the standard temperature."""
    raw = pd.read_csv(real("modes/mpm_20170111_12z_aggregated.csv"))
    theirs = pd.read_csv(real("modes/mpm_20170111_12z_wind.csv")).drop_duplicates(["ts", "icao"])
    names = {
        **{"icao": "tail", "ts": "time", "lat": "latitude", "lon": "longitude"},
        **{"alt": "pressure_altitude_ft", "hdg": "heading_deg", "ias": "indicated_airspeed_kt"},
        **{"gs_adsb": "ground_speed_kt", "trk_adsb": "track_deg"},
    }
    table = raw.drop_duplicates(["ts", "icao"])[list(names)].rename(columns=names)
    ours, _ = read_file(write(tmp_path / "as_true.csv", table))
    seconds = ours["time"].to_numpy().astype("datetime64[ns]").astype(float) / 1e9
    frame = ours.assign(ts=seconds.round(1), icao=ours["tail"].astype(str))
    pair = theirs.assign(ts=theirs["ts"].round(1)).merge(frame, on=["ts", "icao"])
    difference = np.hypot(pair["eastward_wind"] - pair["vwx"], pair["northward_wind"] - pair["vwy"])
    difference = difference.dropna()
    assert difference.size > 39_000
    assert np.median(difference) < 0.015  # they round to 0.01 m/s
    assert np.quantile(difference, 0.9) < 0.04
