"""Heading error while the aircraft speeds up or slows down: climb, level-off, descent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.flags import PHASE
from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Errors, FloatArray, Parameter, Stated, number
from airswing.gap.effects.forms import DEGREE, HeadingEffect, standard_error
from airswing.physics.atmosphere import GRAVITY
from airswing.synthetic.sealed.draws import Draw, Signed, sign

if TYPE_CHECKING:
    import pandas as pd

STEADY = 0.02
"""Acceleration (m s-2) that is noise of the positions in cruise."""
USUAL = 0.03
"""Acceleration in climb (negative in descent), in g, of an error that acts by phase alone."""


def _by_phase(rng: np.random.Generator) -> dict[str, object]:
    """Draw an error by phase: + in climb, - in descent, none in cruise."""
    return {"by_phase": True, "amplitude_deg": 10.0 * sign(rng)}


def _out_of_cruise(frame: pd.DataFrame, values: Mapping[str, object]) -> NDArray[np.bool_]:
    return np.asarray(frame["phase"] != 2)


class AccelerationError(HeadingEffect):
    """amplitude sin(m) tan(dip) a/g, a the longitudinal acceleration or, by phase, a usual one.

    Speeding up in climb and slowing down in descent make it opposite in the two; in cruise only a
    change of speed that stands out of the positions' noise counts (levelling off). A free pendulum
    north of the magnetic equator has an amplitude of -57 degrees; slaving to a gyro leaves a part.
    """

    name = "acceleration_error"
    title = "heading error from acceleration in climb and descent"
    draw = Draw(
        Signed("amplitude_deg", 20.0),
        ("amplitude_deg",),
        form=_by_phase,
        acts=_out_of_cruise,
        compared=("amplitude_deg",),
        places=("acceleration", "phase"),
        read_from=(("across", "phase"),),
    )
    physics = (
        "The flux valve hangs as a pendulum. Under longitudinal acceleration it tilts and takes "
        "in a part of the vertical field: an error as the sine of the magnetic heading times the "
        "tangent of the dip, opposite in climb and descent."
    )
    source = "FAA-H-8083-15B, Instrument Flying Handbook, ch. 5 (ANDS); AGARDograph 160 vol. 1."
    parameters = (
        Parameter(
            "amplitude_deg",
            "degree",
            20.0,
            "at 1 g and a dip of 45 degrees; may be negative",
            required=True,
            si=DEGREE,
        ),
        Parameter(
            "by_phase",
            "1",
            0.0,
            "true: as at 0.03 g in climb, -0.03 g in descent; null: by acceleration",
            None,
            number=False,
        ),
    )
    needs = ("magnetic_heading", "acceleration", "dip")
    confused_with = ("hard_iron: where climb and descent are not sampled alike",)
    column_names = ("amplitude", "by_phase")
    alternatives = ((0,), (1,))
    reliability = 0.76  # of the true acceleration, by the generator

    @property
    def column_scales(self) -> FloatArray:
        """See `Effect.column_scales`; rad."""
        return np.full(2, 20.0 * DEGREE)

    def basis(self, frame: Frame) -> FloatArray:
        """Return sin(m) tan(dip) a/g by acceleration and by phase, (2, n).

        By acceleration it is 0 in cruise but for a visible change of speed.
        """
        steady = (frame.phase == PHASE["cruise"]) & (np.abs(frame.acceleration) < STEADY)
        pull = np.where(steady, 0.0, frame.acceleration) / GRAVITY
        climbs = frame.phase == PHASE["ascent"]
        usual = USUAL * (1.0 * climbs - (frame.phase == PHASE["descent"]))
        return np.asarray(
            np.sin(frame.magnetic_heading) * np.tan(frame.dip) * np.stack([pull, usual])
        )

    def to_parameters(
        self, coefficients: FloatArray, covariance: FloatArray, frame: Frame
    ) -> tuple[Stated, Errors]:
        """See `Effect.to_parameters`; of the form with the larger coefficient."""
        k = int(np.argmax(np.abs(coefficients)))
        values: Stated = {
            "amplitude_deg": float(coefficients[k]) / DEGREE,
            "by_phase": k == 1 or None,
        }
        return values, {"amplitude_deg": standard_error(covariance, k) / DEGREE}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> FloatArray:
        """See `Effect.from_parameters`."""
        full = self.complete(values)
        out = np.zeros(2)
        out[int(bool(full["by_phase"]))] = number(full["amplitude_deg"]) * DEGREE
        return out

    def acts(self, frame: Frame) -> NDArray[np.bool_]:
        """See `Effect.acts`: in climb and descent."""
        return np.asarray(np.isin(frame.phase, (PHASE["ascent"], PHASE["descent"])))

    def testable(self, frame: Frame) -> str | None:
        """See `Effect.testable`; climb or descent must be there."""
        reason = super().testable(frame)
        steep = np.isin(frame.phase, (PHASE["ascent"], PHASE["descent"]))
        if reason is None and not np.any(self.basis(frame)[:, steep]):
            return "no climb or descent in these reports"
        return reason


EFFECT = AccelerationError()
