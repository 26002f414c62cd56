"""Two cycles in magnetic heading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Errors, FloatArray, Parameter, Stated, number
from airswing.gap.effects.forms import (
    DEGREE,
    HeadingEffect,
    amplitude_phase,
    cycles,
    sine_cosine,
)
from airswing.synthetic.sealed.draws import Cycle, Draw


class SoftIron(HeadingEffect):
    """Iron magnetised by the earth's field itself: amplitude sin(2 m + phase)."""

    name = "soft_iron"
    title = "heading error of two cycles"
    deviates = True
    draw = Draw(
        Cycle(), ("amplitude_deg",), on_real_data=True, compared=("amplitude_deg", "phase_deg")
    )
    distinguished_by: ClassVar[Mapping[str, str]] = {
        "hard_iron": "headings in more compass points",
    }
    physics = (
        "Soft iron lying in the horizontal is magnetised by the earth's horizontal field and turns "
        "with the aircraft: two cycles in magnetic heading, whatever the strength of the field."
    )
    source = "Coefficients D and E, NGA Handbook of Magnetic Compass Adjustment."
    parameters = (
        Parameter("amplitude_deg", "degree", 2.0, "of two cycles", required=True, si=DEGREE),
        Parameter("phase_deg", "degree", 180.0, "of amplitude sin(2 magnetic heading + phase)"),
    )
    needs = ("magnetic_heading",)
    confused_with = (
        "hard_iron: where headings lie in two lobes",
        "compass_offset: where headings lie in two opposite lobes",
    )
    column_names = ("sin2", "cos2")

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; rad."""
        return np.radians([1.5, 1.5])

    def basis(self, frame: Frame) -> FloatArray:
        """Return sine and cosine of twice the magnetic heading, (2, n)."""
        return cycles(frame.magnetic_heading, 2)

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`."""
        (amplitude, phase), (error, phase_error) = amplitude_phase(coefficients, covariance)
        return (
            {"amplitude_deg": amplitude, "phase_deg": phase},
            {"amplitude_deg": error, "phase_deg": phase_error},
        )

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        return sine_cosine(number(full["amplitude_deg"]), number(full["phase_deg"]))


EFFECT = SoftIron()
