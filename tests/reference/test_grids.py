"""Grids of GRIB sections and of coordinates, against ecCodes' latitudes and longitudes."""

import pickle

import eccodes
import numpy as np
import pytest

from airswing.reference import grids
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import scan_file
from tests.reference.builders import GLOBE, LAMBERT, LATLON, MERCATOR, POLAR, ROTATED, build, write

SOUTH_CONE = {"Latin1InDegrees": -30.0, "Latin2InDegrees": -60.0}
SOUTHWARD = {"latitudeOfFirstGridPointInDegrees": -30.0, "projectionCentreFlag": 128}
UP = {"latitudeOfFirstGridPointInDegrees": 40.0, "latitudeOfLastGridPointInDegrees": 60.0}
WEST = {"longitudeOfFirstGridPointInDegrees": 35.0, "longitudeOfLastGridPointInDegrees": 5.0}
THIRDS = {"Ni": 91, "longitudeOfFirstGridPointInDegrees": -10.0}
THIRDS |= {"Nj": 61, "longitudeOfLastGridPointInDegrees": 20.0}
THIRDS |= {f"{axis}DirectionIncrementInDegrees": 0.333 for axis in "ij"}
SECANT = {**LAMBERT, "Latin1InDegrees": 30.0, "Latin2InDegrees": 60.0}
ACROSS = {"LoVInDegrees": 180.0, "longitudeOfFirstGridPointInDegrees": 160.0}
BOTH = {
    "lambert tangent": LAMBERT,
    "lambert secant": SECANT,
    "lambert south": {**LAMBERT, **SOUTH_CONE, "latitudeOfFirstGridPointInDegrees": -55.0},
    "lambert by columns": {**LAMBERT, "jPointsAreConsecutive": 1},
    "lambert over the antimeridian": {**LAMBERT, **ACROSS},
    "latlon": LATLON,
    "latlon northwards": {**LATLON, **UP, "jScansPositively": 1},
    "latlon westwards": {**LATLON, **WEST, "iScansNegatively": 1},
    "latlon by columns": {**LATLON, "jPointsAreConsecutive": 1},
    "globe": GLOBE,
    "rotated": ROTATED,
    "polar": POLAR,
    "mercator": MERCATOR,
}
SECOND = {
    **{f"polar north LaD {lad}": {**POLAR, "LaDInDegrees": lad} for lad in (25, 60, 90)},
    **{f"polar south LaD {n}": {**POLAR, **SOUTHWARD, "LaDInDegrees": -n} for n in (25, 60, 90)},
    "mercator LaD 40": {**MERCATOR, "LaDInDegrees": 40.0},
    "lambert LaD elsewhere": {**LAMBERT, "LaDInDegrees": 60.0},
}
for _shape in (0, 2, 4, 5, 6, 8, 9):
    SECOND[f"lambert on earth {_shape}"] = {**SECANT, "shapeOfTheEarth": _shape}
    SECOND[f"mercator on earth {_shape}"] = {**MERCATOR, "shapeOfTheEarth": _shape}
CASES = {f"{name}-{edition}": (keys, edition) for name, keys in BOTH.items() for edition in (1, 2)}
CASES |= {name: (keys, 2) for name, keys in SECOND.items()}
CASES["lambert on an oblate earth-1"] = ({**LAMBERT, "resolutionAndComponentFlags": 72}, 1)


def grid_of(message, folder):
    contents = scan_file(write(folder / "one.grib", message))
    assert contents.grids, contents.skipped
    return read_grid(*contents.grids[0])


def points_of(message):
    """Latitude, longitude and value of every point by ecCodes' iterator."""
    handle = eccodes.codes_new_from_message(message)
    iterator = eccodes.codes_grib_iterator_new(handle, 0)
    rows = []
    while point := eccodes.codes_grib_iterator_next(iterator):
        rows.append(point)
    eccodes.codes_grib_iterator_delete(iterator)
    eccodes.codes_release(handle)
    return np.array(rows).T


