"""One cycle in magnetic heading, growing as the horizontal field weakens."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Errors, FloatArray, Parameter, Stated, number
from airswing.gap.effects.forms import HeadingEffect, amplitude_phase, cycles, sine_cosine
from airswing.synthetic.sealed.draws import Cycle, Draw


class HardIron(HeadingEffect):
    """A permanent field of the airframe: error amplitude sin(m + phase) times H_ref / H.

    The amplitude is stated at ``at_horizontal_field_nT``: the median H of the archive unless the
    parameters say otherwise.
    """

    name = "hard_iron"
    title = "heading error of one cycle"
    deviates = True
    draw = Draw(
        Cycle(),
        ("amplitude_deg",),
        on_real_data=True,
        compared=("amplitude_deg", "phase_deg"),
        read_from=(("across", "heading"),),
    )
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
        Parameter(
            "at_horizontal_field_nT",
            "nT",
            0.0,
            "H the amplitude is stated at; the archive's median H where not given",
            default=None,
        ),
    )
    needs = ("magnetic_heading",)
    confused_with = (
        "reference wind bias: across the heading alone it is the same",
        "vertical soft iron: one cycle growing with tan(dip), alike within one region",
        "soft_iron: where headings lie in two lobes",
    )
    column_names = ("sin", "cos")

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; rad."""
        return np.radians([2.5, 2.5])

    def basis(self, frame: Frame) -> FloatArray:
        """Return sine and cosine of the magnetic heading times H_ref / H, (2, n)."""
        growth = frame.reference_field / frame.horizontal_field
        growth = np.where(np.isfinite(growth), growth, 1.0)
        return np.asarray(cycles(frame.magnetic_heading) * growth)

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`."""
        (amplitude, phase), (error, phase_error) = amplitude_phase(coefficients, covariance)
        return (
            {
                "amplitude_deg": amplitude,
                "phase_deg": phase,
                "at_horizontal_field_nT": frame.reference_field,
            },
            {"amplitude_deg": error, "phase_deg": phase_error},
        )

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`; restated at the archive's H."""
        full = self.complete(values)
        stated = full["at_horizontal_field_nT"]
        growth = 1.0 if stated is None else number(stated) / frame.reference_field
        return growth * sine_cosine(number(full["amplitude_deg"]), number(full["phase_deg"]))


EFFECT = HardIron()
