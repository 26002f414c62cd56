"""Reported wind older than position and time of the report."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import Parameter, WindEffect, log_pressure_lapse
from airswing.synthetic.sealed.draws import Draw


def _delay(rng: np.random.Generator) -> dict[str, object]:
    return {"offset_s": 60.0}


class TimeLag(WindEffect):
    """Reported wind is that met `offset_s` seconds earlier on the path, to first order in it.

    ``W = W_ref - offset (dW/dt + V_G . grad W + dW/dlnp dlnp/dt)`` with ``dlnp/dt`` from the rate
    of climb. Times truncated to the minute resemble a negative lag of half a minute.
    """

    name = "time_lag"
    title = "wind older than its position and time"
    draw = Draw(_delay, ("offset_s",))
    distinguished_by = {
        "altitude_offset": "both climbs and descents through the same shear",
        "reference_time_offset": "flights against the motion of the weather",
    }
    physics = (
        "Averaging, filtering and buffering in the unit attach a wind to a later position and "
        "time; the report shows the wind of a place the aircraft has left."
    )
    source = "First-order Taylor expansion of the reference wind along the path."
    parameters = (
        Parameter("offset_s", "s", 60.0, "positive: older than position and time", required=True),
    )
    needs = ("dudt", "dudx")
    confused_with = (
        "altitude_offset: in climb alone or in descent alone",
        "reference_time_offset: where the wind's change along the path is its change in time",
    )
    reverses = True
    reliability = 0.93  # correlation with the true change along the path in simulated archives

    def columns(self, frame: Frame) -> Floats:
        sinking = np.nan_to_num(-frame.climb_rate * log_pressure_lapse(frame))
        along = [
            np.nan_to_num(t)
            + np.nan_to_num(frame.ground_u * x + frame.ground_v * y)
            + sinking * np.nan_to_num(p)
            for t, x, y, p in (
                (frame.dudt, frame.dudx, frame.dudy, frame.dudlnp),
                (frame.dvdt, frame.dvdx, frame.dvdy, frame.dvdlnp),
            )
        ]
        return -np.stack(along, axis=-1)[None]


EFFECT = TimeLag()
