"""Gridded models: rotation, interpolation, effects, GRIB files read back; a real run."""

import json
from datetime import datetime

import numpy as np
import pyproj
import pytest
from tests.reference.gridded.datasets import points, winds

import airswing
from airswing.reference.grib.headers import scan_file
from airswing.synthetic import real_winds
from airswing.synthetic.atmosphere import World, WorldParameters
from airswing.synthetic.fields import (
    GRIB_RADIUS,
    GriddedReference,
    ReferenceChange,
    build_reference,
    centred_grid,
    sample_reference,
    write_reference,
)

GRID = centred_grid(42.0, -85.0, columns=25, rows=21, spacing=40000.0, radius=GRIB_RADIUS[1])
LEVELS = np.array([900.0, 700.0, 500.0, 400.0])
HOURS = np.arange(0.0, 7.0)


@pytest.fixture(scope="module")
def world():
    return World(WorldParameters(), 8, 24.0)


def stored(world, **change):
    return build_reference(world, GRID, "ruc", LEVELS, HOURS, ReferenceChange(**change))


def test_grid_components_point_where_the_grid_does(world):
    """Moving along the stored vector on the map goes the wind's way on the earth."""
    along, earth = stored(world), stored(world, unrotated=-1.0)  # components along the earth's axes
    lat, lon = GRID.coordinates
    row, column = 15, 22
    grid_u, grid_v = along.wind[3, :, 2, row, column]
    true_u, true_v = earth.wind[3, :, 2, row, column]
    projection = pyproj.Proj(proj="lcc", lat_1=25, lat_2=25, lat_0=25, lon_0=-95, R=6367470)
    x, y = projection(lon[row, column], lat[row, column])
    lon2, lat2 = projection(x + 50 * grid_u, y + 50 * grid_v, inverse=True)
    azimuth = pyproj.Geod(a=6367470, b=6367470).inv(lon[row, column], lat[row, column], lon2, lat2)
    assert azimuth[0] == pytest.approx(np.degrees(np.arctan2(true_u, true_v)), abs=0.05)


def test_speed_bias_acts_above_its_level_only(world):
    unbiased, strong = stored(world), stored(world, speed_percent=10.0, above_hpa=500.0)
    ratio = strong.wind / np.where(np.abs(unbiased.wind) > 5, unbiased.wind, np.nan)
    np.testing.assert_allclose(np.nanmean(ratio, axis=(0, 1, 3, 4)), [1, 1, 1.1, 1.1], atol=1e-3)


def agree(model, fields, hours, start):
    """The reader of model winds gives what the generator samples, summed over its fields."""
    rng, grid = np.random.default_rng(2), fields[0].grid
    lat, lon = (rng.uniform(axis.min(), axis.max(), 500) for axis in grid.coordinates)
    pressure = rng.uniform(fields[0].levels.min(), fields[0].levels.max(), 500)
    hours = rng.uniform(*hours, 500)
    expected = sum(sample_reference(field, lat, lon, pressure, hours) for field in fields)
    reports = points(lat, lon, 100.0 * pressure, after=hours, start=np.datetime64(start))
    collocated = winds(airswing.collocate(reports, {"x": model}))
    assert np.isfinite(collocated[0]).mean() > 0.3
    np.testing.assert_allclose(collocated, expected, atol=1e-3)


@pytest.mark.parametrize(("edition", "flag"), [(1, True), (2, False)])
def test_written_fields_are_read_as_the_generator_samples_them(tmp_path, edition, flag):
    sizes = {"columns": 14, "rows": 11, "spacing": 40635.0}
    grid = centred_grid(43.0, -86.0, **sizes, radius=GRIB_RADIUS[edition])
    wind = np.random.default_rng(2).normal(5, 20, (4, 2, 2, 11, 14)).round(1).astype(np.float32)
    hours, start = np.array([22.0, 23.0, 24.0, 25.0]), datetime(2009, 10, 19)
    reference = GriddedReference("ruc", grid, np.array([850.0, 500.0]), hours, wind, flag)
    options = {"start": start, "lead_hours": 2, "times_per_file": 2}
    write_reference(tmp_path / "ruc", reference, edition=edition, **options)
    model = airswing.build_catalogue(f"{tmp_path}/ruc/*", name="x", cache_dir=tmp_path)
    assert len(model.files) == 2 and model.grids[0].wind_along_grid is flag
    assert set(model.leads) == {7200}
    assert [row.edition for row in scan_file(model.files[0].path).fields] == [edition] * 8
    agree(model, [reference], (22, 25), start)


GRIB = "grib/wrf_ruc13_g212"


def test_a_real_run_is_read_as_the_reader_of_model_winds_reads_it(real, tmp_path):
    run, error, start = real_winds.read_run(real(GRIB))
    model = airswing.build_catalogue(f"{real(GRIB)}/*", name="x", cache_dir=tmp_path)
    agree(model, [run], (0, 9), start)
    agree(model, [run, error], (12, 12), start)  # the analysis of the next cycle
    assert 2.0 < np.nanstd(error.wind[0, 0, run.levels.tolist().index(500.0)]) < 3.0


@pytest.mark.slow
def test_the_whole_job_recovers_the_deviations(real, tmp_path, blank_cards, monkeypatch):
    """Every stage on real winds but the page, through two references of different leads."""
    real_winds.write_archive(tmp_path, real(GRIB), aircraft=6, seed=2)
    monkeypatch.setattr("airswing.report.run.page.write_page", lambda *_, **__: None)
    fits = airswing.run(tmp_path / "config.yaml").fits
    truth = json.loads((tmp_path / "truth" / "truth.json").read_text())["aircraft"]
    tails = fits["aircraft"].values.astype(str)
    expected = np.array([[truth[tail]["deviation"][k] for k in "ABC"] for tail in tails])
    for reference in ("cycle_00", "cycle_12"):
        fit = fits.sel(reference=reference)
        assert (fit["status"] == 0).all()
        error = fit["deviation"].values[:, :3] - expected
        spread = np.sqrt(np.diagonal(fit["deviation_covariance"].values, 0, 1, 2))[:, :3]
        assert np.mean(np.abs(error) < 1.96 * spread) >= 0.75
        assert np.sqrt(np.mean(error**2)) < 0.6
