"""Flights of the sample fleets: routes, timetables, and every aircraft's path in steps of 10 s.

Each aircraft has a home hub and an axis along which most flights go out and back. A flight is
steered over the ellipsoid: climb-out, turn to course, a way point off the direct line, arrival fix,
last turn; turns are coordinated. Ground speed follows the airspeed schedule and the large-scale
wind, so the exact airspeed vector (ground minus true wind) also contains the mesoscale. A tour, for
a day of real model winds, is a day of straight legs spread evenly over the compass, without
landing.

Units: SI, degrees for places, radians for angles, hours since the start of the archive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from airswing.synthetic.atmosphere import Array, stream

Places = dict[str, tuple[float, float]]
Wind = Callable[[Array, Array, Array, Array], Array]
"""(latitude, longitude, altitude m, hours) to the wind (2, n), m/s."""

STEP = 10.0
"""Time step of the steering, s."""
ASCENT, CRUISE, DESCENT = 1, 2, 3
GEOD = Geod(ellps="WGS84")
_G = 9.80665  # standard gravity, m/s2
_MAX_BANK = np.radians(14.0)
_CLIMB, _DESCENT = 6.0, 6.5  # m/s: 1,200 and 1,300 feet a minute


_AIRPORTS = (
    "MSP 44.88 -93.22, DTW 42.21 -83.35, ORD 41.98 -87.90, MKE 42.95 -87.90, "
    "CLE 41.41 -81.85, IND 39.72 -86.29, CVG 39.05 -84.66, DSM 41.53 -93.66, "
    "DLH 46.84 -92.19, MQT 46.35 -87.40, TVC 44.74 -85.58, GRB 44.48 -88.13, "
    "CWA 44.78 -89.67, MLI 41.45 -90.51, SBN 41.71 -86.32, CMH 40.00 -82.89, "
    "LAN 42.78 -84.59, RST 43.91 -92.50, CIU 46.25 -84.47, PIA 40.66 -89.69, "
    "INL 48.57 -93.40, STL 38.75 -90.37, APN 45.08 -83.56, BUF 42.94 -78.73, "
    "PIT 40.49 -80.23, HIB 47.39 -92.84, EAU 44.87 -91.48"
)
_GREAT_LAKES: Places = {
    code: (float(latitude), float(longitude))
    for code, latitude, longitude in (row.split() for row in _AIRPORTS.split(","))
}
_LOWER_CODES = "DTW ORD MKE CLE IND CVG TVC GRB CWA MLI SBN CMH LAN PIA APN"
_LOWER_LAKES = {code: _GREAT_LAKES[code] for code in _LOWER_CODES.split()}


@dataclass(frozen=True)
class Network:
    """A region to fly in."""

    airports: Places
    hubs: tuple[str, ...]  # home airports
    legs: tuple[float, float]  # shortest and longest leg, km
    centre: tuple[float, float]  # of the model grid, degrees


NETWORKS = {
    "great_lakes": Network(
        _GREAT_LAKES, ("MSP", "DTW", "ORD", "MKE", "CLE"), (280, 800), (43.4, -87)
    ),
    "lower_lakes": Network(_LOWER_LAKES, ("DTW", "ORD", "MKE"), (230, 620), (42.3, -86.2)),
}


@dataclass(frozen=True)
class Timetable:
    """Flights of an archive, one row each, in order of aircraft and time."""

    aircraft: NDArray[np.int64]  # (F,) index
    departure: Array  # (F,) hours since the start
    origin: Array  # (F, 2) degrees
    destination: Array  # (F, 2) degrees
    cruise_altitude: Array  # (F,) m
    cruise_airspeed: Array  # (F,) true, m/s


def timetable(
    network: Network,
    *,
    aircraft: int,
    days: int,
    seed: int,
    legs_per_day: float,
    shuttles: int = 0,
) -> Timetable:
    """Draw the flights of a fleet; the last ``shuttles`` aircraft fly on a single route."""
    rows: list[tuple[int, float, str, str, float, float]] = []
    place = network.airports
    for index in range(aircraft):
        rng = stream(seed, f"timetable {index}")
        hub = network.hubs[index % len(network.hubs)]
        names, share = _routes(rng, network, hub)
        if index >= aircraft - shuttles:
            names, share = names[:1], np.ones(1)
        cruise = rng.uniform(126.0, 142.0)
        for day in range(days):
            clock = day * 24.0 + rng.uniform(10.0, 13.0)
            rounds = int(legs_per_day / 2 + rng.uniform())
            for _ in range(rounds):
                there = str(rng.choice(names, p=share))
                for start, end in ((hub, there), (there, hub)):
                    a, b = place[start], place[end]
                    length = float(GEOD.inv(a[1], a[0], b[1], b[0])[2])
                    top = min(7900.0, 3400.0 + length / 110.0)
                    level = max(3600.0, top - 610.0 * float(rng.integers(0, 4)))
                    rows.append((index, clock, start, end, level, cruise + rng.normal(0, 1.5)))
                    clock += length / (cruise - 12.0) / 3600.0 + rng.uniform(0.5, 0.8)
                if clock > day * 24.0 + 29.0:
                    break
    columns = list(zip(*rows, strict=True))
    return Timetable(
        aircraft=np.array(columns[0]),
        departure=np.round(np.array(columns[1]) * 3600.0) / 3600.0,
        origin=np.array([place[code] for code in columns[2]]),
        destination=np.array([place[code] for code in columns[3]]),
        cruise_altitude=np.array(columns[4]),
        cruise_airspeed=np.array(columns[5]),
    )


def _routes(rng: np.random.Generator, network: Network, hub: str) -> tuple[list[str], Array]:
    place = network.airports[hub]
    names, bearings = [], []
    for code, (lat, lon) in network.airports.items():
        azimuth, _, length = GEOD.inv(place[1], place[0], lon, lat)
        if network.legs[0] * 1e3 <= length <= network.legs[1] * 1e3:
            names.append(code)
            bearings.append(azimuth)
    lobe = np.radians(np.array(bearings) - rng.uniform(0, 180))
    weight = np.exp(2.2 * np.abs(np.cos(lobe))) * rng.uniform(0.3, 1.0, len(names))
    keep = rng.choice(len(names), min(7, len(names)), replace=False, p=weight / weight.sum())
    return [names[index] for index in keep], weight[keep] / weight[keep].sum()


@dataclass
class Flown:
    """Flights step by step: arrays (steps, flights)."""

    latitude: Array  # degrees
    longitude: Array
    altitude: Array  # pressure altitude, m
    east: Array  # ground velocity, m/s
    north: Array
    bank: Array  # radians, right wing down positive
    phase: NDArray[np.int8]  # 1 ascent, 2 cruise, 3 descent; 0 once landed
    departure: Array  # (flights,) hours since the start
    aircraft: NDArray[np.int64]  # (flights,) index

    def at(self, name: str, flight: NDArray[np.int64], step: Array) -> Array:
        """One quantity at fractional steps of flights, linear between steps."""
        values = getattr(self, name)
        where = np.clip(step, 0.0, values.shape[0] - 1.001)  # the last step has no next one
        low = where.astype(int)
        first = values[low, flight]
        return np.asarray(first + (values[low + 1, flight] - first) * (where - low))

    def acceleration(self, flight: NDArray[np.int64], step: Array) -> tuple[Array, Array]:
        """Eastward and northward acceleration over the ground, m s-2."""
        parts = [
            (self.at(name, flight, step + 1.0) - self.at(name, flight, np.maximum(step - 1, 0)))
            / (STEP * np.where(step < 1, 1 + step, 2.0))
            for name in ("east", "north")
        ]
        return parts[0], parts[1]


def fly(table: Timetable, wind: Wind, *, seed: int) -> Flown:
    """Steer every flight from gate to gate in the large-scale wind."""
    flights = table.departure.size
    rng = stream(seed, "steering")
    lat, lon = table.origin[:, 0].copy(), table.origin[:, 1].copy()
    course, targets = _targets(table, rng)
    track = course + rng.normal(0, 1.0, flights)
    release = rng.uniform(350.0, 900.0, flights)  # m; runway heading is held up to there
    stage = np.zeros(flights, int)
    phase = np.full(flights, ASCENT, np.int8)
    altitude, rate = np.zeros(flights), np.zeros(flights)
    speed = np.full(flights, 68.0)  # m/s at take-off
    states: list[list[NDArray[Any]]] = []
    breeze = np.zeros((2, flights))
    for step in range(1500):  # over four hours: the longest leg is shorter
        alive = phase > 0
        if not alive.any():
            break
        # The large-scale wind changes little in a minute, and evaluating it is most of the cost.
        if step % 6 == 0:
            hours = table.departure + step * STEP / 3600.0
            breeze[:, alive] = wind(lat[alive], lon[alive], altitude[alive], hours[alive])
        bank = np.arctan(rate * speed / _G)
        now = (lat, lon, altitude, speed * np.sin(track), speed * np.cos(track), bank, phase)
        states.append([values.copy() for values in now])
        aim, remaining = _course(lat, lon, targets[stage, np.arange(flights)])
        passed = (stage < 2) & (remaining < np.where(stage == 0, 4500.0, 5500.0))
        stage = np.where(passed, stage + 1, stage)
        _, home = _course(lat, lon, table.destination)
        # The way over the fix and its turns is longer than the straight one.
        home = (home + 14e3 * (stage < 2)) / 0.83
        limit = _G * np.tan(_MAX_BANK) / speed
        # As an autopilot: reaches the course in about 22 s, and the bank within 9 s.
        turn = np.pi - (np.pi - (aim - track)) % (2 * np.pi)  # in (-pi, pi]
        wanted = np.clip(turn / 22.0, -limit, limit)
        wanted = np.where((phase == ASCENT) & (altitude < release), 0.0, wanted)
        new_rate = rate + (wanted - rate) * (1 - np.exp(-STEP / 9.0))
        new_track = track + 0.5 * (rate + new_rate) * STEP
        share, top = np.clip(altitude / table.cruise_altitude, 0.0, 1.0), table.cruise_airspeed
        # Climb takes thrust; idle descents are nearly as fast as cruise and end at 74 m/s.
        climbing = 70.0 + (0.84 * top - 70.0) * share
        sinking = 74.0 + (0.98 * top - 74.0) * share
        airspeed = np.where(phase == ASCENT, climbing, np.where(phase == CRUISE, top, sinking))
        along = breeze[0] * np.sin(track) + breeze[1] * np.cos(track)
        across = breeze[0] * np.cos(track) - breeze[1] * np.sin(track)
        # The argument of the root remains positive in a gale at take-off.
        ground = along + np.sqrt(np.maximum(airspeed**2 - across**2, 100.0))
        # m s-2; drag slows more than thrust accelerates.
        pull = np.clip((ground - speed) / 45.0, -0.35, 0.3)
        new_speed = np.maximum(speed + pull * STEP, 45.0)
        mean_track, mean_speed = 0.5 * (track + new_track), 0.5 * (speed + new_speed)
        moving = np.where(alive, STEP, 0.0)
        per_lat, _ = _metres(lat)
        # The length of a degree of longitude is that at the middle of the step.
        _, per_lon = _metres(
            lat + np.degrees(0.5 * mean_speed * np.cos(mean_track) * STEP / per_lat)
        )
        lon = lon + np.degrees(mean_speed * np.sin(mean_track) * moving / per_lon)
        lat = lat + np.degrees(mean_speed * np.cos(mean_track) * moving / per_lat)
        climb = np.where(phase == ASCENT, _CLIMB, np.where(phase == DESCENT, -_DESCENT, 0.0))
        altitude = np.maximum(altitude + climb * moving, 0.0)
        track, speed, rate = new_track, new_speed, new_rate
        # m that a descent beginning now would lose on the way.
        sink = home / np.maximum(speed, 60.0) * _DESCENT
        level = (phase == ASCENT) & (altitude >= table.cruise_altitude)
        down = (phase != DESCENT) & alive & (altitude > 500) & (sink < altitude)
        phase = np.where(down, DESCENT, np.where(level, CRUISE, phase))
        landed = (phase == DESCENT) & ((altitude < 250.0) | ((stage == 2) & (remaining < 4000.0)))
        phase = np.where(landed, 0, phase).astype(np.int8)
    names = ("latitude", "longitude", "altitude", "east", "north", "bank", "phase")
    steps = {
        name: np.stack(rows) for name, rows in zip(names, zip(*states, strict=True), strict=True)
    }
    return Flown(departure=table.departure, aircraft=table.aircraft, **steps)


def _targets(table: Timetable, rng: np.random.Generator) -> tuple[Array, Array]:
    """Course from gate to gate; way point, fix and gate (3, flights, 2)."""
    flights = table.departure.size
    course, length = _course(table.origin[:, 0], table.origin[:, 1], table.destination)
    middle = _offset(table.origin, course, length * rng.uniform(0.35, 0.65, flights))
    # A few per cent of the distance off the straight line, so that cruise has turns.
    side = length * rng.uniform(0.02, 0.07, flights) * rng.choice([-1, 1], flights)
    way = _offset(middle, course + np.pi / 2, side)
    # Approaches begin over a fix 14 to 26 km out, to either side: turns at low level.
    fix = _offset(
        table.destination,
        course + np.pi + rng.uniform(-1.6, 1.6, flights),
        rng.uniform(14e3, 26e3, flights),
    )
    return course, np.stack([way, fix, table.destination])


def _metres(latitude: Array) -> tuple[Array, Array]:
    """Metres per radian of latitude and of longitude on the WGS84 ellipsoid."""
    a, e2 = 6378137.0, 0.00669437999014  # semi-major axis, eccentricity squared
    root = 1.0 - e2 * np.sin(np.radians(latitude)) ** 2
    normal = a / np.sqrt(root)
    return a * (1 - e2) / root**1.5, normal * np.cos(np.radians(latitude))


def _course(lat: Array, lon: Array, target: Array) -> tuple[Array, Array]:
    """Initial great-circle course (radians) and distance (m) to targets (F, 2)."""
    p1, p2 = np.radians(lat), np.radians(target[:, 0])
    dl = np.radians(target[:, 1] - lon)
    east = np.sin(dl) * np.cos(p2)
    north = np.cos(p1) * np.sin(p2) - np.sin(p1) * np.cos(p2) * np.cos(dl)
    along = np.sin(p1) * np.sin(p2) + np.cos(p1) * np.cos(p2) * np.cos(dl)
    return np.arctan2(east, north), 6371000.0 * np.arctan2(np.hypot(east, north), along)


def _offset(place: Array, course: Array, distance: Array) -> Array:
    """Places (F, 2) moved along a course by a distance in m (local plane)."""
    north, east = _metres(place[:, 0])
    lat = place[:, 0] + np.degrees(distance * np.cos(course) / north)
    lon = place[:, 1] + np.degrees(distance * np.sin(course) / east)
    return np.stack([lat, lon], axis=1)


def report_steps(
    flown: Flown, *, climb_seconds: float, cruise_seconds: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Flight and step (n,) of every report, in order of flight and time.

    The intervals between reports, in ascent and descent and in cruise, are multiples of 10 s.
    """
    rate = np.where(flown.phase == CRUISE, STEP / cruise_seconds, STEP / climb_seconds)
    rate = np.where((flown.phase > 0) & (flown.altitude > 150.0), rate, 0.0)
    count = np.floor(np.cumsum(rate, axis=0) + 1e-9)  # sums of thirds fall short of whole numbers
    flight, step = np.nonzero((np.diff(count, axis=0, prepend=0.0) > 0).T)
    return flight, step


