"""What is read: each chunk once, only what is needed, the same on any scheduler, and resumed."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import dask
import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.reference.gridded import chunk_reading
from tests.reference.gridded.datasets import HOUR, LEVELS, START, latlon, points, winds

LAT, LON = np.arange(20.0, 60.1, 1.0), np.arange(-120.0, -59.9, 1.0)


def many(count: int, hours: float, seed: int = 4) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    found = points(
        rng.uniform(20, 60, count), rng.uniform(-120, -60, count), rng.uniform(20000, 100000, count)
    )
    return found.assign(
        time=("report", START + (rng.uniform(0, hours * 3600e9, count)).astype("m8[ns]"))
    )


def stored(path: Path, hours: int, chunks: tuple[int, ...] | None) -> str:
    ds = latlon(latitude=LAT, longitude=LON, hours=hours)
    how = {n: {"chunksizes": chunks, "zlib": True} if chunks else {} for n in "uv"}
    ds.to_netcdf(path, encoding=how)
    return str(path)


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of what is read, one a read: by xarray, or a chunk as it is stored."""
    seen: list[int] = []
    original, as_stored = chunk_reading._load, chunk_reading.RawVariable.values

    def counted(variable: xr.Variable) -> np.ndarray:
        values = original(variable)
        seen.append(values.size)
        return values

    def expanded(
        raw: chunk_reading.RawVariable, place: tuple[int, ...], flat: np.ndarray
    ) -> np.ndarray | None:
        seen.append(int(np.prod(raw.chunks)))
        return as_stored(raw, place, flat)

    monkeypatch.setattr(chunk_reading, "_load", counted)
    monkeypatch.setattr(chunk_reading.RawVariable, "values", expanded)
    return seen


def test_each_chunk_is_read_once(tmp_path: Path, loads: list[int]) -> None:
    path = stored(tmp_path / "a.nc", 6, (3, 2, 20, 31))
    model = airswing.build_catalogue(path, name="m")
    reports = many(3000, 5.0)
    with dask.config.set(scheduler="synchronous"):
        found = airswing.collocate(reports, {"m": model}, account=True).compute()
    # 2 chunks of times x 3 of levels x 3 of rows x 2 of columns, of u and v
    assert len(loads) == 2 * 3 * 3 * 2 * 2 == int(found["decoded_messages"][0])
    one_by_one = [
        winds(airswing.collocate(reports.isel(report=slice(n, n + 7)), {"m": model}))[0]
        for n in range(0, 70, 7)
    ]
    np.testing.assert_array_equal(np.concatenate(one_by_one), winds(found)[0][:70])


def test_only_levels_and_places_that_are_needed(tmp_path: Path, loads: list[int]) -> None:
    path = stored(tmp_path / "a.nc", 2, None)
    model = airswing.build_catalogue(path, name="m")
    near = points([40.2, 40.4], [-100.3, -99.6], [52000.0, 61000.0])
    winds(airswing.collocate(near, {"m": model}))
    assert loads == [2 * 3] * 4  # u and v on two levels: a box of two rows and three columns
    plan = airswing.reference.planning.plan(near, {"m": model})["m"]
    assert (plan.model_times, plan.messages, plan.matched) == (1, 4, 2)


def test_a_lazy_dataset_is_not_touched_before_it_is_asked_for() -> None:
    ds = latlon(latitude=LAT, longitude=LON, hours=4).chunk(time=2, level=3)
    reports = many(500, 3.0)
    computed: list[int] = []

    def refuse(block: np.ndarray) -> np.ndarray:
        computed.append(block.size)
        return block

    lazy = ds.map_blocks(lambda part: part, template=ds)
    for name in "uv":
        lazy[name] = lazy[name].copy(
            data=lazy[name].data.map_blocks(refuse, dtype="f4", meta=np.empty(0))
        )
    found = airswing.collocate(reports, {"era5": lazy})
    assert not computed
    expected = winds(airswing.collocate(reports, {"era5": ds.compute()}))
    np.testing.assert_array_equal(winds(found), expected)
    assert len(computed) == 2 * 2 * 2  # chunks of times and levels, of u and v: each once


