"""All model times joined: lazy, exact in time, the same on every scheduler, and resumable."""

import os

import dask
import numpy as np
import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.reference.catalogue import build_catalogue
from airswing.reference.collocate import collocate, overlap, require_overlap
from airswing.reference.grib import values
from tests.reference.builders import LATLON, SIZE, build, profile, write
from tests.reference.gridded.datasets import points

START = np.datetime64("2009-08-01T00:00", "ns")


def hourly(folder, hours=(0, 1, 2, 3), *, levels=(300, 500, 700)):
    """Hourly files; u is 10 times the hour plus ln p, v its negative."""
    folder.mkdir(exist_ok=True)
    for hour in hours:
        messages = []
        for level in levels:
            value, when = 10.0 * hour + np.log(level * 100.0), (20090801, 100 * hour)
            for name, sign in (("u", 1), ("v", -1)):
                values = sign * value + 1e-3 * np.arange(SIZE)
                options = {"parameter": name, "level": level, "when": when, "bits": 32}
                messages.append(build(LATLON, values, **options))
        write(folder / f"h{hour:02d}.grib", *messages)
    return build_catalogue(str(folder / "h*.grib"), name="m", cache_dir=folder / "cache")


def reports(hours, pressure=50000.0, latitude=50.0, longitude=20.0):
    return points(latitude, longitude, pressure, after=hours, start=START)


def random_reports(count, first=-0.5, last=3.5, seed=4):
    rng = np.random.default_rng(seed)
    return reports(
        rng.uniform(first, last, count),
        rng.uniform(28000, 72000, count),
        rng.uniform(39, 61, count),
        rng.uniform(4, 36, count),
    )


def winds(ds, catalogue, **options):
    return collocate(ds, {"m": catalogue}, **options).compute(scheduler="synchronous")


def test_linear_in_time_between_valid_times_with_its_slope(tmp_path):
    catalogue = hourly(tmp_path)
    hours = np.array([0.0, 0.25, 1.0, 2.75, 3.0])
    got = winds(reports(hours), catalogue, derivatives=True)
    steady = got.reference_eastward_wind.values[0] - 10 * hours
    np.testing.assert_allclose(steady, steady[0], atol=1e-6)
    np.testing.assert_allclose(got.lead_time.values[0], 0.0)
    assert got.unread_messages.values.tolist() == [0]
    tendency = got.reference_eastward_wind_tendency[0]
    np.testing.assert_allclose(tendency[:4], 10 / 3600, rtol=1e-6)
    assert np.isnan(tendency[4])  # both valid times are needed
    np.testing.assert_allclose(got.reference_northward_wind_lnp_derivative[0], -1.0, atol=1e-5)
    without_derivatives = winds(reports(hours), catalogue)
    xr.testing.assert_equal(got[list(without_derivatives.data_vars)], without_derivatives)


def test_gaps_longer_than_the_limit_are_not_bridged(tmp_path):
    catalogue = hourly(tmp_path, hours=(0, 3, 7))
    ds = reports([0.0, 1.5, 3.0, 5.0, 7.0])
    for gap, expected in ((10799, [1, 0, 1, 0, 1]), (10800, [1, 1, 1, 0, 1]), (14400, [1] * 5)):
        u = winds(ds, catalogue, max_time_gap=float(gap)).reference_eastward_wind[0]
        np.testing.assert_array_equal(np.isfinite(u), expected)


def test_lead_times_are_weighted_like_the_winds(tmp_path):
    for step in (1, 3):
        winds_of_run = profile([500], np.ones(SIZE), when=(20090801, 0), step=step)
        write(tmp_path / f"f{step}.grib", *winds_of_run)
    catalogue = build_catalogue(str(tmp_path / "f*.grib"), name="m", cache_dir=tmp_path / "c")
    got = winds(reports([1.0, 1.5, 3.0]), catalogue)
    np.testing.assert_allclose(got.lead_time[0], [1.0, 1.5, 3.0])


def refuse(*args, **kwargs):
    raise RuntimeError("computed")


@pytest.mark.parametrize("chunks", [None, 7, 50])
def test_nothing_is_computed_before_the_result_is(chunks, tmp_path, monkeypatch):
    """Neither messages are read nor dask-backed reports computed; chunks do not matter."""
    catalogue, ds = hourly(tmp_path), random_reports(50)
    expected = winds(ds, catalogue, derivatives=True)
    if chunks is not None:
        ds = ds.chunk(report=chunks)
    with monkeypatch.context() as patch, dask.config.set(scheduler=refuse):
        patch.setattr(values, "sparse_values", refuse)
        lazy = collocate(ds, {"m": catalogue}, derivatives=True)
        assert lazy.sizes == {"reference": 1, "report": 50}
        assert all(dask.is_dask_collection(lazy[name].variable) for name in lazy.data_vars)
        with pytest.raises(RuntimeError, match="computed"):
            lazy.compute()
    assert lazy.compute(scheduler="threads").identical(expected)


