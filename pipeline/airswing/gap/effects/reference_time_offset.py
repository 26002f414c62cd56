"""Model fields valid at another time than indicated."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import Parameter, WindEffect
from airswing.synthetic.sealed.draws import Draw, Signed
from airswing.units import HOUR


class ReferenceTimeOffset(WindEffect):
    """Field with valid time t shows the atmosphere of t + offset.

    The wind met at t is the reference at t - offset, from the winds w- and w+ an hour before and
    after t: w + s (w- - w+) / 2 + s^2 ((w- + w+) / 2 - w) with s the offset in hours, exact at no
    offset and at one of an hour. Without those winds it is w minus offset times tendency.
    """

    name = "reference_time_offset"
    title = "model fields valid at another time than stamped"
    draw = Draw(Signed("offset_h"), ("offset_h",), scope="fleet")
    physics = (
        "Fields carry a wrong valid time, or a file is one forecast hour off: the reference runs "
        "ahead of the atmosphere (positive) or behind it."
    )
    source = "Second-order interpolation of the reference wind in time."
    parameters = (
        Parameter("offset_h", "hour", 1.0, "positive: fields of a later time", required=True),
    )
    scope = "reference"
    needs = ("dudt",)
    # share of the first order, which is searched, in the energy of an offset of an hour: 0.67 to
    # 0.81 in simulated archives
    reliability = 0.7
    confused_with = (
        "time_lag: where the wind's change along the path is its change in time",
        "a model whose waves move too fast or too slowly",
    )

    def columns(self, frame: Frame) -> Floats:
        tendency = np.stack([frame.dudt, frame.dvdt], axis=-1)
        before, _, after = _hourly_winds(frame)
        wide = (after - before) / (2.0 * HOUR)
        return np.nan_to_num(-np.where(np.isfinite(wide), wide, tendency))[None]

    def curvature(self, frame: Frame) -> Floats | None:
        before, now, after = _hourly_winds(frame)
        if not np.isfinite(before + after).any():
            return None
        return np.nan_to_num((0.5 * (before + after) - now) / HOUR**2)[None]


def _hourly_winds(frame: Frame) -> tuple[Floats, Floats, Floats]:
    return (
        np.stack([frame.u_before, frame.v_before], axis=-1),
        np.stack([frame.u_ref, frame.v_ref], axis=-1),
        np.stack([frame.u_after, frame.v_after], axis=-1),
    )


EFFECT = ReferenceTimeOffset()
