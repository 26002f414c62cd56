"""Order, duplicates and layout: the same Dataset whatever the order of rows and files."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from airswing.products.ragged import aircraft_of_report
from airswing.reports import read_reports
from airswing.vocabulary import VARIABLES
from tests.reports.tables import audit_of, flight, row, write


def read(path, rows, **options):
    ds = read_reports(write(path / "reports.csv", rows), **options)
    return ds, audit_of(ds)


def fleet():
    """Two tails, repeated rows, minute ties, missing values: everything order could disturb."""
    feet = [1e3, 2e3, 3e3, 4e3, 5e3, 6e3]
    climb = flight(tail="B2", seconds=[0, 0, 60, 60, 120, 180], altitude_ft=feet)
    level = flight(tail="A1", start="2009-01-05T23:50:00", temperature_degC=-20.0)
    fuller = level.iloc[[3]].assign(wind_speed_kt=44)
    emptier = level.iloc[[4]].assign(wind_speed_kt=np.nan)
    return pd.concat([climb, level, level.iloc[[2]], fuller, emptier], ignore_index=True)


def test_the_contract_of_the_dataset(tmp_path):
    ds, audit = read(tmp_path, fleet())
    assert ds["aircraft"].to_numpy().tolist() == ["A1", "B2"]
    assert ds["row_size"].to_numpy().tolist() == [10, 6]
    assert (audit["reports_read"], audit["reports_kept"]) == (19, 16)
    assert audit["dropped"] == {"exact_duplicate": 1, "same_tail_and_time": 2}
    wanted = {
        *("latitude", "longitude", "pressure", "eastward_wind", "northward_wind"),
        *("air_temperature", "roll_flag", "temperature_qc", "wind_qc", "phase", "icing", "flight"),
        *("reported_airspeed", "reported_heading", "position_resolution", "time_resolution"),
        *("wind_speed_resolution", "wind_direction_resolution"),
    }
    for name in wanted:
        entry = VARIABLES[name]
        assert ds[name].dims == entry.dims
        assert ds[name].dtype == np.dtype(entry.dtype), name
        assert ds[name].attrs["long_name"] == entry.long_name
    assert ds["time"].dtype == np.dtype("datetime64[ns]")
    seconds = ds["time"].to_numpy().astype(np.int64)
    assert (np.diff(seconds)[np.diff(aircraft_of_report(ds)) == 0] >= 0).all()


@pytest.mark.parametrize(
    "less", [{"wind_speed_kt": None}, {"wind_speed_kt": 30, "temperature_degC": None}]
)
def test_of_two_reports_at_one_place_and_time_the_fuller_stays(tmp_path, less):
    ds, audit = read(tmp_path, [row(**less), row()])
    assert audit["dropped"] == {"same_tail_and_time": 1}
    assert float(ds["eastward_wind"][0]) == pytest.approx(40 * 1852 / 3600)


@pytest.mark.parametrize(
    ("second", "east", "dropped"), [("07", -80.0, {"conflicting_position": 1}), ("00", -86.75, {})]
)
def test_two_places_are_a_conflict_except_on_a_minute_clock(tmp_path, second, east, dropped):
    rows = [row(time=f"2009-01-05T12:0{k}:{second}Z", longitude=-87 + 0.1 * k) for k in range(5)]
    ds, audit = read(tmp_path, [*rows, row(time=f"2009-01-05T12:02:{second}Z", longitude=east)])
    assert audit["dropped"] == dropped
    assert ds.sizes["report"] == 6 - len(dropped)


@pytest.mark.parametrize("sign", [1, -1])
def test_reports_of_one_minute_follow_the_climb_or_descent(tmp_path, sign):
    feet = 10_000 + sign * np.arange(12) * 700.0
    table = flight(seconds=np.arange(12) * 20.0, altitude_ft=feet)
    table["time"] = table["time"].dt.floor("min")
    ds, _ = read(tmp_path, table.sample(frac=1.0, random_state=3))
    assert (sign * np.diff(ds["pressure_altitude"]) > 0).all()


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(19)), cut=st.integers(1, 18))
def test_order_of_rows_and_files_does_not_matter(tmp_path, order, cut):
    table = fleet()
    wanted, _ = read(tmp_path, table)
    first = write(tmp_path / "one.csv", table.iloc[order[:cut]])
    second = write(tmp_path / "two.csv", table.iloc[order[cut:]])
    xr.testing.assert_equal(read_reports([second, first]), wanted)
    xr.testing.assert_identical(read(tmp_path, table.iloc[order])[0], wanted)


def test_given_phases_and_flights_are_kept_and_the_rest_derived(tmp_path):
    first = flight(flight="MES1", phase=["descent"] + [""] * 9)
    second = flight(flight="MES1", start="2009-01-06T12:00:00", phase="")
    ds, audit = read(tmp_path, pd.concat([first, second]))
    assert ds["phase"].to_numpy().tolist() == [3] + [2] * 19
    assert ds["flight"].to_numpy().tolist() == [0] * 10 + [1] * 10
    assert audit["repaired"] == {"phase_derived": 19}


def test_a_mean_over_straight_flight_and_the_middle_of_a_turn(tmp_path):
    table = flight(seconds=np.arange(8) * 15.0, longitude=179.99, temperature_degC=-40.0)
    table["heading_deg"] = [359.0, 1, 359, 1, 0, 40, 80, 120]
    table["wind_speed_kt"] = np.arange(8.0)
    ds, audit = read(tmp_path, table, interval=60.0)
    assert (audit["dropped"], ds.sizes["report"]) == ({"averaged": 6}, 2)
    np.testing.assert_allclose(ds["eastward_wind"] * 3600 / 1852, [1.5, 6.0], rtol=1e-5)
    np.testing.assert_allclose(ds["reported_heading"] % 360, [0.0, 80.0], atol=1e-4)
    middle = table["longitude"].iloc[[1, 2]].to_numpy() % 360
    assert float(ds["longitude"][0]) % 360 == pytest.approx(middle.mean(), abs=1e-6)
    assert ds["time"].to_numpy()[0] == np.datetime64("2009-01-05T12:00:22.5")
