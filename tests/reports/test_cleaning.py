"""Cleaning: what is dropped, what is repaired, and what the wind becomes."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.flags import WIND_SOURCE
from airswing.reports.audit import Audit
from airswing.reports.cleaning import clean

TIME = np.datetime64("2009-01-05T12:00:00", "ns")


def piece(rows=1, **values):
    """Raw piece in SI with some columns replaced."""
    defaults = {"tail": "N412XJ", "time": TIME, "latitude": 41.5, "longitude": -87.25}
    defaults |= {"pressure_altitude": 5000.0, "wind_direction": 270.0, "wind_speed": 20.0}
    return pd.DataFrame({**defaults, **values}, index=range(rows))


def cleaned(rows=1, **values):
    audit = Audit()
    return clean(piece(rows, **values), audit), audit


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"tail": ""}, "missing_tail"),
        ({"tail": None}, "missing_tail"),
        ({"time": np.datetime64("NaT", "ns")}, "missing_time"),
        ({"time": np.datetime64("NaT", "ns"), "time_blank": False}, "unparsable_time"),
        ({"time": np.datetime64("1970-01-01", "ns")}, "time_out_of_range"),
        ({"time": np.datetime64("2150-01-01", "ns")}, "time_out_of_range"),
        ({"latitude": np.nan}, "missing_position"),
        ({"longitude": np.inf}, "missing_position"),
        ({"latitude": 90.5}, "latitude_out_of_range"),
        ({"longitude": -180.5}, "longitude_out_of_range"),
        ({"longitude": 360.5}, "longitude_out_of_range"),
    ],
)
def test_a_report_without_tail_time_or_position_is_dropped_for_one_reason(values, reason):
    frame, audit = cleaned(**values)
    assert len(frame) == 0
    assert audit.dropped == {reason: 1}
    assert (audit.read, audit.usable) == (1, 0)


def test_longitudes_and_headings_are_brought_to_one_range():
    frame, audit = cleaned(6, longitude=[0.0, 179.5, 180.0, 272.75, 360.0, -180.0])
    assert frame["longitude"].tolist() == [0.0, 179.5, -180.0, -87.25, 0.0, -180.0]
    assert audit.repaired["longitude_wrapped"] == 3
    frame, audit = cleaned(2, reported_heading=[-34.5, 20.0])
    assert frame["reported_heading"].tolist() == [325.5, 20.0]
    assert audit.repaired["reported_heading_wrapped"] == 1


def test_calm_has_no_wind_whatever_its_direction():
    frame, audit = cleaned(4, wind_direction=[0.0, 137.0, 360.0, np.nan], wind_speed=0.0)
    assert (frame[["eastward_wind", "northward_wind"]] == 0.0).all(axis=None)
    assert frame["wind_direction"].isna().all()
    assert audit.repaired["calm_without_direction"] == 1


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("wind_speed", [-1.0, 151.0]),
        ("wind_direction", [361.0, -181.0]),
        ("air_temperature", [100.0, 400.0]),
        ("pressure_altitude", [30000.0]),
        ("reported_airspeed", [-5.0]),
        ("reported_heading", [400.0]),
    ],
)
def test_impossible_values_become_missing_and_are_counted(name, values):
    frame, audit = cleaned(len(values), **{name: values})
    assert frame[name].isna().tolist() == [True] * len(values)
    assert audit.repaired[f"{name}_out_of_range"] == len(values)
    if name.startswith("wind"):  # half a wind is no wind
        assert frame[["eastward_wind", "northward_wind", "wind_speed"]].isna().all(axis=None)
        assert audit.repaired["wind_incomplete"] == len(values)


def test_pressure_follows_from_altitude_and_the_reverse():
    # ICAO Doc 7488: 54019.9 Pa at 5000 m, 19330.4 Pa at 12000 m (two layers)
    frame, _ = cleaned(2, pressure_altitude=[5000.0, 12000.0])
    np.testing.assert_allclose(frame["pressure"], [54019.9, 19330.4], rtol=2e-5)
    frame, _ = cleaned(pressure_altitude=np.nan, pressure=54019.9)
    np.testing.assert_allclose(frame["pressure_altitude"], 5000.0, atol=0.1)


def test_the_wind_at_an_unset_position_fails():
    frame, audit = cleaned(2, latitude=[0.0, 0.0], longitude=[0.0, -91.0])
    assert frame["wind_qc"].tolist() == [2, 0]
    assert audit.repaired["wind_failed_at_origin"] == 1


def test_components_in_place_of_speed_and_direction():
    source = piece(2).drop(columns=["wind_speed", "wind_direction"])
    frame = clean(source.assign(eastward_wind=3.0, northward_wind=[4.0, np.nan]), Audit())
    assert frame["wind_speed"][0] == 5.0
    assert frame["wind_direction"][0] == pytest.approx(180.0 + np.degrees(np.arctan2(3, 4)))
    assert np.isnan(frame["eastward_wind"][1])


def with_motion(**values):
    """A report of heading, airspeed and ground vector without a wind."""
    windless = piece().drop(columns=["wind_direction", "wind_speed"])
    motion = {"reported_heading": 0.0, "reported_airspeed": 200.0, "ground_speed": 200.0}
    audit = Audit()
    return clean(windless.assign(**{**motion, "track": 0.0, **values}), audit), audit


def test_the_wind_of_a_triangle_computed_by_hand():
    """North at 200 m/s through air, over ground 200 m/s north and 15 m/s east."""
    over_ground = {"ground_speed": np.hypot(200, 15), "track": np.degrees(np.arctan2(15, 200))}
    frame, audit = with_motion(**over_ground)
    np.testing.assert_allclose(frame["eastward_wind"], 15.0, atol=1e-3)
    np.testing.assert_allclose(frame["northward_wind"], 0.0, atol=1e-3)
    assert frame["wind_source"].tolist() == [WIND_SOURCE["derived"]]
    assert audit.repaired["wind_derived"] == 1
    frame, _ = with_motion(wind_direction=180.0, wind_speed=10.0, **over_ground)
    np.testing.assert_allclose(frame["northward_wind"], 10.0, atol=1e-4)
    assert frame["wind_source"].tolist() == [WIND_SOURCE["reported"]]
    _, audit = with_motion(ground_speed=30.0)
    assert audit.repaired["derived_wind_out_of_range"] == 1


def test_airspeeds_from_mach_and_indicated_airspeed_say_their_temperature():
    frame, _ = with_motion(reported_airspeed=np.nan, mach=0.7, air_temperature=255.65)
    # ICAO Doc 7488: the speed of sound is 320.5 m/s at 5,000 m
    np.testing.assert_allclose(frame["reported_airspeed"], 0.7 * 320.5, atol=0.1)
    assert frame["wind_source"].tolist() == [WIND_SOURCE["derived"]]
    frame, _ = with_motion(reported_airspeed=np.nan, indicated_airspeed=150.0)
    assert frame["wind_source"].tolist() == [WIND_SOURCE["derived_at_standard_temperature"]]
    assert 185.0 < frame["reported_airspeed"][0] < 195.0


def floats(low, high):
    return st.floats(low, high) | st.just(float("nan"))


REPORT = st.fixed_dictionaries(
    {
        "tail": st.sampled_from(["A", "", "NA"]),
        "latitude": floats(-400, 400),
        "longitude": floats(-400, 400),
        "wind_speed": floats(-10, 200),
        "wind_direction": floats(-10, 370),
    }
)


@given(st.lists(REPORT, min_size=1, max_size=20))
def test_every_report_is_kept_or_dropped_once_and_what_stays_is_possible(reports):
    frame, audit = cleaned(len(reports), **pd.DataFrame(reports).to_dict("list"))
    assert (audit.read, audit.usable) == (len(reports), len(frame))
    assert frame["latitude"].between(-90, 90).all()
    assert ((frame["longitude"] >= -180) & (frame["longitude"] < 180)).all()
    assert (frame["eastward_wind"].isna() == frame["northward_wind"].isna()).all()
    measured = frame[frame["eastward_wind"].notna()]
    speed = np.hypot(measured["eastward_wind"], measured["northward_wind"])
    np.testing.assert_allclose(speed, measured["wind_speed"], atol=1e-4)