# Tours. First and last hour of flying (the run's winds end with the day), minutes of a leg (about
# fifty legs a day fly each of eight compass points six times), steps before its first report;
# south, north, west, east of where tours start (inside the real run's grid); levels, m.
_HOURS, _LEG_MINUTES, _SILENT = (0.3, 23.5), 26.0, 12
_BOX, _ALTITUDES = (35.0, 41.0, -101.0, -87.0), (1500.0, 7600.0)


def tour(wind: Wind, *, aircraft: int, seed: int) -> Flown:
    """Fly every aircraft through one day of legs, one flight a leg."""
    rng = stream(seed, "tour")
    steps = round(_LEG_MINUTES * 60.0 / STEP)
    legs = int((_HOURS[1] - _HOURS[0]) * 60.0 // _LEG_MINUTES)
    lat = rng.uniform(*_BOX[:2], aircraft)
    lon = rng.uniform(*_BOX[2:], aircraft)
    airspeed = rng.uniform(126.0, 142.0, aircraft)
    even = np.arange(legs) * 360.0 / legs
    courses = np.stack([rng.permutation(even + rng.uniform(0, 360.0)) for _ in range(aircraft)])
    shape = (legs, steps + 2, aircraft)
    names = ("latitude", "longitude", "altitude", "east", "north")
    flown = {name: np.zeros(shape) for name in names}
    phase = np.zeros(shape, np.int8)
    phase[:, _SILENT:steps] = CRUISE
    start = _HOURS[0] + np.arange(legs) * _LEG_MINUTES / 60.0
    for leg in range(legs):
        level = rng.uniform(*_ALTITUDES, aircraft)
        blown = wind(lat, lon, level, np.full(aircraft, start[leg]))
        turn = np.radians(courses[:, leg])
        speed = airspeed + blown[0] * np.sin(turn) + blown[1] * np.cos(turn)
        along = np.arange(steps + 2)[:, None] * STEP * speed
        begin = [np.broadcast_to(values, along.shape) for values in (lon, lat, courses[:, leg])]
        places = GEOD.fwd(begin[0], begin[1], begin[2], along)
        track = np.radians(np.asarray(places[2]) + 180.0)
        flown["longitude"][leg], flown["latitude"][leg] = places[0], places[1]
        flown["altitude"][leg] = level
        flown["east"][leg], flown["north"][leg] = speed * np.sin(track), speed * np.cos(track)
        lon, lat = flown["longitude"][leg, steps], flown["latitude"][leg, steps]

    def ordered(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(1, 2, 0).reshape(steps + 2, -1))

    return Flown(
        **{name: ordered(values) for name, values in flown.items()},
        bank=np.zeros((steps + 2, aircraft * legs)),
        phase=ordered(phase),
        departure=np.tile(start, aircraft),
        aircraft=np.repeat(np.arange(aircraft), legs),
    )
