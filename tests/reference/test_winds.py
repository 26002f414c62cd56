"""One model time at its reports: by hand, by invariants, by cfgrib."""

import numpy as np
import pytest
import xarray as xr

from airswing.reference.catalogue import build_catalogue
from airswing.reference.collocate import sample_model_times
from airswing.reference.grids import LONGITUDE_LATITUDE
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
    expected = (
        model.grids[0].convergence(at[0], at[1])[0] if model.grids[0].wind_along_grid else 0.0
    )
    assert table[8] == expected


CFGRIB = [
    ("grib/wrf_ruc13_g212/2005080712_wrfprs_ruc13_00.tm00_G212", 5000.0),
    ("grib/wrf_ruc13_g212/2005080700_wrfprs_ruc13_12.tm00_G212", 5000.0),
    ("grib/nam_g211_20180917_00z.grib2", 10000.0),
    ("grib/jma_meps_20190605_regular_ll.grib2", None),
]


@pytest.mark.parametrize(("name", "top"), CFGRIB)
def test_exactness_against_cfgrib_and_interp(name, top, real, tmp_path):
    """An independent path: cfgrib's fields, xarray's interp, pyproj's indices."""
    path = str(real(name))
    model = build_catalogue(path, name="x", cache_dir=tmp_path).model_time(0)
    keys = {"typeOfLevel": "isobaricInhPa"}
    data = xr.open_dataset(
        path,
        engine="cfgrib",
        backend_kwargs={"indexpath": str(tmp_path / "i"), "filter_by_keys": keys},
    )[["u", "v"]]
    if "step" in data.dims:
        data = data.isel(step=0)
    lat, lon, p = points_inside(model, np.random.default_rng(8), 400)
    mine = sample_model_time(model, lat, lon, p)
    theirs = by_interp(data, model.grids[0], lat, lon, p)
    np.testing.assert_array_equal(np.isfinite(mine), np.isfinite(theirs))
    assert np.isfinite(mine[0]).mean() > 0.5
    np.testing.assert_allclose(mine, theirs, atol=2e-4)


def points_inside(model, rng, count):
    south, north, west, east = model.grids[0].outline()
    lat, lon = rng.uniform(south, north, 20 * count), rng.uniform(west, east, 20 * count)
    inside = np.flatnonzero(np.isfinite(model.grids[0].fractional_index(lat, lon)[0]))[:count]
    levels = np.asarray(model.rows["level"][0])
    p = np.exp(rng.uniform(np.log(levels[0]), np.log(levels[-1]), inside.size))
    return lat[inside], lon[inside], p


def by_interp(data, grid, lat, lon, p):
    """Linear interpolation by xarray on (ln p, y, x), then rotation by the published formula."""
    import pyproj

    data = data.assign_coords(isobaricInhPa=np.log(data.isobaricInhPa.values * 100.0)).sortby(
        "isobaricInhPa"
    )
    if grid.frame == LONGITUDE_LATITUDE:
        x, y, names = lon, lat, ("longitude", "latitude")
        data = data.sortby("latitude")
    else:
        project = pyproj.Proj(grid.frame.proj)
        px, py = project(data.longitude.values, data.latitude.values)
        data = data.drop_vars(("latitude", "longitude")).assign_coords(
            x=px.mean(axis=0), y=py.mean(axis=1)
        )
        assert np.ptp(px, axis=0).max() < 20 and np.ptp(py, axis=1).max() < 20
        (x, y), names = project(lon, lat), ("x", "y")
    at = {
        name: xr.DataArray(values, dims="report")
        for name, values in zip((*names, "isobaricInhPa"), (x, y, np.log(p)), strict=True)
    }
    got = data.interp(at)
    u, v = got.u.values, got.v.values
    if grid.wind_along_grid:
        # LoV 265 E and Latin 25 in both files (DOMAIN, trap 1)
        rot = np.radians((lon - 265.0 + 180) % 360 - 180) * np.sin(np.radians(25.0))
        u, v = np.cos(rot) * u + np.sin(rot) * v, -np.sin(rot) * u + np.cos(rot) * v
    return np.stack([u, v])
