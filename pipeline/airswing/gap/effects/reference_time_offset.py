"""Model fields valid at another time than indicated."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import Floats, Parameter, ProportionalEffect, WindEffect, known
from airswing.synthetic.sealed.draws import Draw, Signed


class ReferenceTimeOffset(ProportionalEffect, WindEffect):
    """Field with valid time t shows the atmosphere of t + offset, to first order in the offset.

    The wind met at t is the reference minus offset times its tendency.
    """

    name = "reference_time_offset"
    title = "model fields valid at another time than stamped"
    draw = Draw(
        Signed("offset_h"),
        ("offset_h",),
        whose="fleet",
        compared=("offset_h",),
        places=("tendency",),
    )
    physics = (
        "Fields carry a wrong valid time, or a file is one forecast hour off: the reference runs "
        "ahead of the atmosphere (positive) or behind it."
    )
    source = "First-order Taylor expansion of the reference wind in time."
    parameters = (
        Parameter(
            "offset_h",
            "hour",
            1.0,
            "positive: fields show a later time than stamped",
            required=True,
            si=3600.0,
        ),
    )
    scope = "reference"
    needs = ("dudt",)
    # in simulated archives, fields of the correct time close twice as much as the tendency for an
    # offset of an hour (small waves have changed), and as much for a quarter of an hour
    reliability = 0.55
    confused_with = (
        "time_lag: where the wind's change along the path is its change in time",
        "a model whose waves move too fast or too slowly",
    )
    column_names = ("offset",)

    def columns(self, frame: Frame) -> Floats:
        """See `Effect.columns`: minus the tendency."""
        return known(-np.stack([frame.dudt, frame.dvdt], axis=-1))[None]


EFFECT = ReferenceTimeOffset()
