"""Grid-relative model winds used as earth-relative ones, or the reverse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import (
    Parameter,
    Parameters,
    ProportionalEffect,
    Random,
    State,
    number,
)
from airswing.synthetic.sealed.draws import Draw, Signed


class ReferenceGridRelative(ProportionalEffect):
    """Missing rotation of the reference wind by `fraction` times the convergence angle of the grid.

    1: grid-relative winds were used without rotation; -1: earth-relative winds were rotated.
    """

    name = "reference_grid_relative"
    title = "model winds left along the grid"
    draw = Draw(Signed("fraction"), ("fraction",), limit=1.0, scope="fleet")
    physics = (
        "Winds on Lambert and similar grids are stored along the grid's axes. Where their flag is "
        "wrong they are off by the angle between grid north and true north, which grows away from "
        "the grid's central meridian: the wind vector turns, its speed stays."
    )
    source = "NCEP GRIB documentation, resolution and component flags (uvRelativeToGrid)."
    parameters = (
        Parameter("fraction", "1", 1.0, "1: rotation missing; -1: one too many", required=True),
    )
    scope = "reference"
    stage = "atmosphere"
    needs = ("grid_convergence",)
    confused_with = (
        "hard_iron: where the wind is steady: turned, it is off by one cycle in the heading",
        "declination_error: both turn with longitude, one the wind, the other the heading",
    )

    def columns(self, frame: Frame) -> Floats:
        # the wind's right-hand normal times the convergence angle
        turned = np.stack([frame.v_ref, -frame.u_ref], axis=-1)
        return np.nan_to_num(frame.grid_convergence[:, None] * turned)[None]

    def apply(self, state: State, frame: Frame, values: Parameters, rng: Random) -> State:
        angle = number(values["fraction"]) * np.nan_to_num(frame.grid_convergence)
        cosine, sine = np.cos(angle), np.sin(angle)
        return replace(
            state,
            wind_u=cosine * state.wind_u + sine * state.wind_v,
            wind_v=cosine * state.wind_v - sine * state.wind_u,
        )


EFFECT = ReferenceGridRelative()
