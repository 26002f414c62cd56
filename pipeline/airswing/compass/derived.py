"""What follows from the coefficients: the sinusoid with its errors, the choice of cycles, halves.

Assumptions: coefficients near normal, with a given covariance; everything to first order (delta
method) except the phase near zero amplitude, whose interval is that of the arc sine. Angles of the
curve in any one unit, the phase in degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.compass.clusters import Array

NORMAL_95 = 1.959964


def t_inflation(freedom: Array) -> Array:
    """Make a standard error so much wider that +-1.96 of it is Student's 95 % interval.

    Parameters
    ----------
    freedom : array
        Degrees of freedom; infinity gives 1.

    Returns
    -------
    array, same shape
    """
    from scipy.special import stdtrit

    finite = np.minimum(np.maximum(freedom, 1.0), 1e6)
    return np.asarray(stdtrit(finite, 0.975) / NORMAL_95)


def sinusoid(coefficients: Array, covariance: Array) -> tuple[Array, Array]:
    """Offset, amplitude and phase of offset + amplitude sin(m + phase), with standard errors.

    Parameters
    ----------
    coefficients : array, shape (>= 3,)
        A, B, C ... in degrees.
    covariance : array, shape (>= 3, >= 3)
        degree2.

    Returns
    -------
    value, error : arrays, shape (3,)
        Degrees. The amplitude's error is that along (B, C), the phase's that across it over the
        amplitude: near zero amplitude it tends to the half circle, not to infinity.
    """
    a, b, c = coefficients[:3]
    amplitude = float(np.hypot(b, c))
    square = covariance[1:3, 1:3]
    along = (np.array([b, c]) / amplitude if amplitude > 0 else np.linalg.eigh(square)[1][:, -1])
    across = np.array([-along[1], along[0]])
    wide = NORMAL_95 * float(np.sqrt(max(across @ square @ across, 0.0)))
    sine = min(wide / amplitude, 1.0) if amplitude > 0 else 1.0
    value = np.array([a, amplitude, np.degrees(np.arctan2(c, b))])
    error = np.array([np.sqrt(covariance[0, 0]), np.sqrt(max(along @ square @ along, 0.0)),
                      np.degrees(np.arcsin(sine)) / NORMAL_95 if sine < 1 else 180 / NORMAL_95])
    return value, error


def choose_cycles(theta: Array, covariance: Array, clusters: int) -> int:
    """Whether a second cycle is there: Wald's statistic against the clusters' information.

    Parameters
    ----------
    theta : array, shape (p,)
    covariance : array, shape (p, p)
        Clustered covariance of ``theta``.
    clusters : int
        Independent pieces of data, which a quasi-BIC counts instead of reports.

    Returns
    -------
    int
        1 or 2.
    """
    two = theta[3:5]
    statistic = float(two @ np.linalg.solve(covariance[3:5, 3:5], two))
    return 2 if statistic > 2.0 * np.log(max(clusters, 3)) else 1


def one_cycle(theta: Array, normal: Array, free: NDArray[np.int64]) -> Array:
    """Estimate with D = E = 0, from the two-cycle fit's normal equations.

    Parameters
    ----------
    theta : array, shape (p,)
    normal : array, shape (p, p)
    free : array of int
        Fitted parameters.

    Returns
    -------
    array, shape (p,)
    """
    kept = free[(free != 3) & (free != 4)]
    moved = theta.copy()
    push = normal[np.ix_(kept, [3, 4])] @ theta[3:5]
    moved[kept] += np.linalg.solve(normal[np.ix_(kept, kept)], push)
    moved[3:5] = 0.0
    return moved


def halves_apart(influence: Array, order: NDArray[np.int64], covariance: Array) -> tuple[float, float]:
    """How far the curves of the first and second half of the flights are apart.

    Parameters
    ----------
    influence : array, shape (flights, p)
    order : array of int, shape (flights,)
        Flights by time.
    covariance : array, shape (p, p)

    Returns
    -------
    rms : float
        Root mean square over headings of the difference of the one-cycle curves, in the unit of
        the coefficients.
    chi2 : float
        Its Wald statistic on three degrees of freedom.
    """
    first = order[: order.size // 2]
    apart = 4.0 * influence[first].sum(axis=0)[:3]
    rms = float(np.sqrt(apart[0] ** 2 + 0.5 * (apart[1] ** 2 + apart[2] ** 2)))
    return rms, float(apart @ np.linalg.solve(4.0 * covariance[:3, :3], apart))
