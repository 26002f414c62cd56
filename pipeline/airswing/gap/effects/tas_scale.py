"""Relative error of the airspeed."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import (
    AirspeedEffect,
    Estimate,
    Parameter,
    Parameters,
    number,
    standard_error,
)
from airswing.synthetic.sealed.draws import Draw, Signed


class TasScale(AirspeedEffect):
    """Indicated true airspeed is (1 + scale) times the true one."""

    name = "tas_scale"
    title = "airspeed wrong by a factor"
    draw = Draw(Signed("scale_percent"), ("scale_percent",), on_real_data=True)
    physics = (
        "Errors of static port, pitot tube or temperature recovery make the true airspeed wrong "
        "by a factor; the reported wind is wrong along the heading only."
    )
    source = (
        "de Haan 2011, J. Geophys. Res. 116, D10111; Lenschow 1986, Probing the Atmospheric BL."
    )
    parameters = (
        Parameter("scale_percent", "percent", 2.0, "positive: airspeed too high", required=True),
    )
    confused_with = ("tas_offset: where the airspeed varies little",)
    column_scales = np.array([0.02])

    def columns(self, frame: Frame) -> Floats:
        return np.asarray(frame.airspeed[:, None] * super().columns(frame))

    def indicated(self, airspeed: Floats, values: Parameters) -> Floats:
        return airspeed * (1.0 + number(values["scale_percent"]) / 100.0)

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # a coefficient is relative to the INDICATED airspeed
        ratio = 1.0 - float(coefficients[0])
        error = 100.0 * standard_error(covariance) / ratio**2
        return {"scale_percent": 100.0 * (1.0 / ratio - 1.0)}, {"scale_percent": error}


EFFECT = TasScale()
