"""GRIB that only ecCodes understands, NetCDF and wrfout that lie: counted or one message."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from benchmarks.fuzz.seeds import make_dataset_seeds

import airswing
from airswing.errors import LONGEST, InputError
from airswing.handover.forecasts.stations import forecasts_at_stations
from tests.reference.gridded.datasets import winds

DEADLY = (75, 1)
"""Octet 39 of section 3, the basic angle of a Gaussian grid: ecCodes dies of its latitudes."""


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return make_dataset_seeds(tmp_path_factory.mktemp("seeds"))


def places(*, late: bool = False) -> xr.Dataset:
    when = np.datetime64("2009-09-16T09:00", "ns") + np.timedelta64(40 if late else 0, "D")
    rng = np.random.default_rng(1)
    return xr.Dataset(
        {
            "time": ("report", np.full(40, when)),
            "latitude": ("report", rng.uniform(40.0, 45.0, 40)),
            "longitude": ("report", rng.uniform(-90.0, -85.0, 40)),
            "pressure": ("report", np.repeat([60_000.0, 70_000.0], 20)),
        }
    )


def messages(path: Path) -> list[bytes]:
    return [b"GRIB" + part for part in path.read_bytes().split(b"GRIB")[1:]]


def damaged(message: bytes) -> bytes:
    at, value = DEADLY
    return message[:at] + bytes([value]) + message[at + 1 :]


def test_a_section_that_ends_eccodes_costs_its_message(seeds: dict[str, Path], tmp_path: Path):
    whole = airswing.build_catalogue(str(seeds["GRIB2 Gaussian"]), name="m", cache_dir=tmp_path)
    sound = winds(airswing.collocate(places(), {"m": whole}))
    parts = messages(seeds["GRIB2 Gaussian"])
    path = tmp_path / "gaussian.grib"
    path.write_bytes(b"".join([*parts[:4], damaged(parts[4]), parts[5]]))
    model = airswing.build_catalogue(str(path), name="m", cache_dir=tmp_path)
    found = winds(airswing.collocate(places(), {"m": model}))
    assert np.isfinite(sound).all()
    np.testing.assert_array_equal(found[0][:20], sound[0][:20])
    assert np.isnan(found[0][20:]).all()
    (left,) = [one for one in model.skipped if one["what"] == "grid"]
    assert left["count"] == 1


def test_values_of_a_station_forecast_that_no_atmosphere_has(
    seeds: dict[str, Path], tmp_path: Path
):
    import pandas as pd

    stations = pd.DataFrame({"station": ["A"], "latitude": [42.0], "longitude": [-88.0]})
    parts = messages(seeds["station GRIB"])
    scale = parts[1].index(b"\x05", 37 + 72 + 34) + 11  # binary scale of section 5
    lying = parts[1][:scale] + b"\x00\x40" + parts[1][scale + 2 :]
    path = tmp_path / "stations.grib"
    path.write_bytes(b"".join([parts[0], lying, *parts[2:4], parts[4][:-30]]))
    table, skipped = forecasts_at_stations([path], stations)
    assert set(table["variable"]) == {"air_temperature"}
    assert set(table["lead"]) == {3.0, 6.0}
    assert sum(skipped.values()) == 2, skipped


def test_model_times_far_from_every_report(seeds: dict[str, Path], tmp_path: Path):
    for kind in ("gridded NetCDF-4", "zarr", "GRIB2 model levels"):
        model = airswing.build_catalogue(str(seeds[kind]), name="m", cache_dir=tmp_path)
        found = winds(airswing.collocate(places(late=True), {"m": model}))
        assert np.isnan(found[0]).all()


def lying_copy(source: Path, folder: Path, lie: Callable[[netCDF4.Dataset], object]) -> Path:
    path = folder / "lying.nc"
    path.write_bytes(source.read_bytes())
    with netCDF4.Dataset(path, "a") as file:
        lie(file)
    return path


@pytest.mark.parametrize(
    ("kind", "lie"),
    [
        ("gridded NetCDF-4", lambda file: file["latitude"].setncattr("standard_name", 7)),
        ("gridded NetCDF-4", lambda file: file["level"].setncattr("units", np.arange(3.0))),
        ("gridded NetCDF-4", lambda file: file["longitude"].setncattr("axis", 1e30)),
        ("gridded NetCDF-3", lambda file: file["time"].setncattr("units", "days since 0-0-0")),
        ("wrfout", lambda file: file.setncattr("DX", "furlongs")),
        ("wrfout", lambda file: file.setncattr("MAP_PROJ", "round")),
        ("wrfout", lambda file: file["XLAT"].__setitem__((0, 4, 5), np.nan)),
    ],
)
def test_attributes_of_another_kind_end_in_a_result_or_one_message(
    kind: str, lie: Callable[[netCDF4.Dataset], object], seeds: dict[str, Path], tmp_path: Path
):
    path = lying_copy(seeds[kind], tmp_path, lie)
    try:
        model = airswing.build_catalogue(str(path), name="m", cache_dir=tmp_path)
    except InputError as error:
        assert str(path) in str(error) and len(str(error)) < LONGEST
    else:
        u = winds(airswing.collocate(places(), {"m": model}))[0]
        assert np.isfinite(u).any() and np.nanmax(np.abs(u)) < 40.0


def test_one_lying_file_among_several_is_named_and_left_out(seeds: dict[str, Path], tmp_path: Path):
    lying_copy(seeds["wrfout"], tmp_path, lambda file: file.setncattr("DX", "furlongs"))
    (tmp_path / "sound.nc").write_bytes(seeds["wrfout"].read_bytes())
    model = airswing.build_catalogue(str(tmp_path / "*.nc"), name="m", cache_dir=tmp_path)
    (left,) = [one for one in model.skipped if "lying.nc" in str(one)]
    assert "cannot be understood" in str(left)
    assert np.isfinite(winds(airswing.collocate(places(), {"m": model}))[0]).any()
