"""Variables of every report on which an error may depend.

A variable is linear (cells between quantiles), circular (equal sectors) or a category. Heading and
airspeed are those of design columns; so are drift angle and ground speed (computed from this
airspeed in the reference wind, since the flown ground speed includes the error of the reference). A
variable that is unknown in half of the reports, or constant, is left out. Units: see :data:`UNITS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.units import DAY, FOOT, ZERO_CELSIUS

#: Variables with kind, number of cells of a curve, unit, and knots of a table: about the resolution
#: that an archive of some weeks supports.
VARIABLES: dict[str, tuple[str, int, str, int]] = {
    "magnetic_heading": ("circular", 12, "degree", 12),
    "track": ("circular", 12, "degree", 12),
    "wind_direction": ("circular", 12, "degree", 18),
    "hour": ("circular", 8, "hour", 8),
    "wind_speed": ("linear", 8, "m/s", 8),
    "airspeed": ("linear", 8, "m/s", 10),
    "ground_speed": ("linear", 8, "m/s", 8),
    "drift": ("linear", 8, "degree", 8),
    "latitude": ("linear", 8, "degree", 7),
    "longitude": ("linear", 8, "degree", 8),
    "altitude": ("linear", 8, "ft", 9),
    "temperature": ("linear", 8, "degC", 8),
    "bank": ("linear", 6, "degree", 5),
    "acceleration": ("linear", 6, "m/s2", 6),
    "turn": ("linear", 12, "degree", 6),
    "last_turn": ("linear", 6, "degree", 4),
    "flight_time": ("linear", 8, "minute", 8),
    "date": ("linear", 6, "day", 9),
    "icing": ("category", 2, "", 1),
    "phase": ("category", 3, "", 1),
}
#: Kind and number of cells, and unit, of each variable.
KINDS = {name: row[:2] for name, row in VARIABLES.items()}
UNITS = {name: row[2] for name, row in VARIABLES.items()}
KNOTS = {name: row[3] for name, row in VARIABLES.items()}
#: Period of the circular variables that are not angles.
PERIOD = {"hour": 24.0}
CATEGORIES = {"icing": ("off", "on"), "phase": ("ascent", "cruise", "descent")}
#: Squared correlation of inferred variables with the true ones in simulated archives.
RELIABILITY = {"acceleration": 0.76, "bank": 0.75}


@dataclass(frozen=True)
class Variable:
    """Values of one variable at every report."""

    name: str
    kind: str  # ``linear``, ``circular`` or ``category``
    values: Floats  # (n,) in the unit of :data:`UNITS`; categories by number; NaN where unknown

    def edges(self, number: int) -> Floats:
        """Divide the range of the values into about ``number`` cells; their edges, (m + 1,)."""
        if self.kind == "category":
            return np.asarray(np.arange(len(CATEGORIES[self.name]) + 1) - 0.5, np.float64)
        if self.kind == "circular":
            return np.asarray(np.linspace(0.0, PERIOD.get(self.name, 360.0), number + 1))
        ordered = np.sort(self.values[np.isfinite(self.values)])
        low, high = float(ordered[0]), float(ordered[-1])
        width = 0.005 * (high - low)
        inner = np.unique(np.quantile(ordered, np.arange(1, number) / number))
        # several quantiles may be at one frequent value: they are one edge
        inner = inner[(inner > low + width) & (inner < high)]
        if inner.size > 1:
            inner = inner[np.r_[True, np.diff(inner) > width]]
        # where most values are equal (turns, banks), cells with fewer reports, in steps of 0.7,
        # divide the others, until there are three quarters of the requested cells
        if high > low:
            for share in (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08):
                if inner.size + 1 >= 0.75 * number:
                    break
                inner = _edges_upward(ordered, share / number * ordered.size, width)
        return np.asarray(np.r_[low, inner, high], np.float64)


def _edges_upward(ordered: Floats, least: float, width: float) -> Floats:
    """Inner edges, from the lowest up, of cells with a least width and number of reports."""
    inner: list[float] = []
    edge, first = float(ordered[0]), 0
    while (place := first + int(np.ceil(least))) < ordered.size:
        place = max(place, int(np.searchsorted(ordered, edge + width)))
        if place >= ordered.size:
            break
        # equal values are in one cell
        first = int(np.searchsorted(ordered, ordered[place]))
        if ordered[first] <= edge:
            first = int(np.searchsorted(ordered, edge, "right"))
        if ordered.size - first < least or ordered[first] >= ordered[-1]:
            break
        edge = float(ordered[first])
        inner.append(edge)
    return np.array(inner)


def cells_of(values: Floats, edges: Floats) -> Integers:
    """Cell of each value between edges (m + 1,), the outer ones open; -1 where unknown."""
    cell = np.searchsorted(edges[1:-1], values, "right")
    return np.where(np.isfinite(values), cell, -1).astype(np.int64)


def values_of(frame: Frame, quiet: Frame, name: str) -> Floats:
    """Compute the values of a variable, (n,) in the unit of `UNITS`; NaN where unknown.

    ``quiet`` are the reports with heading and airspeed free of the noise of the residual.
    """
    if name == "ground_speed":
        east = quiet.airspeed * np.sin(quiet.heading) + quiet.u_ref
        north = quiet.airspeed * np.cos(quiet.heading) + quiet.v_ref
        return np.asarray(np.hypot(east, north))
    track = np.arctan2(frame.ground_u, frame.ground_v)
    simple: dict[str, Callable[[], ArrayLike]] = {
        "wind_direction": lambda: _positive_degrees(np.arctan2(-frame.u_rep, -frame.v_rep)),
        "wind_speed": lambda: np.hypot(frame.u_rep, frame.v_rep),
        "altitude": lambda: altitude_from_pressure(frame.pressure) / FOOT,
        "drift": lambda: np.degrees(np.angle(np.exp(1j * (track - quiet.heading)))),
        "magnetic_heading": lambda: _positive_degrees(quiet.magnetic_heading),
        "track": lambda: _positive_degrees(track),
        "hour": lambda: np.mod(frame.time / 3600.0, 24.0),
        "airspeed": lambda: quiet.airspeed,
        "latitude": lambda: frame.latitude,
        "longitude": lambda: frame.longitude,
        "temperature": lambda: frame.temperature - ZERO_CELSIUS,
        "bank": lambda: np.degrees(frame.bank),
        "acceleration": lambda: frame.acceleration,
        "turn": lambda: recent_turn(frame),
        "last_turn": lambda: last_turn(frame),
        "flight_time": lambda: flight_time(frame),
        "date": lambda: (frame.time - frame.epoch) / DAY,
        "icing": lambda: np.where(frame.icing < 0, np.nan, frame.icing > 0),
        "phase": lambda: np.where(frame.phase > 0, frame.phase - 1.0, np.nan),
    }
    return np.asarray(simple[name](), np.float64)


def _positive_degrees(angle: Floats) -> Floats:
    return np.asarray(np.mod(np.degrees(angle), 360.0))


def record(frame: Frame, quiet: Frame) -> dict[str, Variable]:
    """Compute the variables that are known and vary, by name; arguments of `values_of`."""
    out = {}
    for name, (kind, number) in KINDS.items():
        variable = Variable(name, kind, values_of(frame, quiet, name))
        count = int(np.isfinite(variable.values).sum())
        if count == 0 or count < 0.5 * variable.values.size:
            continue
        cells = cells_of(variable.values, variable.edges(number))
        if (np.bincount(cells[cells >= 0]) >= 30).sum() >= 2:  # thirty reports have a mean
            out[name] = variable
    return out


def reliabilities(frame: Frame, variables: Mapping[str, Variable]) -> dict[str, float]:
    """Squared correlation of variables with the true ones, by name, where it is less than one.

    Airspeed, ground speed and drift are free of the noise of the residual; their squared
    correlation with those of the reports (of the ``frame``) takes the place of that with the truth.
    """
    out = dict(RELIABILITY)
    for name in {"airspeed", "ground_speed", "drift"} & variables.keys():
        pairs = np.stack([variables[name].values, values_of(frame, frame, name)])
        out[name] = float(np.corrcoef(pairs[:, np.isfinite(pairs).all(axis=0)])[0, 1] ** 2)
    return out


def flight_time(frame: Frame) -> Floats:
    """Return the time since the first report of the flight, (n,) minutes; NaN after a day."""
    start = pd.Series(frame.time).groupby(frame.flight).transform("min").to_numpy()
    minutes = (frame.time - start) / 60.0
    return np.asarray(np.where(minutes <= 1440.0, minutes, np.nan))


def recent_turn(frame: Frame) -> Floats:
    """Return the change of track over the last two minutes, (n,) degrees."""
    order, begins, track = _tracks(frame)
    out = np.zeros(order.size)
    if order.size:
        # flights one after the other on one axis of time, for one interpolation
        recent = 120.0
        gap = float(np.ptp(frame.time)) + 2 * recent
        place = frame.time[order] - frame.time.min() + np.cumsum(begins) * gap
        start = place[np.maximum.accumulate(np.where(begins, np.arange(order.size), 0))]
        before = np.interp(np.maximum(place - recent, start), place, track)
        out[order] = track - before
    return out


def last_turn(frame: Frame) -> Floats:
    """Return the last turn between two reports, (n,) degrees; 0 before the first of a flight.

    A turn is a change of track by ten degrees or more.
    """
    order, begins, track = _tracks(frame)
    step = np.where(begins, 0.0, np.diff(track, prepend=track[:1]))
    turns = begins | (np.abs(step) >= 10.0)
    out = np.zeros(order.size)
    out[order] = step[np.maximum.accumulate(np.where(turns, np.arange(order.size), 0))]
    return out


def _tracks(frame: Frame) -> tuple[Integers, Booleans, Floats]:
    """Rows by flight and time, first reports of flights, and unwrapped tracks, degrees.

    The track at a report is that of the parabola through its position and the two next to it (at
    the ends of a flight that of the nearest report within): the velocity over ground near a turn is
    estimated with the reported wind (`airswing.physics.turns`), whose noise is in the residual.
    """
    order = np.lexsort((frame.time, frame.flight))
    begins = np.r_[True, np.diff(frame.flight[order]) != 0][: order.size]
    ends = np.r_[begins[1:], True][: order.size]
    nearest = np.arange(order.size)
    inside = ~begins & ~ends
    nearest[:-1][begins[:-1] & inside[1:]] += 1
    nearest[1:][ends[1:] & inside[:-1]] -= 1
    latitude = np.radians(frame.latitude[order])
    shrink = np.cos(0.5 * (latitude[1:] + latitude[:-1]))
    east = np.diff(np.radians(frame.longitude[order])) * shrink
    seconds = np.maximum(np.diff(frame.time[order]), 1.0)
    velocity = (east + 1j * np.diff(latitude)) / seconds
    at = np.zeros(order.size, complex)
    at[1:-1] = velocity[:-1] * seconds[1:] + velocity[1:] * seconds[:-1]
    track = np.angle(1j * np.conj(at[nearest]))
    return order, begins, np.degrees(np.unwrap(track))
