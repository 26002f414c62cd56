"""What every report records, as variables a regression or a table may depend on.

Assumptions: a variable is linear (cells between quantiles), circular (equal sectors) or a category.
Headings and airspeeds are those a design column may stand on, so that they hold none of the
residual's own noise; so are drift and ground speed (that of this airspeed in the reference wind:
the one flown holds the true wind, hence the reference's error). The reported wind's direction and
speed do hold it: what depends on them is judged against simulated reports, which have that
dependence as well.

Validity: a variable that is unknown in half the reports, or does not vary, is left out; a report
that does not know it is in no cell.

Units: degrees, m/s, K, hPa, minutes, hours, days.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.gap.archive.flight_time import flight_time
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.recent_turns import last_turn, turn
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.units import DAY, FOOT, ZERO_CELSIUS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Variables with their kind, and the number of cells of a curve.
KINDS: dict[str, tuple[str, int]] = {
    "magnetic_heading": ("circular", 12),
    "track": ("circular", 12),
    "wind_direction": ("circular", 12),
    "hour": ("circular", 8),
    "wind_speed": ("linear", 8),
    "airspeed": ("linear", 8),
    "ground_speed": ("linear", 8),
    "drift": ("linear", 8),
    "latitude": ("linear", 8),
    "longitude": ("linear", 8),
    "altitude": ("linear", 8),
    "temperature": ("linear", 8),
    "bank": ("linear", 6),
    "acceleration": ("linear", 6),
    "turn": ("linear", 12),
    "last_turn": ("linear", 6),
    "flight_time": ("linear", 8),
    "date": ("linear", 6),
    "icing": ("category", 2),
    "phase": ("category", 3),
}
#: Full turn of the circular variables.
PERIOD = {"hour": 24.0}
#: Variables that hold the noise of the report itself.
OF_THE_REPORT = ("wind_direction", "wind_speed")
#: Units in which curves are stated.
UNITS = {
    "magnetic_heading": "degree",
    "track": "degree",
    "wind_direction": "degree",
    "hour": "hour",
    "wind_speed": "m/s",
    "airspeed": "m/s",
    "ground_speed": "m/s",
    "drift": "degree",
    "latitude": "degree",
    "longitude": "degree",
    "altitude": "ft",
    "temperature": "degC",
    "bank": "degree",
    "acceleration": "m/s2",
    "turn": "degree",
    "last_turn": "degree",
    "flight_time": "minute",
    "date": "day",
    "icing": "",
    "phase": "",
}
#: Part of the cells asked for that is worth having, and how many times fewer reports than a cell of
#: equal shares holds do where most are alike.
WORTH_CELLS, FEWER = 0.75, np.array([1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08])
CATEGORIES = {"icing": ("off", "on"), "phase": ("ascent", "cruise", "descent")}


@dataclass(frozen=True)
class Variable:
    """One variable of every report."""

    # kind: ``linear``, ``circular`` or ``category``
    name: str
    kind: str
    values: Floats  # (n,): in its unit of :data:`UNITS`; categories by number; NaN where unknown

    @property
    def period(self) -> float:
        """Full turn of a circular variable."""
        return PERIOD.get(self.name, 360.0)

    def edges(self, count: int) -> Floats:
        """Edges of about this many cells, from the first to the last, (m + 1,)."""
        if self.kind == "category":
            return np.asarray(np.arange(len(CATEGORIES[self.name]) + 1) - 0.5, np.float64)
        if self.kind == "circular":
            return np.asarray(np.linspace(0.0, self.period, count + 1))
        known = self.values[np.isfinite(self.values)]
        inner = np.unique(np.quantile(known, np.arange(1, count) / count))
        spread = float(np.ptp(known))
        low, high = float(known.min()), float(known.max())
        # a variable that mostly has one value puts several quantiles on it: they are one edge
        inner = inner[(inner > low + 0.005 * spread) & (inner < high)]
        if inner.size > 1:
            inner = inner[np.r_[True, np.diff(inner) > 0.005 * spread]]
        # where nearly all are alike (turns, banks) that leaves next to none: the rest is divided
        if inner.size + 1 < WORTH_CELLS * count and spread > 0.0:
            inner = _edges_of_few(np.sort(known), count, 0.005 * spread)
        return np.asarray(np.r_[low, inner, high], np.float64)

    def cells(self, edges: Floats) -> Integers:
        """Cell of every report, (n,); -1 where the value is unknown."""
        return cells_of(self.values, edges)


def _edges_of_few(ordered: Floats, count: int, width: float) -> Floats:
    """Inner edges of cells that hold fewer reports each, until there are about so many.

    Parameters
    ----------
    ordered : (n,) float
        Values in ascending order.
    count : int
        Cells wanted.
    width : float
        Least width of a cell.
    """
    inner = np.zeros(0)
    for share in FEWER / count:
        inner = _swept(ordered, share * ordered.size, width)
        if inner.size + 1 >= WORTH_CELLS * count:
            break
    return inner


def _swept(ordered: Floats, least: float, width: float) -> Floats:
    """Inner edges of cells of this width and number of reports at least, from the lowest up."""
    inner: list[float] = []
    edge, first = float(ordered[0]), 0
    while (place := first + int(np.ceil(least))) < ordered.size:
        place = max(place, int(np.searchsorted(ordered, edge + width)))
        if place >= ordered.size:
            break
        # a value goes whole into the cell that it begins
        first = int(np.searchsorted(ordered, ordered[place]))
        if ordered[first] <= edge:
            first = int(np.searchsorted(ordered, edge, "right"))
        if ordered.size - first < least or ordered[first] >= ordered[-1]:
            break
        edge = float(ordered[first])
        inner.append(edge)
    return np.array(inner)


def cells_of(values: Floats, edges: Floats) -> Integers:
    """Cell of every value between edges, (n,); the outer cells are open; -1 where NaN."""
    cell = np.searchsorted(edges[1:-1], values, "right")
    return np.where(np.isfinite(values), cell, -1).astype(np.int64)


def values_of(frame: Frame, quiet: Frame, name: str) -> Floats:
    """Values of a variable; shape (n,).

    Parameters
    ----------
    frame : Frame
        Reports as they are (or simulated).
    quiet : Frame
        The same with heading and airspeed free of the residual's noise.
    """
    if name == "wind_direction":
        return np.asarray(np.mod(np.degrees(np.arctan2(-frame.u_rep, -frame.v_rep)), 360.0))
    if name == "wind_speed":
        return np.asarray(np.hypot(frame.u_rep, frame.v_rep))
    if name == "altitude":
        return np.asarray(altitude_from_pressure(frame.pressure)) / FOOT
    if name == "ground_speed":
        east = quiet.airspeed * np.sin(quiet.heading) + quiet.u_ref
        north = quiet.airspeed * np.cos(quiet.heading) + quiet.v_ref
        return np.asarray(np.hypot(east, north))
    if name == "drift":
        track = np.arctan2(frame.ground_u, frame.ground_v)
        return np.asarray(np.degrees(np.angle(np.exp(1j * (track - quiet.heading)))))
    simple: dict[str, Callable[[], ArrayLike]] = {
        "magnetic_heading": lambda: np.mod(np.degrees(quiet.magnetic_heading), 360.0),
        "track": lambda: np.mod(np.degrees(np.arctan2(frame.ground_u, frame.ground_v)), 360.0),
        "hour": lambda: np.mod(frame.time / 3600.0, 24.0),
        "airspeed": lambda: quiet.airspeed,
        "latitude": lambda: frame.latitude,
        "longitude": lambda: frame.longitude,
        "temperature": lambda: frame.temperature - ZERO_CELSIUS,
        "bank": lambda: np.degrees(frame.bank),
        "acceleration": lambda: frame.acceleration,
        "turn": lambda: turn(frame),
        "last_turn": lambda: last_turn(frame),
        "flight_time": lambda: flight_time(frame),
        "date": lambda: (frame.time - frame.epoch) / DAY,
        "icing": lambda: np.where(frame.icing < 0, np.nan, frame.icing > 0),
        "phase": lambda: np.where(frame.phase > 0, frame.phase - 1.0, np.nan),
    }
    return np.asarray(simple[name](), np.float64)


def record(frame: Frame, quiet: Frame) -> dict[str, Variable]:
    """Variables that are known and vary.

    Parameters
    ----------
    frame, quiet : Frame
        See :func:`values_of`.

    Returns
    -------
    dict
        Name -> variable.
    """
    out = {}
    for name in KINDS:
        values = values_of(frame, quiet, name)
        known = values[np.isfinite(values)]
        if known.size < 0.5 * values.size or known.size == 0:
            continue
        variable = Variable(name, KINDS[name][0], values)
        edges = variable.edges(KINDS[name][1])
        counts = np.bincount(variable.cells(edges) + 1, minlength=edges.size)[1:]
        # two cells at least must hold reports enough for a mean of their own
        if (counts >= 30).sum() >= 2:
            out[name] = variable
    return out
