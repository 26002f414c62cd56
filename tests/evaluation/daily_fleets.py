"""Simulated fleets as daily sums: thousands of aircraft-years without their reports.

Legs of flights with the errors of a reference that last (for the fleet, for a region, for a
flight), of heavy tails where asked, a noise level for each aircraft, routes that turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from airswing.evaluation.monitoring import changes
from tests.compass.flown import curve


@dataclass(frozen=True)
class World:
    """Errors in m/s a component; ``tails``: degrees of freedom of Student's t, 0 for normal."""

    reports: int = 40
    flights: int = 4
    legs: int = 3
    fleet_error: float = 0.6
    region_error: float = 0.5
    persistence: float = 0.4
    flight_error: float = 1.2
    report_error: float = 1.5
    spread_of_noise: float = 0.25
    tails: int = 5
    wrong_curve: float = 0.3
    """Degrees of a third harmonic, half as much of a fourth, a quarter of a fifth."""
    days_off: float = 0.12
    airspeed: float = 120.0
    regions: int = 4
    season: float = 0.15
    """How much larger all errors are in winter."""
    weather_routes: float = 0.0
    """Share of flights whose direction depends on the sign of the regional error."""


def watched(world, *, aircraft, days, seed, change=None):
    """The test of a fleet's compasses; ``change`` as for :func:`daily_sums`."""
    rows = daily_sums(world, aircraft=aircraft, days=days, seed=seed, change=change)
    order = np.lexsort((rows[1], rows[0]))
    sums = changes.CompassDays(*(column[order] for column in rows[:4]))
    return changes.compass_watch(np.array([f"N{k}" for k in range(aircraft)]), sums)


def daily_sums(world, *, aircraft, days, seed, change=None):
    """Rows of a fleet: aircraft, day, normal, right; reports and summed ln |dV| last.

    ``change``: degrees that compasses read more, (aircraft, day, 5) or what broadcasts to it.
    """
    rng = np.random.default_rng(seed)
    w = world
    size = np.exp(w.spread_of_noise * rng.normal(size=aircraft))
    region = rng.integers(w.regions, size=aircraft)
    fleet = _lasting(rng, w, (days, 2)) * w.fleet_error
    regional = _lasting(rng, w, (days, w.regions, 2)) * w.region_error
    lobes = rng.uniform(0, 360, (aircraft, days // 60 + 1))
    odd = w.wrong_curve * rng.normal(size=(aircraft, 6)) * np.repeat([1.0, 0.5, 0.25], 2)
    fixed = np.concatenate([rng.normal(0, 2, (aircraft, 3)), rng.normal(0, 0.5, (aircraft, 2))], 1)
    change = np.broadcast_to(0.0 if change is None else change, (aircraft, days, 5))
    rows = []
    for day in range(days):
        of = np.flatnonzero(rng.random(aircraft) >= w.days_off)
        if not of.size:
            continue
        season = 1.0 + w.season * np.cos(2 * np.pi * day / 365.0)
        scale = (size[of] * season)[:, np.newaxis]
        shape = (of.size, w.flights)
        first = lobes[of, day // 60][:, np.newaxis] + 180.0 * rng.integers(2, size=shape)
        first = np.where(rng.random(shape) < 0.5, first, rng.uniform(0, 360, shape))
        if w.weather_routes:
            side = np.where(regional[day, region[of], 0] > 0, 0.0, 180.0)
            turned = lobes[of, day // 60] + side
            follow = rng.random(shape) < w.weather_routes
            first = np.where(follow, turned[:, np.newaxis], first)
        true = first[..., np.newaxis] + rng.normal(0, 25, (*shape, w.legs))
        magnetic = np.radians(true.reshape(of.size, -1))
        heading = magnetic + np.radians(-3.0)
        count = w.reports / (w.flights * w.legs)
        error = scale[..., np.newaxis] * w.flight_error * _tailed(rng, w, (*shape, 2))
        error = np.repeat(error, w.legs, axis=1).reshape(of.size, -1, 2)
        error += (season * (fleet[day] + regional[day, region[of]]))[:, np.newaxis]
        noise = w.report_error / np.sqrt(count)
        error += scale[..., np.newaxis] * noise * _tailed(rng, w, error.shape)
        waves = [wave(k * magnetic) for k in (3, 4, 5) for wave in (np.sin, np.cos)]
        basis = np.stack(waves, axis=-1)
        off = np.einsum("nlk,nk->nl", basis, odd[of])
        off += curve(fixed[of] + change[of, day], np.degrees(magnetic))
        speed = w.airspeed * np.ones(magnetic.size)
        cross, along = changes.compass_design(magnetic.ravel(), heading.ravel(), speed)
        sine, cosine = np.sin(heading), np.cos(heading)
        y_cross = w.airspeed * np.radians(off) + error[..., 0] * cosine - error[..., 1] * sine
        y_along = error[..., 0] * sine + error[..., 1] * cosine
        y, flown = np.stack([y_cross, y_along]), (2, of.size, w.flights, w.legs)
        x, error = np.stack([cross.T, along.T]).reshape(*flown, -1), y.reshape(flown)
        normal = count * np.einsum("knfli,knflj->nfij", x, x, optimize=True)
        right = count * np.einsum("knfli,knfl->nfi", x, error, optimize=True)
        normal, right = (
            by_flight.sum(1) for by_flight in changes.without_flight_bias(normal, right)
        )
        logarithm = count * np.log(np.hypot(*y)).sum(-1)
        total = np.full(of.size, float(w.reports))
        rows.append((of, np.full(of.size, day), normal, right, total, logarithm))
    return tuple(np.concatenate(column) for column in zip(*rows, strict=True))


def _lasting(rng, world, shape):
    r = world.persistence
    shock = np.sqrt(1 - r**2) * rng.normal(size=(shape[0] + 50, *shape[1:]))
    return lfilter([1.0], [1.0, -r], shock, axis=0)[50:]


def _tailed(rng, world, shape):
    """Of unit variance."""
    if n := world.tails:
        return rng.standard_t(n, size=shape) * np.sqrt((n - 2) / n)
    return rng.normal(size=shape)
