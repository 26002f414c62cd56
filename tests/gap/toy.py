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
from airswing.gap.noise import NoiseFit, fit_noise

LATITUDES = (41.98, 44.88, 42.2, 39.0, 35.0, 38.7, 43.0, 46.8, 40.7, 36.1, 32.9, 47.5)
LONGITUDES = (87.9, 93.2, 83.4, 84.7, 90.0, 90.4, 76.1, 92.2, 74.2, 86.7, 97.0, 100.0)
AIRPORTS = np.stack([LATITUDES, -np.array(LONGITUDES)], axis=-1)


COPIED = ("aircraft", "flight", "time", "latitude", "longitude", "pressure")
COPIED += ("declination", "horizontal_field")


class Waves:
    """Sum of plane waves in x, y (km), ln p and time (h)."""

    def __init__(
        self, rng: np.random.Generator, *, sd: float, length: float, hours: float, count: int = 60
    ) -> None:
        k = 2 * np.pi / (length * np.exp(rng.normal(0, 0.5, count)))
        angle = rng.uniform(0, 2 * np.pi, count)
        self.k = np.stack(
            [
                k * np.cos(angle),
                k * np.sin(angle),
                rng.normal(0, 1.5, count),
                rng.normal(0, 2 * np.pi / hours / 2, count),
            ]
        )
        self.phase = rng.uniform(0, 2 * np.pi, (2, count))
        self.size = sd * np.sqrt(2 / count)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Value (n, 2) at points (n, 4)."""
        base = points @ self.k
        return self.size * np.stack([np.sin(base + p).sum(1) for p in self.phase], -1)


def make_frame(
    *,
    seed: int = 0,
    aircraft: int = 8,
    days: int = 20,
    heading_error: Callable[[dict[str, Any]], np.ndarray] | None = None,
    airspeed_factor: Callable[[dict[str, Any]], np.ndarray] | None = None,
    noise: float = 1.0,
    model_error: float = 2.0,
    reference_hours: float = 0.0,
) -> Frame:
    """Build an archive; `heading_error` (rad) and `airspeed_factor` get the context of reports.

    The reference shows the atmosphere `reference_hours` after the time it is stamped with.
    """
    rng = np.random.default_rng(seed)
    context = _paths(rng, aircraft, days)
    n = context["time"].size
    points = np.stack(
        [
            (context["longitude"] + 90) * 85,
            (context["latitude"] - 40) * 111,
            np.log(context["pressure"] / 5e4),
            context["time"] / 3600,
        ],
        -1,
    )
    height = 1 - np.log(context["pressure"] / 9e4)
    large = Waves(rng, sd=6.0, length=2500, hours=60)

    def wind_after(hours: float) -> np.ndarray:
        later = large(points + np.array([0.0, 0.0, 0.0, hours])) * height[:, None]
        return later + np.stack([9 * height, np.zeros(n)], -1)

    wind = wind_after(0.0)
    Waves(rng, sd=6.0, length=2500, hours=60)  # keeps the draws that follow
    error = Waves(rng, sd=model_error, length=700, hours=18)(points)
    error += Waves(rng, sd=0.4, length=1500, hours=1e5, count=20)(points)
    true = wind + error
    airspeed = 110 + 25 * np.clip(np.log(9e4 / context["pressure"]), 0, 1) + rng.normal(0, 3, n)
    course = context.pop("course")
    across = true[:, 0] * np.cos(course) - true[:, 1] * np.sin(course)
    heading = course - np.arcsin(np.clip(across / airspeed, -0.7, 0.7))
    ground = airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1) + true
    declination = np.radians(-(context["longitude"] + 92) * 0.5)
    context |= {
        "heading": heading,
        "airspeed": airspeed,
        "declination": declination,
        "magnetic_heading": heading - declination,
        "horizontal_field": 19000 + 350 * (40 - context["latitude"]),
        "wind": wind,
    }
    if heading_error is not None:
        indicated = heading.copy()
        for _ in range(6):
            context |= {"heading": indicated, "magnetic_heading": indicated - declination}
            indicated = heading + heading_error(context)
        context |= {"heading": indicated, "magnetic_heading": indicated - declination}
    if airspeed_factor is not None:
        context["airspeed"] = airspeed * airspeed_factor(context)
    pointer = np.stack([np.sin(context["heading"]), np.cos(context["heading"])], -1)
    reported = ground - context["airspeed"][:, None] * pointer + rng.normal(0, noise, (n, 2))
    stamped = [wind_after(reference_hours + hours) for hours in (-1.0, 0.0, 1.0)]
    return _frame(context, reported, ground, stamped, aircraft)


def noise_of(frame: Frame, columns: Frame | None = None) -> NoiseFit:
    """Noise of an archive; heading and airspeed of ``columns`` where given."""
    return fit_noise(frame.residual, frame if columns is None else columns)


def _paths(rng: np.random.Generator, aircraft: int, days: int) -> dict[str, Any]:
    pieces = []
    flight = 0
    for a in range(aircraft):
        hub = AIRPORTS[a % 3]
        away = rng.choice(np.arange(3, 12), 5, replace=False)
        for d in range(days):
            clock = d * 86400 + 11 * 3600 + rng.uniform(0, 7200)
            for _ in range(4):
                end = AIRPORTS[rng.choice(away)]
                for start, stop in ((hub, end), (end, hub)):
                    flight += 1
                    scale = np.cos(np.radians(start[0]))
                    north, east = (stop - start) * [111e3, 111e3 * scale]
                    distance = np.hypot(north, east)
                    minutes = distance / 120 / 60
                    steps = np.arange(2, minutes - 2, 3.0)
                    if steps.size < 4:
                        continue
                    share = steps / minutes
                    climb = np.minimum(np.minimum(steps, minutes - steps) / 18, 1)
                    top = 0.45 + 0.1 * rng.random()
                    phase = np.where(steps < 18, 1, np.where(steps > minutes - 18, 3, 2))
                    pieces.append(
                        {
                            "aircraft": np.full(steps.size, a),
                            "flight": np.full(steps.size, flight),
                            "time": clock + steps * 60,
                            "latitude": start[0] + share * (stop - start)[0],
                            "longitude": start[1] + share * (stop - start)[1],
                            "pressure": 9.5e4 * (1 - (1 - top) * climb),
                            "phase": phase,
                            "course": np.full(steps.size, np.arctan2(east, north))
                            + 0.08 * rng.normal(size=steps.size),
                        }
                    )
                    clock += (minutes + 25) * 60
    joined = {k: np.concatenate([p[k] for p in pieces]) for k in pieces[0]}
    order = np.lexsort((joined["time"], joined["aircraft"]))
    return {k: v[order] for k, v in joined.items()}


def _frame(
    context: dict[str, Any],
    reported: np.ndarray,
    ground: np.ndarray,
    winds: list[np.ndarray],
    aircraft: int,
) -> Frame:
    before, wind, after = winds
    n = reported.shape[0]
    air = ground - reported
    heading = np.arctan2(air[:, 0], air[:, 1])
    rng = np.random.default_rng(1)
    zeros = np.zeros(n)
    phase = context["phase"]
    acceleration = np.where(phase == 1, 0.15, np.where(phase == 3, -0.15, 0)) + rng.normal(
        0, 0.03, n
    )
    smooth = {
        f"d{c}d{x}": rng.normal(0, 2e-4 if x == "t" else 2e-5, n) for x in "txy" for c in "uv"
    }
    return Frame(
        tails=tuple(f"N{400 + a}" for a in range(aircraft)),
        epoch=float(context["time"].min()),
        reference_field=float(np.median(context["horizontal_field"])),
        report=np.arange(n),
        **{name: context[name] for name in COPIED},
        u_rep=reported[:, 0],
        v_rep=reported[:, 1],
        u_ref=wind[:, 0],
        v_ref=wind[:, 1],
        heading=heading,
        magnetic_heading=heading - context["declination"],
        airspeed=np.hypot(*air.T),
        ground_u=ground[:, 0],
        ground_v=ground[:, 1],
        heading_error=zeros,
        dip=zeros + 1.2,
        acceleration=acceleration,
        bank=rng.normal(0, 0.05, n),
        climb_rate=np.where(phase == 1, 5.0, np.where(phase == 3, -5.0, 0)),
        temperature=288 - 50 * np.log(9.5e4 / context["pressure"]) + rng.normal(0, 4, n),
        phase=phase,
        icing=(rng.random(n) < 0.15).astype(np.int64),
        **smooth,
        u_before=before[:, 0],
        v_before=before[:, 1],
        u_after=after[:, 0],
        v_after=after[:, 1],
        dudlnp=-wind[:, 0],
        dvdlnp=-wind[:, 1],
        grid_convergence=np.radians((context["longitude"] + 95) * 0.42),
        lead_time=zeros + 1,
        **dict.fromkeys(AIRCRAFT_FIELDS, np.full(aircraft, np.nan)),
    )
