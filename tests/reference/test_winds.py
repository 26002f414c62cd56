"""One model time at its reports: by hand, by invariants, by cfgrib."""

import numpy as np
import pytest
import xarray as xr

from airswing.reference.catalogue import build_catalogue
from airswing.reference.collocate import sample_model_times
from airswing.units import MODEL_EARTH_RADIUS as EARTH_RADIUS
from tests.reference.builders import LAMBERT, LATLON, MERCATOR, POLAR, ROTATED, build, write
from tests.reference.test_grids import grid_of, points_of

SHAPE = (LATLON["Nj"], LATLON["Ni"])


def lattice(keys):
    """Latitude and longitude of every point in message order, by ecCodes' iterator."""
    lat, lon, _ = points_of(build(keys))
    return lat, lon


def sample_model_time(model, lat, lon, p, **options):
    return sample_model_times([model], [(lat, lon, p)], **options).tables[0]


def model_of(folder, keys, fields, **options):
    """A model time from u and v by level (hPa), written and catalogued."""
    messages = [
        build(keys, values, parameter=name, level=level, bits=32, **options)
        for level, pair in fields.items()
        for name, values in zip("uv", pair, strict=True)
    ]
    path = write(folder / "m.grib", *messages)
    return build_catalogue(path, name="x", cache_dir=folder / "c").model_time(0)


def test_nothing_is_extrapolated(tmp_path):
    flat = np.full(SHAPE, 7.0).ravel()
    model = model_of(tmp_path, LATLON, {300: (flat, flat), 500: (flat, flat)})
    lat = np.array([50.0, 50, 50, 60.001, 39.999, 50, 50, 60, 40])
    lon = np.array([20.0, 20, 20, 20, 20, 4.999, 35.001, 5, 35])
    p = np.array([29999.0, 50001, 40000, 4e4, 4e4, 4e4, 4e4, 3e4, 5e4])
    u, _ = sample_model_time(model, lat, lon, p)
    np.testing.assert_array_equal(np.isfinite(u), [0, 0, 1, 0, 0, 0, 0, 1, 1])


def test_bitmap_gaps_give_no_value(tmp_path):
    u = np.full(SHAPE, 3.0)
    u[5, 5] = np.nan
    full = np.full(SHAPE, 3.0).ravel()
    model = model_of(tmp_path, LATLON, {500: (u.ravel(), full), 300: (full, full)})
    # The gap is at latitude 50, longitude 15; cells around it have no value, its neighbours do.
    lat, lon = np.array([50.0, 50.5, 50.0, 52.0, 50.0]), np.array([15.0, 15.5, 17.0, 15.0, 15.0])
    p = np.array([5e4, 5e4, 5e4, 5e4, 3e4])
    for sparse in (True, False):
        table = sample_model_time(model, lat, lon, p, sparse=sparse)
        np.testing.assert_array_equal(np.isfinite(table[0]), [0, 0, 1, 1, 1])


@pytest.mark.parametrize("keys", [LAMBERT, ROTATED, POLAR, MERCATOR], ids=lambda k: k["gridType"])
def test_a_westerly_everywhere_is_a_westerly_at_the_reports(keys, tmp_path):
    """Write a constant true wind along the grid; it must come back true."""
    grid = grid_of(build(keys), tmp_path)
    lat, lon = lattice(keys)
    angle = grid.convergence(lat, lon)
    u = np.cos(angle) * 25.0 - np.sin(angle) * 4.0
    v = np.sin(angle) * 25.0 + np.cos(angle) * 4.0
    model = model_of(tmp_path, keys, {500: (u, v)})
    assert model.grids[0].wind_along_grid
    inner = np.isfinite(grid.fractional_index(lat, lon)[0]) & (np.abs(lat) < 75)
    at = lat[inner] * 0.999, lon[inner] + 0.01, np.full(inner.sum(), 5e4)
    got = sample_model_time(model, *at)
    inside = np.isfinite(got[0])
    assert inside.mean() > 0.5
    np.testing.assert_allclose(got[0][inside], 25.0, atol=0.03)
    np.testing.assert_allclose(got[1][inside], 4.0, atol=0.03)
    if keys is not MERCATOR:
        assert np.ptp(np.degrees(angle)) > 5, "the test grid turns enough to matter"


