"""The generator's own field against IGRF values at places and the package's lattice."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from airswing.synthetic.earth_field import EarthField, declination_of_year

BOX = (25.0, 48.0, -124.0, -75.0)


@pytest.fixture(scope="module")
def earth() -> EarthField:
    return EarthField(datetime(2009, 7, 1), 30.0, BOX)


@pytest.mark.parametrize(
    ("place", "field"),
    [((41.0, -88.0), 19369.0), ((27.97, -82.53), 24717.0), ((47.45, -122.31), 19178.0)],
)
def test_horizontal_field_at_known_places(
    earth: EarthField, place: tuple[float, float], field: float
) -> None:
    found = earth.at(np.array([place[0]]), np.array([place[1]]), np.zeros(1))[1][0]
    assert found == pytest.approx(field, rel=0.006)


def test_lattice_is_close_to_igrf_between_its_points(earth: EarthField) -> None:
    import ppigrf

    rng = np.random.default_rng(1)
    lat, lon = rng.uniform(26, 47, 20), rng.uniform(-123, -76, 20)
    east, north, up = ppigrf.igrf(lon, lat, 4.0, datetime(2009, 7, 16))
    declination, horizontal, down = earth.at(lat, lon, np.full(20, 15 * 24.0))
    expected = np.degrees(np.arctan2(east, north)).ravel()
    np.testing.assert_allclose(np.degrees(declination), expected, atol=0.03)
    np.testing.assert_allclose(horizontal, np.hypot(east, north).ravel(), rtol=2e-3)
    np.testing.assert_allclose(down, -up.ravel(), rtol=2e-3)


def test_an_older_table_differs_by_the_secular_variation(earth: EarthField) -> None:
    lat, lon = np.array([44.9]), np.array([-93.2])
    now = np.degrees(earth.at(lat, lon, np.zeros(1))[0][0])
    old = np.degrees(declination_of_year(lat, lon, 1995.0, BOX)[0])
    assert now == pytest.approx(0.5, abs=0.5)
    assert 1.0 < old - now < 2.5
