"""Airports, hubs and timetables of the sample fleet.

Assumptions: each aircraft has a home hub and an axis: most of its flights go out and back along
it, a smaller part elsewhere, as hub-and-spoke turboprops do. Airport positions to 0.01 degree
(public aeronautical data). Valid for two networks: ``great_lakes`` (regional turboprops) and
``continental`` (the 48 states).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from airswing.synthetic.world.true_atmosphere import stream

__all__ = ["NETWORKS", "Network", "Timetable", "timetable"]

Array = NDArray[np.float64]
GEOD = Geod(ellps="WGS84")

_AIRPORTS: dict[str, tuple[float, float]] = {
    "MSP": (44.88, -93.22),
    "DTW": (42.21, -83.35),
    "ORD": (41.98, -87.90),
    "MKE": (42.95, -87.90),
    "CLE": (41.41, -81.85),
    "IND": (39.72, -86.29),
    "CVG": (39.05, -84.66),
    "DSM": (41.53, -93.66),
    "DLH": (46.84, -92.19),
    "MQT": (46.35, -87.40),
    "TVC": (44.74, -85.58),
    "GRB": (44.48, -88.13),
    "CWA": (44.78, -89.67),
    "MLI": (41.45, -90.51),
    "SBN": (41.71, -86.32),
    "CMH": (40.00, -82.89),
    "LAN": (42.78, -84.59),
    "RST": (43.91, -92.50),
    "CIU": (46.25, -84.47),
    "PIA": (40.66, -89.69),
    "INL": (48.57, -93.40),
    "STL": (38.75, -90.37),
    "APN": (45.08, -83.56),
    "BUF": (42.94, -78.73),
    "PIT": (40.49, -80.23),
    "HIB": (47.39, -92.84),
    "EAU": (44.87, -91.48),
}
_WIDER: dict[str, tuple[float, float]] = {
    "ATL": (33.64, -84.43),
    "DEN": (39.86, -104.67),
    "DFW": (32.90, -97.04),
    "SEA": (47.45, -122.31),
    "LAX": (33.94, -118.41),
    "BOS": (42.36, -71.01),
    "JFK": (40.64, -73.78),
    "MIA": (25.79, -80.29),
    "SLC": (40.79, -111.98),
    "PHX": (33.43, -112.01),
    "IAH": (29.98, -95.34),
    "MSP": (44.88, -93.22),
    "ORD": (41.98, -87.90),
    "MEM": (35.04, -89.98),
    "BIL": (45.81, -108.54),
    "MCI": (39.30, -94.71),
    "RDU": (35.88, -78.79),
    "BNA": (36.12, -86.68),
    "ABQ": (35.04, -106.61),
    "OKC": (35.39, -97.60),
    "TPA": (27.98, -82.53),
}


@dataclass(frozen=True)
class Network:
    """A region to fly in."""

    airports: dict[str, tuple[float, float]]  # code to (latitude, longitude) in degrees
    hubs: tuple[str, ...]  # home airports
    legs: tuple[float, float]  # shortest and longest leg in km
    centre: tuple[float, float]  # middle of the model grid in degrees


NETWORKS = {
    "great_lakes": Network(_AIRPORTS, ("MSP", "DTW", "ORD", "MKE", "CLE"), (280, 800), (43.4, -87)),
    "lower_lakes": Network(
        {
            code: _AIRPORTS[code]
            for code in (
                "DTW",
                "ORD",
                "MKE",
                "CLE",
                "IND",
                "CVG",
                "TVC",
                "GRB",
                "CWA",
                "MLI",
                "SBN",
                "CMH",
                "LAN",
                "PIA",
                "APN",
            )
        },
        ("DTW", "ORD", "MKE"),
        (230, 620),
        (42.3, -86.2),
    ),
    "continental": Network(
        _WIDER, ("ATL", "DEN", "DFW", "ORD", "SLC", "MEM"), (500, 1900), (38.5, -96.5)
    ),
}


@dataclass(frozen=True)
class Timetable:
    """Flights of an archive, one row each."""

    aircraft: NDArray[np.int64]  # (F,): index of the aircraft
    departure: Array  # (F,): hours since the start
    # origin, destination: (F, 2): latitude and longitude in degrees
    origin: Array
    destination: Array
    cruise_altitude: Array  # (F,): m
    cruise_airspeed: Array  # (F,): true airspeed in m/s


def _routes(rng: np.random.Generator, network: Network, hub: str) -> tuple[list[str], Array]:
    """Return destinations of one aircraft and how often it goes there."""
    here = network.airports[hub]
    names, bearings = [], []
    for code, (lat, lon) in network.airports.items():
        azimuth, _, length = GEOD.inv(here[1], here[0], lon, lat)
        if network.legs[0] * 1e3 <= length <= network.legs[1] * 1e3:
            names.append(code)
            bearings.append(azimuth)
    lobe = np.radians(np.array(bearings) - rng.uniform(0, 180))
    weight = np.exp(2.2 * np.abs(np.cos(lobe))) * rng.uniform(0.3, 1.0, len(names))
    keep = rng.choice(len(names), min(7, len(names)), replace=False, p=weight / weight.sum())
    return [names[index] for index in keep], weight[keep] / weight[keep].sum()


def timetable(
    network: Network,
    *,
    aircraft: int,
    days: int,
    seed: int,
    legs_per_day: float,
    shuttles: int = 0,
) -> Timetable:
    """Return the flights of a fleet.

    Parameters
    ----------
    days : int
        Length in days.
    legs_per_day : float
        Mean number of legs an aircraft flies a day.
    shuttles : int, default 0
        How many aircraft, the last ones, fly to and fro on a single route: too few headings for
        a compass swing.

    Returns
    -------
    Timetable
        Flights in order of aircraft and time.
    """
    rows: list[tuple[int, float, str, str, float, float]] = []
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
                    a, b = network.airports[start], network.airports[end]
                    length = float(GEOD.inv(a[1], a[0], b[1], b[0])[2])
                    top = min(7900.0, 3400.0 + length / 110.0)
                    level = max(3600.0, top - 610.0 * float(rng.integers(0, 4)))
                    rows.append((index, clock, start, end, level, cruise + rng.normal(0, 1.5)))
                    clock += length / (cruise - 12.0) / 3600.0 + rng.uniform(0.5, 0.8)
                if clock > day * 24.0 + 29.0:
                    break
    columns = list(zip(*rows, strict=True))
    place = network.airports
    return Timetable(
        aircraft=np.array(columns[0]),
        departure=np.round(np.array(columns[1]) * 3600.0) / 3600.0,
        origin=np.array([place[code] for code in columns[2]]),
        destination=np.array([place[code] for code in columns[3]]),
        cruise_altitude=np.array(columns[4]),
        cruise_airspeed=np.array(columns[5]),
    )