@pytest.mark.parametrize("keys", [LATLON, LAMBERT, ROTATED, POLAR], ids=lambda k: k["gridType"])
def test_derivatives_are_those_of_the_samples_themselves(keys, tmp_path):
    rng = np.random.default_rng(2)
    lat, lon = lattice(keys)
    smooth = [np.cumsum(rng.normal(0, 0.3, lat.size)) + 20 for _ in range(4)]
    model = model_of(tmp_path, keys, {500: tuple(smooth[:2]), 300: tuple(smooth[2:])})
    ni, nj = model.grids[0].ni, model.grids[0].nj
    middle = nj // 2 * ni + ni // 2
    at = np.array([lat[middle] + 0.11]), np.array([lon[middle] + 0.13]), np.array([38000.0])
    table = sample_model_time(model, *at, derivatives=True)[:, 0]

    def wind(north=0.0, east=0.0, lnp=0.0):
        stretch = np.cos(np.radians(at[0]))
        place = (
            at[0] + np.degrees(north / EARTH_RADIUS),
            at[1] + np.degrees(east / EARTH_RADIUS) / stretch,
            at[2] * np.exp(lnp),
        )
        return sample_model_time(model, *place)[:, 0]

    step = 50.0
    assert np.isfinite(table).all()
    np.testing.assert_allclose(table[:2], wind(), rtol=1e-12)
    np.testing.assert_allclose(table[2:4], (wind(lnp=1e-4) - wind(lnp=-1e-4)) / 2e-4, rtol=1e-6)
    for row, move in ((4, "east"), (6, "north")):
        slope = (wind(**{move: step}) - wind(**{move: -step})) / (2 * step)
        np.testing.assert_allclose(table[row : row + 2], slope, rtol=2e-4, atol=1e-10)
    grid = model.grids[0]
    assert table[8] == (grid.convergence(*at[:2])[0] if grid.wind_along_grid else 0.0)


@pytest.mark.parametrize(
    "name",
    [
        "grib/wrf_ruc13_g212/2005080712_wrfprs_ruc13_00.tm00_G212",
        "grib/wrf_ruc13_g212/2005080700_wrfprs_ruc13_12.tm00_G212",
        "grib/nam_g211_20180917_00z.grib2",
        "grib/jma_meps_20190605_regular_ll.grib2",
    ],
)
def test_exactness_against_cfgrib(name, real, tmp_path):
    """At grid points, between two levels in ln p: the mean of cfgrib's fields, turned."""
    path = str(real(name))
    model = build_catalogue(path, name="x", cache_dir=tmp_path).model_time(0)
    keys = {"indexpath": "", "filter_by_keys": {"typeOfLevel": "isobaricInhPa"}}
    data = xr.open_dataset(path, engine="cfgrib", backend_kwargs=keys)[["u", "v"]]
    data = data.isel(step=0) if "step" in data.dims else data
    levels = data.isobaricInhPa.values * 100.0
    rng, shape = np.random.default_rng(8), data.u.shape
    k, j, i = (rng.integers(1, size - 1, 400) for size in shape)
    lat, lon = xr.broadcast(data.latitude, data.longitude)
    lat, lon = lat.values[j, i], lon.values[j, i]
    u, v = ((data[name].values[k, j, i] + data[name].values[k - 1, j, i]) / 2 for name in "uv")
    if model.grids[0].wind_along_grid:
        # LoV 265 E and Latin 25 in both files (DOMAIN, trap 1)
        turn = np.radians((lon - 265.0 + 180) % 360 - 180) * np.sin(np.radians(25.0))
        u, v = np.cos(turn) * u + np.sin(turn) * v, -np.sin(turn) * u + np.cos(turn) * v
    sampled = sample_model_time(model, lat, lon, np.sqrt(levels[k] * levels[k - 1]))
    valid = np.isfinite(sampled[0])
    assert valid.mean() > 0.5 and np.isfinite(u[valid]).all()
    np.testing.assert_allclose(sampled[:, valid], np.stack([u, v])[:, valid], atol=3e-4)
