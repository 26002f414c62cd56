"""What an archive shows and no other effect explains: a table over one or two variables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import KINDS
from airswing.gap.archive.value_tables import UNIT_OF, Axis, Grid, change_of, table_values
from airswing.gap.effects.base import Parameter, Parameters, State
from airswing.gap.effects.forms import MomentEffect

#: Rounds in which a table by the reported wind meets the wind it makes.
ROUNDS = 8
#: Rounds in which the wind before a table is found: a change of 20 % settles to a millionth.
ROUNDS_BACK = 12
#: Components of which a report does not tell what it was before.
IRREVERSIBLE = ("scatter", "reported_speed")


class Empirical(MomentEffect):
    """An error of one component by a table over one or two variables of the report.

    A table by the reported wind is one by the wind as sent: what is sent is found in a few rounds.
    The component ``reported_speed`` is a map instead: ``edges`` are speeds, ``values`` what is sent
    in their place, linear between them and moved along beyond. The component ``scatter`` moves no
    mean: its values are standard deviations of an error drawn anew for every report.
    """

    name = "empirical"
    physics = (
        "None: a table fitted to the archive, so that a simulation can hold what nobody has "
        "explained yet. It holds inside the range of its variables and on these aircraft alone."
    )
    source = "The diagnosis of the archive itself, on weeks left out."
    parameters = (
        Parameter("component", "", 0.0, "what is in error", None, required=True, number=False),
        Parameter("variables", "", 0.0, "one or two names", None, required=True, number=False),
        Parameter("edges", "", 0.0, "cells of each variable", None, required=True, number=False),
        Parameter("values", "", 0.0, "one per cell", None, required=True, number=False),
    )
    confused_with = ("whatever depends on the same variables",)

    def apply(
        self, state: State, frame: Frame, values: Parameters, rng: np.random.Generator
    ) -> State:
        """See `Effect.apply`: heading and airspeed exactly, winds by addition."""
        component = str(values["component"])
        if component == "reported_speed":
            return _resent(state, values)
        grid, table = grid_of(values), np.asarray(values["values"], np.float64)
        before = u, v = state.report_u, state.report_v
        if component == "scatter":
            value = table_values(grid, table, frame, u=u, v=v, heading=_heading(frame, before))
            drawn = value * rng.standard_normal((2, frame.size))
            return replace(state, report_u=u + drawn[0], report_v=v + drawn[1])
        for _ in range(ROUNDS if {"wind_direction", "wind_speed"} & set(grid.variables) else 1):
            value = table_values(grid, table, frame, u=u, v=v, heading=_heading(frame, before))
            u, v = _moved(component, value, frame, before)
        return replace(state, report_u=u, report_v=v)

    def undo(self, state: State, frame: Frame, values: Parameters) -> State:
        """Wind before the table moved it; a table of scatter or a map of speeds leaves it as sent.

        Parameters
        ----------
        state : State
            The wind as sent.
        values : mapping
            Complete parameters.

        Returns
        -------
        State
            Exact but within a hair of an edge of a variable that the table itself moves.
        """
        component = str(values["component"])
        if component in IRREVERSIBLE:
            return state
        grid, table = grid_of(values), np.asarray(values["values"], np.float64)
        sent = u, v = state.report_u, state.report_v
        for _ in range(ROUNDS_BACK):
            heading = _heading(frame, (u, v))
            value = table_values(grid, table, frame, u=sent[0], v=sent[1], heading=heading)
            again = _moved(component, value, frame, (u, v))
            u, v = u + sent[0] - again[0], v + sent[1] - again[1]
        return replace(state, report_u=u, report_v=v)

    def complete(self, values: Mapping[str, object]) -> Parameters:
        """See `Effect.complete`; the table must fit its edges."""
        out = super().complete(values)
        if out["component"] not in UNIT_OF:
            raise InputError(
                "empirical has no such component",
                field="component",
                found=out["component"],
                remedy=f"one of {', '.join(UNIT_OF)}",
            )
        grid = grid_of(out)
        table = np.asarray(out["values"], np.float64)
        mapped = out["component"] == "reported_speed"
        if mapped and grid.variables != ("wind_speed",):
            raise InputError(
                "a map of speeds has one variable, wind_speed",
                field="variables",
                found=list(grid.variables),
            )
        if table.shape != (grid.size + mapped,) or not np.isfinite(table).all():
            raise InputError(
                f"a table needs one number per {'speed' if mapped else 'cell'}",
                field="values",
                found=f"{table.size} values for {grid.size + mapped}",
            )
        return out


Wind = tuple[NDArray[np.float64], NDArray[np.float64]]


def _heading(frame: Frame, wind: Wind) -> NDArray[np.float64]:
    """Heading that a wind implies, rad."""
    return np.arctan2(frame.ground_u - wind[0], frame.ground_v - wind[1])


def _moved(component: str, value: NDArray[np.float64], frame: Frame, wind: Wind) -> Wind:
    """Wind moved by a table's values: heading and airspeed exactly, winds by addition."""
    u, v = wind
    heading = _heading(frame, wind)
    airspeed = np.hypot(frame.ground_u - u, frame.ground_v - v)
    if component in ("across_heading", "heading_angle"):
        turn = np.radians(value)
        if component == "across_heading":
            turn = -value / np.maximum(airspeed, 1.0)
        return (
            frame.ground_u - airspeed * np.sin(heading + turn),
            frame.ground_v - airspeed * np.cos(heading + turn),
        )
    change = value[:, None] * change_of(component, heading=heading, airspeed=airspeed, u=u, v=v)
    return u + change[:, 0], v + change[:, 1]


