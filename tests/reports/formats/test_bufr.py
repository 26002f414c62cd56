"""BUFR: the real files against eccodes' decoding, every template, and damaged messages."""

import eccodes
import numpy as np
import pandas as pd
import pytest
from benchmarks.fuzz.seeds import bufr_file
from tests.reports.tables import audit_of

from airswing.guarded import WorkerEndedError, guarded
from airswing.products.ragged import aircraft_of_report
from airswing.reports import read_file, read_reports
from airswing.reports.formats.bufr import decode_messages

EVERY = pytest.param(1, 6698, marks=pytest.mark.slow)


@pytest.mark.parametrize(("step", "number"), [(8, 838), EVERY])
def test_the_real_file_agrees_with_eccodes_report_by_report(real, tmp_path, step, number):
    messages = real("reports/amdar_20090123_europe.bufr").read_bytes().split(b"BUFR")[1::step]
    path = tmp_path / "part.bufr"
    path.write_bytes(b"".join(b"BUFR" + body for body in messages))
    tails = ("aircraftRegistrationNumberOrOtherIdentification", "aircraftFlightNumber")
    numbers = ("latitude", "longitude", "hour", "minute", "windSpeed", "airTemperature")

    def value(message, key):
        try:
            return eccodes.codes_get(message, f"#1#{key}")
        except eccodes.KeyValueNotFoundError:
            return ""

    rows = []
    with path.open("rb") as file:
        while (message := eccodes.codes_bufr_new_from_file(file)) is not None:
            eccodes.codes_set(message, "unpack", 1)
            names = [value(message, key).strip() for key in tails]
            rows.append([names[0] or names[1], *(value(message, key) for key in numbers)])
            eccodes.codes_release(message)
    theirs = pd.DataFrame(rows, columns=["tail", *numbers])
    named = theirs[theirs["tail"] != ""].replace(-1e100, np.nan).reset_index(drop=True)
    frame, audit = read_file(path)
    assert audit.read == len(theirs) == len(messages) == number
    assert audit.dropped == {"missing_tail": len(theirs) - len(named)}
    assert frame["tail"].tolist() == named["tail"].tolist()
    minute = (frame["time"] - pd.Timestamp("2009-01-23")) // pd.Timedelta("1min")
    assert minute.tolist() == (60 * named["hour"] + named["minute"]).tolist()
    np.testing.assert_allclose(frame[["latitude", "longitude"]], named[["latitude", "longitude"]])
    np.testing.assert_allclose(frame["air_temperature"], named["airTemperature"], rtol=1e-6)
    valid = frame["wind_speed"].notna()
    np.testing.assert_allclose(frame["wind_speed"][valid], named["windSpeed"][valid], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "tail", "time", "altitude", "speed", "codes"),
    [
        ("ecmwf-acars1", "YTIUIERA", "2012-01-07T09:15:00", 914.6, 20.6, (1, 0)),
        ("ecmwf-amdar1", "EU0068", "2012-08-07T09:00:00", 150.0, 6.0, (3, 0)),
        ("gts-acars-uk1", "EU3375", "2009-02-24T11:31:00", 6260.0, 33.4, (2, 1)),
        ("gts-acars-us1", "FJCYR4RA", "2009-02-24T11:31:52", 8199.0, 43.2, (0, 0)),
        ("gts-acars1", "EU5331", "2009-02-24T11:31:00", 1380.0, 3.1, (3, 1)),
        ("gts-acars2", "FJCYR4RA", "2009-02-24T11:31:52", 8199.0, 43.2, (0, 0)),
        ("test-airep1", "EU4824", "2004-11-30T12:00:00", 9790.0, 39.1, (1, 0)),
    ],
)
def test_every_small_template(real, name, tail, time, altitude, speed, codes):
    frame, _ = read_file(real(f"reports/dballe_{name}.bufr"))
    assert len(frame) == 1
    report = frame.iloc[0]
    assert (report["tail"], report["time"]) == (tail, pd.Timestamp(time))
    assert report["pressure_altitude"] == pytest.approx(altitude, abs=0.1)
    assert report["wind_speed"] == pytest.approx(speed, abs=1e-4)
    assert (report["roll_flag"]) == codes[1]
    assert read_reports(real(f"reports/dballe_{name}.bufr"))["phase"].item() == codes[0]


def encoded(path, template, values, **header):
    """Write a message of a template; values by key with its number, ``#1#latitude``."""
    message = eccodes.codes_bufr_new_from_samples("BUFR4")
    first = {"masterTablesVersionNumber": 33, "localTablesVersionNumber": 0, "dataCategory": 4}
    for key, value in {**first, **header, "unexpandedDescriptors": template, **values}.items():
        if isinstance(value, list) and isinstance(value[0], str):
            eccodes.codes_set_string_array(message, key, value)
        elif isinstance(value, list):
            eccodes.codes_set_array(message, key, np.array(value))
        else:
            eccodes.codes_set(message, key, value)
    eccodes.codes_set(message, "pack", 1)
    with path.open("wb") as file:
        eccodes.codes_write(message, file)
    eccodes.codes_release(message)
    return path


