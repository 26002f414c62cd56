"""What a report errs by beyond what the others of its flight foretell.

Assumptions: those of :mod:`airswing.gap.noise.whitening`. With V the covariance of a flight's
errors, the error of report i given all others has mean -[V^-1 r]_i / [V^-1]_ii + r_i and variance
1 / [V^-1]_ii. What changes along a flight stands out in it twenty times clearer than in the error
itself; what is the same all along a flight is nearly gone from it.

Validity: whole flights. Linear time: the recursion of the whitening, then its adjoint backwards.

Source: de Jong (1988), Biometrika 75, 594-600 (backward recursion); Cook & Weisberg (1982) (the
error of a report left out).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.noise.whitening import Evened, FlightOrder, Gains, whiten

Floats = NDArray[np.float64]


def interpolation_errors(values: Floats, order: FlightOrder, gains: Gains) -> tuple[Floats, Floats]:
    """Values less what the other reports of the flight foretell.

    Parameters
    ----------
    values : (n, 2 c) float
        m/s; pairs of east and north.
    gains : Gains
        Of the same.

    Returns
    -------
    errors : (n, 2 c) float
        m/s; 0 at masked reports.
    precision : (n,) float
        1 over the variance of each under the noise model, s2 m-2, in the mean over directions; 0
        at masked reports.
    """
    errors, precision = even_interpolation_errors(values, order, gains)
    return uneven(errors, gains), precision


def uneven(errors: Floats, gains: Gains) -> Floats:
    """Errors (n, 2 c) that are alike in all directions as they are along and across headings."""
    return errors if gains.evened is None else _turned(errors, gains.evened.inverse)


def evened(values: Floats, gains: Gains) -> Floats:
    """Vectors (n, 2 c) as the whitening makes them alike in all directions."""
    return values if gains.evened is None else _turned(values, gains.evened)


def even_interpolation_errors(
    values: Floats, order: FlightOrder, gains: Gains
) -> tuple[Floats, Floats]:
    """As :func:`interpolation_errors`, with errors along and across the heading made alike."""
    alike = replace(gains, evened=None)
    white = whiten(evened(values, gains), order, alike)
    score, precision = np.zeros_like(white), np.zeros(values.shape[0])
    back: Floats = np.zeros((0, values.shape[1]))
    weight_back: Floats = np.zeros(0)
    blocks = [order.index[a:b] for a, b in zip(order.starts[:-1], order.starts[1:], strict=True)]
    for now, after in zip(blocks[::-1], [np.zeros(0, np.int64), *blocks[:0:-1]], strict=True):
        decay = gains.decay[after]
        state, information = np.zeros((now.size, values.shape[1])), np.zeros(now.size)
        state[: after.size] = decay[:, None] * back
        information[: after.size] = decay**2 * weight_back
        weight, gain = gains.weight[now], gains.gain[now]
        own = weight[:, None] * white[now]
        score[now] = own + gain[:, None] * state
        precision[now] = weight**2 + gain**2 * information
        back = (1 - gain)[:, None] * state - own
        weight_back = weight**2 + (1 - gain) ** 2 * information
    score *= gains.scale[:, None]
    precision *= gains.scale**2
    known = (precision > 0) & (gains.weight > 0)
    errors = np.divide(score, precision[:, None], out=np.zeros_like(score), where=known[:, None])
    return errors, np.where(known, precision, 0.0)


def _turned(values: Floats, evened: Evened) -> Floats:
    """Vectors (n, 2 c) of each report times its factors."""
    pairs = values.reshape(values.shape[0], -1, 2).swapaxes(1, 2)
    return np.asarray(evened.by_report(pairs).swapaxes(1, 2).reshape(values.shape))