@pytest.mark.parametrize("name", CASES)
def test_points_and_direction_are_those_of_eccodes(name, tmp_path):
    keys, edition = CASES[name]
    message = build(keys, edition=edition, bits=24)
    grid = grid_of(message, tmp_path)
    lat, lon, value = points_of(message)
    assert lat.size == grid.size
    fi, fj = grid.plane(lat, lon)
    # 1e-4 degrees of the grid's step of 0.3 degrees or more
    assert max(np.abs(fi - np.rint(fi)).max(), np.abs(fj - np.rint(fj)).max()) < 4e-4
    i, j = np.rint(fi).astype(int) % grid.ni, np.rint(fj).astype(int)
    np.testing.assert_array_equal(grid.position(i, j), np.rint(value).astype(int))
    # inside, in every convention of longitude; the other hemisphere is outside
    middle = (i > 0) & (i < grid.ni - 1) & (j > 0) & (j < grid.nj - 1)
    for turn in (-360.0, 0.0, 360.0):
        again, _ = grid.fractional_index(lat[middle], lon[middle] + turn)
        np.testing.assert_allclose(again, np.mod(fi[middle], grid.ni), atol=1e-6)
    if not grid.periodic:
        assert not grid.contains(-lat[middle], lon[middle] + 140.0).any()
    assert pickle.loads(pickle.dumps(grid)) == grid
    # v along the grid, turned to true east and north, points along the column
    place = np.argsort(np.rint(value))
    lat, lon = np.radians(lat[place]), np.radians(lon[place])
    i, j = np.full(1, grid.ni // 2), np.full(1, grid.nj // 2)
    up = 1 if grid.y[-1] > grid.y[0] else -1
    below, above = (int(grid.position(i, j + n * up)[0]) for n in (-1, 1))
    point = int(grid.position(i, j)[0])
    east = (lon[above] - lon[below] + np.pi) % (2 * np.pi) - np.pi
    bearing = np.arctan2(east * np.cos(lat[point]), lat[above] - lat[below])
    angle = grid.convergence(np.degrees(lat[[point]]), np.degrees(lon[[point]]))[0]
    assert np.angle(np.exp(1j * (angle - bearing))) == pytest.approx(0.0, abs=6e-3)


def test_convergence_of_the_published_example():
    """Latin 25, LoV 265E: -12.7 degrees at 125W, +4.4 at 84.5W, +8.5 at 75W (DOMAIN, trap 1)."""
    frame = grids.Frame(
        "projected", "+proj=lcc +lat_1=25 +lat_2=25 +lat_0=25 +lon_0=265 +R=6371229"
    )
    angle = np.degrees(frame.convergence(np.full(3, 40.0), np.array([-125.0, -84.5, -75.0])))
    np.testing.assert_allclose(angle, [-12.7, 4.4, 8.5], atol=0.05)


@pytest.mark.parametrize("columns", [0, 1])
def test_every_other_row_may_run_backwards(columns, tmp_path):
    keys = {**LATLON, "jPointsAreConsecutive": columns, "alternativeRowScanning": 1}
    grid = grid_of(build(keys), tmp_path)
    order = np.arange(grid.size).reshape((grid.ni, grid.nj) if columns else (grid.nj, grid.ni))
    order[1::2] = order[1::2, ::-1]
    i, j = np.meshgrid(np.arange(grid.ni), np.arange(grid.nj))
    np.testing.assert_array_equal(grid.position(i, j), order.T if columns else order)


def test_southern_polar_grid_of_edition_1_equals_edition_2(tmp_path):
    # ecCodes' iterator ignores the projection centre flag of edition 1
    first = grid_of(build({**POLAR, **SOUTHWARD}, edition=1), tmp_path)
    second = grid_of(build({**POLAR, **SOUTHWARD, "LaDInDegrees": -60.0}), tmp_path)
    lat, lon, _ = points_of(build({**POLAR, **SOUTHWARD, "LaDInDegrees": -60.0}))
    for a, b in zip(first.plane(lat, lon), second.plane(lat, lon), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("edition", [1, 2])
def test_thirds_of_a_degree_are_taken_from_the_corners(edition, tmp_path):
    # the increment is written as 0.333; adding it 90 times would be 0.03 degrees off
    grid = grid_of(build({**LATLON, **THIRDS}, edition=edition), tmp_path)
    steps = np.arange(0, 61)
    fi, fj = grid.plane(60.0 - steps / 3.0, -10.0 + steps / 3.0)
    np.testing.assert_allclose(fi, steps, atol=1e-9)
    np.testing.assert_allclose(fj, steps, atol=1e-9)


@pytest.mark.parametrize("edition", [1, 2])
def test_regular_gaussian_grids_are_known(edition, tmp_path):
    handle = eccodes.codes_grib_new_from_samples(f"regular_gg_pl_grib{edition}")
    eccodes.codes_set(handle, "shortName", "u")
    message = bytes(eccodes.codes_get_message(handle))
    eccodes.codes_release(handle)
    lat, lon, _ = points_of(message)
    for index in grid_of(message, tmp_path).plane(lat, lon):
        assert np.abs(index - np.rint(index)).max() < 1e-3


def rapid_refresh(*, thousandths, last):
    """Section 3 of NCEP's template 3.32769 for the native grid of the 13 km Rapid Refresh."""
    ni, nj, step = 953, 834, 0.121813
    ends = np.array([-1.0, 1.0]) * step / 2
    frame = grids.rotated_frame(90.0 - 54.0, 254.0 + 180.0)
    lat, lon = frame.places(ends * (ni - 1), ends * (nj - 1))
    section = bytearray(80)
    section[:5], section[12:14], section[14] = (80).to_bytes(4, "big") + b"\x03", b"\x80\x01", 6
    section[54], section[71] = 0x38, 0x40
    stated = step * 1e3 if thousandths else step
    degrees = {46: lat[0], 50: lon[0] % 360, 55: 54.0, 59: 254.0, 63: stated, 67: stated}
    degrees |= {72: lat[1], 76: lon[1] % 360} if last else {}
    numbers = {at: round(abs(x) * 1e6) | (x < 0) << 31 for at, x in degrees.items()}
    for at, number in (numbers | {6: ni * nj, 30: ni, 34: nj}).items():
        section[at : at + 4] = int(number).to_bytes(4, "big")
    return bytes(section)


@pytest.mark.parametrize("thousandths", [True, False])
@pytest.mark.parametrize("last", [True, False])
def test_native_grid_of_the_rapid_refresh(thousandths, last):
    """The first point lies near -10.59 N 220.91 E, as in the operational files."""
    grid = read_grid(2, rapid_refresh(thousandths=thousandths, last=last))
    assert (grid.ni, grid.nj) == (953, 834) and grid.wind_along_grid
    fi, fj = grid.plane(np.array([-10.59, 54.0]), np.array([220.91, 254.0]))
    np.testing.assert_allclose(fi, [0.0, 476.0], atol=0.2)
    np.testing.assert_allclose(fj, [0.0, 416.5], atol=0.2)
    # at its central meridian the grid points north, east of it to the left of north
    angle = grid.convergence([54.0, 40.0], [254.0, 274.0])
    assert angle[0] == pytest.approx(0.0, abs=1e-8) and angle[1] > 0.1


@pytest.mark.parametrize(
    ("base", "keys", "reason"),
    [
        (ROTATED, {"angleOfRotationInDegrees": 30.0}, "about its pole"),
        (LAMBERT, {"Latin1InDegrees": 30.0, "Latin2InDegrees": -30.0}, "no Lambert cone"),
        (POLAR, {"projectionCentreFlag": 64}, "bipolar"),
        (MERCATOR, {"orientationOfTheGridInDegrees": 10.0}, "turned against the equator"),
        (LATLON, {"latitudeOfLastGridPointInDegrees": 80.0}, "contradict"),
    ],
)
def test_unknown_grids_are_refused_with_a_reason(base, keys, reason, tmp_path):
    contents = scan_file(write(tmp_path / "bad.grib", build(base, extra=keys)))
    assert not contents.fields
    assert any(kind == "grid" and reason in why for kind, why in contents.skipped)


def test_axes_may_run_either_way_and_need_not_be_even():
    lat = np.array([80.0, 50.0, 10.0, -5.0])
    grid = grids.AxesGrid(grids.LONGITUDE_LATITUDE, np.array([170.0, 175.0, -175.0, -160.0]), lat)
    fi, fj = grid.fractional_index([65.0, 0.0], [172.5, 180.0])
    np.testing.assert_allclose(fi, [0.5, 1.5])
    np.testing.assert_allclose(fj, [0.5, 2 + 10 / 15])
    assert not grid.contains([0.0], [165.0]).any()


def test_points_grid_equals_the_projection_it_was_made_from():
    frame = grids.Frame(
        "projected", "+proj=lcc +lat_1=40 +lat_2=40 +lat_0=40 +lon_0=-97 +R=6370000"
    )
    axes = grids.AxesGrid(frame, np.arange(-20, 21) * 3e3, np.arange(-15, 16) * 3e3, True)
    x, y = np.meshgrid(axes.x, axes.y)
    lat, lon = (coordinate.reshape(x.shape) for coordinate in frame.places(x.ravel(), y.ravel()))
    points = grids.PointsGrid(lat, lon, wind_along_grid=True)
    rng = np.random.default_rng(0)
    where = frame.places(rng.uniform(-59e3, 59e3, 200), rng.uniform(-44e3, 44e3, 200))
    by_points, by_axes = (grid.fractional_index(*where) for grid in (points, axes))
    np.testing.assert_allclose(by_points, by_axes, atol=1e-5)
    np.testing.assert_allclose(points.convergence(*where), axes.convergence(*where), atol=1e-5)
    assert not points.contains([35.0, 40.0], [-97.0, 83.0]).any()
    again = pickle.loads(pickle.dumps(points))
    assert again == points and hash(again) == hash(points)
    laid = grids.through_points(frame, lat, lon)
    assert laid is not None
    np.testing.assert_allclose(laid.x, axes.x, atol=1e-3)
    assert grids.through_points(grids.LONGITUDE_LATITUDE, lat, lon) is None
