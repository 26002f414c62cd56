"""Deviation of a magnetic compass as a function of the indicated magnetic heading.

Archibald Smith's five coefficients, ``A + B sin m + C cos m + D sin 2m + E cos 2m``: A is the
misalignment, B and C the hard iron and vertical soft iron, D and E the horizontal soft iron. The
approximation holds for deviations below about 20 degrees. B and C are proportional to 1/H (hard
iron), so both columns take a gain: the horizontal field the coefficients are given for, over the
horizontal field at the report. Headings in radians; coefficients in any unit of angle, which the
result has too. Source: NGA Handbook of Magnetic Compass Adjustment (2004), chapter 3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

COEFFICIENTS = ("A", "B", "C", "D", "E")


def deviation_basis(heading: ArrayLike, gain: ArrayLike = 1.0) -> Array:
    """Return the basis of the coefficients A to E: 1, g sin m, g cos m, sin 2m, cos 2m; (5, ...).

    Parameters
    ----------
    heading : array_like, shape (...)
        Indicated magnetic heading, radians.
    gain : array_like, broadcastable to (...)
        Factor of the one-cycle columns (B and C).
    """
    m = np.asarray(heading, dtype=np.float64)
    sine, cosine = np.sin(m), np.cos(m)
    return np.stack(
        np.broadcast_arrays(
            1.0, sine * gain, cosine * gain, 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
        )
    )


def deviation_slope(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Return the derivative (...) of the deviation by the heading, per radian.

    Parameters
    ----------
    coefficients : array_like, shape (..., 5)
        B and C already multiplied by their gain.
    heading : array_like, shape (...)
        Radians.
    """
    _, b, c, d, e = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    _, sine, cosine, sine2, cosine2 = deviation_basis(heading)
    return np.asarray(b * cosine - c * sine + 2.0 * (d * cosine2 - e * sine2))
