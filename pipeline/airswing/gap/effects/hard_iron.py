"""One cycle in magnetic heading, inversely proportional to the horizontal field."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import CycleEffect, Estimate, Parameter, number
from airswing.synthetic.sealed.draws import Draw, cycle


class HardIron(CycleEffect):
    """Permanent field of the airframe: error amplitude sin(m + phase) times H_ref / H.

    The amplitude refers to ``at_horizontal_field_nT``, by default the median H of the archive.
    """

    name = "hard_iron"
    title = "heading error of one cycle"
    deviates = True
    draw = Draw(cycle, ("amplitude_deg",), on_real_data=True)
    physics = (
        "Magnetised parts and direct currents add a field fixed in the aircraft; against the "
        "earth's horizontal field H it turns the flux valve by an angle of one cycle in magnetic "
        "heading that grows as 1/H."
    )
    source = (
        "Coefficients B and C, NGA Handbook of Magnetic Compass Adjustment; Jacobs et al. 2010."
    )
    parameters = (
        Parameter("amplitude_deg", "degree", 4.0, "amplitude at the stated H", required=True),
        Parameter("phase_deg", "degree", 180.0, "error = amplitude sin(magnetic heading + phase)"),
        Parameter("at_horizontal_field_nT", "nT", 0.0, "its H; null: the median", None),
    )
    needs = ("magnetic_heading",)
    confused_with = (
        "reference wind bias: identical across the heading",
        "vertical soft iron: one cycle proportional to tan(dip), equal within one region",
        "soft_iron: where headings lie in two lobes",
    )
    column_scales = np.radians([2.5, 2.5])

    def basis(self, frame: Frame) -> Floats:
        growth = frame.reference_field / frame.horizontal_field
        growth = np.where(np.isfinite(growth), growth, 1.0)
        return np.asarray(super().basis(frame) * growth)

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        values, errors = super().to_parameters(coefficients, covariance, frame)
        return values | {"at_horizontal_field_nT": frame.reference_field}, errors

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        # converted to the median H of the archive
        field = self.complete(values)["at_horizontal_field_nT"]
        growth = 1.0 if field is None else number(field) / frame.reference_field
        return growth * super().from_parameters(values, frame)


EFFECT = HardIron()
