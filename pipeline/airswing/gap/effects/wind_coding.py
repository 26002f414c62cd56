"""Winds coded more coarsely than documented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import in_steps
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State, number
from airswing.physics.triangle import wind_components, wind_from_direction
from airswing.synthetic.sealed.draws import Draw
from airswing.units import KNOT


class WindCoding(MomentEffect):
    """Speed rounded to `step` knots, direction to `direction_step_deg` degrees (0: not rounded)."""

    name = "wind_coding"
    title = "winds coded more coarsely than stated"
    draw = Draw(
        ladder=(
            {"step": 2.0, "direction_step_deg": 2.0},
            {"step": 2.0, "direction_step_deg": 5.0},
            {"step": 5.0, "direction_step_deg": 5.0},
            {"step": 5.0, "direction_step_deg": 10.0},
        )
    )
    physics = (
        "A message format on the way keeps fewer digits (10-degree or 5-knot steps): values lie "
        "on a lattice, and the error across the wind grows with its speed."
    )
    source = "WMO No. 958, AMDAR Reference Manual, appendix on coding; FM 42 AMDAR code form."
    parameters = (
        Parameter("step", "kt", 5.0, "step of the speed", required=True),
        Parameter("direction_step_deg", "degree", 10.0, "step of the direction; 0: not rounded"),
    )
    confused_with = ("noise: where the step is finer than the noise",)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        speed, direction = wind_from_direction(state.report_u, state.report_v)
        step = number(values["step"]) * KNOT
        angle = np.radians(number(values["direction_step_deg"]))
        report_u, report_v = wind_components(in_steps(speed, step), in_steps(direction, angle))
        return replace(state, report_u=report_u, report_v=report_v)


EFFECT = WindCoding()
