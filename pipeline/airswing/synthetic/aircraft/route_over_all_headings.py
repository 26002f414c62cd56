"""Tours: one day of straight cruise legs that cover the compass, for a day of real model winds.

Assumptions: an aircraft flies leg after leg along geodesics at constant level and ground speed,
without landing, its directions spread evenly over the compass in random order, so that a single
day holds what hub-and-spoke flying needs weeks for. Nothing is reported in the first two minutes
of a leg. Units: SI, degrees for places, hours since the start.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from airswing.synthetic.aircraft.airborne_fleet import CRUISE, STEP, Flown
from airswing.synthetic.world.true_atmosphere import stream

__all__ = ["tour"]

Array = NDArray[np.float64]
Kind = TypeVar("Kind", bound=np.generic)
_GEOD = Geod(ellps="WGS84")
# Steps of a leg before the first report.
_SILENT = 12
# First and last hour of flying: the run's winds end with the day.
_HOURS = 0.3, 23.5
# Some fifty legs a day: each of the eight compass points is flown six times.
_LEG_MINUTES = 26.0
# South, north, west, east of where tours start, degrees: well inside the real run's grid.
_BOX = 35.0, 41.0, -101.0, -87.0
# Range of the legs' levels, m.
_ALTITUDES = 1500.0, 7600.0


def tour(
    wind: Callable[[Array, Array, Array, Array], Array],
    *,
    aircraft: int,
    seed: int,
) -> Flown:
    """Fly every aircraft through its legs.

    Parameters
    ----------
    wind : callable
        (latitude, longitude, altitude m, hours) to the wind (2, n) in m/s.

    Returns
    -------
    Flown
        One flight a leg, in order of aircraft and time.
    """
    rng = stream(seed, "tour")
    steps = round(_LEG_MINUTES * 60.0 / STEP)
    legs = int((_HOURS[1] - _HOURS[0]) * 60.0 // _LEG_MINUTES)
    lat = rng.uniform(*_BOX[:2], aircraft)
    lon = rng.uniform(*_BOX[2:], aircraft)
    airspeed = rng.uniform(126.0, 142.0, aircraft)
    even = np.arange(legs) * 360.0 / legs
    courses = np.stack([rng.permutation(even + rng.uniform(0, 360.0)) for _ in range(aircraft)])
    shape = (legs, steps + 2, aircraft)
    kept = {
        name: np.zeros(shape) for name in ("latitude", "longitude", "altitude", "east", "north")
    }
    phase = np.zeros(shape, np.int8)
    phase[:, _SILENT:steps] = CRUISE
    start = _HOURS[0] + np.arange(legs) * _LEG_MINUTES / 60.0
    for leg in range(legs):
        level = rng.uniform(*_ALTITUDES, aircraft)
        blown = wind(lat, lon, level, np.full(aircraft, start[leg]))
        turn = np.radians(courses[:, leg])
        speed = airspeed + blown[0] * np.sin(turn) + blown[1] * np.cos(turn)
        along = np.arange(steps + 2)[:, None] * STEP * speed
        here = np.broadcast_to(lon, along.shape), np.broadcast_to(lat, along.shape)
        course = np.broadcast_to(courses[:, leg], along.shape)
        places = _GEOD.fwd(*here, course, along)
        track = np.radians(np.asarray(places[2]) + 180.0)
        kept["longitude"][leg], kept["latitude"][leg] = places[0], places[1]
        kept["altitude"][leg] = level
        kept["east"][leg], kept["north"][leg] = speed * np.sin(track), speed * np.cos(track)
        lon, lat = kept["longitude"][leg, steps], kept["latitude"][leg, steps]

    def ordered(values: NDArray[Kind]) -> NDArray[Kind]:
        return np.ascontiguousarray(values.transpose(1, 2, 0).reshape(steps + 2, -1))

    return Flown(
        bank=np.zeros((steps + 2, aircraft * legs)),
        phase=ordered(phase).astype(np.int8),
        departure=np.tile(start, aircraft),
        aircraft=np.repeat(np.arange(aircraft), legs),
        **{name: ordered(values) for name, values in kept.items()},
    )
