"""Tours: one day of straight cruise legs that cover the compass, for a day of real model winds.

Assumptions: an aircraft flies leg after leg along geodesics at constant level and ground speed,
without landing, its directions spread evenly over the compass in random order, so that a single
day holds what hub-and-spoke flying needs weeks for. Nothing is reported in the first two minutes
of a leg. Units: SI, degrees for places, hours since the start.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from airswing.synthetic.aircraft.airborne_fleet import CRUISE, STEP, Flown
from airswing.synthetic.world.true_atmosphere import stream

__all__ = ["tour"]

Array = NDArray[np.float64]
_GEOD = Geod(ellps="WGS84")
# Steps of a leg before the first report.
_SILENT = 12


def tour(
    wind: Callable[[Array, Array, Array, Array], Array],
    *,
    aircraft: int,
    seed: int,
    hours: tuple[float, float] = (0.3, 23.5),
    leg_minutes: float = 26.0,
    box: tuple[float, float, float, float] = (35.0, 41.0, -101.0, -87.0),
    altitudes: tuple[float, float] = (1500.0, 7600.0),
) -> Flown:
    """Fly every aircraft through its legs.

    Parameters
    ----------
    wind : callable
        (latitude, longitude, altitude m, hours) to the wind (2, n) in m/s.
    aircraft, seed : int
        Fleet and seed.
    hours : (float, float)
        First and last hour of flying.
    leg_minutes : float
        Length of a leg.
    box : (float, float, float, float)
        South, north, west, east of the places where tours start, degrees.
    altitudes : (float, float)
        Range of the legs' levels, m.

    Returns
    -------
    Flown
        One flight a leg, in order of aircraft and time.
    """
    rng = stream(seed, "tour")
    steps = round(leg_minutes * 60.0 / STEP)
    legs = int((hours[1] - hours[0]) * 60.0 // leg_minutes)
    lat = rng.uniform(box[0], box[1], aircraft)
    lon = rng.uniform(box[2], box[3], aircraft)
    airspeed = rng.uniform(126.0, 142.0, aircraft)
    even = np.arange(legs) * 360.0 / legs
    courses = np.stack([rng.permutation(even + rng.uniform(0, 360.0)) for _ in range(aircraft)])
    shape = (legs, steps + 2, aircraft)
    kept = {
        name: np.zeros(shape) for name in ("latitude", "longitude", "altitude", "east", "north")
    }
    phase = np.zeros(shape, np.int8)
    phase[:, _SILENT:steps] = CRUISE
    start = hours[0] + np.arange(legs) * leg_minutes / 60.0
    for leg in range(legs):
        level = rng.uniform(*altitudes, aircraft)
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

    def ordered(values: NDArray[np.generic]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(1, 2, 0).reshape(steps + 2, -1))

    return Flown(
        bank=np.zeros((steps + 2, aircraft * legs)),
        phase=ordered(phase).astype(np.int8),
        departure=np.tile(start, aircraft),
        aircraft=np.repeat(np.arange(aircraft), legs),
        **{name: ordered(values) for name, values in kept.items()},
    )
