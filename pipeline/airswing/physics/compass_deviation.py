"""Deviation of a magnetic compass as a function of the indicated magnetic heading.

Assumptions and validity
------------------------
Archibald Smith's five coefficients, ``A + B sin m + C cos m + D sin 2m + E cos 2m``: A is the
misalignment, B and C the hard iron and vertical soft iron, D and E the horizontal soft iron. The
approximation holds for deviations below about 20 degrees. B and C are proportional to 1/H (hard
iron), so both columns take a gain: the horizontal field the coefficients are given for, over the
horizontal field at the report.

Units
-----
Headings in radians. Coefficients in any unit of angle; the result has the same.

References
----------
NGA Handbook of Magnetic Compass Adjustment (2004), chapter 3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

COEFFICIENTS = ("A", "B", "C", "D", "E")


def deviation_basis(heading: ArrayLike, gain: ArrayLike = 1.0) -> Array:
    """Return the functions that the coefficients A to E multiply.

    Parameters
    ----------
    heading : array_like, shape (...)
        Indicated magnetic heading, radians.
    gain : array_like, broadcastable to (...)
        Factor of the one-cycle columns (B and C).

    Returns
    -------
    ndarray, shape (5, ...)
        1, g sin m, g cos m, sin 2m, cos 2m.
    """
    m = np.asarray(heading, dtype=np.float64)
    basis = np.empty((5, *m.shape))
    sine, cosine = np.sin(m), np.cos(m)
    basis[0] = 1.0
    basis[1] = sine * gain
    basis[2] = cosine * gain
    basis[3] = 2.0 * sine * cosine
    basis[4] = 1.0 - 2.0 * sine * sine
    return basis


def deviation_slope(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Return the derivative of the deviation by the heading.

    Parameters
    ----------
    coefficients : array_like, shape (..., 5)
        B and C already multiplied by their gain.
    heading : array_like, shape (...)
        Radians.

    Returns
    -------
    ndarray, shape (...)
        Unit of the coefficients per radian.
    """
    _, b, c, d, e = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    _, sine, cosine, sine2, cosine2 = deviation_basis(heading)
    return np.asarray(b * cosine - c * sine + 2.0 * (d * cosine2 - e * sine2))
