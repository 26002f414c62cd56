"""Two cycles in magnetic heading."""

from __future__ import annotations

import numpy as np

from airswing.gap.effects.base import CycleEffect, Parameter
from airswing.synthetic.sealed.draws import Draw, cycle


class SoftIron(CycleEffect):
    """Iron magnetised by the earth's field: error amplitude sin(2 m + phase)."""

    name = "soft_iron"
    title = "heading error of two cycles"
    deviates = True
    draw = Draw(cycle, ("amplitude_deg",), on_real_data=True)
    distinguished_by = {"hard_iron": "headings in more compass points"}
    physics = (
        "Soft iron lying in the horizontal is magnetised by the earth's horizontal field and turns "
        "with the aircraft: two cycles in magnetic heading, independent of the field strength."
    )
    source = "Coefficients D and E, NGA Handbook of Magnetic Compass Adjustment."
    parameters = (
        Parameter("amplitude_deg", "degree", 2.0, "of two cycles", required=True),
        Parameter("phase_deg", "degree", 180.0, "of amplitude sin(2 magnetic heading + phase)"),
    )
    needs = ("magnetic_heading",)
    confused_with = (
        "hard_iron: where headings lie in two lobes",
        "compass_offset: where headings lie in two opposite lobes",
    )
    number_of_cycles = 2
    column_scales = np.radians([1.5, 1.5])


EFFECT = SoftIron()