@pytest.mark.parametrize("kind", ["netcdf", "zarr", "dataset"])
def test_the_same_bits_on_threads_processes_and_a_scheduler(kind: str, tmp_path: Path) -> None:
    from distributed import Client

    ds = latlon(latitude=LAT, longitude=LON, hours=4)
    if kind == "netcdf":
        model = airswing.build_catalogue(stored(tmp_path / "a.nc", 4, (2, 3, 21, 31)), name="m")
    elif kind == "zarr":
        ds.chunk(time=2, level=2).to_zarr(tmp_path / "a.zarr")
        model = airswing.build_catalogue(str(tmp_path / "*.zarr"), name="m")
        assert model.engine == "zarr" and model.stored[0].chunks[:2] == (2, 2)
    else:
        model = ds.chunk(time=1)
    reports = many(400, 3.0)
    found = airswing.collocate(reports, {"m": model}, derivatives=True)
    expected = winds(airswing.collocate(reports, {"m": ds}, derivatives=True))
    for scheduler in ("synchronous", "threads", "processes"):
        with dask.config.set(scheduler=scheduler, num_workers=2):
            np.testing.assert_array_equal(winds(found), expected)
    with Client(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None):
        np.testing.assert_array_equal(winds(found), expected)


def test_finished_model_times_are_taken_up_again(tmp_path: Path, loads: list[int]) -> None:
    path = stored(tmp_path / "a.nc", 6, (3, 6, 41, 61))
    reports = many(300, 5.0)
    kept = tmp_path / "kept"

    def run() -> tuple[np.ndarray, np.ndarray]:
        model = airswing.build_catalogue(path, name="m")
        return winds(airswing.collocate(reports, {"m": model}, store=kept))

    first = run()
    assert len(loads) == 4 and len(list(kept.glob("*.npy"))) == 6
    np.testing.assert_array_equal(run(), first)
    assert len(loads) == 4
    sorted(kept.glob("*.npy"))[2].unlink()
    np.testing.assert_array_equal(run(), first)
    assert len(loads) == 6  # the chunk of one of the two halves, of u and v
    os.replace(stored(tmp_path / "b.nc", 6, (2, 6, 41, 61)), path)
    run()
    assert len(loads) == 12


def test_a_file_that_vanishes_gives_no_value_and_is_counted(tmp_path: Path) -> None:
    paths = [stored(tmp_path / f"{n}.nc", 2, None) for n in range(2)]
    with xr.open_dataset(paths[1]) as ds:
        later = ds.load().assign_coords(time=ds.time + np.timedelta64(2, "h"))
    later.to_netcdf(paths[1])
    model = airswing.build_catalogue(str(tmp_path / "*.nc"), name="m")
    found = airswing.collocate(many(50, 3.0), {"m": model})
    os.unlink(paths[1])
    assert [one["reason"] for one in model.changed()] == ["vanished since it was catalogued"]
    done = found.compute()
    late = many(50, 3.0).time.values > START + HOUR
    np.testing.assert_array_equal(np.isnan(winds(done)[0]), late)
    assert int(done["unread_messages"][0]) == 2


def test_grib_and_datasets_in_one_pass(tmp_path: Path) -> None:
    from tests.reference.builders import LATLON, build, write

    messages = [
        build(
            LATLON,
            np.full(176, value + level / 100),
            parameter=name,
            level=level,
            when=(20221111, hour * 100),
            bits=24,
        )
        for hour in (0, 1)
        for level in (200, 300, 500, 700, 850, 1000)
        for name, value in (("u", 5.0), ("v", -3.0))
    ]
    grib = airswing.build_catalogue(
        write(tmp_path / "m.grib", *messages), name="g", cache_dir=tmp_path
    )
    ds = latlon(latitude=np.arange(40.0, 61), longitude=np.arange(5.0, 36), hours=2)
    reports = points([50.3], [20.2], [60000.0], after=0.25)
    found = airswing.collocate(reports, {"grib": grib, "ds": ds.chunk(time=1)}).compute()
    assert list(found.reference.values) == ["grib", "ds"]
    weight = np.log(6 / 5) / np.log(7 / 5)
    assert found.reference_eastward_wind.values[0, 0] == pytest.approx(10 + 2 * weight, abs=1e-3)
    assert (
        found.reference_eastward_wind.values[1, 0]
        == winds(airswing.collocate(reports, {"ds": ds}))[0][0]
    )


def test_a_task_carries_nothing_large(tmp_path: Path) -> None:
    path = stored(tmp_path / "a.nc", 4, (1, 6, 41, 61))
    model = airswing.build_catalogue(path, name="m")
    assert len(pickle.dumps(model.model_time(1))) < 20_000
    assert model.levels(0).tolist() == (LEVELS * 100).tolist()
