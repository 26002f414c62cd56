"""Columns: names, units, and messages that name what is wrong."""

from __future__ import annotations

import pytest

from airswing.errors import InputError
from airswing.reports.columns import canonical_names, parse_mapping, sources, split_name

PLAIN = ["tail", "time", "latitude", "longitude"]
WIND = ["wind_direction_deg", "wind_speed_kt"]


@pytest.mark.parametrize(
    ("name", "value", "si"),
    [
        ("pressure_altitude_ft", 1000.0, 304.8),
        ("pressure_altitude_m", 1000.0, 1000.0),
        ("pressure_altitude_hft", 350.0, 10668.0),
        ("pressure_hPa", 500.0, 50000.0),
        ("pressure_mb", 500.0, 50000.0),
        ("pressure_Pa", 500.0, 500.0),
        ("wind_speed_kt", 3600.0, 1852.0),
        ("wind_speed_m_s", 7.0, 7.0),
        ("wind_speed_mps", 7.0, 7.0),
        ("wind_speed_km_h", 36.0, 10.0),
        ("temperature_degC", -20.0, 253.15),
        ("temperature_K", 253.15, 253.15),
        ("temperature_C", 0.0, 273.15),
        ("temperature_degF", 32.0, 273.15),
        ("heading_rad", 3.141592653589793, 180.0),
        ("true_airspeed_kt", 250.0, 250.0 * 1852.0 / 3600.0),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_understood(name, value, si):
    levels = [] if name.startswith("pressure") else ["pressure_altitude_ft"]
    rest = [other for other in WIND if other.split("_")[1] not in name or "wind" not in name]
    found = sources([*PLAIN, *levels, *rest, name], {}, "x.csv")
    quantity, _ = split_name(name)
    source = found[quantity.variable]
    assert source.column == name
    assert value * source.factor + source.offset == pytest.approx(si, rel=1e-12)


@pytest.mark.parametrize("name", ["pressure_altitude", "wind_speed", "pressure_m", "speed_kt"])
def test_a_name_without_a_fitting_unit_is_not_guessed(name):
    assert split_name(name) is None


def test_every_canonical_name_can_be_mapped_to():
    for name in canonical_names():
        ((_, source),) = parse_mapping({"theirs": name}).values()
        assert source.column == "theirs"


def test_a_mapped_column_takes_the_users_unit():
    mapping = parse_mapping(
        {"WSPD": {"name": "wind_speed_kt", "unit": "m/s"}, "ALT": "pressure_altitude_m"}
    )
    found = sources([*PLAIN, "WSPD", "ALT", "wind_direction_deg"], mapping, "x.csv")
    assert (found["wind_speed"].column, found["wind_speed"].factor) == ("WSPD", 1.0)
    assert found["pressure_altitude"].factor == 1.0


def test_a_mapped_column_comes_before_one_of_that_name():
    mapping = parse_mapping({"corrected": "wind_speed_kt"})
    names = [*PLAIN, *WIND, "pressure_hPa", "corrected"]
    assert sources(names, mapping, "x.csv")["wind_speed"].column == "corrected"


@pytest.mark.parametrize(
    ("columns", "parts"),
    [
        ({"W": {"name": "wind_speed_kt", "unit": "hPa"}}, ["W", "hPa", "wind_speed_kt", "m/s"]),
        ({"W": {"name": "wind_speed_kt", "unit": "smoots"}}, ["smoots", "wind_speed_kt"]),
        ({"W": "wind_sped_kt"}, ["wind_sped_kt", "wind_speed_kt"]),
        ({"W": {"name": "tail", "unit": "kt"}}, ["tail has no unit"]),
        ({"W": {"nam": "tail"}}, ["{name: ..., unit: ...}"]),
        ({"A": "wind_speed_kt", "B": "wind_speed_m_s"}, ["two columns", "A, B"]),
    ],
)
def test_a_bad_mapping_is_refused_by_name(columns, parts):
    with pytest.raises(InputError) as error:
        parse_mapping(columns)
    for part in parts:
        assert part in str(error.value)


def test_a_missing_column_names_the_nearest():
    names = ["tail", "time", "lat", "longitude", "wind_dir", "wind_speed_kt", "pressure_hPa"]
    with pytest.raises(InputError, match="latitude") as error:
        sources(names, {}, "fleet.csv")
    assert "fleet.csv" in str(error.value)
    assert "Nearest there: lat" in str(error.value)
    with pytest.raises(InputError, match="wind_direction_deg") as error:
        sources([*names, "latitude"], {}, "fleet.csv")
    assert "wind_dir" in str(error.value)


def test_a_level_is_required_in_one_of_two_ways():
    with pytest.raises(InputError, match="neither pressure_altitude_ft nor pressure_hPa"):
        sources([*PLAIN, *WIND], {}, "x.csv")
    assert "pressure" in sources([*PLAIN, *WIND, "pressure_hPa"], {}, "x.csv")


def test_a_mapped_column_that_is_absent_is_named():
    with pytest.raises(InputError, match="WSPD: the mapped column is not in the file"):
        sources([*PLAIN, *WIND, "pressure_hPa"], parse_mapping({"WSPD": "wind_speed_kt"}), "x.csv")
