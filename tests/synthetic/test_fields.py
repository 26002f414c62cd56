"""Gridded models: rotation, interpolation, effects, GRIB files read back; a real run."""

import json
from datetime import datetime

import eccodes
import numpy as np
import pyproj
import pytest

import airswing
from airswing.synthetic import real_winds
from airswing.synthetic.atmosphere import World, WorldParameters
from airswing.synthetic.fields import (
    GRIB_RADIUS,
    GriddedReference,
    ReferenceChange,
    build_reference,
    centred_grid,
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
    plain, strong = stored(world), stored(world, speed_percent=10.0, above_hpa=500.0)
    ratio = strong.wind / np.where(np.abs(plain.wind) > 5, plain.wind, np.nan)
    np.testing.assert_allclose(np.nanmean(ratio, axis=(0, 1, 3, 4)), [1, 1, 1.1, 1.1], atol=1e-3)


@pytest.mark.parametrize(("edition", "flag"), [(1, True), (2, False)])
def test_eccodes_reads_the_written_fields(tmp_path, edition, flag):
    sizes = {"columns": 14, "rows": 11, "spacing": 40635.0}
    grid = centred_grid(43.0, -86.0, **sizes, radius=GRIB_RADIUS[edition])
    wind = np.random.default_rng(2).normal(5, 20, (4, 2, 2, 11, 14)).round(1).astype(np.float32)
    hours = np.array([22.0, 23.0, 24.0, 25.0])
    made = GriddedReference("ruc", grid, np.array([850.0, 500.0]), hours, wind, flag)
    write_reference(
        tmp_path,
        made,
        start=datetime(2009, 10, 19),
        edition=edition,
        lead_hours=2,
        times_per_file=2,
    )
    assert len(list(tmp_path.iterdir())) == 2
    found = []
    for path in sorted(tmp_path.iterdir()):
        with path.open("rb") as source:
            while (handle := eccodes.codes_grib_new_from_file(source)) is not None:
                found.append(handle)

    def values(name):
        return [eccodes.codes_get(handle, name) for handle in found]

    assert values("shortName") == ["u", "v"] * 8
    assert values("level") == [850, 850, 500, 500] * 4
    expected = {
        "uvRelativeToGrid": int(flag),
        "gridType": "lambert",
        "typeOfLevel": "isobaricInhPa",
        "radius": grid.radius,
        "endStep": 2,
        "editionNumber": edition,
    }
    assert {name: set(values(name)) for name in expected} == {k: {v} for k, v in expected.items()}
    times = [(20091019, 2200), (20091019, 2300), (20091020, 0), (20091020, 100)]
    dates = zip(values("validityDate"), values("validityTime"), strict=True)
    assert list(dates) == [time for time in times for _ in range(4)]
    stack = np.stack([eccodes.codes_get_values(handle) for handle in found])
    order = wind.transpose(0, 2, 1, 3, 4).reshape(16, -1)
    np.testing.assert_allclose(stack, order, atol=1e-4)
    lat, lon = grid.coordinates
    north, east = (eccodes.codes_get_array(found[0], k) for k in ("latitudes", "longitudes"))
    np.testing.assert_allclose(north, lat.ravel(), atol=1e-6)
    np.testing.assert_allclose((east + 180) % 360 - 180, lon.ravel(), atol=1e-6)
    for handle in found:
        eccodes.codes_release(handle)


GRIB = "grib/wrf_ruc13_g212"


def test_the_run_is_read_as_eccodes_reads_it(real):
    folder = real(GRIB)
    run, error, start = real_winds.read_run(folder)
    assert start.isoformat() == "2005-08-07T00:00:00"
    assert run.hours.tolist() == list(range(0, 25, 3))
    assert run.wind.shape[3:] == (129, 185)
    with (folder / "2005080700_wrfprs_ruc13_12.tm00_G212").open("rb") as source:
        while (handle := eccodes.codes_grib_new_from_file(source)) is not None:
            if (eccodes.codes_get(handle, "shortName"), eccodes.codes_get(handle, "level")) == (
                "v",
                500,
            ):
                break
            eccodes.codes_release(handle)
    values = eccodes.codes_get_values(handle).reshape(129, 185)
    values[values == eccodes.codes_get(handle, "missingValue")] = np.nan
    latitude = eccodes.codes_get_array(handle, "latitudes").reshape(129, 185)
    eccodes.codes_release(handle)
    level = run.levels.tolist().index(500.0)
    np.testing.assert_allclose(run.wind[4, 1, level], values, atol=1e-4)
    np.testing.assert_allclose(run.grid.coordinates[0], latitude, atol=1e-4)
    assert np.isnan(values).mean() == pytest.approx(0.41, abs=0.01)
    assert 2.0 < np.nanstd(error.wind[0, 0, level]) < 3.0


@pytest.mark.slow
def test_the_whole_job_recovers_the_deviations(real, tmp_path, blank_cards, monkeypatch):
    """Every stage on real winds but the page, through two references of different leads."""
    real_winds.write_archive(tmp_path, real(GRIB), aircraft=6, seed=2)
    monkeypatch.setattr("airswing.workflow.main.make_page", lambda *_: None)
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
