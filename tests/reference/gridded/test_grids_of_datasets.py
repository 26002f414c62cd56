"""Every grid a Dataset can have, against pyproj and numpy."""

import numpy as np
import pytest
import xarray as xr
from pyproj import CRS, Transformer

import airswing
from airswing.reference.grids import AxesGrid, Frame, frame_of
from tests.reference.gridded import datasets

KINDS = ["lambert", "tangent", "polar", "mercator", "rotated"]
RNG = np.random.default_rng(11)


def geographic(kind):
    """From x and y of a kind of grid to longitude and latitude, by pyproj."""
    crs = datasets.crs_of(kind)
    if kind == "rotated":
        return Transformer.from_crs(crs, crs.source_crs or "EPSG:4326", always_xy=True)
    return Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)


def places_in(kind, count=200):
    """Fractional indices inside a grid, their coordinates and places."""
    x, y = datasets.axes_of(kind)
    fi, fj = RNG.uniform(0, x.size - 1, count), RNG.uniform(0, y.size - 1, count)
    px, py = np.interp(fi, np.arange(x.size), x), np.interp(fj, np.arange(y.size), y)
    lon, lat = geographic(kind).transform(px, py)
    return fi, fj, px, py, np.asarray(lat), np.asarray(lon)


@pytest.mark.parametrize(("kind", "units"), [*((k, "m") for k in KINDS), ("lambert", "km")])
def test_projected_winds_against_pyproj(kind, units):
    ds = datasets.projected(kind, units=units)
    fi, fj, px, py, lat, lon = places_in(kind)
    p = RNG.uniform(20500.0, 99500.0, fi.size)
    along = datasets.by_hand(ds.ua.values[0], ds.va.values[0], datasets.LEVELS * 100, fi, fj, p)
    # the direction of the grid's columns from two places on the sphere, a metre apart
    step = 1e-5 if kind == "rotated" else 1.0
    lon0, lat0 = geographic(kind).transform(px, py - step)
    lon1, lat1 = geographic(kind).transform(px, py + step)
    clockwise = np.arctan2((lon1 - lon0) * np.cos(np.radians(lat)), lat1 - lat0)
    assert kind == "mercator" or np.abs(clockwise).max() > np.radians(2)
    collocated = datasets.winds(airswing.collocate(datasets.points(lat, lon, p), {"x": ds}))
    np.testing.assert_allclose(collocated, datasets.turned(*along, clockwise), atol=1e-3)


@pytest.mark.parametrize("first", [0.0, -180.0])
@pytest.mark.parametrize("north_up", [True, False])
def test_a_whole_globe_either_way_round(first, north_up):
    lat = np.linspace(-90, 90, 37)[:: 1 if north_up else -1]
    ds = datasets.latlon(latitude=lat, longitude=first + np.arange(0, 360, 5.0))
    where = RNG.uniform(-89.9, 89.9, 150), RNG.uniform(-180, 360, 150)
    where[1][:20] = np.linspace(-5.0, 5.0, 20)  # across the seam of 0/360
    where[1][20:40] = np.linspace(176.0, 184.0, 20)
    where[0][40:44] = (90.0, -90.0, 89.99, -89.99)
    p = RNG.uniform(20500.0, 99500.0, 150)
    collocated = datasets.winds(airswing.collocate(datasets.points(*where, p), {"x": ds}))
    fi = np.mod(where[1] - first, 360.0) / 5.0
    fj = np.interp(where[0], np.sort(lat), np.arange(37))
    fj = fj if north_up else 36 - fj
    expected = datasets.by_hand(ds.u.values[0], ds.v.values[0], datasets.LEVELS * 100, fi, fj, p)
    np.testing.assert_allclose(collocated, expected, atol=1e-3)


def test_outside_a_regional_grid_there_is_no_wind():
    ds = datasets.latlon(latitude=np.arange(40, 61, 1.0), longitude=np.arange(350, 371, 1.0) % 360)
    inside = [(50.0, -5.0), (50.0, 355.0), (50.0, 5.0), (40.0, 350.0), (60.0, 10.0)]
    outside = [(39.9, 0.0), (50.0, 10.1), (50.0, 349.9), (50.0, 180.0), (60.1, 0.0)]
    lat, lon = np.transpose(inside + outside)
    u, _ = datasets.winds(airswing.collocate(datasets.points(lat, lon, 50000.0), {"x": ds}))
    np.testing.assert_array_equal(np.isfinite(u), [True] * 5 + [False] * 5)
    assert u[0] == u[1]


@pytest.mark.parametrize("mapping", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_points_give_the_winds_of_their_projection(kind, mapping):
    """Latitudes and longitudes of every point, with a grid mapping whose axes are absent or not."""
    ds = datasets.projected(kind)
    x, y = datasets.axes_of(kind)
    grid = AxesGrid(frame_of(datasets.MAPPINGS[kind], field=""), x, y)
    lat, lon = grid.frame.places(*(axis.ravel() for axis in np.meshgrid(x, y)))
    bare = ds.copy(deep=True).drop_vars(["x", "y"])
    if not mapping:
        bare = bare.drop_vars("crs")
        for name in ("ua", "va"):
            del bare[name].attrs["grid_mapping"]
    shape = (y.size, x.size)
    bare = bare.assign_coords(
        lat=(("y", "x"), lat.reshape(shape), {"units": "degrees_north"}),
        lon=(("y", "x"), np.mod(lon, 360).reshape(shape), {"units": "degrees_east"}),
    )
    *_, lat, lon = places_in(kind, 80)
    reports = datasets.points(lat, lon, 60000.0)
    by_axes, by_points = (datasets.winds(airswing.collocate(reports, {"x": d})) for d in (ds, bare))
    # without a projection: cells of 60 to 80 km, noise of 15 m/s
    np.testing.assert_allclose(by_axes, by_points, atol=1e-4 if mapping else 4e-2)


def test_a_pole_turned_in_its_own_frame():
    mapping = datasets.MAPPINGS["rotated"] | {"north_pole_grid_longitude": 20.0}
    frame = frame_of(mapping, field="")
    crs = CRS.from_cf(mapping)
    to = Transformer.from_crs(crs.source_crs or "EPSG:4326", crs, always_xy=True)
    lat, lon = RNG.uniform(30, 60, 20), RNG.uniform(-120, -80, 20)
    np.testing.assert_allclose(frame.xy(lat, lon), to.transform(lon, lat), atol=1e-6)
    assert isinstance(frame, Frame)


def test_wkt_alone_and_a_string_in_the_configuration():
    ds = datasets.projected("lambert")
    crs = datasets.crs_of("lambert")
    *_, lat, lon = places_in("lambert", 20)
    reports = datasets.points(lat, lon, 60000.0)
    expected = datasets.winds(airswing.collocate(reports, {"x": ds}))
    wkt = ds.copy()
    wkt["crs"] = xr.Variable((), 0, {"crs_wkt": crs.to_wkt()})
    np.testing.assert_allclose(
        datasets.winds(airswing.collocate(reports, {"x": wkt})), expected, atol=1e-6
    )
    bare = ds.copy(deep=True).drop_vars("crs")
    for name in ("ua", "va"):
        del bare[name].attrs["grid_mapping"]
    text = "+proj=lcc +lat_1=30 +lat_2=60 +lat_0=38.5 +lon_0=-97.5 +x_0=100000 +R=6371229"
    configured = airswing.build_catalogue(bare, name="x", naming={"projection": text})
    result = datasets.winds(airswing.collocate(reports, {"x": configured}))
    np.testing.assert_allclose(result, expected, atol=1e-6)
