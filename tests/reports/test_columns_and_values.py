"""Column names, units and mappings; times and flag codes."""

import numpy as np
import pandas as pd
import pytest

from airswing.errors import InputError
from airswing.flags import ICING, PHASE, ROLL
from airswing.reports import Audit
from airswing.reports.columns import (
    conversion,
    decode_flags,
    parse_mapping,
    parse_times,
    possible,
    sources,
    split_name,
)

PLAIN = ["tail", "time", "latitude", "longitude"]
WIND = ["wind_direction_deg", "wind_speed_kt"]
NOON = np.datetime64("2009-01-05T12:00:00", "ns")


@pytest.mark.parametrize(
    ("name", "value", "variable", "si"),
    [
        ("pressure_altitude_ft", 1000.0, "pressure_altitude", 304.8),
        ("pressure_altitude_hft", 350.0, "pressure_altitude", 10668.0),
        ("pressure_hPa", 500.0, "pressure", 50000.0),
        ("pressure_mb", 500.0, "pressure", 50000.0),
        ("wind_speed_kt", 3600.0, "wind_speed", 1852.0),
        ("Wind_Speed_m_s", 7.0, "wind_speed", 7.0),
        ("wind_speed_km_h", 36.0, "wind_speed", 10.0),
        ("temperature_degC", -20.0, "air_temperature", 253.15),
        ("temperature_degF", 32.0, "air_temperature", 273.15),
        ("heading_rad", np.pi, "reported_heading", 180.0),
        ("true_airspeed_kt", 3600.0, "reported_airspeed", 1852.0),
        ("latitude", 40.0, "latitude", 40.0),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_understood(name, value, variable, si):
    quantity, unit = split_name(name)
    assert quantity.variable == variable
    factor, offset = conversion(unit, quantity.si_unit)
    assert value * factor + offset == pytest.approx(si, rel=1e-12)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"W": {"name": "wind_speed_kt", "unit": "hPa"}}, ["W", "hPa", "wind_speed_kt", "m/s"]),
        ({"W": {"name": "wind_speed_kt", "unit": "smoots"}}, ["smoots", "wind_speed_kt"]),
        ({"W": "wind_sped_kt"}, ["wind_sped_kt", "wind_speed_kt"]),
        ({"W": {"name": "tail", "unit": "kt"}}, ["tail has no unit"]),
        ({"W": {"nam": "tail"}}, ["{name: ..., unit: ...}"]),
        ({"A": "wind_speed_kt", "B": "wind_speed_m_s"}, ["two columns", "A, B"]),
        ({"wind_speed_kt": {"value": "fast"}}, ["is not a number"]),
        ({"W": {"name": "time", "format": "%d.%Q"}}, ["W.format", "bad directive", "%d.%m.%Y"]),
    ],
)
def test_a_bad_mapping_is_refused_by_name(columns, words):
    with pytest.raises(InputError) as error:
        parse_mapping(columns)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize(
    ("names", "mapping", "message"),
    [
        (["tail", "time", "lat", "longitude", *WIND, "pressure_hPa"], {}, "Nearest there: lat"),
        ([*PLAIN, "wind_dir", "wind_speed_kt", "pressure_hPa"], {}, "Nearest there: wind_dir"),
        (["AltM", "UTC", "Aircraft", "lat", "lon", *WIND], {}, "tail: .*Nearest there: Aircraft. "),
        (["ail", *PLAIN[1:], "AltM", *WIND], {}, "tail: .*Nearest there: ail. "),
        ([*PLAIN, *WIND, "AltM"], {}, "pressure_altitude_ft: .*Nearest there: AltM. "),
        ([*PLAIN, *WIND], {}, "neither pressure_altitude_ft nor pressure_hPa"),
        ([*PLAIN, *WIND, "pressure_hPa"], {"W": "wind_speed_kt"}, "W: the mapped column is not"),
        ([*PLAIN, "heading_deg", "ground_speed_kt", "pressure_hPa"], {}, "wind_direction_deg"),
    ],
)
def test_an_absent_column_is_named_with_the_nearest(names, mapping, message):
    with pytest.raises(InputError, match=f"{message}.*airswing inspect"):
        sources(names, parse_mapping(mapping))


@pytest.mark.parametrize(
    "value",
    [
        "2009-01-05T12:00:00Z",
        "2009-01-05 12:00:00",
        "2009-01-05T06:00:00-06:00",
        " 2009-01-05T12:00:00.000Z ",
        "20090105T120000Z",
        *(kind(n) for n in (2009010512, 200901051200, 20090105120000) for kind in (int, str)),
        *(kind(1231156800 * 1000**n) for n in range(4) for kind in (int, str)),
        *("2454837.0", 2454837.0),
        pd.Timestamp("2009-01-05T06:00:00-06:00"),
    ],
)
def test_one_time_in_many_notations(value):
    time, blank = parse_times(pd.Series([value]))
    assert time[0] == NOON
    assert not blank[0]


def test_blank_and_unreadable_times_differ_and_rows_keep_their_notation():
    values = ["", "  ", None, "noon", "05/01/2009 12:00", "2009-13-01", "2009-01-05T13:00+01:00"]
    time, blank = parse_times(pd.Series(values))
    assert np.isnat(time).tolist() == [True] * 6 + [False]
    assert blank.tolist() == [True, True, True, False, False, False, False]
    assert time[6] == NOON
    fraction, _ = parse_times(pd.Series(["2009-01-05T12:00:00.25Z", "1231156800.25"]))
    assert (fraction - NOON).tolist() == [250_000_000, 250_000_000]


@pytest.mark.parametrize(
    "value",
    # elapsed seconds, a date, a modified Julian date, the far future
    [0, 3600, 20240701, 54836.5, "2099-01-01T00:00:00Z", "1969-12-31T00:00Z", 2099010100],
)
def test_times_that_no_report_can_have_are_not_possible(value):
    assert not possible(parse_times(pd.Series([value]))[0])[0]


@pytest.mark.parametrize(
    ("flag", "codes", "values", "meanings"),
    [
        (
            *("roll_flag", ROLL, ["G", "b", "N", "", "-", " G ", None, "Z", float("nan")]),
            "good bad not_available missing missing good missing missing missing",
        ),
        (
            *("phase", PHASE, ["ascent", "Cruise", "DESCENT", "", "hover"]),
            "ascent cruise descent unknown unknown",
        ),
        (
            *("icing", ICING, ["0", "1", 0.0, 1, 1.0, "", None, True, "2"]),
            "off on off on on missing missing on missing",
        ),
    ],
)
def test_flag_codes_are_decoded_and_counted(flag, codes, values, meanings):
    audit = Audit()
    decoded = decode_flags(values, flag, audit).tolist()
    assert decoded == [codes[name] for name in meanings.split()]
    assert sum(audit.flags[flag].values()) == len(values)
    assert audit.repaired == {f"{flag}_unknown_code": 1}
    if flag == "roll_flag":
        assert audit.flags[flag] == {"G": 2, "b": 1, "N": 1, "blank": 3, "-": 1, "Z": 1}
