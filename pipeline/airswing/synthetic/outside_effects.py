"""Effects outside the catalogue: any component of the wind changed by one or two variables.

A *part* turns one variable of the report into a number of order one; the parts of an effect are
multiplied. The product changes one component of the wind the unit computed, before it is coded, and
is scaled to the stated root mean square over the reports where the effect acts. An effect of
scatter changes no mean: it clips, rounds or jitters winds. Cyclic variables are taken as fractions
of their turn, the others as their place between the 2nd and 98th percentile of the archive.
Units: SI and radians; kt and degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from airswing.synthetic.atmosphere import Array
from airswing.synthetic.instrument import Mask
from airswing.units import KNOT

Value = Mapping[str, Any]
Winds = tuple[Array, Array]
Variables = Mapping[str, Array]
LEAST_SHARE = 0.05
"""An effect acts where its product exceeds this share of its largest size."""
COMPONENTS = ("across_heading", "along_heading", "across_wind", "along_wind", "speed", "direction")
"""Changed component: body and wind axes (m/s), speed (relative), direction (radians)."""
_ANGLES = ("magnetic_heading", "heading", "track", "wind_direction")
CYCLIC: dict[str, float] = {**dict.fromkeys(_ANGLES, 2 * np.pi), "hour": 24.0}
"""Cyclic variables and their turn."""
FLAGS = ("icing", "phase")
"""Variables with a few values; an effect acts on one of them."""
VARIABLES = (
    *CYCLIC,
    *FLAGS,
    *("airspeed", "ground_speed", "latitude", "longitude", "altitude", "temperature", "bank"),
    *("acceleration", "date", "flight_time", "wind_speed", "drift"),
)
"""Everything a report records or that follows from it without a model."""
SHAPES = ("step", "sector", "hinge", "bump", "saw")
"""Forms of one variable; products and thresholds have two parts."""


def report_variables(
    frame: Mapping[str, Any] | pd.DataFrame, u: Array, v: Array, hours: Array
) -> dict[str, Array]:
    """`VARIABLES` at the reports of `airswing.synthetic.observe.observe` with computed wind u, v.

    Radians, m/s, degrees for places, m, K, hours, days.
    """

    def column(name: str) -> Array:
        return np.asarray(frame[name], float)

    east, north, heading = column("ground_u"), column("ground_v"), column("heading")
    track = np.arctan2(east, north)
    found = {
        name: column(name)
        for name in ("icing", "phase", "airspeed", "temperature", "bank", "acceleration")
    }
    found |= {name: column(f"true_{name}") for name in ("latitude", "longitude", "altitude")}
    _, flight = np.unique(np.asarray(frame["flight"]), return_inverse=True)
    begin = np.full(flight.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, flight, hours)
    return found | {
        "heading": heading,
        "magnetic_heading": heading - column("declination"),
        "track": track,
        "ground_speed": np.hypot(east, north),
        "drift": np.angle(np.exp(1j * (track - heading))),
        "wind_direction": np.arctan2(-u, -v),
        "wind_speed": np.hypot(u, v),
        "hour": np.mod(hours, 24.0),
        "date": hours / 24.0,
        "flight_time": np.asarray(hours - begin[flight]),
    }


# From a variable as a fraction of its turn or range, its signed distance to where the part is (the
# short way round where it is cyclic), whether it is cyclic, and the width.
_FORMS: dict[str, Callable[[Array, Array, bool, float], Array]] = {
    # 1 beyond the place; half a turn of a cyclic variable
    "step": lambda value, away, cyclic, width: np.asarray(away > 0.0, np.float64),
    "sector": lambda value, away, cyclic, width: np.asarray(np.abs(away) < width, np.float64),
    "hinge": lambda value, away, cyclic, width: np.maximum(away, 0.0) * (2.0 if cyclic else 1.0),
    "bump": lambda value, away, cyclic, width: np.asarray(np.exp(-0.5 * (away / width) ** 2)),
    # a ramp from -1 to 1 that starts again every width
    "saw": lambda value, away, cyclic, width: 2.0 * np.mod(away / width, 1.0) - 1.0,
    # one wave of a turn, or a ramp over the range
    "linear": lambda value, away, cyclic, width: (
        np.asarray(np.sin(2 * np.pi * away)) if cyclic else 2.0 * (value - 0.5)
    ),
}


def part_values(part: Value, variables: Variables) -> Array:
    """One part, ``{variable, shape, at, width}`` or ``{variable, equals}``, at every report."""
    name = str(part["variable"])
    if name not in variables:
        raise ValueError(f"no variable {name}")
    values = np.asarray(variables[name], np.float64)
    if name in FLAGS:
        return np.asarray(values == float(part["equals"]), np.float64)
    if part["shape"] not in _FORMS:
        raise ValueError(f"no shape {part['shape']}")
    at = float(part["at"])
    if name in CYCLIC:
        value = np.mod(values / CYCLIC[name], 1.0)
        away = np.mod(value - at + 0.5, 1.0) - 0.5
    else:
        # The outermost reports would stretch the scale of places and widths.
        low, middle, high = np.quantile(values, [0.02, at, 0.98])
        width = max(high - low, 1e-12)
        value = np.clip((values - low) / width, 0.0, 1.0)
        away = value - float(np.clip((middle - low) / width, 0.0, 1.0))
    form = _FORMS[str(part["shape"])]
    return form(value, away, name in CYCLIC, float(part.get("width", 0.1)))


def _product(parameters: Value, variables: Variables, chosen: Mask) -> tuple[Array, Mask]:
    """Product of the parts of an effect, and the chosen reports (n,) on which it acts."""
    if not parameters.get("parts"):
        return np.ones(chosen.size), chosen.copy()
    parts = [part_values(part, variables) for part in parameters["parts"]]
    product = np.prod(parts, axis=0) * chosen
    size = np.abs(product)
    return product, np.asarray(size > LEAST_SHARE * max(float(size.max(initial=0.0)), 1e-12))


def component_axes(
    component: str, u: Array, v: Array, heading: Array, *, across: tuple[str, ...]
) -> Winds:
    """Unit vectors (east, north) of a component along or across the heading or the wind."""
    if component.endswith("heading"):
        east, north = np.sin(heading), np.cos(heading)
    else:
        speed = np.maximum(np.hypot(u, v), 1e-9)
        east, north = u / speed, v / speed
    return (north, -east) if component in across else (east, north)


def _mean_effect(
    parameters: Value, u: Array, v: Array, variables: Variables, chosen: Mask
) -> Winds:
    """Wind changed by an effect on the mean."""
    component = str(parameters["component"])
    if component not in COMPONENTS:
        raise ValueError(f"no component {component}")
    shape, here = _product(parameters, variables, chosen)
    lever = np.hypot(u, v) if component in ("speed", "direction") else np.ones_like(u)
    size = float(np.sqrt(np.mean((shape * lever)[here] ** 2))) if here.any() else 0.0
    if size <= 0.0:
        return u, v
    amount = float(parameters["sign"]) * float(parameters["size_m_s"]) / size * shape
    if component == "speed":
        factor = np.maximum(1.0 + amount, 0.0)
        return u * factor, v * factor
    if component == "direction":
        sine, cosine = np.sin(amount), np.cos(amount)
        return cosine * u + sine * v, cosine * v - sine * u
    across = ("across_heading", "across_wind")
    east, north = component_axes(component, u, v, variables["heading"], across=across)
    return u + amount * east, v + amount * north


SCATTER = ("floor", "ceiling", "hole", "lattice", "jitter", "gross")
"""Effects of scatter: least and largest speed, speeds that are never sent, weak winds in a few
directions only, noise, and winds of any direction in place of a fraction of the reports."""


def _scattered(value: Value, u: Array, v: Array, rng: np.random.Generator) -> Winds:
    """Wind that an effect of scatter sends where it acts."""
    kind, speed = str(value["kind"]), np.hypot(u, v)
    if kind == "jitter":
        noise = rng.normal(0.0, float(value["size_m_s"]) / np.sqrt(2.0), (2, u.size))
        return u + noise[0], v + noise[1]
    if kind == "gross":
        hit = rng.uniform(size=u.size) < float(value["fraction"])
        turn = rng.uniform(0.0, 2 * np.pi, u.size)
        wild = (speed + 10.0) * np.sin(turn), (speed + 10.0) * np.cos(turn)
        return np.where(hit, wild[0], u), np.where(hit, wild[1], v)
    if kind == "lattice":
        direction, step = np.arctan2(u, v), np.radians(float(value["direction_step_deg"]))
        weak = speed < float(value["limit_kt"]) * KNOT
        rounded = np.where(weak, np.round(direction / step) * step, direction)
        return speed * np.sin(rounded), speed * np.cos(rounded)
    if kind == "hole":
        # The nearer edge of an interval of speeds.
        low, high = (float(edge) * KNOT for edge in value["between_kt"])
        nearer = np.where(speed - low < high - speed, low, high)
        changed = np.where((speed > low) & (speed < high), nearer, speed)
    else:
        limit = float(value["limit_kt"]) * KNOT
        changed = np.maximum(speed, limit) if kind == "floor" else np.minimum(speed, limit)
    factor = changed / np.maximum(speed, 1e-9)
    return u * factor, v * factor


def effect_change(
    parameters: Value,
    u: Array,
    v: Array,
    variables: Variables,
    chosen: Mask,
    rng: np.random.Generator,
) -> Array:
    """Change (n, 2), m/s, that an effect makes to the wind u, v that a unit computed.

    An effect on the mean has ``component`` (of `COMPONENTS`), ``parts`` (see `part_values`),
    ``size_m_s`` (root mean square where it acts) and ``sign``; an effect of scatter ``kind`` (of
    `SCATTER`), its values, and ``parts`` where it acts on some reports only. ``chosen`` (n,) are
    the reports of its aircraft and period.
    """
    if "kind" in parameters:
        new, here = _scattered(parameters, u, v, rng), _product(parameters, variables, chosen)[1]
    else:
        new, here = _mean_effect(parameters, u, v, variables, chosen), np.ones(u.size, bool)
    return np.where(here[:, None], np.stack([new[0] - u, new[1] - v], axis=-1), 0.0)