def test_wrong_arguments_name_the_right_call(tmp_path):
    catalogue, ds = hourly(tmp_path), reports([1.0])
    with pytest.raises(TypeError, match="reports are an xarray Dataset, not a DataFrame"):
        collocate(ds.to_dataframe(), {"m": catalogue})
    for wrong in ([catalogue], catalogue, "ruc/*.grb", {"m": tmp_path / "h00.grib"}):
        with pytest.raises(TypeError, match=r'collocate\(reports, \{"ruc": build_catalogue'):
            collocate(ds, wrong)


def test_the_order_of_reports_does_not_matter(tmp_path):
    catalogue, ds = hourly(tmp_path), random_reports(211)
    expected = winds(ds, catalogue, derivatives=True)
    shuffle = np.random.default_rng(0).permutation(211)
    mixed = winds(ds.isel(report=shuffle), catalogue, derivatives=True)
    assert mixed.identical(expected.isel(report=shuffle))


def test_each_message_is_read_once(tmp_path):
    catalogue = hourly(tmp_path)
    for ds, expected in (
        (random_reports(400), 4 * 3 * 2),
        (reports([1.0], pressure=50000.0), 2),  # at a valid time and on a level
        (reports([1.5], pressure=40000.0), 8),
    ):
        got = winds(ds, catalogue, account=True)
        assert got.decoded_messages.values.tolist() == [expected]


def test_a_vanished_and_a_replaced_file_are_counted_gaps(tmp_path):
    catalogue = hourly(tmp_path)
    ds = reports([0.5, 1.5, 2.5, 3.0])
    before = winds(ds, catalogue).reference_eastward_wind[0]
    os.remove(tmp_path / "h01.grib")
    got = winds(ds, catalogue)
    expected = before.where(np.arange(4) > 1)
    np.testing.assert_array_equal(got.reference_eastward_wind[0], expected)
    assert got.unread_messages.values.tolist() == [1]
    (tmp_path / "h03.grib").write_bytes(b"something else")
    got = winds(ds, catalogue)
    np.testing.assert_array_equal(np.isfinite(got.reference_eastward_wind[0]), [0, 0, 0, 0])


def test_reports_without_a_time_or_place_get_no_value(tmp_path):
    ds = reports(np.ones(4), [5e4, 5e4, np.nan, 5e4], [50.0, np.nan, 50.0, 50.0])
    ds["time"] = ds.time.where(np.array([False, True, True, True]))
    got = winds(ds, hourly(tmp_path))
    np.testing.assert_array_equal(np.isfinite(got.reference_eastward_wind[0]), [0, 0, 0, 1])


def test_no_reports_and_no_references(tmp_path):
    catalogue = hourly(tmp_path)
    empty = winds(reports([1.0]).isel(report=slice(0, 0)), catalogue)
    assert empty.reference_eastward_wind.shape == (1, 0)
    with pytest.raises(InputError, match="no reference"):
        collocate(reports([1.0]), {})
    with pytest.raises(InputError, match="lack pressure"):
        collocate(reports([1.0]).drop_vars("pressure"), {"m": catalogue})


def test_reports_without_model_winds_are_counted_by_reason(tmp_path):
    catalogue = hourly(tmp_path)
    ds = reports([-1, 0.5, 0.5, 0.5, 2.0], [5e4, 5e4, 5e4, 2e4, 5e4], [50, 50, 10, 50, 50], 20.0)
    row = overlap(ds, {"m": catalogue})["m"]
    assert (row["reports"], row["matched"]) == (5, 2)
    assert (row["without_time"], row["outside_grid"], row["outside_levels"]) == (1, 1, 1)
    assert row["report_extent"].startswith("2009-07-31T23:00Z to 2009-08-01T02:00Z, latitude 10 to")
    assert row["model_extent"].startswith("2009-08-01T00:00Z to 2009-08-01T03:00Z, latitude 40 to")
    matched = np.isfinite(winds(ds, catalogue).reference_eastward_wind[0]).sum()
    assert matched == row["matched"]
    require_overlap({"m": row})


BETWEEN = reports([0.5, 2.5], pressure=45000.0)


@pytest.mark.parametrize(
    ("hours", "levels", "ds", "expected"),
    [
        ((0, 3), (300, 700), reports([50.0]), r"1 outside its times.*-03T02:00Z.*-01T00:00Z"),
        ((0, 3), (300, 700), reports([1.0], latitude=-20.0), r"1 outside its grid.*-20.*40 to 60"),
        ((0, 3), (300, 700), reports([1.0], pressure=101000.0), "1 outside its levels.*units"),
        ((0, 6), (300, 700), BETWEEN, "2 outside its times.*max_time_gap"),
        ((0, 3), (300, 400), BETWEEN, "2 outside its levels.*300 to 400 hPa.*units"),
    ],
)
def test_reports_without_overlap_are_named(hours, levels, ds, expected, tmp_path):
    catalogue = hourly(tmp_path, hours, levels=levels)
    with pytest.raises(InputError, match=expected):
        require_overlap(overlap(ds, {"m": catalogue}))
