"""The flights: they go where they should, at the speed they say, when they say."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from airswing.synthetic.flights import (
    NETWORKS,
    STEP,
    Flown,
    Timetable,
    fly,
    timetable,
)

GEOD = pyproj.Geod(ellps="WGS84")


@pytest.fixture(scope="module")
def table() -> Timetable:
    return timetable(NETWORKS["great_lakes"], aircraft=4, days=6, seed=5, legs_per_day=4.0)


@pytest.fixture(scope="module")
def flown(table: Timetable) -> Flown:
    def wind(lat: np.ndarray, lon: np.ndarray, alt: np.ndarray, hours: np.ndarray) -> np.ndarray:
        return np.stack([10.0 + 0.002 * alt, -3.0 + 0 * alt])

    return fly(table, wind, seed=5)


def test_every_flight_arrives(table: Timetable, flown: Flown) -> None:
    last = (flown.phase > 0).sum(axis=0) - 1
    assert last.max() < flown.phase.shape[0]
    flights = np.arange(last.size)
    left = GEOD.inv(
        flown.longitude[last, flights],
        flown.latitude[last, flights],
        table.destination[:, 1],
        table.destination[:, 0],
    )[2]
    assert np.median(left) < 15e3
    assert np.max(left) < 60e3
    assert (flown.altitude.max(axis=0) >= table.cruise_altitude - 100).all()


def test_ground_velocity_is_the_velocity_of_the_positions(flown: Flown) -> None:
    """Centred geodesic chord over two steps against the stored velocity, in cruise."""
    lat, lon = flown.latitude, flown.longitude
    azimuth, _, length = GEOD.inv(lon[:-2], lat[:-2], lon[2:], lat[2:])
    steady = (flown.phase[:-2] == 2) & (flown.phase[2:] == 2) & (np.abs(flown.bank[1:-1]) < 0.01)
    turn = np.radians(azimuth)
    for name, part in (("east", np.sin(turn)), ("north", np.cos(turn))):
        error = length / (2 * STEP) * part - getattr(flown, name)[1:-1]
        assert np.sqrt(np.mean(error[steady] ** 2)) < 0.1
