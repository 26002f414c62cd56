"""Model fields valid earlier or later than stamped."""

from __future__ import annotations

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import FloatArray, Parameter
from airswing.gap.effects.forms import OneCoefficient, WindEffect, known
from airswing.synthetic.sealed.draws import Draw, Signed


class ReferenceTimeOffset(OneCoefficient, WindEffect):
    """A field stamped t shows the atmosphere of t + offset, to first order in the offset.

    The wind met at t is then the reference less offset times its tendency.
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
    # by the generator: fields of the right time close twice what the tendency tells where they are
    # an hour off (small waves are others by then), no more where they are a quarter off
    reliability = 0.55
    confused_with = (
        "time_lag: where the wind's change along the path is its change in time",
        "a model whose waves move too fast or too slowly",
    )
    column_names = ("offset",)

    def columns(self, frame: Frame) -> FloatArray:
        """See `Effect.columns`: minus the tendency."""
        return known(-np.stack([frame.dudt, frame.dvdt], axis=-1))[None]


EFFECT = ReferenceTimeOffset()
