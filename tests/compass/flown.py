"""A small simulator of flights for the fit's tests: independent of the package's formulas.

True wind, model = truth + bias + errors shared by the day and by the flight, a unit that
computes its wind along a deviated heading, and headings made again from what was reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.ragged import ragged


@dataclass(frozen=True)
class Setting:
    aircraft: int = 6
    days: int = 60
    flights_a_day: int = 4
    reports_a_flight: int = 12
    references: int = 1
    airspeed: float = 110.0
    bias: tuple[float, float] = (0.5, -0.4)
    bias_spread: float = 0.15
    day_error: float = 0.5
    flight_error: float = 1.2
    noise: float = 1.2
    ground_error: float = 0.25
    scale_spread: float = 0.005
    outliers: float = 0.0
    wind_factor: float = 1.0
    """Reported winds over those of the unit."""
    hub_and_spoke: bool = False
    legs: int = 3


NO_ERROR = {"day_error": 0.0, "flight_error": 0.0, "ground_error": 0.0, "bias_spread": 0.0}


def curve(coefficients, m):
    """A + B sin m + C cos m + D sin 2m + E cos 2m, degrees; coefficients (..., 5)."""
    x = np.radians(m)
    a, b, c, d, e = np.moveaxis(np.asarray(coefficients, float), -1, 0)[..., np.newaxis]
    return a + b * np.sin(x) + c * np.cos(x) + d * np.sin(2 * x) + e * np.cos(2 * x)


def wrap(angle):
    return (angle + 180.0) % 360.0 - 180.0


def fly(deviation, setting, seed):
    """HEADINGS Dataset of a fleet with known deviations in degrees, and the truth.

    Deviations are (aircraft, 5), or (aircraft, day, 5) where compasses change.
    """
    rng = np.random.default_rng(seed)
    s = setting
    flights = s.aircraft, s.days, s.flights_a_day
    n = *flights, s.reports_a_flight
    reports = int(np.prod(n))
    bias = np.array(s.bias) + s.bias_spread * rng.normal(size=(s.references, s.aircraft, 2))
    scale = s.scale_spread * rng.normal(size=s.aircraft)
    leg = np.minimum((np.arange(s.reports_a_flight) * s.legs) // s.reports_a_flight, s.legs - 1)
    first_leg = rng.uniform(0, 360, flights)
    if s.hub_and_spoke:
        first_leg = rng.choice([70.0, 250.0], flights) + rng.normal(0, 12, flights)
    turns = np.cumsum(rng.normal(0, 25, (*flights, s.legs)), axis=-1)
    true = first_leg[..., np.newaxis] + turns[..., leg] + rng.normal(0, 2, n)
    declination = rng.normal(-3, 3, flights)[..., np.newaxis] * np.ones(n)
    magnetic = (true - declination).reshape(s.aircraft, s.days, -1)
    indicated, deviation = magnetic, np.asarray(deviation)
    by_day = deviation if deviation.ndim == 3 else deviation[:, np.newaxis]
    for _ in range(60):
        indicated = magnetic + curve(by_day, indicated)
    wind = (
        np.array([12.0, 3.0])
        + rng.normal(0, 8, (1, s.days, 1, 1, 2))
        + rng.normal(0, 5, (*flights, 1, 2))
        + rng.normal(0, 1, (*n, 2))
    )
    tas = s.airspeed + rng.normal(0, 4, n)
    ground = tas[..., np.newaxis] * _unit(true) + wind
    sensed_air = (tas * (1 + scale[:, None, None, None]))[..., np.newaxis]
    reported = ground - sensed_air * _unit(indicated.reshape(n) + declination)
    wrong = rng.random(n) < s.outliers
    reported = s.wind_factor * np.where(wrong[..., np.newaxis], -reported, reported)
    model = np.empty((s.references, *n, 2))
    for k in range(s.references):
        model[k] = (
            wind
            + bias[k][:, None, None, None]
            + s.day_error * rng.normal(size=(1, s.days, 1, 1, 2))
            + s.flight_error * rng.normal(size=(*flights, 1, 2))
            + s.noise * rng.normal(size=(*n, 2))
        )
    measured_ground = (ground + s.ground_error * rng.normal(size=(*n, 2))).reshape(reports, 2)
    reported, model = reported.reshape(reports, 2), model.reshape(s.references, reports, 2)
    air, implied = measured_ground - reported, measured_ground - model
    airspeed, heading = np.hypot(*air.T), _degrees(air)
    day = np.arange(s.days)[:, None, None] * np.timedelta64(1, "D")
    minute = np.linspace(1, 22, s.flights_a_day)[:, None] * 60 + np.arange(s.reports_a_flight) * 3
    time = np.datetime64("2008-07-01", "ns") + (day + minute.astype("timedelta64[m]"))
    start = np.array([-87.0, 43.0]) + rng.uniform(-3, 3, (*flights, 1, 2))
    path = np.cumsum(ground * 180.0, axis=-2) / 111_200.0
    place = (start + path * np.array([1 / np.cos(np.radians(43.0)), 1.0])).reshape(reports, 2)
    declination = declination.reshape(reports)
    columns = {
        "time": np.broadcast_to(time, n).reshape(reports),
        "longitude": place[:, 0],
        "latitude": place[:, 1],
        "pressure": np.full(reports, 55000.0, np.float32),
        "flight": np.repeat(np.arange(np.prod(flights)), s.reports_a_flight).astype(np.int32),
        "eastward_wind": reported[:, 0],
        "northward_wind": reported[:, 1],
        "heading": heading % 360,
        "magnetic_heading": (heading - declination) % 360,
        "airspeed": airspeed,
        "declination": declination,
        "screening": np.zeros(reports, np.int32),
        "reference_eastward_wind": model[..., 0],
        "reference_northward_wind": model[..., 1],
        "heading_error": wrap(heading - _degrees(implied)),
        "heading_error_standard_error": np.broadcast_to(
            np.degrees(s.ground_error / airspeed), (s.references, reports)
        ),
        "airspeed_error": airspeed - np.hypot(implied[..., 0], implied[..., 1]),
    }
    sizes = np.full(s.aircraft, reports // s.aircraft)
    aircraft = [f"N{k:03d}" for k in range(s.aircraft)]
    ds = ragged(columns, sizes, aircraft, ["ruc", "rtfdaa", "nam"][: s.references])
    wind = np.broadcast_to(wind, (*n, 2)).reshape(reports, 2)
    return ds, {"bias": bias, "scale": scale, "true_wind": wind}


def _unit(heading):
    return np.stack([np.sin(np.radians(heading)), np.cos(np.radians(heading))], axis=-1)


def _degrees(vector):
    return np.degrees(np.arctan2(vector[..., 0], vector[..., 1]))


def fleet_deviations(aircraft, rng, *, two_cycles=0.7, amplitude=6.0):
    """Deviations of a fleet: offset, one cycle up to ``amplitude``, two cycles of that spread."""
    offset = rng.normal(0, 1.0, aircraft)
    size, phase = rng.uniform(0.5, amplitude, aircraft), rng.uniform(0, 2 * np.pi, aircraft)
    two_cycle_terms = two_cycles * rng.normal(size=(2, aircraft))
    return np.stack([offset, size * np.cos(phase), size * np.sin(phase), *two_cycle_terms], axis=-1)
