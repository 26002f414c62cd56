"""How far a corrected wind may be from the one a right compass would have sent.

Assumptions
-----------
The correction turns the air vector by the deviation at the indicated heading: what it adds to the
wind is V (e^(-i delta) - 1) along the heading, of length V delta. It is off by

* the curve: V times the standard error of the fitted curve there, and V times what the unit's table
  differs from the curve at this heading and in this field, which is known;
* the heading at the report: a heading off by eps reads the curve at the wrong place and turns the
  correction with it, ``V (delta, delta') eps`` along and across, which saturates as eps grows like
  a circle's chord, ``2 (1 - exp(-sd^2 / 2))`` in place of ``sd^2``;
* the airspeed at the report: ``delta`` times its error (and its scale, where that is taken off);
* coding: the report rounds the wind it corrects to whole steps of speed and direction, and the
  report of a right compass would have been rounded too, elsewhere: twice the variance of one.

The parts are independent and add in quadrature, both components together: the standard error is the
root mean square *length* of the difference. Gusts and noise of the sensors are in both reports and
not in it.

Validity: deviations under 30 degrees. Degrees in tables and curves, else radians and m s-1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class At(NamedTuple):
    """What is known of each corrected report; arrays of shape (n,)."""

    airspeed: Array  # m s-1
    airspeed_error: Array  # m s-1
    heading_error: Array  # standard error of the indicated heading, rad
    deviation: Array  # what is taken off the heading, rad
    slope: Array  # its derivative by the heading


def correction_error(at: At, curve_error: ArrayLike, coding: ArrayLike = 0.0) -> Array:
    """Standard error of the corrected wind (m s-1), both components together.

    Parameters
    ----------
    curve_error : array_like, shape (n,)
        Standard error of what is taken off the heading, rad.
    coding : array_like, shape (n,)
        Variance of what coding leaves, m2 s-2; see :func:`coding_variance`.
    """
    chord = 2.0 * (1.0 - np.exp(-0.5 * at.heading_error**2))
    turned = (at.deviation**2 + at.slope**2) * chord
    variance = at.airspeed**2 * (np.asarray(curve_error) ** 2 + turned)
    variance += (at.deviation * at.airspeed_error) ** 2 + np.asarray(coding)
    return np.asarray(np.sqrt(variance))


def coding_variance(speed: ArrayLike, speed_step: ArrayLike, direction_step: ArrayLike) -> Array:
    """Variance (m2 s-2) that coding leaves between a corrected report and a right one.

    Of both components together and of both reports; winds and steps of speed in m s-1, steps of
    direction in rad, 0 where unknown.
    """
    arc = np.asarray(speed) * np.asarray(direction_step)
    # A uniform error has a twelfth of its step squared; twice, for two reports.
    return np.asarray((np.asarray(speed_step) ** 2 + arc**2) / 6.0)


def table_slope(table: ArrayLike, heading: ArrayLike) -> Array:
    """Slope (degrees per degree) of tables (n, node), even from 0 degrees, at headings (n,)."""
    values = np.asarray(table, dtype=np.float64)
    nodes = values.shape[-1]
    step = 360.0 / nodes
    lower = np.floor(np.mod(np.asarray(heading, dtype=np.float64), 360.0) / step).astype(np.int64)
    row = np.arange(values.shape[0])
    return np.asarray((values[row, (lower + 1) % nodes] - values[row, lower % nodes]) / step)


def curve_slope(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Slope (degrees per degree) of the curve A + B sin m + C cos m + D sin 2m + E cos 2m.

    Coefficients (n, 5) and headings m (n,) in degrees.
    """
    _, b, c, d, e = np.radians(np.asarray(coefficients, dtype=np.float64)).T
    angle = np.radians(np.asarray(heading, dtype=np.float64))
    once, twice = (b, c, angle), (2.0 * d, 2.0 * e, 2.0 * angle)
    return np.asarray(sum(s * np.cos(x) - t * np.sin(x) for s, t, x in (once, twice)))
