"""What an uncertain heading at the report adds to the noise of its residual.

Assumptions: a column of the deviation is evaluated at the heading the archive holds. Where that
heading is off by eps (near a turn: `airswing.physics.turns`), the column misses the error the
unit made by about airspeed x deviation x eps, at random from report to report. The miss is white
noise of that report, and is added to the noise the residual is whitened with. So is the rounding of
headings that come in coarse steps, which would pass for errors of many kinds: it stays the same
along a course, and white noise of its size gives such aircraft as little say as they deserve.

Validity: one size of deviation for each aircraft. SI units and radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import heading_lattices
from airswing.physics.triangle import wrap_signed

Floats = NDArray[np.float64]

WIDEST = float(np.radians(90.0))
"""Error of a heading from which on a column tells nothing, rad."""


def heading_doubt(frame: Frame, columns_frame: Frame) -> Floats:
    """Error of the deviation's columns that the doubt of the heading makes.

    Parameters
    ----------
    frame : Frame
        As reported.
    columns_frame : Frame
        With the heading that stands in the columns.

    Returns
    -------
    (n,) float
        Standard deviation per component, m s-1; 0 where the heading's error is not known.
    """
    east, north = frame.ground_u - columns_frame.u_ref, frame.ground_v - columns_frame.v_ref
    implied = np.arctan2(east, north)
    squared = wrap_signed(columns_frame.heading - implied) ** 2
    count = np.maximum(np.bincount(frame.aircraft, minlength=len(frame.tails)), 1)
    deviation = np.sqrt(np.bincount(frame.aircraft, squared, minlength=len(frame.tails)) / count)
    off = np.minimum(np.nan_to_num(frame.heading_error), WIDEST)
    rounding = rounding_of_headings(frame)[frame.aircraft]
    near_turns = deviation[frame.aircraft] * off
    return np.asarray(columns_frame.airspeed * np.hypot(near_turns, rounding))


def rounding_of_headings(frame: Frame) -> Floats:
    """Standard deviation of each aircraft's headings from their coarse steps, (aircraft,) rad."""
    steps = np.array([one.step if one else 0.0 for one in heading_lattices(frame)])
    return np.asarray(np.radians(steps) / np.sqrt(12.0))
