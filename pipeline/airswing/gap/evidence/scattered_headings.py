"""What headings that scatter look like in the columns of the fleet, and are not.

Assumptions: a heading off by d turns the air vector V, and leaves V (1 - cos d) too little along
it: V var(d) / 2 on average, of second order, in no column of the heading. Errors of the reference
are alike in all directions, so headings scatter by what the residual varies more across the heading
than along it, var(across) - var(along) = V^2 var(d). What scatters irregularly does a little of it
regularly as well: the same at the same heading, on all units of a make.

Validity: scatter of tens of degrees at most. Real flux valves that err by 1.7 degrees irregularly
(3.2 m/s) lose 0.05 m/s of airspeed and have 0.15 m/s of soft iron in common.
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
from airswing.physics.robust_spread import robust_sd

Floats = NDArray[np.float64]

#: Standard deviations at which gross errors are bounded.
BOUND = 5.0
#: Part of irregular heading errors that all aircraft have alike.
REGULAR = 0.05


def excess(frame: Frame) -> float:
    """What the residual varies more across the heading than along it, m2 s-2, not negative."""
    across, along = (
        _variance((frame.residual * unit).sum(axis=1)) for unit in unit_vectors(frame.heading)
    )
    return max(across - along, 0.0)


def of_columns(frame: Frame, layout: Layout, effects: Mapping[str, Effect]) -> Floats:
    """Size of it in every column, (p,) m/s: of headings and airspeeds; 0 in those of the wind."""
    out, more = np.zeros(layout.size), excess(frame)
    lost = more / (2 * float(np.mean(frame.airspeed)))
    for name in layout.effects:
        effect = effects[name]
        if isinstance(effect, HeadingEffect):
            out[layout.columns(name)] = REGULAR * np.sqrt(more)
        elif getattr(effect, "stage", "sensor") == "sensor":
            out[layout.columns(name)] = lost
    return out


def _variance(values: Floats) -> float:
    middle = float(np.median(values))
    bound = BOUND * robust_sd(values)
    return float(np.mean(np.clip(values - middle, -bound, bound) ** 2))
