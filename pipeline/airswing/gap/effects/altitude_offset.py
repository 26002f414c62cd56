"""Error of the reported altitude."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import Parameter, WindEffect, log_pressure_lapse
from airswing.synthetic.sealed.draws import Draw, Signed


class AltitudeOffset(WindEffect):
    """Reported pressure altitude too high by an offset, to first order in it.

    The aircraft flew lower than reported, at a higher pressure: ``W = W_ref + offset k dW/dlnp``
    with ``k = g / (R T)`` of the standard atmosphere, by which pressure altitude is defined.
    """

    name = "altitude_offset"
    title = "reported altitude off"
    draw = Draw(Signed("offset_ft", 300.0), ("offset_ft",))
    physics = (
        "A static-port error, or an altimeter setting left on the ground's pressure, gives the "
        "report a wrong level: it differs from the model by the wind shear times the height."
    )
    source = "First-order Taylor expansion of the reference wind in ln p; ICAO Doc 7488/3."
    parameters = (
        Parameter("offset_ft", "ft", 300.0, "positive: reported higher than flown", required=True),
    )
    needs = ("dudlnp",)
    confused_with = (
        "a height error of the model: an exact alias when the whole fleet shows it",
        "time_lag: where climb and shear always go together",
    )
    reliability = 0.9  # correlation with the true shear in simulated archives

    def columns(self, frame: Frame) -> Floats:
        shear = np.stack([frame.dudlnp, frame.dvdlnp], axis=-1)
        return np.nan_to_num(shear * log_pressure_lapse(frame)[:, None])[None]


EFFECT = AltitudeOffset()
