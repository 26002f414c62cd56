"""Constant heading error of one aircraft."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import HeadingEffect, Parameter, ProportionalEffect
from airswing.synthetic.sealed.draws import Draw, Signed


class CompassOffset(ProportionalEffect, HeadingEffect):
    """Constant error of the indicated heading: coefficient A of Archibald Smith."""

    name = "compass_offset"
    title = "constant heading error"
    deviates = True
    draw = Draw(Signed("offset_deg"), ("offset_deg",), on_real_data=True)
    physics = (
        "The flux valve is not aligned with the aircraft's axis, so every heading is wrong by the "
        "same angle. A constant sideslip of the air over the aircraft looks exactly the same."
    )
    source = "Coefficient A, NGA Handbook of Magnetic Compass Adjustment; de Haan 2013 (Mode-S)."
    parameters = (
        Parameter("offset_deg", "degree", 1.5, "indicated minus true heading", required=True),
    )
    needs = ("heading",)
    confused_with = (
        "constant sideslip: an exact alias",
        "declination_error: where the declination varies little over the region",
        "compass_drift, compass_step: where the record is short",
    )

    def basis(self, frame: Frame) -> Floats:
        return np.ones((1, frame.size))


EFFECT = CompassOffset()
