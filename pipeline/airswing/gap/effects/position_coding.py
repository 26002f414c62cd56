"""Positions coded more coarsely than documented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import in_steps
from airswing.gap.effects.base import MomentEffect, Parameter, Parameters, Random, State, number
from airswing.synthetic.sealed.draws import Draw


class PositionCoding(MomentEffect):
    """Latitude and longitude rounded to `step` minutes of arc; the wind is unchanged.

    The unit computes the wind from its internal navigation; coarse positions affect the ground
    vectors that users derive from the reports.
    """

    name = "position_coding"
    title = "positions coded more coarsely than stated"
    draw = Draw(ladder=({"step": 0.5}, {"step": 1.0}, {"step": 2.0}, {"step": 5.0}))
    physics = (
        "A message format on the way keeps fewer digits of the position: ground speed and track "
        "made from consecutive positions scatter, and with them heading and airspeed."
    )
    source = "WMO No. 958, AMDAR Reference Manual, appendix on coding."
    parameters = (Parameter("step", "arcmin", 1.0, "step of either coordinate", required=True),)
    confused_with = ("noise of the ground velocity from irregular report times",)

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        step = number(values["step"]) / 60.0
        latitude = np.clip(in_steps(state.latitude, step), -90.0, 90.0)
        return replace(state, latitude=latitude, longitude=in_steps(state.longitude, step))


EFFECT = PositionCoding()
