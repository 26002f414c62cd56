"""Effects outside the catalogue: any component of the wind changed by one or two variables.

A *part* turns one variable of the report into a number of order one; the parts of an effect are
multiplied. The product changes one component of the wind the unit computed, before it is coded, and
is scaled to the stated root mean square over the reports where the effect acts. An effect of
scatter changes no mean: it clips, rounds or jitters winds. Cyclic variables are taken as fractions
of their turn, the others as their position between the 2nd and 98th percentile of the archive.

Truth: named effects are implemented here again, independent of the diagnosis; least squares by
aircraft gives the share of a change they explain. The share of a variable is the part of the signed
size of the change that the means over its bins explain. An effect is suitable for a case when it
changes reports by `LEAST_SIZE` and more, its sum of squares exceeds `LEAST_ENERGY` (a single known
curve is then four standard errors), and named effects explain less than `MOST_NAMED` of it. Units:
SI and radians; kt and degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.synthetic.atmosphere import Array
from airswing.synthetic.instrument import Mask
from airswing.synthetic.sealed.labels import Injected
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
    columns = {
        name: column(name)
        for name in ("icing", "phase", "airspeed", "temperature", "bank", "acceleration")
    }
    columns |= {name: column(f"true_{name}") for name in ("latitude", "longitude", "altitude")}
    _, flight = np.unique(np.asarray(frame["flight"]), return_inverse=True)
    begin = np.full(flight.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, flight, hours)
    return columns | {
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
        # The outermost reports would widen the scale of positions and widths.
        low, middle, high = np.quantile(values, [0.02, at, 0.98])
        width = max(high - low, 1e-12)
        value = np.clip((values - low) / width, 0.0, 1.0)
        away = value - float(np.clip((middle - low) / width, 0.0, 1.0))
    form = _FORMS[str(part["shape"])]
    return form(value, away, name in CYCLIC, float(part.get("width", 0.1)))


def _product(parameters: Value, variables: Variables, selected: Mask) -> tuple[Array, Mask]:
    """Product of the parts of an effect, and the selected reports (n,) on which it acts."""
    if not parameters.get("parts"):
        return np.ones(selected.size), selected.copy()
    parts = [part_values(part, variables) for part in parameters["parts"]]
    product = np.prod(parts, axis=0) * selected
    size = np.abs(product)
    return product, np.asarray(size > LEAST_SHARE * max(float(size.max(initial=0.0)), 1e-12))


def component_axes(component: str, u: Array, v: Array, heading: Array) -> Winds:
    """Unit vectors (east, north) of a component along or across the heading or the wind."""
    across = ("across_heading", "across_wind", "direction")
    if component.endswith("heading"):
        east, north = np.sin(heading), np.cos(heading)
    else:
        speed = np.maximum(np.hypot(u, v), 1e-9)
        east, north = u / speed, v / speed
    return (north, -east) if component in across else (east, north)


def _mean_effect(
    parameters: Value, u: Array, v: Array, variables: Variables, selected: Mask
) -> Winds:
    component = str(parameters["component"])
    if component not in COMPONENTS:
        raise ValueError(f"no component {component}")
    shape, acting = _product(parameters, variables, selected)
    lever = np.hypot(u, v) if component in ("speed", "direction") else np.ones_like(u)
    size = float(np.sqrt(np.mean((shape * lever)[acting] ** 2))) if acting.any() else 0.0
    if size <= 0.0:
        return u, v
    amount = float(parameters["sign"]) * float(parameters["size_m_s"]) / size * shape
    if component == "speed":
        factor = np.maximum(1.0 + amount, 0.0)
        return u * factor, v * factor
    if component == "direction":
        sine, cosine = np.sin(amount), np.cos(amount)
        return cosine * u + sine * v, cosine * v - sine * u
    east, north = component_axes(component, u, v, variables["heading"])
    return u + amount * east, v + amount * north


SCATTER = ("floor", "ceiling", "hole", "lattice", "jitter", "gross")
"""Effects of scatter: least and largest speed, speeds that are never sent, weak winds in a few
directions only, noise, and winds of any direction in place of a fraction of the reports."""


def _scattered(value: Value, u: Array, v: Array, rng: np.random.Generator) -> Winds:
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
    selected: Mask,
    rng: np.random.Generator,
) -> Array:
    """Change (n, 2), m/s, that an effect makes to the wind u, v that a unit computed.

    An effect on the mean has ``component`` (of `COMPONENTS`), ``parts`` (see `part_values`),
    ``size_m_s`` (root mean square where it acts) and ``sign``; an effect of scatter ``kind`` (of
    `SCATTER`), its values, and ``parts`` where it acts on some reports only. ``selected`` (n,) are
    the reports of its aircraft and period.
    """
    if "kind" in parameters:
        new = _scattered(parameters, u, v, rng)
        acting = _product(parameters, variables, selected)[1]
    else:
        new, acting = _mean_effect(parameters, u, v, variables, selected), np.ones(u.size, bool)
    return np.where(acting[:, None], np.stack([new[0] - u, new[1] - v], axis=-1), 0.0)


LEAST_ENERGY = 400.0
"""(m/s)^2, the least sum of squares of the change."""
LEAST_SIZE = 0.3
"""m/s, root mean square where the effect acts."""
WORTH_KT = 0.1
"""Least closure that a diagnosis must detect, kt."""
MOST_NAMED = 0.35
"""Largest share of the energy that named effects may explain."""
BINS = 36
"""Number of bins: of ten degrees for angles, with equal numbers of reports otherwise."""


def outside_truth(
    frame: pd.DataFrame, innovation: Array, effect: Injected, *, seed: int
) -> dict[str, Any]:
    """Measure an outside effect on an archive without it and its innovation (n, 2).

    Returns its ``component, shape, variables, scope, reports`` and ``size_m_s``, the
    ``named_share`` of its energy that named effects explain, ``closes_kt``, and in ``carried`` the
    share that a curve of each single variable explains.
    """
    u, v = frame["computed_u"].to_numpy(float), frame["computed_v"].to_numpy(float)
    variables = report_variables(frame, u, v, frame["hours"].to_numpy(float))
    parameters, tails, period = effect["parameters"], effect["tails"], effect["period"]
    selected = np.ones(len(frame), bool)
    if tails is not None:
        selected &= np.isin(frame["tail"].to_numpy(str), np.array(tails))
    if period is not None:
        selected &= frame["time"].to_numpy() >= np.datetime64(period[0])
    change = effect_change(parameters, u, v, variables, selected, np.random.default_rng(seed))
    lengths = np.hypot(*change.T)
    acts = lengths > 0.05 * lengths.max(initial=0.0)
    size = float(np.sqrt((lengths[acts] ** 2).mean())) if acts.any() else 0.0
    component = str(parameters["component"])
    signed = signed_size(change, u, v, variables["heading"], component)
    named = 0.0
    if component != "scatter":
        named = named_share(change, variables, u, v, frame["aircraft"].to_numpy(int))
    longer = np.hypot(*(innovation + change).T) - np.hypot(*innovation.T)
    acting = [str(part["variable"]) for part in parameters["parts"]]
    if parameters.get("kind") == "lattice":
        acting += ["wind_direction", "wind_speed"]
    elif parameters.get("kind") in ("floor", "ceiling", "hole"):
        acting.append("wind_speed")
    carried = carried_by(signed[selected], {name: x[selected] for name, x in variables.items()})
    return {
        "component": component,
        "shape": str(parameters.get("kind", parameters["shape"])),
        "variables": list(dict.fromkeys(acting)),
        "scope": "all" if tails is None else "one" if len(tails) == 1 else "some",
        "reports": int(acts.sum()),
        "size_m_s": round(size, 3),
        "named_share": round(named, 3),
        "closes_kt": round(float(np.nanmean(longer)) / KNOT, 3),
        "carried": {name: round(share, 3) for name, share in carried.items()},
    }


def is_fit(truth: Mapping[str, Any]) -> bool:
    """Whether an outside effect is suitable for a case."""
    return bool(
        truth["reports"] * truth["size_m_s"] ** 2 >= LEAST_ENERGY
        and truth["size_m_s"] >= LEAST_SIZE
        and truth["named_share"] < MOST_NAMED
    )


def _named_forms(variables: Mapping[str, Array], u: Array, v: Array) -> Array:
    """Wind errors (k, n, 2) of named effects at unit size."""
    heading, magnetic = variables["heading"], variables["magnetic_heading"]
    across = variables["airspeed"] * np.stack([np.cos(heading), -np.sin(heading)])
    along = np.stack([np.sin(heading), np.cos(heading)])
    sine, cosine = np.sin(magnetic), np.cos(magnetic)
    icing = np.asarray(variables["icing"] == 1, np.float64)
    turning = [np.ones_like(u), sine, cosine, np.sin(2 * magnetic), np.cos(2 * magnetic)]
    turning += [icing, icing * sine, icing * cosine, variables["date"] / 30.0]
    turning += [variables["acceleration"] * sine, variables["bank"] * cosine]
    wind = np.stack([u, v])
    forms = [across * factor for factor in turning]
    forms += [along, along * variables["airspeed"] / 100.0, wind / 10.0, np.stack([v, -u]) / 10.0]
    return np.stack(forms).transpose(0, 2, 1)


def named_share(
    change: Array, variables: Mapping[str, Array], u: Array, v: Array, aircraft: NDArray[np.int64]
) -> float:
    """Share, in [0, 1], of the energy of a change (n, 2) that named effects explain."""
    total = float((change**2).sum())
    if total == 0.0:
        return 0.0
    explained = 0.0
    for number in np.unique(aircraft[np.any(change != 0.0, axis=1)]):
        rows = aircraft == number
        forms = _named_forms({k: values[rows] for k, values in variables.items()}, u[rows], v[rows])
        design = forms.reshape(len(forms), -1).T
        target = change[rows].ravel()
        # With few headings the forms are nearly collinear: singular values near zero are omitted.
        solution = np.linalg.lstsq(design, target, rcond=1e-9)[0]
        explained += float((target**2).sum() - ((target - design @ solution) ** 2).sum())
    return explained / total


def signed_size(change: Array, u: Array, v: Array, heading: Array, component: str) -> Array:
    """A change (n, 2) along its component, (n,) m/s; for ``scatter`` its length."""
    if component == "scatter":
        return np.asarray(np.hypot(*change.T))
    east, north = component_axes(component, u, v, heading)
    return np.asarray(change[:, 0] * east + change[:, 1] * north)


def carried_by(size: Array, variables: Mapping[str, Array]) -> dict[str, float]:
    """Share of the sum of squares of a signed size that a function of each variable could make."""
    total = float((size**2).sum())
    shares = {}
    for name, values in variables.items():
        if name in FLAGS:
            bins = values.astype(np.int64) + 1
        elif name in CYCLIC:
            turn = np.mod(values / CYCLIC[name], 1.0)
            bins = np.minimum((turn * BINS).astype(np.int64), BINS - 1)
        else:
            bins = np.searchsorted(np.quantile(values, np.linspace(0, 1, BINS + 1)[1:-1]), values)
        # Energy of the means of bins: that of the best step function of the variable.
        energy = np.bincount(bins, size) ** 2 / np.maximum(np.bincount(bins), 1)
        shares[name] = float(energy.sum()) / total if total > 0.0 else 0.0
    return shares
