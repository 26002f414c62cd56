"""Heading error in banked turns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import RELIABILITY
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects.base import HeadingEffect, Parameter, ProportionalEffect
from airswing.synthetic.sealed.draws import Draw, Signed


def _turning(frame: pd.DataFrame, values: Mapping[str, object]) -> Booleans:
    return np.asarray(frame["bank"].abs() > np.radians(2.0))


class TurnError(ProportionalEffect, HeadingEffect):
    """Error amplitude bank tan(dip) cos(m), bank in radians, right wing down positive."""

    name = "turn_error"
    title = "heading error in turns"
    draw = Draw(Signed("amplitude_deg", 10.0), ("amplitude_deg",), acts=_turning)
    physics = (
        "In a coordinated turn the flux valve banks with the aircraft and takes in a part of the "
        "vertical field: an error as bank times the tangent of the dip times the cosine of the "
        "magnetic heading (the northerly turning error)."
    )
    source = "FAA-H-8083-15B, Instrument Flying Handbook, ch. 5 (northerly turning error)."
    parameters = (
        Parameter(
            "amplitude_deg", "degree", 20.0, "at 1 rad and a dip of 45 degrees", required=True
        ),
    )
    needs = ("magnetic_heading", "bank", "dip")
    confused_with = ("noise of the ground velocity: bank is inferred from the turning track",)
    reliability = RELIABILITY["bank"]

    def basis(self, frame: Frame) -> Floats:
        turning = frame.bank * np.tan(frame.dip) * np.cos(frame.magnetic_heading)
        return np.asarray(turning)[None]


EFFECT = TurnError()