def _resent(state: State, values: Parameters) -> State:
    """Winds of other speeds and the same directions."""
    speed = np.hypot(state.report_u, state.report_v)
    knots, sent = grid_of(values).axes[0].edges, np.asarray(values["values"], float)
    scale = mapped_speed(speed, knots, sent) / np.maximum(speed, 1e-6)
    return replace(state, report_u=scale * state.report_u, report_v=scale * state.report_v)


def mapped_speed(
    speed: NDArray[np.float64], speeds: NDArray[np.float64], sent: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Speeds sent in the place of others, m/s: linear between a map's points, moved along beyond.

    Parameters
    ----------
    speed : (n,) float
    speeds, sent : (m,) float
        The map; speeds increase.

    Returns
    -------
    (n,) float
    """
    inside = np.interp(speed, speeds, sent)
    return np.asarray(np.maximum(inside + np.maximum(speed - speeds[-1], 0.0), 0.0))


def grid_of(values: Mapping[str, object]) -> Grid:
    """Cells of an empirical table's parameters.

    Parameters
    ----------
    values : mapping
        ``variables``, a list of one or two names, and ``edges``, a list of numbers for each.

    Raises
    ------
    InputError
        A variable is unknown, or edges do not increase.
    """
    names, edges = values["variables"], values["edges"]
    if isinstance(names, str) or not isinstance(names, Sequence) or not 1 <= len(names) <= 2:
        raise InputError("a table has one or two variables", field="variables", found=names)
    axes = []
    for name, cut in zip(names, edges if isinstance(edges, Iterable) else (), strict=False):
        if name not in KINDS:
            raise InputError(
                "unknown variable of a table",
                field="variables",
                found=name,
                remedy=f"one of {', '.join(KINDS)}",
            )
        try:
            own = np.asarray(cut, np.float64)
        except (TypeError, ValueError) as err:
            raise InputError("edges must be numbers", field="edges", found=cut) from err
        if own.ndim != 1 or own.size < 2 or (np.diff(own) <= 0).any():
            raise InputError("edges must increase", field="edges", found=cut)
        axes.append(Axis(str(name), KINDS[str(name)][0], own))
    if len(axes) != len(names):
        raise InputError("every variable needs its edges", field="edges", found=len(axes))
    return Grid(tuple(axes))


#: Not of the catalogue: a simulation takes it, no diagnosis looks for it by name.
EMPIRICAL = Empirical()
