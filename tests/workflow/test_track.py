"""Model winds appended to any table: the model's own winds come back, the table as it was."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner

import airswing
from airswing.cli import app
from airswing.errors import InputError

LATITUDE, LONGITUDE = np.arange(40.0, 45.1, 0.5), np.arange(-92.0, -83.9, 0.5)
TIMES = pd.date_range("2009-03-01", periods=4, freq="1h")
LEVELS = np.array([70000.0, 50000.0, 30000.0])


@pytest.fixture
def model() -> xr.Dataset:
    """Winds linear in place, so that interpolation adds nothing."""
    shape = (TIMES.size, LEVELS.size, LATITUDE.size, LONGITUDE.size)
    lat, lon = np.meshgrid(LATITUDE, LONGITUDE, indexing="ij")
    dims = ("time", "pressure", "latitude", "longitude")
    attrs = {"units": "m s-1"}
    return xr.Dataset(
        {
            "eastward_wind": (
                dims,
                np.broadcast_to(lat - 42.0, shape).copy(),
                attrs | {"standard_name": "eastward_wind"},
            ),
            "northward_wind": (
                dims,
                np.broadcast_to(lon + 88.0, shape).copy(),
                attrs | {"standard_name": "northward_wind"},
            ),
        },
        coords={
            "time": ("time", TIMES, {"standard_name": "time"}),
            "pressure": (
                "pressure",
                LEVELS,
                {"units": "Pa", "standard_name": "air_pressure", "positive": "down"},
            ),
            "latitude": ("latitude", LATITUDE, {"units": "degrees_north"}),
            "longitude": ("longitude", LONGITUDE, {"units": "degrees_east"}),
        },
    )


def track(**changes) -> pd.DataFrame:
    columns = {
        "name": ["007", "b", "c"],
        "time": ["2009-03-01T00:30:00Z", "2009-03-01T02:00:00Z", "2010-01-01T00:00:00Z"],
        "lat": [42.0, 43.0, 43.0],
        "lon": [-90.0, -88.0, -88.0],
        "pressure_hPa": [500.0, 400.0, 400.0],
    }
    return pd.DataFrame(columns | changes)


def test_winds_of_the_model_at_the_places(model):
    found = airswing.append_winds(track(), {"m": model})
    pd.testing.assert_frame_equal(found[track().columns], track())
    np.testing.assert_allclose(found["m_eastward_wind_m_s"], [0.0, 1.0, np.nan], atol=1e-6)
    np.testing.assert_allclose(found["m_northward_wind_m_s"], [-2.0, 0.0, np.nan], atol=1e-6)
    # from the north; from the west; after the model's last time there is none
    np.testing.assert_allclose(found["m_wind_direction_deg"], [0.0, 270.0, np.nan], atol=1e-4)
    np.testing.assert_allclose(found["m_wind_speed_kt"] * 0.514444, [2.0, 1.0, np.nan], rtol=1e-5)


def test_levels_in_feet_and_names_of_the_user(model):
    feet = [18289.0, 23574.0, 23574.0]  # 500 and 400 hPa of the standard atmosphere
    table = track(fl=feet).drop(columns="pressure_hPa")
    found = airswing.append_winds(table, {"m": model}, columns={"fl": "pressure_altitude_ft"})
    np.testing.assert_allclose(found["m_northward_wind_m_s"], [-2.0, 0.0, np.nan], atol=1e-6)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (track().drop(columns="pressure_hPa"), "pressure_hPa or pressure_altitude_ft"),
        (track().drop(columns="time"), "time"),
        (track(time=["noon", "then", ""]), "a time cannot be read.*noon"),
    ],
)
def test_what_is_missing_is_named(model, table, says):
    with pytest.raises(InputError, match=says):
        airswing.append_winds(table, {"m": model})
    with pytest.raises(InputError, match="no such column"):
        airswing.append_winds(track(), {"m": model}, columns={"x": "time"})


def test_the_command_keeps_the_table_as_it_is(model, tmp_path):
    model.to_netcdf(tmp_path / "m.nc")
    track().to_csv(tmp_path / "track.csv", index=False)
    words = ["collocate", str(tmp_path / "track.csv"), "--reference", f"m={tmp_path}/*.nc"]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out.csv")])
    assert done.exit_code == 0, done.output
    found = pd.read_csv(tmp_path / "out.csv", dtype=str)
    assert list(found["name"]) == ["007", "b", "c"]
    assert found["m_eastward_wind_m_s"].iloc[1] == "1.000"
    assert "2 of 3 rows have a wind of m" in done.output
    assert "covers 2009-03-01T00:00Z to 2009-03-01T03:00Z" in done.output
    track().rename(columns={"time": "when"}).to_csv(tmp_path / "track.csv", index=False)
    refused = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out.csv")])
    assert "--columns" in str(refused.exception)
    words += ["--columns", "when=time"]
    assert CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out.csv")]).exit_code == 0
    words = words[:-2]
    assert CliRunner().invoke(app, words).exit_code == 2
    words[-1] = "m.nc"
    assert CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out.csv")]).exit_code != 0
