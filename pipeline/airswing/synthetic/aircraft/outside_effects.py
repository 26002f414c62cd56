"""Effects nobody thought of: any component of the wind moved by any one or two variables.

Assumptions and validity: a *part* turns one variable of the report into a number of order one
(a step, a sector, a bump ...); the parts of an effect are multiplied. The product moves one
component of the wind the unit computed, before the unit codes it, so heading and airspeed that
follow from the wind triangle move with it as they would behind a real fault. The amount is scaled
so that the change has the stated root mean square over the reports where it acts (where the
product exceeds a twentieth of its largest size). An effect of scatter moves no mean: it clips,
rounds or jitters winds. Nothing here knows of any catalogue or design column.

Variables that turn (directions, the hour) are taken as fractions of their turn; the others as
their place between the 2nd and 98th percentile of the archive, so that places drawn blindly fall
where reports are. Units: SI and radians; kt and degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.synthetic.aircraft.parameter_values import listed, number

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "COMPONENTS",
    "CYCLIC",
    "FLAGS",
    "SCATTER",
    "SHAPES",
    "VARIABLES",
    "outside_change",
    "part_values",
    "parts_of",
    "report_variables",
    "scatter_change",
    "where_it_acts",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Value = Mapping[str, object]
Winds = tuple[Array, Array]
KNOT = 1852.0 / 3600.0
LEAST_SHARE = 0.05  # An effect acts where its shape exceeds this share of its largest size

# What is moved: body axes and wind axes in m/s, the wind's speed in parts, its direction.
COMPONENTS = (
    "across_heading",
    "along_heading",
    "across_wind",
    "along_wind",
    "speed",
    "direction",
)
# Variables that turn, and their turn.
CYCLIC: dict[str, float] = {
    "magnetic_heading": 2 * np.pi,
    "heading": 2 * np.pi,
    "track": 2 * np.pi,
    "wind_direction": 2 * np.pi,
    "hour": 24.0,
}
FLAGS = ("icing", "phase")  # Variables with a few values: an effect acts on one of them
# Everything a report records or that follows from it without a model.
VARIABLES = (
    *CYCLIC,
    *FLAGS,
    "airspeed",
    "ground_speed",
    "latitude",
    "longitude",
    "altitude",
    "temperature",
    "bank",
    "acceleration",
    "date",
    "flight_time",
    "wind_speed",
    "drift",
)
# Forms of one variable; products and thresholds are made of two parts.
SHAPES = ("step", "sector", "hinge", "bump", "saw")


def report_variables(
    frame: Mapping[str, object] | pd.DataFrame, u: Array, v: Array, hours: Array
) -> dict[str, Array]:
    """Return every variable an outside effect may act by.

    Parameters
    ----------
    frame : mapping
        Columns (n,) of `airswing.synthetic.aircraft.observe.observe`: exact state and indication.
    u, v : ndarray (n,)
        Wind as computed, m/s.
    hours : ndarray (n,)
        Since the start of the first day, UTC.

    Returns
    -------
    dict
        The names of `VARIABLES` to (n,): radians, m/s, degrees for places, m, K, hours, days.
    """
    east, north = np.asarray(frame["ground_u"], float), np.asarray(frame["ground_v"], float)
    heading = np.asarray(frame["heading"], float)
    track = np.arctan2(east, north)
    same = {
        name: np.asarray(frame[name], float)
        for name in ("icing", "phase", "airspeed", "temperature", "bank", "acceleration")
    }
    places = {
        name: np.asarray(frame[f"true_{name}"], float)
        for name in ("latitude", "longitude", "altitude")
    }
    return (
        same
        | places
        | {
            "heading": heading,
            "magnetic_heading": heading - np.asarray(frame["declination"], float),
            "track": track,
            "ground_speed": np.hypot(east, north),
            "drift": np.angle(np.exp(1j * (track - heading))),
            "wind_direction": np.arctan2(-u, -v),
            "wind_speed": np.hypot(u, v),
            "hour": np.mod(hours, 24.0),
            "date": hours / 24.0,
            "flight_time": _flown(np.asarray(frame["flight"]), hours),
        }
    )


def _flown(flight: NDArray[np.generic], hours: Array) -> Array:
    """Return the hours since the first report of each flight."""
    _, own = np.unique(flight, return_inverse=True)
    begin = np.full(own.max(initial=-1) + 1, np.inf)
    np.minimum.at(begin, own, hours)
    return np.asarray(hours - begin[own])


@dataclass(frozen=True)
class _Place:
    """A variable as a fraction of its turn or of its range, and where ``at`` lies in it."""

    value: Array
    at: float
    turns: bool

    @property
    def apart(self) -> Array:
        """Distance to ``at``, signed; the short way round where the variable turns."""
        apart = self.value - self.at
        return np.mod(apart + 0.5, 1.0) - 0.5 if self.turns else apart


def _place(values: Array, name: str, at: float) -> _Place:
    """Return a variable in [0, 1] and ``at`` (a fraction of the turn, or a quantile) on it."""
    if name in CYCLIC:
        return _Place(np.mod(values / CYCLIC[name], 1.0), at, True)
    # the outermost reports would stretch the scale on which places and widths are drawn
    low, middle, high = np.quantile(values, [0.02, at, 0.98])
    width = max(high - low, 1e-12)
    clipped = np.clip((values - low) / width, 0.0, 1.0)
    return _Place(clipped, float(np.clip((middle - low) / width, 0.0, 1.0)), False)


def _step(place: _Place, width: float) -> Array:
    """Return 1 beyond the place; half a turn of a variable that turns."""
    return np.asarray(place.apart > 0.0, np.float64)


def _sector(place: _Place, width: float) -> Array:
    return np.asarray(np.abs(place.apart) < width, np.float64)


def _hinge(place: _Place, width: float) -> Array:
    return np.maximum(place.apart, 0.0) * (2.0 if place.turns else 1.0)


def _bump(place: _Place, width: float) -> Array:
    return np.asarray(np.exp(-0.5 * (place.apart / width) ** 2))


def _saw(place: _Place, width: float) -> Array:
    """Return a ramp from -1 to 1 that starts again every ``width``."""
    return np.asarray(2.0 * np.mod(place.apart / width, 1.0) - 1.0)


def _linear(place: _Place, width: float) -> Array:
    """Return the plain dependence a product is made of: one wave of a turn, a ramp of a range."""
    if place.turns:
        return np.asarray(np.sin(2 * np.pi * place.apart))
    return 2.0 * (place.value - 0.5)


_FORMS: dict[str, Callable[[_Place, float], Array]] = {
    "step": _step,
    "sector": _sector,
    "hinge": _hinge,
    "bump": _bump,
    "saw": _saw,
    "linear": _linear,
}


def part_values(part: Value, variables: Mapping[str, Array]) -> Array:
    """Return one part of an effect at every report.

    Parameters
    ----------
    part : mapping
        ``variable, shape, at, width`` (fractions), or ``variable, equals`` for a flag.
    variables : mapping
        Name to values (n,), in the units of the module docstring.

    Returns
    -------
    ndarray (n,)
        Of order one.

    Raises
    ------
    ValueError
        A variable or shape that is not known.
    """
    name = str(part["variable"])
    if name not in variables:
        raise ValueError(f"no variable {name}")
    values = np.asarray(variables[name], np.float64)
    if name in FLAGS:
        return np.asarray(values == number(part["equals"]), np.float64)
    if part["shape"] not in _FORMS:
        raise ValueError(f"no shape {part['shape']}")
    place = _place(values, name, number(part["at"]))
    return _FORMS[str(part["shape"])](place, number(part.get("width", 0.1)))


def parts_of(parameters: Value) -> Sequence[Value]:
    """Return the parts whose product an effect acts by.

    Raises
    ------
    TypeError
        If they are no list.
    """
    parts = parameters["parts"]
    if isinstance(parts, Sequence):
        return parts
    raise TypeError(f"{parts!r} are no parts")


def _product(parts: Sequence[Value], variables: Mapping[str, Array]) -> Array:
    return np.asarray(np.prod([part_values(part, variables) for part in parts], axis=0))


def where_it_acts(parameters: Value, variables: Mapping[str, Array], chosen: Mask) -> Mask:
    """Return the reports (n,) on which an effect acts.

    Parameters
    ----------
    parameters : mapping
        With ``parts``.
    variables : mapping
        Name to values (n,).
    chosen : ndarray of bool (n,)
        Its aircraft and period.

    Returns
    -------
    ndarray of bool (n,)
    """
    if not parameters.get("parts"):
        return chosen.copy()
    size = np.abs(_product(parts_of(parameters), variables)) * chosen
    return np.asarray(size > LEAST_SHARE * max(float(size.max(initial=0.0)), 1e-12))


def _directions(
    component: str, u: Array, v: Array, variables: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return what one unit of a component adds to the wind, (n,) each."""
    if component.endswith("heading"):
        east, north = np.sin(variables["heading"]), np.cos(variables["heading"])
    else:
        speed = np.maximum(np.hypot(u, v), 1e-9)
        east, north = u / speed, v / speed
    if component.startswith("across"):
        return north, -east
    return east, north


