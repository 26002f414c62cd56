"""A small simulator of flights for the fit's tests: independent of the package's formulas.

True wind, model = truth + bias + errors shared by the day and by the flight, a unit that
computes its wind along a deviated heading, and headings made again from what was reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr


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
    hub_and_spoke: bool = False
    legs: int = 3


def curve(coefficients, m):
    """A + B sin m + C cos m + D sin 2m + E cos 2m, degrees; coefficients (..., 5)."""
    x = np.radians(m)
    a, b, c, d, e = np.moveaxis(np.asarray(coefficients, float), -1, 0)[..., np.newaxis]
    return a + b * np.sin(x) + c * np.cos(x) + d * np.sin(2 * x) + e * np.cos(2 * x)


def wrap(angle):
    return (angle + 180.0) % 360.0 - 180.0


def fly(deviation, setting: Setting, seed: int) -> tuple[xr.Dataset, dict]:
    """HEADINGS Dataset of a fleet with known deviations (aircraft, 5) in degrees."""
    rng = np.random.default_rng(seed)
    deviation = np.atleast_2d(np.asarray(deviation, float))
    s = setting
    n = s.aircraft, s.days, s.flights_a_day, s.reports_a_flight
    bias = np.array(s.bias) + s.bias_spread * rng.normal(size=(s.references, s.aircraft, 2))
    scale = s.scale_spread * rng.normal(size=s.aircraft)
    leg = np.minimum((np.arange(s.reports_a_flight) * s.legs) // s.reports_a_flight, s.legs - 1)
    first = rng.uniform(0, 360, n[:3])
    if s.hub_and_spoke:
        first = rng.choice([70.0, 250.0], n[:3]) + rng.normal(0, 12, n[:3])
    turns = np.cumsum(rng.normal(0, 25, (*n[:3], s.legs)), axis=-1)
    true = first[..., np.newaxis] + turns[..., leg] + rng.normal(0, 2, n)
    declination = rng.normal(-3, 3, n[:3])[..., np.newaxis] * np.ones(n)
    magnetic_true = true - declination
    flat = magnetic_true.reshape(s.aircraft, -1)
    shown = flat.copy()
    for _ in range(60):
        shown = flat + curve(deviation, shown)
    shown = shown.reshape(n)
    indicated = shown + declination
    wind = (
        np.array([12.0, 3.0])
        + rng.normal(0, 8, (1, s.days, 1, 1, 2))
        + rng.normal(0, 5, (*n[:3], 1, 2))
        + rng.normal(0, 1, (*n, 2))
    )
    tas = s.airspeed + rng.normal(0, 4, n)
    ground = tas[..., np.newaxis] * _unit(true) + wind
    unit_air = (tas * (1 + scale[:, None, None, None]))[..., np.newaxis] * _unit(indicated)
    reported = ground - unit_air
    wrong = rng.random(n) < s.outliers
    reported = np.where(wrong[..., np.newaxis], -reported, reported)
    reports = int(np.prod(n))
    model = np.empty((s.references, *n, 2))
    for k in range(s.references):
        model[k] = (
            wind
            + bias[k][:, None, None, None]
            + s.day_error * rng.normal(size=(1, s.days, 1, 1, 2))
            + s.flight_error * rng.normal(size=(*n[:3], 1, 2))
            + s.noise * rng.normal(size=(*n, 2))
        )
    seen = ground + s.ground_error * rng.normal(size=(*n, 2))
    air = (seen - reported).reshape(reports, 2)
    implied = seen.reshape(reports, 2) - model.reshape(s.references, reports, 2)
    airspeed = np.hypot(*air.T)
    heading = np.degrees(np.arctan2(air[:, 0], air[:, 1]))
    other = np.degrees(np.arctan2(implied[..., 0], implied[..., 1]))
    day = np.broadcast_to(np.arange(s.days)[:, None, None], n[1:])
    hour = np.broadcast_to(np.linspace(1, 22, s.flights_a_day)[:, None], n[2:])
    minute = np.arange(s.reports_a_flight) * 3
    time = (
        np.datetime64("2008-07-01", "ns")
        + day.astype("timedelta64[D]")
        + (hour * 60 + minute).astype("timedelta64[m]")
    )
    time = np.broadcast_to(time, n).reshape(reports)
    flight = np.repeat(np.arange(np.prod(n[:3])), s.reports_a_flight)
    start = np.array([-87.0, 43.0]) + rng.uniform(-3, 3, (*n[:3], 1, 2))
    flown = np.cumsum(ground * 180.0, axis=-2) / 111_200.0
    place = (start + flown * np.array([1 / np.cos(np.radians(43.0)), 1.0])).reshape(reports, 2)
    by_report = {
        "time": time,
        "longitude": place[:, 0],
        "latitude": place[:, 1],
        "pressure": np.full(reports, 55000.0, np.float32),
        "flight": flight.astype(np.int32),
        "eastward_wind": reported.reshape(reports, 2)[:, 0],
        "northward_wind": reported.reshape(reports, 2)[:, 1],
        "heading": heading % 360,
        "magnetic_heading": (heading - declination.reshape(reports)) % 360,
        "airspeed": airspeed,
        "declination": declination.reshape(reports),
        "screening": np.zeros(reports, np.int32),
    }
    shape = (s.references, reports)
    known = np.degrees(s.ground_error / airspeed)
    by_reference = {
        "reference_eastward_wind": model.reshape(*shape, 2)[..., 0],
        "reference_northward_wind": model.reshape(*shape, 2)[..., 1],
        "heading_error": wrap(heading - other),
        "heading_error_standard_error": np.broadcast_to(known, shape),
        "airspeed_error": airspeed - np.hypot(implied[..., 0], implied[..., 1]),
    }
    ds = xr.Dataset(
        {name: ("report", values) for name, values in by_report.items()}
        | {name: (("reference", "report"), values) for name, values in by_reference.items()}
        | {"row_size": ("aircraft", np.full(s.aircraft, reports // s.aircraft))},
        coords={
            "aircraft": ("aircraft", np.array([f"N{k:03d}" for k in range(s.aircraft)], object)),
            "reference": ("reference", np.array(["ruc", "rtfdaa", "nam"][: s.references], object)),
        },
    )
    truth = {
        "deviation": deviation,
        "bias": bias,
        "scale": scale,
        "true_wind": np.broadcast_to(wind, (*n, 2)).reshape(reports, 2),
    }
    return ds, truth


def _unit(heading):
    return np.stack([np.sin(np.radians(heading)), np.cos(np.radians(heading))], axis=-1)


def fleet_deviations(aircraft: int, rng, *, two_cycles: float = 0.7, amplitude: float = 6.0):
    """Deviations of a fleet: offset, one cycle up to ``amplitude``, two cycles of that spread."""
    offset = rng.normal(0, 1.0, aircraft)
    size, phase = rng.uniform(0.5, amplitude, aircraft), rng.uniform(0, 2 * np.pi, aircraft)
    second = two_cycles * rng.normal(size=(2, aircraft))
    return np.stack([offset, size * np.cos(phase), size * np.sin(phase), *second], axis=-1)
