"""Gridded models: rotation, interpolation, gradients, effects, and the GRIB files read back."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import eccodes
import numpy as np
import pyproj
import pytest

from airswing.synthetic.atmosphere import World, WorldParameters
from airswing.synthetic.fields import (
    GRIB1_RADIUS,
    GRIB2_RADIUS,
    GriddedReference,
    ReferenceChange,
    build_references,
    centred_grid,
    sample_reference,
    write_reference,
)

GRID = centred_grid(42.0, -85.0, columns=25, rows=21, spacing=40000.0, radius=GRIB1_RADIUS)
LEVELS = np.array([900.0, 700.0, 500.0, 400.0])
HOURS = np.arange(0.0, 7.0)
POINTS = {
    "latitude": np.array([40.3, 42.0, 43.7, 44.1]),
    "longitude": np.array([-88.1, -85.0, -82.3, -86.6]),
    "pressure": np.array([850.0, 640.0, 512.0, 433.0]),
    "hours": np.array([0.2, 2.5, 4.75, 5.0]),
}


@pytest.fixture(scope="module")
def world() -> World:
    return World(WorldParameters(), 8, 24.0)


def stored(world: World, **change: float) -> GriddedReference:
    made = build_references(
        world,
        GRID,
        names=("ruc",),
        levels=LEVELS,
        hours=HOURS,
        changes={"ruc": ReferenceChange(**change)},  # type: ignore[arg-type]
    )
    return made["ruc"]


def test_grid_components_point_where_the_grid_does(world: World) -> None:
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


def test_nothing_is_extrapolated(world: World) -> None:
    here = stored(world)
    outside = {
        "latitude": np.array([60.0, 42, 42, 42]),
        "longitude": np.full(4, -85.0),
        "pressure": np.array([500.0, 950.0, 300.0, 500.0]),
        "hours": np.array([1.0, 1.0, 1.0, 6.5]),
    }
    assert np.isnan(sample_reference(here, **outside)).all()


def test_speed_bias_acts_above_its_level_only(world: World) -> None:
    plain, strong = stored(world), stored(world, speed_percent=10.0, above_hpa=500.0)
    ratio = strong.wind / np.where(np.abs(plain.wind) > 5, plain.wind, np.nan)
    np.testing.assert_allclose(np.nanmean(ratio, axis=(0, 1, 3, 4)), [1, 1, 1.1, 1.1], atol=1e-3)


START = datetime(2009, 10, 19)
GRIB_LEVELS = np.array([850.0, 500.0])
GRIB_HOURS = np.array([22.0, 23.0, 24.0, 25.0])


def fields(edition: int, *, flag: bool) -> GriddedReference:
    grid = centred_grid(
        43.0,
        -86.0,
        columns=14,
        rows=11,
        spacing=40635.0,
        radius=GRIB1_RADIUS if edition == 1 else GRIB2_RADIUS,
    )
    wind = np.random.default_rng(2).normal(5, 20, (4, 2, 2, 11, 14)).round(1).astype(np.float32)
    return GriddedReference("ruc", grid, GRIB_LEVELS, GRIB_HOURS, wind, flag)


def messages(path: Path) -> list[dict[str, object]]:
    keys = (
        *("shortName", "level", "typeOfLevel", "validityDate", "validityTime", "endStep"),
        *("uvRelativeToGrid", "gridType", "radius", "editionNumber"),
    )
    found = []
    with path.open("rb") as source:
        while (handle := eccodes.codes_grib_new_from_file(source)) is not None:
            message = {key: eccodes.codes_get(handle, key) for key in keys}
            for key in ("values", "latitudes", "longitudes"):
                message[key] = eccodes.codes_get_array(handle, key)
            found.append(message)
            eccodes.codes_release(handle)
    return found


@pytest.mark.parametrize("edition", [1, 2])
@pytest.mark.parametrize("flag", [True, False])
def test_eccodes_reads_the_written_fields(tmp_path: Path, edition: int, flag: bool) -> None:
    made = fields(edition, flag=flag)
    paths = write_reference(tmp_path, made, start=START, edition=edition, lead_hours=2)
    assert len(paths) == 4
    for step, path in enumerate(paths):
        found = messages(path)
        assert [(item["shortName"], item["level"]) for item in found] == [
            ("u", 850),
            ("v", 850),
            ("u", 500),
            ("v", 500),
        ]
        for number, item in enumerate(found):
            expected = made.wind[step, number % 2, number // 2].ravel()
            np.testing.assert_allclose(item["values"], expected, atol=1e-4)
            assert item["uvRelativeToGrid"] == int(flag)
            assert (item["gridType"], item["typeOfLevel"]) == ("lambert", "isobaricInhPa")
            assert (item["radius"], item["endStep"]) == (made.grid.radius, 2)
            assert item["editionNumber"] == edition
    lat, lon = made.grid.coordinates
    np.testing.assert_allclose(found[0]["latitudes"], lat.ravel(), atol=1e-6)
    east = np.asarray(found[0]["longitudes"])
    np.testing.assert_allclose((east + 180) % 360 - 180, lon.ravel(), atol=1e-6)
    late = messages(paths[2])[0]
    assert (late["validityDate"], late["validityTime"]) == (20091020, 0)


@pytest.mark.parametrize("edition", [1, 2])
def test_cfgrib_reads_several_times_in_one_file(tmp_path: Path, edition: int) -> None:
    import xarray as xr

    made = fields(edition, flag=True)
    paths = write_reference(
        tmp_path, made, start=START, edition=edition, lead_hours=3, times_per_file=4
    )
    assert len(paths) == 1
    data = xr.open_dataset(paths[0], engine="cfgrib", backend_kwargs={"indexpath": ""})
    np.testing.assert_allclose(data["u"].values, made.wind[:, 0], atol=1e-4)
    np.testing.assert_allclose(data["v"].values, made.wind[:, 1], atol=1e-4)
    assert str(data["valid_time"].values[3])[:16] == "2009-10-20T01:00"
