"""The sample fleet in the air: where every aircraft is, how it moves and when it reports.

Assumptions
-----------
Each flight is steered over the ellipsoid in steps of 10 s: climb-out on the runway's direction,
a turn to course, a way-point off the direct line, an arrival fix, a last turn. Turns are
coordinated (bank from turn rate and ground speed), never over 14 degrees. Speed over the ground
follows the airspeed schedule and the large-scale wind, so the *exact* airspeed vector (ground
minus true wind) also carries the mesoscale, as in real air. Reports come at fixed intervals by
phase and say where the aircraft exactly is; coding comes later.

Validity: turboprop speeds and altitudes to 8 km. Units: SI, degrees for places, radians for
angles, hours since the archive's start for times of day.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic.aircraft.network import Timetable
from airswing.synthetic.world.true_atmosphere import stream

__all__ = ["ASCENT", "CRUISE", "DESCENT", "STEP", "Flown", "fly"]

Array = NDArray[np.float64]
STEP = 10.0  # Time step of the steering, s
ASCENT, CRUISE, DESCENT = 1, 2, 3
# m/s2, standard gravity.
_G = 9.80665
_MAX_BANK = np.radians(14.0)
# m/s: 1,200 and 1,300 feet a minute.
_CLIMB, _DESCENT = 6.0, 6.5


@dataclass
class Flown:
    """The flights, step by step: arrays of shape (steps, flights)."""

    # latitude, longitude: degrees
    latitude: Array
    longitude: Array
    altitude: Array  # pressure altitude, m
    # east, north: ground velocity, m/s
    east: Array
    north: Array
    bank: Array  # radians, right wing down positive
    phase: NDArray[np.int8]  # 1 ascent, 2 cruise, 3 descent; 0 once landed
    departure: Array  # (flights,): hours since the start
    aircraft: NDArray[np.int64]  # (flights,): index of the aircraft

    def at(self, name: str, flight: NDArray[np.int64], step: Array) -> Array:
        """Return one quantity at fractional steps of flights, linearly between steps."""
        values = getattr(self, name)
        where = np.clip(step, 0.0, values.shape[0] - 1.001)  # the last has no next one
        low = where.astype(int)
        first = values[low, flight]
        return np.asarray(first + (values[low + 1, flight] - first) * (where - low))

    def pressure(self, step: NDArray[np.int64], flight: NDArray[np.int64]) -> Array:
        """Return the pressure in Pa at whole steps."""
        return pressure_from_altitude(self.altitude[step, flight])

    def acceleration(self, flight: NDArray[np.int64], step: Array) -> tuple[Array, Array]:
        """Return the eastward and northward acceleration over the ground, m s-2."""
        parts = [
            (self.at(name, flight, step + 1.0) - self.at(name, flight, np.maximum(step - 1, 0)))
            / (STEP * np.where(step < 1, 1 + step, 2.0))
            for name in ("east", "north")
        ]
        return parts[0], parts[1]


def _wrap(angle: Array) -> Array:
    """Return an angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2 * np.pi))


def _metres(latitude: Array) -> tuple[Array, Array]:
    """Return metres per radian of latitude and of longitude on the WGS84 ellipsoid."""
    a, e2 = 6378137.0, 0.00669437999014  # semi-major axis, eccentricity squared
    sine = np.sin(np.radians(latitude))
    root = 1.0 - e2 * sine**2
    normal = a / np.sqrt(root)
    return a * (1 - e2) / root**1.5, normal * np.cos(np.radians(latitude))


def _course(lat: Array, lon: Array, target: Array) -> tuple[Array, Array]:
    """Return initial great-circle course (radians) and distance (m) to targets (F, 2)."""
    p1, p2 = np.radians(lat), np.radians(target[:, 0])
    dl = np.radians(target[:, 1] - lon)
    east = np.sin(dl) * np.cos(p2)
    north = np.cos(p1) * np.sin(p2) - np.sin(p1) * np.cos(p2) * np.cos(dl)
    along = np.sin(p1) * np.sin(p2) + np.cos(p1) * np.cos(p2) * np.cos(dl)
    return np.arctan2(east, north), 6371000.0 * np.arctan2(np.hypot(east, north), along)


