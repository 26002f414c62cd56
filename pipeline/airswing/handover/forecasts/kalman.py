"""The Kalman filter of a forecast's systematic error, and the running mean it is held against.

Assumes one forecast a day at one place, of one variable and one lead, always at the same hour, and
an error y = forecast - observation made of a slowly wandering bias and white noise::

    y(t) = x(t) + eps(t),    x(t) = x(t-1) + eta(t),    var(eta) = ratio * var(eps)

(Delle Monache et al. 2006, J. Geophys. Res. 111, D05308). The noise's variance is found by a
second filter on z(t) = (y(t) - y(t-m))^2 / (2 + m ratio), m the days since the last error known,
which for m = 1 is the paper's; its own variances are the paper's 0.0005 and 1. A day without an
error leaves the bias where it was and makes it less certain. Nothing is known of the bias before
the first error: the filter starts from a diffuse state, so that its gain, and with it the
correction, does not depend on the variable's unit.

Valid for errors whose bias wanders; a change of regime is followed in some 1/sqrt(ratio) days.
Plain arrays, the day last, any unit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Of the second filter: how the noise's variance wanders, and how one sample of it scatters.
VARIANCE_OF_NOISE_CHANGE, VARIANCE_OF_NOISE_SAMPLE = 0.0005, 1.0
_SERIES_AT_ONCE = 2048  # So many that a day's numbers stay in the processor's cache


def kalman_bias(errors: Floats, ratio: Floats | float) -> Floats:
    """Bias of the forecast as it is known when the error of each day is in.

    Parameters
    ----------
    errors : array, shape (..., day)
        Forecast minus observation; NaN where either is missing.
    ratio : float or array, shape (...)
        Variance of the bias's daily change over that of the noise.

    Returns
    -------
    array, shape (..., day)
        NaN before the first error; a forecast of the next day is corrected by taking it off.
    """
    series = errors.reshape(-1, errors.shape[-1])
    ratios = np.broadcast_to(np.asarray(ratio, dtype=np.float64), errors.shape[:-1]).ravel()
    found = np.empty(series.shape)
    for first in range(0, series.shape[0], _SERIES_AT_ONCE):
        part = slice(first, first + _SERIES_AT_ONCE)
        # a row a day: every step then goes through memory as it lies
        found[part] = _filtered(np.ascontiguousarray(series[part].T), ratios[part]).T
    return found.reshape(errors.shape)


def _filtered(errors: Floats, ratio: Floats) -> Floats:
    """Bias after each day, (day, series) from (day, series)."""
    filtered, size = np.empty(errors.shape), errors.shape[1]
    bias, noise, last = np.full((3, size), np.nan)
    spread, waited, noise_spread = np.zeros(size), np.zeros(size), np.ones(size)
    for day, error in enumerate(errors):
        waited += 1.0
        known = np.isfinite(error)
        again = known & np.isfinite(last)
        fresh = again & np.isnan(noise)
        later = again & ~fresh
        sample = (error - last) ** 2 / (2.0 + waited * ratio)
        prior = noise_spread + VARIANCE_OF_NOISE_CHANGE
        gain = prior / (prior + VARIANCE_OF_NOISE_SAMPLE)
        # The state is as uncertain as the one error it rests on, plus what it wandered since.
        spread = np.where(fresh, sample * (1.0 + ratio * (waited - 1.0)), spread)
        noise = np.where(fresh, sample, np.where(later, noise + gain * (sample - noise), noise))
        noise_spread = np.where(later, prior * (1.0 - gain), noise_spread)
        spread = spread + ratio * noise
        gain = np.where(again, _gain(spread, noise), 1.0)
        bias = np.where(known, np.where(again, bias + gain * (error - bias), error), bias)
        spread = np.where(again, spread * (1.0 - gain), spread)
        last, waited = np.where(known, error, last), np.where(known, 0.0, waited)
        filtered[day] = bias
    return filtered


def _gain(spread: Floats, noise: Floats) -> Floats:
    """Weight of what is new; half where neither scatters at all."""
    total = spread + noise
    return np.divide(spread, total, out=np.full_like(total, 0.5), where=total != 0.0)


def running_mean(errors: Floats, days: int) -> Floats:
    """Mean of the errors (..., day) known of the last days, this one among them; NaN: none."""
    known = np.isfinite(errors)
    total = np.cumsum(np.where(known, errors, 0.0), axis=-1)
    number = np.cumsum(known, axis=-1)
    for sums in (total, number):
        # A copy: numpy would else take off what it has just changed.
        sums[..., days:] -= sums[..., :-days].copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(number > 0, total / number, np.nan)


def known_before(filtered: Floats, ahead: NDArray[np.int64]) -> Floats:
    """What was known of the bias when a forecast started.

    Parameters
    ----------
    filtered : array, shape (..., day)
        Of :func:`kalman_bias` or :func:`running_mean`, by the day the forecast started.
    ahead : array of int, shape (...)
        Days from one forecast's start to the first later one that its error is known to: 1 for
        leads up to a day, 2 up to two days.

    Returns
    -------
    array, shape (..., day)
        0 where nothing was known.
    """
    found = np.zeros_like(filtered)
    for days in np.unique(ahead):
        shifted = np.zeros_like(filtered)
        shifted[..., days:] = filtered[..., : max(filtered.shape[-1] - days, 0)]
        found = np.where(np.asarray(ahead)[..., None] == days, shifted, found)
    return np.nan_to_num(found, nan=0.0)
