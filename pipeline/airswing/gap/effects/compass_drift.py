"""Deviation that changes linearly in time."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import HeadingEffect, Parameter, ProportionalEffect
from airswing.synthetic.sealed.draws import Draw, Signed


class CompassDrift(ProportionalEffect, HeadingEffect):
    """Heading error that grows at a constant rate from an initial offset."""

    name = "compass_drift"
    title = "compass deviation that drifts"
    deviates = True
    draw = Draw(Signed("rate_deg_per_day", 0.05), ("rate_deg_per_day",), dated="late", grows=True)
    physics = (
        "Parts magnetise slowly, or the slaving of a gyro drifts out of adjustment: the heading "
        "error changes a little every day."
    )
    source = "NGA Handbook of Magnetic Compass Adjustment (change of deviation with time)."
    parameters = (
        Parameter("rate_deg_per_day", "degree/day", 0.05, "change of the error", required=True),
        Parameter("offset_deg", "degree", 1.0, "error at the start of the archive or period"),
    )
    kind = "drift"
    needs = ("heading", "time")
    confused_with = (
        "compass_step: where the record is short",
        "compass_offset: where the drift is slow",
    )
    alternatives = ((0,), (0, 1))

    def basis(self, frame: Frame) -> Floats:
        return np.stack([frame.time - frame.epoch, np.ones(frame.size)])


EFFECT = CompassDrift()
