"""Airspeed that the scatter of headings takes away: what looks like an error of it, and is none.

Assumptions: a heading off by d turns the air vector V, and leaves V (1 - cos d) too little along
it: V var(d) / 2 on average, of second order, in no column of the heading. Errors of the reference
are alike in all directions, so headings scatter by what the residual varies more across the heading
than along it, var(across) - var(along) = V^2 var(d).

Validity: scatter of tens of degrees at most; a unit with a real flux valve's irregular errors of
one or two degrees loses 0.05 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import unit_vectors
from airswing.gap.design.layout import Layout
from airswing.gap.effects import HeadingEffect
from airswing.gap.effects.base import Effect
from airswing.gap.noise.residual_statistics import robust_sd

Floats = NDArray[np.float64]

#: Standard deviations at which gross errors are bounded.
BOUND = 5.0


def shortening(frame: Frame) -> float:
    """Airspeed that the scatter of headings takes away on average, m/s.

    Parameters
    ----------
    frame : Frame

    Returns
    -------
    float
    """
    across, along = (
        _variance((frame.residual * unit).sum(axis=1)) for unit in unit_vectors(frame.heading)
    )
    return max(across - along, 0.0) / (2 * float(np.mean(frame.airspeed)))


def of_columns(frame: Frame, layout: Layout, effects: Mapping[str, Effect]) -> Floats:
    """The same of every column of an airspeed that is off, 0 of the others, (p,) m/s."""
    out, lost = np.zeros(layout.size), shortening(frame)
    for name in layout.effects:
        effect = effects[name]
        sensor = getattr(effect, "stage", "sensor") == "sensor"
        if sensor and not isinstance(effect, HeadingEffect):
            out[layout.columns(name)] = lost
    return out


def _variance(values: Floats) -> float:
    middle = float(np.median(values))
    bound = BOUND * robust_sd(values)
    return float(np.mean(np.clip(values - middle, -bound, bound) ** 2))
