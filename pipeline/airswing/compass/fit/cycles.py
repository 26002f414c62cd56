"""What follows from the coefficients: the sinusoid with its errors, the choice of cycles, halves.

Assumptions: coefficients near normal, with a given covariance; everything to first order (delta
method) except the phase near zero amplitude, whose interval is that of the arc sine. Angles of the
curve in any one unit, the phase in degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.compass.fit.sandwich import Array
from airswing.units import NORMAL_95


def t_inflation(freedom: Array) -> Array:
    """Make a standard error so much wider that +-1.96 of it is Student's 95 % interval.

    Infinite degrees of freedom give 1.
    """
    from scipy.special import stdtrit

    # scipy gives NaN at infinity; a million are as good.
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
    # of no amplitude every direction is alike: the worst known one
    along = np.array([b, c]) / amplitude if amplitude > 0 else np.linalg.eigh(square)[1][:, -1]
    across = np.array([-along[1], along[0]])
    wide = NORMAL_95 * float(np.sqrt(max(float(across @ square @ across), 0.0)))
    sine = min(wide / amplitude, 1.0) if amplitude > 0 else 1.0
    value = np.array([a, amplitude, np.degrees(np.arctan2(c, b))])
    error = np.array(
        [
            np.sqrt(covariance[0, 0]),
            np.sqrt(max(float(along @ square @ along), 0.0)),
            np.degrees(np.arcsin(sine)) / NORMAL_95 if sine < 1 else 180 / NORMAL_95,
        ]
    )
    return value, error


def cycles_statistic(theta: Array, covariance: Array) -> float:
    """Wald's statistic of the second cycle, on two degrees of freedom; covariance clustered."""
    return float(theta[3:5] @ np.linalg.solve(covariance[3:5, 3:5], theta[3:5]))


def choose_cycles(statistic: float, clusters: int) -> int:
    """Number of cycles by evidence: a quasi-BIC that counts independent clusters, not reports."""
    # BIC's price of two parameters; of one or two clusters it would be next to nothing
    return 2 if statistic > 2.0 * np.log(max(clusters, 3)) else 1


def one_cycle_map(normal: Array, free: NDArray[np.int64]) -> Array:
    """Map (p, p) from the two-cycle estimate to that with D = E = 0, by its normal matrix."""
    kept = free[(free != 3) & (free != 4)]
    found = np.eye(normal.shape[0])
    found[3:5, 3:5] = 0.0
    found[np.ix_(kept, [3, 4])] = np.linalg.solve(
        normal[np.ix_(kept, kept)], normal[np.ix_(kept, [3, 4])]
    )
    return found


def choice_covariance(shift: Array, covariance: Array, statistic: float) -> Array:
    """Covariance (p, p) to add where one cycle was chosen: what D = E = 0 may have cost.

    The shift (two-cycle estimate minus the published one) of the other coefficients holds their
    possible bias and its own noise; the positive part of Stein's factor, 1 - 2 / statistic, leaves
    the bias. D and E, published as zero, keep their two-cycle covariance and the square of what was
    put to zero, so that their interval still holds a small second cycle that the data could not
    show.
    """
    factor = max(0.0, 1.0 - 2.0 / statistic) if statistic > 0 else 0.0
    added = factor * np.outer(shift, shift)
    added[3:5, 3:5] = covariance[3:5, 3:5] + np.outer(shift[3:5], shift[3:5])
    return np.asarray(added)


def halves_apart(
    influence: Array, order: NDArray[np.int64], covariance: Array
) -> tuple[float, float]:
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
    # half the flights alone are off by twice the sum of their influences, the others by as much the
    # other way, for those of all sum to nothing
    apart = 4.0 * influence[first].sum(axis=0)[:3]
    rms = float(np.sqrt(apart[0] ** 2 + 0.5 * (apart[1] ** 2 + apart[2] ** 2)))
    return rms, float(apart @ np.linalg.solve(4.0 * covariance[:3, :3], apart))
