"""Deviation that changes linearly in time."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import HeadingEffect, Parameter, ProportionalEffect
from airswing.synthetic.sealed.draws import Draw, Signed


class CompassDrift(ProportionalEffect, HeadingEffect):
    """Heading error that grows at a constant rate from an initial offset, or with one cycle."""

    name = "compass_drift"
    title = "compass deviation that drifts"
    deviates = True
    draw = Draw(Signed("rate_deg_per_day", 0.05), ("rate_deg_per_day",), dated="late", grows=True)
    physics = (
        "The slaving of a gyro drifts out of adjustment, or parts magnetise slowly: the heading "
        "error, or its cycle in magnetic heading, changes a little every day."
    )
    source = "NGA Handbook of Magnetic Compass Adjustment (change of deviation with time)."
    parameters = (
        Parameter("rate_deg_per_day", "degree/day", 0.05, "change of the error", required=True),
        Parameter("offset_deg", "degree", 1.0, "error at the start of the archive or period"),
        Parameter("sine_rate_deg_per_day", "degree/day", 0.05, "change of B in B sin(heading)"),
        Parameter("cosine_rate_deg_per_day", "degree/day", 0.05, "change of C in C cos(heading)"),
    )
    kind = "drift"
    needs = ("heading", "time")
    confused_with = (
        "compass_step: where the record is short",
        "compass_offset: where the drift is slow",
    )
    alternatives = ((0,), (0, 1), (2, 3))

    def basis(self, frame: Frame) -> Floats:
        since, heading = frame.time - frame.epoch, frame.magnetic_heading
        cycle = since * np.sin(heading), since * np.cos(heading)
        return np.stack([since, np.ones(frame.size), *cycle])


EFFECT = CompassDrift()
