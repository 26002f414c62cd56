"""The interpolated field against IGRF itself."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from airswing.physics.geomagnetism import GeomagneticField, geomagnetic_field

ppigrf = pytest.importorskip("ppigrf")

MID_2009 = float(np.datetime64("2009-07-01", "s").astype(np.int64))


def field_at(latitude, longitude, height=3000.0, seconds=MID_2009) -> GeomagneticField:
    return geomagnetic_field(latitude, longitude, height, seconds)


@pytest.mark.parametrize(
    ("north", "south", "west", "east"),
    [
        (50.0, 24.0, -130.0, -65.0),
        (72.0, 50.0, -180.0, -130.0),
        (72.0, 35.0, -12.0, 40.0),
        (15.0, -60.0, -180.0, 180.0),
    ],
)
def test_declination_within_a_hundredth_of_a_degree_of_igrf(
    north: float, south: float, west: float, east: float
) -> None:
    rng = np.random.default_rng(7)
    latitude, longitude = rng.uniform(south, north, 300), rng.uniform(west, east, 300)
    height = rng.uniform(-200.0, 13500.0, 300)
    for date in (datetime(2008, 7, 3), datetime(2011, 3, 1, 6)):
        seconds = (date - datetime(1970, 1, 1)).total_seconds()
        found = field_at(latitude, longitude, height, seconds)
        e, n, up = (part[0] for part in ppigrf.igrf(longitude, latitude, height / 1000.0, date))
        horizontal = np.hypot(e, n)
        strong = horizontal > 5000.0
        miss = np.degrees(np.abs(found.declination - np.arctan2(e, n)))[strong]
        assert strong.sum() > 210
        assert miss.max() < 0.01
        assert np.abs(found.horizontal - horizontal).max() < 1.0
        assert np.degrees(np.abs(found.dip - np.arctan2(-up, horizontal))).max() < 0.01


def test_one_reports_field_does_not_depend_on_the_others() -> None:
    rng = np.random.default_rng(11)
    size = 70_001  # more than two blocks, and no multiple of one
    # from pole to pole across the 180th meridian and two five-year intervals
    latitude, longitude = rng.uniform(-89.9, 89.9, size), rng.uniform(150.0, 210.0, size)
    height = rng.uniform(0.0, 13000.0, size)
    seconds = rng.uniform(1.2e9, 1.3e9, size)
    whole = geomagnetic_field(latitude, longitude, height, seconds)
    for part in (slice(0, 1), slice(5, 12), slice(40_000, 40_777), slice(65_000, size)):
        arguments = latitude[part], longitude[part], height[part], seconds[part]
        alone = geomagnetic_field(*arguments)
        for name in GeomagneticField._fields:
            np.testing.assert_array_equal(getattr(alone, name), getattr(whole, name)[part])
    signed = (longitude + 180.0) % 360.0 - 180.0
    other = geomagnetic_field(latitude, signed, height, seconds)
    np.testing.assert_allclose(other.declination, whole.declination, atol=1e-9)


def test_unknown_places_and_times_outside_the_epochs_have_no_field() -> None:
    latitude = np.array([np.nan, 45.0, 45.0, 91.0, 45.0])
    longitude = np.array([10.0, np.nan, 10.0, 10.0, 10.0])
    seconds = np.array([MID_2009, MID_2009, np.nan, MID_2009, 3.0e9])
    found = field_at(latitude, longitude, 3000.0, seconds)
    assert np.isnan(found.declination).all()
    assert np.isnan(found.horizontal).all()
    assert np.isfinite(field_at(45.0, 10.0).dip)
    assert geomagnetic_field([], [], [], []).declination.shape == (0,)
