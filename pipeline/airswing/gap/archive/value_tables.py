"""Tables over one or two variables: cells, what their values do to the wind, and a prior of them.

Assumptions: an effect nobody thought of moves the wind in one direction (across or along the
heading, across or along the wind) by an amount that depends on one or two variables. The amount is
a constant in each cell, so that an edge stays an edge. Before it is seen, values of neighbouring
cells are alike in half of their variance and free in the other half.

Validity: a report that does not know a variable has no value. Values in the component's unit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import CATEGORIES, Variable, cells_of, values_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Directions in which an error may act, m/s.
COMPONENTS = ("across_heading", "along_heading", "across_wind", "along_wind")
#: The same as angle or factor -> unit of its values.
SCALED = {
    "across_heading": ("heading_angle", "degree"),
    "along_heading": ("airspeed_factor", "percent"),
    "across_wind": ("wind_angle", "degree"),
    "along_wind": ("wind_factor", "percent"),
}
UNIT_OF = {name: "m/s" for name in (*COMPONENTS, "reported_speed", "scatter")} | dict(
    SCALED.values()
)
#: Cells over which the likeness of neighbours falls off.
REACH = 1.5
#: Share of the prior variance that neighbours have in common.
ALIKE = 0.5


@dataclass(frozen=True)
class Axis:
    """One variable of a table, cut into cells."""

    variable: str
    kind: str
    edges: Floats  # (m + 1,)

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(self.edges.size - 1)

    @property
    def labels(self) -> tuple[str, ...]:
        """One per cell."""
        if self.kind == "category":
            return CATEGORIES[self.variable]
        return tuple(
            f"{low:.4g} to {high:.4g}"
            for low, high in zip(self.edges[:-1], self.edges[1:], strict=True)
        )

    def likeness(self) -> Floats:
        """Prior correlation of the cells' values, (m, m)."""
        if self.kind == "category":
            return np.eye(self.size)
        apart = np.abs(np.subtract.outer(np.arange(self.size), np.arange(self.size))).astype(float)
        if self.kind == "circular":
            apart = np.minimum(apart, self.size - apart)
        return np.exp(-apart / REACH)


@dataclass(frozen=True)
class Grid:
    """Cells of one or two variables."""

    axes: tuple[Axis, ...]

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod([axis.size for axis in self.axes]))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(axis.variable for axis in self.axes)

    @property
    def labels(self) -> list[str]:
        """One per cell."""
        out = [""]
        for axis in self.axes:
            out = [f"{one}; {other}" if one else other for one in out for other in axis.labels]
        return out

    def cells(self, values: tuple[Floats, ...]) -> Integers:
        """Cell of every report, (n,); -1 where a variable is unknown."""
        out = np.zeros(values[0].size, np.int64)
        for axis, own in zip(self.axes, values, strict=True):
            cell = cells_of(own, axis.edges)
            out = np.where((out < 0) | (cell < 0), -1, out * axis.size + cell)
        return out

    def prior(self) -> Floats:
        """Prior correlation of the cells' values, (size, size)."""
        common: Floats = np.ones((1, 1))
        for axis in self.axes:
            common = np.asarray(np.kron(common, axis.likeness()), np.float64)
        return np.asarray(ALIKE * common + (1 - ALIKE) * np.eye(self.size))


def table_values(
    grid: Grid, table: Floats, frame: Frame, *, u: Floats, v: Floats, heading: Floats
) -> Floats:
    """Value of a table at every report, (n,); 0 where a variable is unknown.

    Parameters
    ----------
    table : (size,) float
    u, v : (n,) float
        Wind that stands for the reported one, m/s.
    heading : (n,) float
        Indicated heading, rad.
    """
    turned = heading - frame.heading
    changed = replace(
        frame, u_rep=u, v_rep=v, heading=heading, magnetic_heading=frame.magnetic_heading + turned
    )
    cells = grid.cells(tuple(values_of(changed, changed, name) for name in grid.variables))
    return np.where(cells >= 0, np.asarray(table)[np.maximum(cells, 0)], 0.0)


def axis_of(variable: Variable, count: int) -> Axis:
    """Axis of a variable with about this many cells."""
    return Axis(variable.name, variable.kind, variable.edges(count))


def change_of(component: str, *, heading: Floats, airspeed: Floats, u: Floats, v: Floats) -> Floats:
    """Change of the wind by one unit of a component, (n, 2), m/s.

    Parameters
    ----------
    heading, airspeed : (n,) float
        rad, m/s.
    u, v : (n,) float
        Wind, m/s.
    """
    sine, cosine = np.sin(heading), np.cos(heading)
    across, along = np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)
    if component == "across_heading":
        return across
    if component == "along_heading":
        return along
    if component == "heading_angle":
        return np.asarray(-np.radians(airspeed)[:, None] * across)
    if component == "airspeed_factor":
        return np.asarray(-airspeed[:, None] / 100.0 * along)
    wind = np.stack([u, v], -1)
    right = np.stack([v, -u], -1)
    if component == "wind_angle":
        return np.asarray(np.radians(right))
    if component == "wind_factor":
        return np.asarray(wind / 100.0)
    speed = np.hypot(u, v)[:, None]
    chosen = right if component == "across_wind" else wind
    # calm has no direction along or across which anything could be added
    return np.divide(chosen, speed, out=np.zeros_like(wind), where=speed > 0.1)
