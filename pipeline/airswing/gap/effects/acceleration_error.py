"""Heading error under longitudinal acceleration: climb, levelling off, descent."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from airswing.flags import PHASE
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import RELIABILITY
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects.base import (
    DEGREE,
    Estimate,
    HeadingEffect,
    Parameter,
    Stated,
    number,
    standard_error,
)
from airswing.physics.atmosphere import GRAVITY
from airswing.synthetic.sealed.draws import Draw, Signed, sign


def _by_phase(rng: np.random.Generator) -> dict[str, object]:
    # an error by phase: positive in climb, negative in descent, none in cruise
    return {"by_phase": True, "amplitude_deg": 10.0 * sign(rng)}


def _not_level(frame: pd.DataFrame, values: Mapping[str, object]) -> Booleans:
    return np.asarray(frame["phase"] != 2)


class AccelerationError(HeadingEffect):
    """Error amplitude sin(m) tan(dip) a/g, a the measured acceleration or a typical one by phase.

    Acceleration in climb and deceleration in descent lead to opposite signs; in cruise only changes
    of speed above the noise of the positions are used (levelling off). The amplitude of a free
    pendulum north of the magnetic equator is -57 degrees; slaving to a gyro reduces it.
    """

    name = "acceleration_error"
    title = "heading error from acceleration in climb and descent"
    draw = Draw(Signed("amplitude_deg", 20.0), ("amplitude_deg",), form=_by_phase, acts=_not_level)
    physics = (
        "The flux valve hangs as a pendulum. Under longitudinal acceleration it tilts and takes "
        "in a part of the vertical field: an error as the sine of the magnetic heading times the "
        "tangent of the dip, opposite in climb and descent."
    )
    source = "FAA-H-8083-15B, Instrument Flying Handbook, ch. 5 (ANDS); AGARDograph 160 vol. 1."
    parameters = (
        Parameter("amplitude_deg", "degree", 20.0, "at 1 g and a dip of 45 degrees", required=True),
        Parameter("by_phase", "", 0.0, "true: 0.03 g in climb, -0.03 g in descent", None),
    )
    needs = ("magnetic_heading", "acceleration", "dip")
    confused_with = ("hard_iron: where climb and descent are not sampled equally",)
    column_scales = np.full(2, np.radians(20.0))
    alternatives = ((0,), (1,))
    reliability = RELIABILITY["acceleration"]

    def basis(self, frame: Frame) -> Floats:
        # by acceleration and by phase; less than 0.02 m s-2 in cruise is noise of the positions
        steady = (frame.phase == PHASE["cruise"]) & (np.abs(frame.acceleration) < 0.02)
        pull = np.where(steady, 0.0, frame.acceleration) / GRAVITY
        climbs = frame.phase == PHASE["ascent"]
        usual = 0.03 * (1.0 * climbs - (frame.phase == PHASE["descent"]))
        tilt = np.sin(frame.magnetic_heading) * np.tan(frame.dip)
        return np.asarray(tilt * np.stack([pull, usual]))

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # of the form with the larger coefficient
        k = int(np.argmax(np.abs(coefficients)))
        amplitude = float(coefficients[k]) / DEGREE
        values: Stated = {"amplitude_deg": amplitude, "by_phase": k == 1 or None}
        return values, {"amplitude_deg": standard_error(covariance, k) / DEGREE}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        full = self.complete(values)
        out = np.zeros(2)
        out[int(bool(full["by_phase"]))] = number(full["amplitude_deg"]) * DEGREE
        return out

    def testable(self, frame: Frame) -> str | None:
        reason = super().testable(frame)
        steep = np.isin(frame.phase, (PHASE["ascent"], PHASE["descent"]))
        if reason is None and not np.any(self.basis(frame)[:, steep]):
            return "no climb or descent in these reports"
        return reason


EFFECT = AccelerationError()