def _moved(
    component: str, amount: Array, u: Array, v: Array, variables: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return the wind with one component moved by an amount (m/s, parts of one, or radians)."""
    if component == "speed":
        factor = np.maximum(1.0 + amount, 0.0)
        return u * factor, v * factor
    if component == "direction":
        sine, cosine = np.sin(amount), np.cos(amount)
        return cosine * u + sine * v, cosine * v - sine * u
    east, north = _directions(component, u, v, variables)
    return u + amount * east, v + amount * north


def outside_change(
    parameters: Value,
    u: Array,
    v: Array,
    variables: Mapping[str, Array],
    chosen: Mask,
) -> Array:
    """Return what an effect adds to the wind a unit computed.

    Parameters
    ----------
    parameters : mapping
        ``component`` (of `COMPONENTS`), ``parts`` (see `part_values`), ``size_m_s`` (root mean
        square of the change where the effect acts), ``sign`` (1 or -1).
    u, v : ndarray (n,)
        Wind as computed, m/s.
    variables : mapping
        Name to values (n,).
    chosen : ndarray of bool (n,)
        Its aircraft and period.

    Returns
    -------
    ndarray (n, 2)
        m/s.
    """
    component = str(parameters["component"])
    if component not in COMPONENTS:
        raise ValueError(f"no component {component}")
    shape = _product(parts_of(parameters), variables) * chosen
    here = where_it_acts(parameters, variables, chosen)
    lever = np.hypot(u, v) if component in ("speed", "direction") else np.ones_like(u)
    size = float(np.sqrt(np.mean((shape * lever)[here] ** 2))) if here.any() else 0.0
    if size <= 0.0:
        return np.zeros((u.size, 2))
    amount = number(parameters["sign"]) * number(parameters["size_m_s"]) / size * shape
    new = _moved(component, amount, u, v, variables)
    return np.stack([new[0] - u, new[1] - v], axis=-1)


def _limited(u: Array, v: Array, limits: Callable[[Array], Array]) -> Winds:
    """Return the wind with its speed changed and its direction kept."""
    speed = np.hypot(u, v)
    factor = limits(speed) / np.maximum(speed, 1e-9)
    return u * factor, v * factor


def _floor(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    return _limited(u, v, lambda speed: np.maximum(speed, number(value["limit_kt"]) * KNOT))


def _ceiling(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    return _limited(u, v, lambda speed: np.minimum(speed, number(value["limit_kt"]) * KNOT))


def _hole(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    """Send the nearer edge of an interval of speeds that is never sent."""
    low, high = (number(edge) * KNOT for edge in listed(value["between_kt"]))

    def edges(speed: Array) -> Array:
        nearer = np.where(speed - low < high - speed, low, high)
        return np.where((speed > low) & (speed < high), nearer, speed)

    return _limited(u, v, edges)


def _lattice(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    """Send weak winds in a few directions only."""
    speed, direction = np.hypot(u, v), np.arctan2(u, v)
    step = np.radians(number(value["direction_step_deg"]))
    rounded = np.where(
        speed < number(value["limit_kt"]) * KNOT, np.round(direction / step) * step, direction
    )
    return speed * np.sin(rounded), speed * np.cos(rounded)


def _jitter(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    noise = rng.normal(0.0, number(value["size_m_s"]) / np.sqrt(2.0), (2, u.size))
    return u + noise[0], v + noise[1]


def _gross(u: Array, v: Array, here: Mask, value: Value, rng: np.random.Generator) -> Winds:
    """Send a wind of any direction in place of one report in so many."""
    hit = rng.uniform(size=u.size) < number(value["fraction"])
    turn = rng.uniform(0.0, 2 * np.pi, u.size)
    speed = np.hypot(u, v) + 10.0
    return np.where(hit, speed * np.sin(turn), u), np.where(hit, speed * np.cos(turn), v)


# Effects of scatter: what becomes of a wind where they act.
SCATTER: dict[str, Callable[[Array, Array, Mask, Value, np.random.Generator], Winds]] = {
    "floor": _floor,
    "ceiling": _ceiling,
    "hole": _hole,
    "lattice": _lattice,
    "jitter": _jitter,
    "gross": _gross,
}


def scatter_change(
    parameters: Value,
    u: Array,
    v: Array,
    variables: Mapping[str, Array],
    chosen: Mask,
    rng: np.random.Generator,
) -> Array:
    """Return what an effect of scatter adds to the wind a unit computed.

    Parameters
    ----------
    parameters : mapping
        ``kind`` (of `SCATTER`), its values, and ``parts`` where it acts on some reports only.
    u, v : ndarray (n,)
        Wind as computed, m/s.
    variables : mapping
        Name to values (n,).
    chosen : ndarray of bool (n,)
        Its aircraft and period.
    rng : numpy.random.Generator
        Of effects that draw.

    Returns
    -------
    ndarray (n, 2)
        m/s.
    """
    here = where_it_acts(parameters, variables, chosen)
    new = SCATTER[str(parameters["kind"])](u, v, here, parameters, rng)
    return np.where(here[:, None], np.stack([new[0] - u, new[1] - v], axis=-1), 0.0)