@pytest.mark.parametrize("compressed", [0, 1])
def test_the_current_template_with_several_subsets(tmp_path, compressed):
    columns = dict(
        aircraftTailNumber=["N1", "N2", "N2"],
        aircraftFlightNumber=["F1", "F2", "F3"],
        **{"year": [2021] * 3, "month": [2] * 3, "day": [1] * 3, "hour": [11, 11, 12]},
        **{"minute": [59, 59, 0], "second": [49, 50, 1]},
        latitude=[54.985, 10.0, 10.1],
        longitude=[77.23833, 179.9, -179.9],
        flightLevel=[10058, 11000, 11010],
        detailedPhaseOfFlight=[3, 7, 2],
        windDirection=[354, 90, 180],
        windSpeed=[3.1, 10.0, 20.0],
        airTemperature=[211.2, 220.0, 221.0],
        aircraftTrueAirspeed=[230.0, 231.0, 232.0],
        aircraftTrueHeading=[90.0, 91.0, 92.0],
        aircraftRollAngleQuality=[0, 1, 3],
    )
    values = {f"#1#{key}": column for key, column in columns.items()}
    if not compressed:
        values = {f"#{n + 1}#{key}": columns[key][n] for key in columns for n in range(3)}
    path = encoded(
        tmp_path / "a.bufr",
        311010,
        values,
        numberOfSubsets=3,
        compressedData=compressed,
        inputDelayedDescriptorReplicationFactor=[0] * 18,
        inputShortDelayedDescriptorReplicationFactor=[0] * 18,
    )
    ds = read_reports(path)
    assert ds["aircraft"].to_numpy().tolist() == ["N1", "N2"]
    assert ds["row_size"].to_numpy().tolist() == [1, 2]
    np.testing.assert_allclose(ds["longitude"], columns["longitude"], atol=1e-5)
    np.testing.assert_allclose(ds["reported_airspeed"], columns["aircraftTrueAirspeed"])
    np.testing.assert_allclose(ds["reported_heading"], columns["aircraftTrueHeading"])
    np.testing.assert_allclose(ds["eastward_wind"], [0.324, -10.0, 0.0], atol=1e-3)
    assert ds["phase"].to_numpy()[:2].tolist() == [2, 1]
    assert ds["roll_flag"].to_numpy().tolist() == [1, 2, 2]  # unsteady means banked
    assert ds["time"].to_numpy()[2] == np.datetime64("2021-02-01T12:00:01")


def test_a_broken_message_does_not_lose_the_others(tmp_path, real):
    good = real("reports/dballe_ecmwf-amdar1.bufr").read_bytes()
    assert good.count(b"\xcb\x01") == 1  # the template's descriptor 3 11 001
    unknown = good.replace(b"\xcb\x01", b"\xcb\xfe")
    (tmp_path / "a.bufr").write_bytes(unknown + good + good[:-30])
    frame, audit = read_file(tmp_path / "a.bufr")
    assert frame["tail"].tolist() == ["EU0068"]
    assert (audit.read, audit.dropped) == (3, {"undecodable_message": 2})


def test_a_message_that_ends_the_process_costs_one_report(tmp_path):
    """Wrong lengths of sections 1 and 3: ecCodes reads outside the message and ends the process."""
    path = tmp_path / "a.bufr"
    bufr_file(path)
    sound = read_reports(path)
    messages = [b"BUFR" + body for body in path.read_bytes().split(b"BUFR")[1:]]
    deadly = bytearray(messages[0])
    deadly[10], deadly[39] = 68, 127
    with pytest.raises(WorkerEndedError):
        guarded(decode_messages, [bytes(deadly)])
    path.write_bytes(b"".join([messages[1], bytes(deadly), b"noise", *messages[2:]]))
    read = read_reports(path)
    assert audit_of(read)["dropped"] == {"undecodable_message": 1}
    assert read.sizes["report"] == sound.sizes["report"] - 1 == 11
    same = np.isin(sound["aircraft"].to_numpy()[aircraft_of_report(sound)], read["aircraft"])
    np.testing.assert_array_equal(read["eastward_wind"], sound["eastward_wind"][same])


@pytest.mark.parametrize("template", [311008, 311009])
@pytest.mark.parametrize("number", [3, 1])
def test_each_level_of_a_profile_has_its_own_wind_and_place(tmp_path, template, number):
    """An AMDAR profile: altitude, direction, speed and, in 3 11 009, a place each level."""
    header = dict(year=2024, month=7, day=1, hour=10, minute=20, second=0)
    header |= dict(latitude=52.3, longitude=4.76, phaseOfAircraftFlight=5)
    values = {f"#1#{key}": value for key, value in header.items()}
    values["aircraftRegistrationNumberOrOtherIdentification"] = "EU7777"
    for n in range(number):
        values |= {f"#{n + 1}#flightLevel": 300 + 400 * n, f"#{n + 1}#windSpeed": 5.0 + n}
        values[f"#{n + 1}#windDirection"] = 200 + 5 * n
        if template == 311009:
            values |= {f"#{n + 2}#latitude": 52.3 + 0.02 * n, f"#{n + 2}#longitude": 4.8}
    levels = {"inputDelayedDescriptorReplicationFactor": [number]}
    frame, audit = read_file(encoded(tmp_path / "a.bufr", template, values, **levels))
    assert frame["tail"].tolist() == ["EU7777"] * number
    assert audit.dropped == {} and (frame["phase"] == 1).all()
    level = np.arange(number)
    np.testing.assert_allclose(frame["pressure_altitude"], 300 + 400 * level)
    np.testing.assert_allclose(frame["wind_speed"], 5.0 + level, atol=1e-4)
    place = 52.3 + 0.02 * level * (template == 311009)
    np.testing.assert_allclose(frame["latitude"], place, atol=1e-5)
