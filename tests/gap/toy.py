"""A small archive for the gap's tests: hub networks flown through waves of wind and model error.

The model error is a sum of travelling waves shared by all aircraft (not the process the noise model
assumes) plus white noise. Nothing is imported from the effects: an error of heading or airspeed is
put in by the full wind triangle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from airswing.gap.archive.frame import AIRCRAFT_FIELDS, Frame

LATITUDES = (41.98, 44.88, 42.2, 39.0, 35.0, 38.7, 43.0, 46.8, 40.7, 36.1, 32.9, 47.5)
LONGITUDES = (87.9, 93.2, 83.4, 84.7, 90.0, 90.4, 76.1, 92.2, 74.2, 86.7, 97.0, 100.0)
AIRPORTS = np.stack([LATITUDES, -np.array(LONGITUDES)], axis=-1)
Context = dict[str, Any]


def waves(
    rng: np.random.Generator, *, sd: float, length: float, hours: float, number: int = 60
) -> Callable[[np.ndarray], np.ndarray]:
    """Sum of plane waves: value (n, 2) at points (n, 4) of x, y (km), ln p and time (h)."""
    k = 2 * np.pi / (length * np.exp(rng.normal(0, 0.5, number)))
    angle = rng.uniform(0, 2 * np.pi, number)
    height, time = rng.normal(0, 1.5, number), rng.normal(0, 2 * np.pi / hours / 2, number)
    vector = np.stack([k * np.cos(angle), k * np.sin(angle), height, time])
    phases = rng.uniform(0, 2 * np.pi, (2, number))
    size = sd * np.sqrt(2 / number)
    return lambda points: size * np.stack([np.sin(points @ vector + p).sum(1) for p in phases], -1)


def make_frame(
    *,
    seed: int = 0,
    aircraft: int = 8,
    days: int = 20,
    heading_error: Callable[[Context], np.ndarray] | None = None,
    airspeed_factor: Callable[[Context], np.ndarray] | None = None,
    noise: float = 1.0,
    reference_hours: float = 0.0,
) -> Frame:
    """Build an archive; `heading_error` (rad) and `airspeed_factor` get the context of reports.

    The reference shows the atmosphere `reference_hours` after the time it is stamped with.
    """
    rng = np.random.default_rng(seed)
    context = _paths(rng, aircraft, days)
    n, pressure, phase = context["time"].size, context["pressure"], context.pop("phase")
    x, y = (context["longitude"] + 90) * 85, (context["latitude"] - 40) * 111
    points = np.stack([x, y, np.log(pressure / 5e4), context["time"] / 3600], -1)
    height = 1 - np.log(pressure / 9e4)
    large = waves(rng, sd=6.0, length=2500, hours=60)

    def wind_after(hours: float) -> np.ndarray:
        later = large(points + np.array([0.0, 0.0, 0.0, hours])) * height[:, None]
        return later + np.stack([9 * height, np.zeros(n)], -1)

    waves(rng, sd=6.0, length=2500, hours=60)  # keeps the draws that follow
    true = wind_after(0.0) + waves(rng, sd=2.0, length=700, hours=18)(points)
    true += waves(rng, sd=0.4, length=1500, hours=1e5, number=20)(points)
    airspeed = 110 + 25 * np.clip(np.log(9e4 / pressure), 0, 1) + rng.normal(0, 3, n)
    course = context.pop("course")
    across = true[:, 0] * np.cos(course) - true[:, 1] * np.sin(course)
    heading = course - np.arcsin(np.clip(across / airspeed, -0.7, 0.7))
    ground = airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1) + true
    declination = np.radians(-(context["longitude"] + 92) * 0.5)
    field = 19000 + 350 * (40 - context["latitude"])
    context |= {"declination": declination, "horizontal_field": field}
    indicated = heading.copy()
    for _ in range(6 if heading_error else 0):
        seen = {"heading": indicated, "magnetic_heading": indicated - declination}
        indicated = heading + heading_error(context | seen)
    factor = airspeed_factor(context) if airspeed_factor else 1.0
    pointer = np.stack([np.sin(indicated), np.cos(indicated)], -1)
    reported = ground - (airspeed * factor)[:, None] * pointer + rng.normal(0, noise, (n, 2))
    before, wind, after = (wind_after(reference_hours + hours) for hours in (-1.0, 0.0, 1.0))
    air = ground - reported
    heading = np.arctan2(air[:, 0], air[:, 1])
    rng, zeros = np.random.default_rng(1), np.zeros(n)
    gradients = [f"d{component}d{axis}" for axis in "txy" for component in "uv"]
    return Frame(
        tails=tuple(f"N{400 + a}" for a in range(aircraft)),
        epoch=float(context["time"].min()),
        reference_field=float(np.median(field)),
        report=np.arange(n),
        **context,
        **_components("rep", reported),
        **_components("ref", wind),
        **_components("before", before),
        **_components("after", after),
        heading=heading,
        magnetic_heading=heading - declination,
        airspeed=np.hypot(*air.T),
        ground_u=ground[:, 0],
        ground_v=ground[:, 1],
        heading_error=zeros,
        dip=zeros + 1.2,
        acceleration=np.choose(phase, [0, 0.15, 0, -0.15]) + rng.normal(0, 0.03, n),
        **{name: rng.normal(0, 2e-4 if name[-1] == "t" else 2e-5, n) for name in gradients},
        bank=rng.normal(0, 0.05, n),
        climb_rate=np.choose(phase, [0.0, 5.0, 0.0, -5.0]),
        temperature=288 - 50 * np.log(9.5e4 / pressure) + rng.normal(0, 4, n),
        phase=phase,
        icing=(rng.random(n) < 0.15).astype(np.int64),
        dudlnp=-wind[:, 0],
        dvdlnp=-wind[:, 1],
        grid_convergence=np.radians((context["longitude"] + 95) * 0.42),
        lead_time=zeros + 1,
        **dict.fromkeys(AIRCRAFT_FIELDS, np.full(aircraft, np.nan)),
    )


def _components(name: str, wind: np.ndarray) -> dict[str, np.ndarray]:
    return {f"u_{name}": wind[:, 0], f"v_{name}": wind[:, 1]}


def _paths(rng: np.random.Generator, aircraft: int, days: int) -> Context:
    """Reports of flights from one of three hubs to five airports of each aircraft and back."""
    pieces, flight = [], 0
    for a in range(aircraft):
        hub, away = AIRPORTS[a % 3], rng.choice(np.arange(3, 12), 5, replace=False)
        for d in range(days):
            clock = d * 86400 + 11 * 3600 + rng.uniform(0, 7200)
            for leg in range(8):
                if leg % 2 == 0:
                    end = AIRPORTS[rng.choice(away)]
                start, stop = (hub, end) if leg % 2 == 0 else (end, hub)
                flight += 1
                north, east = (stop - start) * [111e3, 111e3 * np.cos(np.radians(start[0]))]
                minutes = np.hypot(north, east) / 120 / 60
                steps = np.arange(2, minutes - 2, 3.0)
                if steps.size < 4:
                    continue
                place = start + (steps / minutes)[:, None] * (stop - start)
                climb = np.minimum(np.minimum(steps, minutes - steps) / 18, 1)
                top = 0.45 + 0.1 * rng.random()
                piece = {
                    "aircraft": np.full(steps.size, a),
                    "flight": np.full(steps.size, flight),
                    "time": clock + steps * 60,
                    "latitude": place[:, 0],
                    "longitude": place[:, 1],
                    "pressure": 9.5e4 * (1 - (1 - top) * climb),
                    "phase": np.where(steps < 18, 1, np.where(steps > minutes - 18, 3, 2)),
                    "course": np.arctan2(east, north) + 0.08 * rng.normal(size=steps.size),
                }
                pieces.append(piece)
                clock += (minutes + 25) * 60
    joined = {name: np.concatenate([piece[name] for piece in pieces]) for name in piece}
    order = np.lexsort((joined["time"], joined["aircraft"]))
    return {name: values[order] for name, values in joined.items()}
