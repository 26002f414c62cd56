"""Grids against eccodes' own latitudes and longitudes, pyproj, and each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import eccodes
import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.reference.builders import LAMBERT, LATLON, MERCATOR, POLAR, ROTATED, build, write

from airswing.reference.geometry.grids import Grid, UnplaceableGridError
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.grib.messages import scan_file

SOUTH_CONE = {"Latin1InDegrees": -30.0, "Latin2InDegrees": -60.0}
GLOBE = {
    **LATLON,
    "Ni": 36,
    "Nj": 19,
    "iDirectionIncrementInDegrees": 10.0,
    "jDirectionIncrementInDegrees": 10.0,
    "latitudeOfFirstGridPointInDegrees": 90.0,
    "latitudeOfLastGridPointInDegrees": -90.0,
    "longitudeOfFirstGridPointInDegrees": 0.0,
    "longitudeOfLastGridPointInDegrees": 350.0,
}
SOUTHWARD = {"latitudeOfFirstGridPointInDegrees": -30.0, "projectionCentreFlag": 128}
UP = {"latitudeOfFirstGridPointInDegrees": 40.0, "latitudeOfLastGridPointInDegrees": 60.0}
WEST = {"longitudeOfFirstGridPointInDegrees": 35.0, "longitudeOfLastGridPointInDegrees": 5.0}
THIRDS = {
    "Ni": 91,
    "longitudeOfFirstGridPointInDegrees": -10.0,
    "Nj": 61,
    "longitudeOfLastGridPointInDegrees": 20.0,
    "iDirectionIncrementInDegrees": 0.333,
    "jDirectionIncrementInDegrees": 0.333,
}
CASES: dict[str, tuple[dict[str, Any], int]] = {}
for _edition in (1, 2):
    CASES |= {
        f"{name}-{_edition}": (keys, _edition)
        for name, keys in {
            "lambert tangent": LAMBERT,
            "lambert secant": {**LAMBERT, "Latin1InDegrees": 30.0, "Latin2InDegrees": 60.0},
            "lambert south": {**LAMBERT, **SOUTH_CONE, "latitudeOfFirstGridPointInDegrees": -55.0},
            "lambert by columns": {**LAMBERT, "jPointsAreConsecutive": 1},
            "lambert over the antimeridian": {
                **LAMBERT,
                "LoVInDegrees": 180.0,
                "longitudeOfFirstGridPointInDegrees": 160.0,
            },
            "latlon": LATLON,
            "latlon northwards": {**LATLON, **UP, "jScansPositively": 1},
            "latlon westwards": {**LATLON, **WEST, "iScansNegatively": 1},
            "latlon by columns": {**LATLON, "jPointsAreConsecutive": 1},
            "globe": GLOBE,
            "rotated": ROTATED,
            "polar": POLAR,
            "mercator": MERCATOR,
        }.items()
    }
for _lad in (25.0, 60.0, 90.0):
    CASES[f"polar north LaD {_lad}"] = ({**POLAR, "LaDInDegrees": _lad}, 2)
    CASES[f"polar south LaD {_lad}"] = ({**POLAR, **SOUTHWARD, "LaDInDegrees": -_lad}, 2)
CASES["mercator LaD 40"] = ({**MERCATOR, "LaDInDegrees": 40.0}, 2)
CASES["lambert LaD elsewhere"] = ({**LAMBERT, "LaDInDegrees": 60.0}, 2)
for _shape in (0, 2, 4, 5, 6, 8, 9):
    CASES[f"lambert on earth {_shape}"] = (
        {**LAMBERT, "Latin1InDegrees": 30.0, "Latin2InDegrees": 60.0, "shapeOfTheEarth": _shape},
        2,
    )
    CASES[f"mercator on earth {_shape}"] = ({**MERCATOR, "shapeOfTheEarth": _shape}, 2)
CASES["lambert on an oblate earth-1"] = ({**LAMBERT, "resolutionAndComponentFlags": 72}, 1)


def grid_of(message: bytes, folder: Path) -> Grid:
    contents = scan_file(write(folder / "one.grib", message))
    assert contents.grids, contents.skipped
    return read_grid(*contents.grids[0])


def eccodes_points(message: bytes) -> np.ndarray:
    """Latitude, longitude and value of every point by eccodes' iterator."""
    handle = eccodes.codes_new_from_message(message)
    iterator = eccodes.codes_grib_iterator_new(handle, 0)
    rows = []
    while point := eccodes.codes_grib_iterator_next(iterator):
        rows.append(point)
    eccodes.codes_grib_iterator_delete(iterator)
    eccodes.codes_release(handle)
    return np.array(rows).T


