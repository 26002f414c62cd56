"""Files of real models that other people wrote, against their programs or against numpy."""

import numpy as np
import pytest
import xarray as xr
from pyproj import CRS, Proj

import airswing
from tests.reference.gridded.datasets import by_hand, points, turned, winds

RNG = np.random.default_rng(5)


def test_wrf_pythons_own_winds_and_pressure(real):
    """wrf-python's ua, va turned (uvmet) and pressure, at the grid points of its file."""
    path = real("models/wrfpython_ci_test_file.nc")
    result = real("models/wrfpython_ci_result_file.nc")
    with xr.open_dataset(path) as raw, xr.open_dataset(result) as answers:
        same = [n for n in range(4) if np.array_equal(raw.XLAT.values[n], answers.lat.values)]
        text = b"".join(np.atleast_1d(raw.Times.values[same[0]]).tolist()).decode()
        k, j, i = RNG.integers((1, 1, 1), (13, 47, 47), (800, 3)).T
        # Half way between two levels in ln p the wind is the mean of the two.
        pressure = answers.pressure.values.astype(float) * 100.0
        p = np.sqrt(pressure[k, j, i] * pressure[k - 1, j, i])
        lat, lon = (answers[n].values[j, i].astype(float) for n in ("lat", "lon"))
        expected = [(w[k, j, i] + w[k - 1, j, i]) / 2.0 for w in answers.uvmet.values]
    reports = points(lat, lon, p, start=np.datetime64(text.replace("_", "T")))
    got = airswing.collocate(reports, {"wrf": airswing.build_catalogue(str(path), name="wrf")})
    # XLAT and XLONG are of single precision: 0.3 m of 10 km in a hurricane.
    np.testing.assert_allclose(winds(got), expected, atol=5e-3)
    assert np.sqrt(np.mean((np.array(winds(got)) - expected) ** 2)) < 5e-4
    assert got.lead_time.values[0] == pytest.approx(12.0)  # of START_DATE


def test_meps_hybrid_levels_by_hand(real):
    path = real("models/fimex_meps_65ml_lambert.nc")
    with xr.open_dataset(path) as ds:
        member = ds.isel(time=0, ensemble_member=1)
        u, v = member.x_wind_ml.values.astype(float), member.y_wind_ml.values.astype(float)
        ps = member.surface_air_pressure.values[0].astype(float)
        levels = ds.ap.values[:, None, None] + ds.b.values[:, None, None] * ps
        x, y = ds.x.values.astype(float), ds.y.values.astype(float)
        proj = Proj(CRS.from_cf(ds.projection_lambert.attrs))
        number = int(ds.ensemble_member.values[1])
    fi, fj = RNG.uniform(0, x.size - 1, 300), RNG.uniform(0, y.size - 1, 300)
    lon, lat = proj(np.interp(fi, range(x.size), x), np.interp(fj, range(y.size), y), inverse=True)
    p = RNG.uniform(12000.0, 88000.0, 300)
    along = by_hand(u, v, levels, fi, fj, p)
    angle = np.radians(np.asarray(proj.get_factors(lon, lat).meridian_convergence))
    model = airswing.build_catalogue(str(path), name="meps", member=number)
    assert any("standard_name" in note for note in model.notes)
    reports = points(lat, lon, p, start=np.datetime64("2017-05-22T06"))
    got = airswing.collocate(reports, {"m": model})
    expected = turned(*along, angle)
    assert np.isfinite(expected[0]).all()
    np.testing.assert_allclose(winds(got), expected, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "u", "v", "dims"),
    [
        ("pycontrails_met-accf-pl.nc", "u", "v", ("level", "latitude", "longitude")),
        (
            "metpy_GFS_test_20101026.nc",
            "u-component_of_wind_isobaric",
            "v-component_of_wind_isobaric",
            ("isobaric3", "lat", "lon"),
        ),
    ],
)
def test_pressure_levels_by_hand(name, u, v, dims, real):
    path = real(f"models/{name}")
    with xr.open_dataset(path) as ds:
        when = ds.time.values[0]
        east, north = (ds[n].isel(time=0).transpose(*dims).values.astype(float) for n in (u, v))
        level, lat, lon = (ds[d].values.astype(float) for d in dims)
        level = level * {"Pa": 1.0, "millibars": 100.0}[ds[dims[0]].units]
    fi, fj = RNG.uniform(0, lon.size - 1, 300), RNG.uniform(0, lat.size - 1, 300)
    p = np.exp(RNG.uniform(np.log(level.min()), np.log(level.max()), 300))
    where = np.interp(fj, range(lat.size), lat), np.interp(fi, range(lon.size), lon)
    reports = points(where[0], where[1] - 360.0 * RNG.integers(0, 2, 300), p, start=when)
    got = airswing.collocate(reports, {"m": airswing.build_catalogue(str(path), name="m")})
    np.testing.assert_allclose(winds(got), by_hand(east, north, level, fi, fj, p), atol=1e-3)


def test_a_lambert_grid_as_cfgrib_opens_it(real, tmp_path):
    """Latitudes and longitudes of every point, the projection in GRIB attributes."""
    path = str(real("grib/nam_g211_20180917_00z.grib2"))
    keys = [{"typeOfLevel": "isobaricInhPa", "cfVarName": name} for name in "uv"]
    options = [{"indexpath": "", "filter_by_keys": k} for k in keys]
    parts = [xr.open_dataset(path, engine="cfgrib", backend_kwargs=o) for o in options]
    lat, lon = RNG.uniform(25, 45, 200), RNG.uniform(-120, -80, 200)
    pressure = RNG.uniform(21000, 99000, 200)
    reports = points(lat, lon, pressure, start=np.datetime64("2018-09-17"))
    scanned = airswing.build_catalogue(path, name="o", cache_dir=tmp_path)
    opened = xr.merge(parts, compat="override")
    got = airswing.collocate(reports, {"o": scanned, "d": opened}).compute()
    assert "the GRIB flag" in got.attrs["reference_notes"]
    np.testing.assert_allclose(*got.reference_eastward_wind.values, atol=1e-4)
    np.testing.assert_allclose(*got.reference_northward_wind.values, atol=1e-4)