def _offset(place: Array, course: Array, distance: Array) -> Array:
    """Return places moved along a course by a distance in m (local plane), shape (F, 2)."""
    north, east = _metres(place[:, 0])
    lat = place[:, 0] + np.degrees(distance * np.cos(course) / north)
    lon = place[:, 1] + np.degrees(distance * np.sin(course) / east)
    return np.stack([lat, lon], axis=1)


def _airspeed(table: Timetable, altitude: Array, phase: NDArray[np.int8]) -> Array:
    """Return the scheduled true airspeed in m/s."""
    share = np.clip(altitude / table.cruise_altitude, 0.0, 1.0)
    top = table.cruise_airspeed
    # from 70 m/s off the ground to less than cruise, for the climb takes thrust; idle descents are
    # flown nearly as fast as cruise and end at 74 m/s over the fence
    climb = 70.0 + (0.84 * top - 70.0) * share
    descent = 74.0 + (0.98 * top - 74.0) * share
    return np.where(phase == ASCENT, climb, np.where(phase == CRUISE, top, descent))


def _targets(table: Timetable, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the course from gate to gate, and a way point, a fix and the gate: (3, flights, 2)."""
    flights = table.departure.size
    course, length = _course(table.origin[:, 0], table.origin[:, 1], table.destination)
    middle = _offset(table.origin, course, length * rng.uniform(0.35, 0.65, flights))
    # airways bend: off the straight line by some hundredths of it, so that cruise has turns
    side = length * rng.uniform(0.02, 0.07, flights) * rng.choice([-1, 1], flights)
    way = _offset(middle, course + np.pi / 2, side)
    # approaches begin over a fix 14 to 26 km out, to either side: turns at low level
    fix = _offset(
        table.destination,
        course + np.pi + rng.uniform(-1.6, 1.6, flights),
        rng.uniform(14e3, 26e3, flights),
    )
    return course, np.stack([way, fix, table.destination])


def _moved(
    lat: Array, lon: Array, speed: Array, track: Array, seconds: Array
) -> tuple[Array, Array]:
    """Return places a step later; the length of a degree of longitude is that of its middle."""
    per_lat, _ = _metres(lat)
    _, per_lon = _metres(lat + np.degrees(0.5 * speed * np.cos(track) * STEP / per_lat))
    return (
        lat + np.degrees(speed * np.cos(track) * seconds / per_lat),
        lon + np.degrees(speed * np.sin(track) * seconds / per_lon),
    )


def fly(
    table: Timetable,
    wind: Callable[[Array, Array, Array, Array], Array],
    *,
    seed: int,
) -> Flown:
    """Steer every flight from gate to gate.

    Parameters
    ----------
    wind : callable
        (latitude, longitude, altitude m, hours) to the large-scale wind (2, n) in m/s.

    Returns
    -------
    Flown
        Every step of every flight.
    """
    flights = table.departure.size
    rng = stream(seed, "steering")
    lat, lon = table.origin[:, 0].copy(), table.origin[:, 1].copy()
    course, targets = _targets(table, rng)
    track = course + rng.normal(0, 1.0, flights)
    release = rng.uniform(350.0, 900.0, flights)  # m: runway heading is held until there
    stage = np.zeros(flights, int)
    phase = np.full(flights, ASCENT, np.int8)
    altitude, rate = np.zeros(flights), np.zeros(flights)
    speed = np.full(flights, 68.0)  # m/s as it leaves the ground
    names = ("latitude", "longitude", "altitude", "east", "north", "bank", "phase")
    kept: dict[str, list[Array]] = {name: [] for name in names}
    breeze = np.zeros((2, flights))
    for step in range(1500):  # over four hours: the longest leg is shorter
        alive = phase > 0
        if not alive.any():
            break
        # the large-scale wind changes little in a minute, and asking for it takes most of the time
        if step % 6 == 0:
            hours = table.departure + step * STEP / 3600.0
            breeze[:, alive] = wind(lat[alive], lon[alive], altitude[alive], hours[alive])
        bank = np.arctan(rate * speed / _G)
        now = (lat, lon, altitude, speed * np.sin(track), speed * np.cos(track), bank, phase)
        for name, values in zip(kept, now, strict=True):
            kept[name].append(values.copy())
        aim, left = _course(lat, lon, targets[stage, np.arange(flights)])
        passed = (stage < 2) & (left < np.where(stage == 0, 4500.0, 5500.0))  # points are flown by
        stage = np.where(passed, stage + 1, stage)
        _, home = _course(lat, lon, table.destination)
        # the way over the fix and round its turns is longer than the straight one
        home = (home + 14e3 * (stage < 2)) / 0.83
        limit = _G * np.tan(_MAX_BANK) / speed
        # steered as an autopilot does: onto the course in some 22 s, rolled into within 9
        wanted = np.clip(_wrap(aim - track) / 22.0, -limit, limit)
        wanted = np.where((phase == ASCENT) & (altitude < release), 0.0, wanted)
        new_rate = rate + (wanted - rate) * (1 - np.exp(-STEP / 9.0))
        new_track = track + 0.5 * (rate + new_rate) * STEP
        ground = _ground_speed(_airspeed(table, altitude, phase), breeze, track)
        # m s-2: drag slows more than thrust speeds up
        pull = np.clip((ground - speed) / 45.0, -0.35, 0.3)
        new_speed = np.maximum(speed + pull * STEP, 45.0)
        mean_track, mean_speed = 0.5 * (track + new_track), 0.5 * (speed + new_speed)
        moving = np.where(alive, STEP, 0.0)
        lat, lon = _moved(lat, lon, mean_speed, mean_track, moving)
        climb = np.where(phase == ASCENT, _CLIMB, np.where(phase == DESCENT, -_DESCENT, 0.0))
        altitude = np.maximum(altitude + climb * moving, 0.0)
        track, speed, rate = new_track, new_speed, new_rate
        # m: what a descent that begins now would lose on the way
        sink = home / np.maximum(speed, 60.0) * _DESCENT
        level = (phase == ASCENT) & (altitude >= table.cruise_altitude)
        down = (phase != DESCENT) & alive & (altitude > 500) & (sink < altitude)
        phase = np.where(down, DESCENT, np.where(level, CRUISE, phase))
        landed = (phase == DESCENT) & ((altitude < 250.0) | ((stage == 2) & (left < 4000.0)))
        phase = np.where(landed, 0, phase).astype(np.int8)
    stacked = {name: np.stack(values) for name, values in kept.items()}
    return Flown(
        departure=table.departure,
        aircraft=table.aircraft,
        **{**stacked, "phase": stacked["phase"].astype(np.int8)},  # type: ignore[arg-type]
    )


def _ground_speed(airspeed: Array, wind: Array, track: Array) -> Array:
    """Speed along the track of what flies at an airspeed in a wind (2, n), m/s."""
    east, north = np.sin(track), np.cos(track)
    along = wind[0] * east + wind[1] * north
    across = wind[0] * north - wind[1] * east
    # the root stays real in a gale on take-off
    return np.asarray(along + np.sqrt(np.maximum(airspeed**2 - across**2, 100.0)))


def report_steps(
    flown: Flown, *, climb_seconds: float, cruise_seconds: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return flight and step of every report, in order of flight and time.

    Parameters
    ----------
    climb_seconds, cruise_seconds : float
        Interval between reports in ascent and descent, and in cruise; multiples of 10 s.

    Returns
    -------
    flight, step : ndarray int (n,)
        Which flight, and which 10-s step of it.
    """
    slow = flown.phase == CRUISE
    rate = np.where(slow, STEP / cruise_seconds, STEP / climb_seconds)
    rate = np.where((flown.phase > 0) & (flown.altitude > 150.0), rate, 0.0)
    count = np.floor(np.cumsum(rate, axis=0) + 1e-9)  # sums of thirds fall short of whole numbers
    due = np.diff(count, axis=0, prepend=0.0) > 0
    flight, step = np.nonzero(due.T)
    return flight, step
