"""Constant error of the airspeed."""

from __future__ import annotations

from airswing.gap.arrays import Floats
from airswing.gap.effects.base import (
    AirspeedEffect,
    Parameter,
    Parameters,
    ProportionalEffect,
    number,
)
from airswing.synthetic.sealed.draws import Draw, Signed


class TasOffset(ProportionalEffect, AirspeedEffect):
    """Indicated true airspeed is the true one plus a constant."""

    name = "tas_offset"
    title = "airspeed wrong by an amount"
    draw = Draw(Signed("offset_m_s"), ("offset_m_s",), on_real_data=True)
    distinguished_by = {"tas_scale": "reports over a wider range of airspeeds"}
    physics = (
        "A zero error of the pressure transducers makes the airspeed wrong by an amount rather "
        "than a factor; the reported wind is wrong along the heading only."
    )
    source = "Lenschow & Spyers-Duran 1989, NCAR Research Aviation Facility Bulletin 23."
    parameters = (
        Parameter("offset_m_s", "m/s", 2.0, "positive: airspeed too high", required=True),
    )
    confused_with = ("tas_scale: where the airspeed varies little",)

    def indicated(self, airspeed: Floats, values: Parameters) -> Floats:
        return airspeed + number(values["offset_m_s"])


EFFECT = TasOffset()