def inverse_error(grid: Grid, lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """Distance in degrees between eccodes' points and the nearest integer index."""
    fi, fj = grid.plane(lat, lon)
    degrees = 1.0 if grid.kind.endswith("ll") else 360.0 / (2 * np.pi * grid.radius)
    error_i, error_j = (fi - np.rint(fi)) * grid.di, (fj - np.rint(fj)) * grid.dj
    return np.hypot(error_i, error_j) * degrees


@pytest.mark.parametrize("name", CASES)
def test_points_are_where_eccodes_puts_them(name: str, tmp_path: Path) -> None:
    keys, edition = CASES[name]
    message = build(keys, edition=edition, bits=24)
    grid = grid_of(message, tmp_path)
    lat, lon, value = eccodes_points(message)
    assert lat.size == grid.size
    fi, fj = grid.plane(lat, lon)
    assert inverse_error(grid, lat, lon).max() < 1e-4
    position = grid.position(np.rint(fi).astype(int) % grid.ni, np.rint(fj).astype(int))
    np.testing.assert_array_equal(position, np.rint(value).astype(int))


@pytest.mark.parametrize("name", CASES)
def test_every_grid_point_is_inside_and_points_beyond_are_not(name: str, tmp_path: Path) -> None:
    keys, edition = CASES[name]
    message = build(keys, edition=edition, bits=24)
    grid = grid_of(message, tmp_path)
    lat, lon, _ = eccodes_points(message)
    fi, fj = grid.plane(lat, lon)
    middle = (np.rint(fi) > 0) & (np.rint(fi) < grid.ni - 1)
    middle &= (np.rint(fj) > 0) & (np.rint(fj) < grid.nj - 1)
    assert np.isfinite(grid.fractional_index(lat[middle], lon[middle])[0]).all()
    for turn in (-360.0, 360.0):
        again, _ = grid.fractional_index(lat[middle], lon[middle] + turn)
        np.testing.assert_allclose(
            again, grid.fractional_index(lat[middle], lon[middle])[0], atol=1e-6
        )
    if not grid.periodic:
        beyond, _ = grid.fractional_index(-lat[middle], lon[middle] + 140.0)
        assert np.isnan(beyond).all()


def test_southern_polar_grid_of_edition_1_equals_edition_2(tmp_path: Path) -> None:
    # eccodes' iterator ignores the projection centre flag of edition 1.
    one = grid_of(build({**POLAR, **SOUTHWARD}, edition=1), tmp_path)
    two = grid_of(build({**POLAR, **SOUTHWARD, "LaDInDegrees": -60.0}), tmp_path)
    lat, lon, _ = eccodes_points(build({**POLAR, **SOUTHWARD, "LaDInDegrees": -60.0}))
    assert one.south and two.south
    for a, b in zip(one.plane(lat, lon), two.plane(lat, lon), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("shape", [2, 5])
def test_ellipsoidal_polar_grid_against_pyproj(shape: int, tmp_path: Path) -> None:
    keys = {**POLAR, "shapeOfTheEarth": shape, "LaDInDegrees": 60.0}
    grid = grid_of(build(keys), tmp_path)
    minor = grid.radius * np.sqrt(1 - grid.eccentricity**2)
    project = pyproj.Proj(
        f"+proj=stere +lat_0=90 +lat_ts=60 +lon_0=255 +a={grid.radius} +b={minor}"
    )
    lat, lon = np.array([35.0, 50.0, 70.0]), np.array([-130.0, -105.0, -80.0])
    x0, y0 = project(230.0, 30.0)
    x, y = project(lon, lat)
    fi, fj = grid.plane(lat, lon)
    np.testing.assert_allclose(fi, (x - x0) / 190500, atol=1e-6)
    np.testing.assert_allclose(fj, (y - y0) / 190500, atol=1e-6)


@pytest.mark.parametrize("alternate", [0, 1])
@pytest.mark.parametrize("columns", [0, 1])
@pytest.mark.parametrize("northward", [0, 1])
@pytest.mark.parametrize("westward", [0, 1])
@pytest.mark.parametrize("base", [LAMBERT, LATLON], ids=["lambert", "latlon"])
def test_every_scanning_order_of_one_grid_says_the_same(
    base: dict[str, Any],
    westward: int,
    northward: int,
    columns: int,
    alternate: int,
    tmp_path: Path,
) -> None:
    """A grid described from each corner: same places, and each value at its place."""
    plain = grid_of(
        build({**base, "jScansPositively": 1, **(UP if base is LATLON else {})}), tmp_path
    )
    i, j = plain.ni - 1 if westward else 0, 0 if northward else plain.nj - 1
    lat, lon = place_of(plain, i, j)
    keys = {
        **base,
        "iScansNegatively": westward,
        "jScansPositively": northward,
        "jPointsAreConsecutive": columns,
        "alternativeRowScanning": alternate,
        "latitudeOfFirstGridPointInDegrees": lat,
        "longitudeOfFirstGridPointInDegrees": lon % 360,
    }
    if base is LATLON:
        keys["latitudeOfLastGridPointInDegrees"] = 60.0 if northward else 40.0
        keys["longitudeOfLastGridPointInDegrees"] = 5.0 if westward else 35.0
    grid = grid_of(build(keys), tmp_path)
    some = np.random.default_rng(3)
    ii, jj = some.integers(0, plain.ni, 50), some.integers(0, plain.nj, 50)
    lats, lons = np.array([place_of(plain, a, b) for a, b in zip(ii, jj, strict=True)]).T
    fi, fj = grid.plane(lats, lons)
    mine_i = plain.ni - 1 - ii if westward else ii
    mine_j = jj if northward else plain.nj - 1 - jj
    np.testing.assert_allclose(fi, mine_i, atol=2e-4)
    np.testing.assert_allclose(fj, mine_j, atol=2e-4)
    np.testing.assert_array_equal(
        grid.position(mine_i, mine_j), expected_position(grid, mine_i, mine_j)
    )


def expected_position(grid: Grid, i: np.ndarray, j: np.ndarray) -> list[int]:
    """Walk the grid as WMO flag table 3.4 tells and look the points up."""
    outer, inner = (grid.ni, grid.nj) if grid.j_consecutive else (grid.nj, grid.ni)
    order = {}
    for row in range(outer):
        run = range(inner) if not (grid.alternate_rows and row % 2) else range(inner - 1, -1, -1)
        for place in run:
            order[(row, place) if grid.j_consecutive else (place, row)] = len(order)
    return [order[a, b] for a, b in zip(i.tolist(), j.tolist(), strict=True)]


def place_of(grid: Grid, i: int, j: int) -> tuple[float, float]:
    """Latitude and longitude of a grid point, by pyproj or by plain steps."""
    if grid.kind == "regular_ll":
        return (
            float(grid.latitude_first + grid.dj * j),
            float(grid.longitude_first + grid.di * i),
        )
    project = pyproj.Proj(
        f"+proj=lcc +lat_1={grid.latin1} +lat_2={grid.latin2} +lat_0={grid.latin1} "
        f"+lon_0={grid.orientation} +R={grid.radius}"
    )
    x0, y0 = project(grid.longitude_first, grid.latitude_first)
    lon, lat = project(x0 + grid.di * i, y0 + grid.dj * j, inverse=True)
    return float(lat), float(lon)


def test_convergence_of_the_published_example() -> None:
    """Latin 25, LoV 265E: -12.7 degrees at 125W, +4.4 at 84.5W, +8.5 at 75W."""
    grid = Grid("lambert", 2, 2, 20.0, 240.0, 1e4, 1e4, orientation=265.0, latin1=25.0, latin2=25.0)
    angle = np.degrees(grid.convergence(np.full(3, 40.0), np.array([-125.0, -84.5, -75.0])))
    np.testing.assert_allclose(angle, [-12.7, 4.4, 8.5], atol=0.05)


@pytest.mark.parametrize("name", CASES)
def test_convergence_is_the_direction_of_the_grids_own_columns(name: str, tmp_path: Path) -> None:
    """Walk a little north: index space must turn by the convergence angle.

    All these projections but latitude/longitude are conformal, and there the angle is the one
    between true north and increasing j as seen by `plane`.
    """
    keys, edition = CASES[name]
    grid = grid_of(build(keys, edition=edition), tmp_path)
    lat0, lon0 = eccodes_points(build(keys, edition=edition))[:2, grid.size // 2 + 3]
    lat, lon = np.array([lat0]), np.array([lon0])
    step = 1e-5
    i1, j1 = grid.plane(lat + step, lon)
    i0, j0 = grid.plane(lat - step, lon)
    x, y = (i1 - i0) * grid.di, (j1 - j0) * grid.dj
    if grid.kind == "rotated_ll":
        pole_lat, pole_lon = np.radians([-grid.pole_latitude, grid.pole_longitude + 180.0])
        phi, lam = np.radians(lat), np.radians(lon)
        sine = np.sin(pole_lat) * np.sin(phi) + np.cos(pole_lat) * np.cos(phi) * np.cos(
            lam - pole_lon
        )
        x = x * np.sqrt(1 - sine**2)
    # True north in grid components is (u_g, v_g) = (-sin a, cos a) for u_e = 0, v_e = 1.
    angle = np.arctan2(-x, y)
    np.testing.assert_allclose(grid.convergence(lat, lon), angle, atol=1e-5)


@given(lat=st.floats(-89, 89), lon=st.floats(-180, 180), u=st.floats(-80, 80), v=st.floats(-80, 80))
def test_turning_keeps_the_speed(lat: float, lon: float, u: float, v: float) -> None:
    grid = Grid("rotated_ll", 9, 9, 0.0, 0.0, 1.0, 1.0, pole_latitude=-35.0, pole_longitude=15.0)
    angle = grid.convergence(lat, lon)
    east, north = np.cos(angle) * u + np.sin(angle) * v, -np.sin(angle) * u + np.cos(angle) * v
    assert np.hypot(east, north) == pytest.approx(np.hypot(u, v), abs=1e-9)


def test_globe_is_periodic_and_a_window_is_not(tmp_path: Path) -> None:
    globe = grid_of(build(GLOBE), tmp_path)
    assert globe.periodic and not grid_of(build(LATLON), tmp_path).periodic
    fi, fj = globe.fractional_index([0.0, 0.0, 90.0], [355.0, -5.0, 123.0])
    np.testing.assert_allclose(fi, [35.5, 35.5, 12.3])
    np.testing.assert_allclose(fj, [9.0, 9.0, 0.0])


@pytest.mark.parametrize("edition", [1, 2])
def test_thirds_of_a_degree_are_taken_from_the_corners(edition: int, tmp_path: Path) -> None:
    # The increment is written as 0.333; adding it 90 times would be 0.03 degrees off.
    grid = grid_of(build({**LATLON, **THIRDS}, edition=edition), tmp_path)
    steps = np.arange(0, 61)
    fi, fj = grid.plane(60.0 - steps / 3.0, -10.0 + steps / 3.0)
    np.testing.assert_allclose(fi, steps, atol=1e-9)
    np.testing.assert_allclose(fj, steps, atol=1e-9)


def test_longitude_conventions_do_not_matter(tmp_path: Path) -> None:
    grid = grid_of(build(LAMBERT), tmp_path)
    east, _ = grid.fractional_index(35.0, 255.0)
    west, _ = grid.fractional_index(35.0, -105.0)
    assert east == west and np.isfinite(east)


@pytest.mark.parametrize("edition", [1, 2])
def test_gaussian_grids_are_refused_by_name(edition: int, tmp_path: Path) -> None:
    handle = eccodes.codes_grib_new_from_samples(f"regular_gg_pl_grib{edition}")
    keys = {1: {"indicatorOfParameter": 131}, 2: {"parameterCategory": 2, "parameterNumber": 2}}
    for key, value in keys[edition].items():
        eccodes.codes_set(handle, key, value)
    contents = scan_file(write(tmp_path / "g.grib", eccodes.codes_get_message(handle)))
    eccodes.codes_release(handle)
    assert not contents.fields
    assert any("gaussian" in why for _, why in contents.skipped)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({**ROTATED, "angleOfRotationInDegrees": 30.0}, "about its own pole"),
        ({**LAMBERT, "Latin1InDegrees": 30.0, "Latin2InDegrees": -30.0}, "no Lambert cone"),
        ({**POLAR, "projectionCentreFlag": 64}, "bipolar"),
        ({**MERCATOR, "orientationOfTheGridInDegrees": 10.0}, "turned against the equator"),
        ({**LATLON, "latitudeOfLastGridPointInDegrees": 80.0}, "contradict"),
    ],
)
def test_what_cannot_be_placed_is_refused_with_a_reason(
    keys: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    contents = scan_file(write(tmp_path / "bad.grib", build(LATLON, edition=2)))
    assert contents.fields
    handle = eccodes.codes_new_from_message(build({**keys, **_valid(keys)}))
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)
    contents = scan_file(write(tmp_path / "bad.grib", eccodes.codes_get_message(handle)))
    eccodes.codes_release(handle)
    assert not contents.fields
    assert any(what == "grid" and reason in why for what, why in contents.skipped)


def _valid(keys: dict[str, Any]) -> dict[str, Any]:
    """The same grid without its fault, so that eccodes will encode values on it."""
    for good in (ROTATED, LAMBERT, POLAR, MERCATOR, LATLON):
        if good["gridType"] == keys["gridType"]:
            return good
    raise AssertionError


@pytest.mark.parametrize("edition", [1, 2])
@pytest.mark.parametrize("base", [LAMBERT, LATLON, ROTATED, POLAR, MERCATOR])
def test_a_section_cut_short_is_refused(base: dict[str, Any], edition: int, tmp_path: Path) -> None:
    contents = scan_file(write(tmp_path / "a.grib", build(base, edition=edition)))
    section = contents.grids[0][1]
    for length in (8, 20, 27):
        with pytest.raises(UnplaceableGridError, match="too short"):
            read_grid(edition, section[:length])
