"""An unexplained error as a table over one or two variables of the report.

The wind changes in one direction by an amount that is constant in each cell, so that edges stay
sharp. A report with an unknown variable is not changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import KINDS, cells_of, values_of
from airswing.gap.arrays import Floats
from airswing.gap.design import unit_vectors
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State
from airswing.physics.triangle import wind_from_triangle

Wind = tuple[Floats, Floats]

#: Components of an error and their units.
UNIT_OF = {
    "across_heading": "m/s",
    "along_heading": "m/s",
    "across_wind": "m/s",
    "along_wind": "m/s",
    "reported_speed": "m/s",
    "scatter": "m/s",
    "heading_angle": "degree",
    "airspeed_factor": "percent",
    "wind_angle": "degree",
    "wind_factor": "percent",
}
#: Components whose effect on a report cannot be removed.
IRREVERSIBLE = ("scatter", "reported_speed")


@dataclass(frozen=True)
class Table:
    """Values in the cells of one or two variables."""

    component: str
    variables: tuple[str, ...]
    edges: tuple[Floats, ...]  # of the cells of each variable
    values: Floats  # one for each cell, in C order

    @property
    def cells(self) -> int:
        """Number of cells."""
        return int(np.prod([cut.size - 1 for cut in self.edges]))

    @classmethod
    def from_parameters(cls, values: Mapping[str, object]) -> Table:
        """Read the parameters of ``empirical``; InputError where one is wrong."""
        names, edges = values["variables"], values["edges"]
        if isinstance(names, str) or not isinstance(names, Sequence) or not 1 <= len(names) <= 2:
            raise InputError("a table has one or two variables", field="variables", found=names)
        cuts = []
        for name, cut in zip(names, edges if isinstance(edges, Iterable) else (), strict=False):
            if name not in KINDS:
                raise InputError(
                    "unknown variable of a table",
                    field="variables",
                    found=name,
                    remedy=f"one of {', '.join(KINDS)}",
                )
            try:
                array = np.asarray(cut, np.float64)
            except (TypeError, ValueError) as err:
                raise InputError("edges must be numbers", field="edges", found=cut) from err
            if array.ndim != 1 or array.size < 2 or (np.diff(array) <= 0).any():
                raise InputError("edges must increase", field="edges", found=cut)
            cuts.append(array)
        if len(cuts) != len(names):
            raise InputError("every variable needs its edges", field="edges", found=len(cuts))
        table = np.asarray(values["values"], np.float64)
        return cls(str(values["component"]), tuple(map(str, names)), tuple(cuts), table)

    def at(self, frame: Frame, wind: Wind, heading: Floats) -> Floats:
        """Evaluate the table at every report, (n,); 0 where a variable is unknown.

        Variables depend on the reported ``wind`` (u, v) and the indicated ``heading`` (rad).
        """
        magnetic = frame.magnetic_heading + heading - frame.heading
        u, v = wind
        changed = replace(frame, u_rep=u, v_rep=v, heading=heading, magnetic_heading=magnetic)
        index = np.zeros(frame.size, np.int64)
        for name, cut in zip(self.variables, self.edges, strict=True):
            cell = cells_of(values_of(changed, changed, name), cut)
            index = np.where((index < 0) | (cell < 0), -1, index * (cut.size - 1) + cell)
        return np.where(index >= 0, self.values[np.maximum(index, 0)], 0.0)


class Empirical(MomentEffect):
    """Error of one component by a table over one or two variables of the report.

    A table over the reported wind depends on the wind as sent, which is found by iteration. The
    component ``reported_speed`` is a map instead: ``edges`` are speeds and ``values`` the speeds
    sent in their place, linear between them and shifted beyond the last. The component ``scatter``
    changes no mean: its values are standard deviations of an error drawn for every report. A table
    is valid within the range of its variables and for the aircraft it was fitted to.
    """

    name = "empirical"
    parameters = (
        Parameter("component", "", 0.0, "component in error", None, required=True),
        Parameter("variables", "", 0.0, "one or two names", None, required=True),
        Parameter("edges", "", 0.0, "cells of each variable", None, required=True),
        Parameter("values", "", 0.0, "one per cell", None, required=True),
    )

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        table = Table.from_parameters(values)
        before = u, v = state.report_u, state.report_v
        if table.component == "reported_speed":
            sent = speed_ratio(np.hypot(u, v), table.edges[0], table.values)
            return replace(state, report_u=sent * u, report_v=sent * v)
        heading = _heading(frame, before)
        if table.component == "scatter":
            drawn = table.at(frame, before, heading) * rng.standard_normal((2, frame.size))
            return replace(state, report_u=u + drawn[0], report_v=v + drawn[1])
        implicit = {"wind_direction", "wind_speed"} & set(table.variables)
        for _ in range(8 if implicit else 1):
            u, v = _changed(table.component, table.at(frame, (u, v), heading), frame, before)
        return replace(state, report_u=u, report_v=v)

    def undo(self, state: State, frame: Frame, values: Parameters) -> State:
        """Remove the table from the wind as sent.

        Exact except very near an edge of a variable that the table itself changes; unchanged for
        the components of `IRREVERSIBLE`.
        """
        table = Table.from_parameters(values)
        if table.component in IRREVERSIBLE:
            return state
        sent = u, v = state.report_u, state.report_v
        for _ in range(12):  # a change of 20 % converges to 1e-6
            value = table.at(frame, sent, _heading(frame, (u, v)))
            again = _changed(table.component, value, frame, (u, v))
            u, v = u + sent[0] - again[0], v + sent[1] - again[1]
        return replace(state, report_u=u, report_v=v)

    def complete(self, values: Mapping[str, object]) -> Parameters:
        out = super().complete(values)
        if out["component"] not in UNIT_OF:
            raise InputError(
                "empirical has no such component",
                field="component",
                found=out["component"],
                remedy=f"one of {', '.join(UNIT_OF)}",
            )
        table = Table.from_parameters(out)
        mapped = table.component == "reported_speed"
        if mapped and table.variables != ("wind_speed",):
            raise InputError(
                "a map of speeds has one variable, wind_speed",
                field="variables",
                found=list(table.variables),
            )
        if table.values.shape != (table.cells + mapped,) or not np.isfinite(table.values).all():
            raise InputError(
                f"a table needs one number per {'speed' if mapped else 'cell'}",
                field="values",
                found=f"{table.values.size} values for {table.cells + mapped}",
            )
        return out


def change_of(component: str, *, heading: Floats, airspeed: Floats, u: Floats, v: Floats) -> Floats:
    """Change (n, 2) of the wind (u, v) by one unit of a component (of `UNIT_OF`), m s-1."""
    across, along = unit_vectors(heading)
    wind, right = np.stack([u, v], -1), np.stack([v, -u], -1)
    match component:
        case "across_heading":
            return across
        case "along_heading":
            return along
        case "heading_angle":
            return np.asarray(-np.radians(airspeed)[:, None] * across)
        case "airspeed_factor":
            return np.asarray(-airspeed[:, None] / 100.0 * along)
        case "wind_angle":
            return np.asarray(np.radians(right))
        case "wind_factor":
            return np.asarray(wind / 100.0)
    vector = right if component == "across_wind" else wind
    speed = np.hypot(u, v)[:, None]  # calm has no direction
    return np.divide(vector, speed, out=np.zeros_like(wind), where=speed > 0.1)


def speed_ratio(speed: Floats, speeds: Floats, sent: Floats) -> Floats:
    """Ratio of sent speeds to speeds, by points (m,): linear between, shifted beyond the last."""
    mapped = np.interp(speed, speeds, sent) + np.maximum(speed - speeds[-1], 0.0)
    return np.asarray(np.maximum(mapped, 0.0) / np.maximum(speed, 1e-6))


def _heading(frame: Frame, wind: Wind) -> Floats:
    return np.arctan2(frame.ground_u - wind[0], frame.ground_v - wind[1])


def _changed(component: str, value: Floats, frame: Frame, wind: Wind) -> Wind:
    """Wind changed by values of a table: heading and airspeed exactly, winds by addition."""
    u, v = wind
    heading = _heading(frame, wind)
    airspeed = np.hypot(frame.ground_u - u, frame.ground_v - v)
    if component in ("across_heading", "heading_angle"):
        angle = np.radians(value)
        if component == "across_heading":
            angle = -value / np.maximum(airspeed, 1.0)
        return wind_from_triangle(frame.ground_u, frame.ground_v, airspeed, heading + angle)
    change = value[:, None] * change_of(component, heading=heading, airspeed=airspeed, u=u, v=v)
    return u + change[:, 0], v + change[:, 1]


#: Not in the catalogue: a simulation accepts it, but no diagnosis searches for it by name.
EMPIRICAL = Empirical()
