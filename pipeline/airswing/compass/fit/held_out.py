"""Improvement of the winds on days that the fit has not seen, aircraft by aircraft.

Assumptions
-----------
The days of an aircraft are divided into `FOLDS` parts (its flights, where there are fewer than five
days). Without the reports of one part the coefficients are, to first order, the published ones
minus the sum of the influences of the part's flights, enlarged by the weight of the others; the
influences are those of the aircraft's single fit, brought to the published covariance, in which the
fleet's knowledge of the reference's bias is included. The squared vector disagreement with the
reference before and after the correction is a quadratic function of the coefficients, whose sums by
part the fit has kept (`airswing.compass.fit.kernel.HeldOut`), weighted as in the fit.

A bias of the reference is no error of the aircraft, and a correction of the compass alone can make
it more visible. The bias that goes with the published coefficients is therefore removed before and
after, but no more of it than `MAX_BIAS`: a larger mean difference is an error of the reports.

What follows
------------
* A mean difference from every reference beyond `IMPLAUSIBLE`, which no model's wind has:
  ``implausible_reports``.
* A curve that is zero within its error: ``no_correction_needed``. Wald's statistic of the curve's
  coefficients is below the 95 % quantile of chi-square.
* Otherwise the mean improvement must be above zero: ``no_improvement`` where it is not. Under the
  model of the fit the improvement is about Wald's statistic less twice its degrees of freedom, so
  that a curve which passes the first test improves held-out days; where it does not, the model of
  the fit does not describe the reports.

References
----------
Stone 1974 (J. Roy. Stat. Soc. B 36), cross-validation; Wald 1943.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from airswing.compass.fit.kernel import COMPASS, FOLDS, AircraftFit, HeldOut
from airswing.compass.fit.sandwich import Array

MAX_BIAS = 1.5
"""m s-1: largest mean difference of an aircraft's winds from a reference that is removed as the
bias of the reference: twice that of the worked example of the joint fit, 0.8 m s-1."""
SIGNIFICANCE = 0.05
"""Probability that an aircraft without deviation is found to have one."""
IMPLAUSIBLE = 5.0
"""m s-1: mean vector difference from a reference, deviation removed, that is an error of the
reports: more than three times `MAX_BIAS`, and twice the rms of a component of Mode-S and AMDAR
winds against a model (2.1 to 2.5 m s-1; Stone & Pearce 2016, J. Atmos. Oceanic Technol. 33). Winds
in m/s read as kt give about half the mean wind, 10 m s-1 at cruise."""


class Improvement(NamedTuple):
    """Decrease of the mean square vector disagreement on held-out days, m2 s-2."""

    mean: float
    standard_error: float  # from the scatter between the parts


def held_out_improvement(fit: AircraftFit, theta: Array, covariance: Array) -> Improvement | None:
    """Return the improvement of the winds on held-out days.

    Parameters
    ----------
    fit : AircraftFit
        Fit of the aircraft without the fleet.
    theta : array, shape (5,)
        Published coefficients A to E, radians.
    covariance : array, shape (5, 5)
        Their covariance.

    Returns
    -------
    Improvement or None
        None where there are fewer than two parts with reports.
    """
    used = np.flatnonzero(theta)
    parts = np.bincount(fit.fold, minlength=FOLDS)
    weight = np.sum([one.weight for one in fit.held_out], axis=0)
    if not fit.held_out or not used.size or np.count_nonzero(parts) < 2:
        return None
    square = np.ix_(used, used)
    influence = fit.flight[:, used] @ _matched(fit.covariance[square], covariance[square])
    left_out = np.zeros((FOLDS, COMPASS))
    np.add.at(left_out, (fit.fold[:, np.newaxis], used), influence)
    rest = 1.0 - weight / weight.sum()
    at = theta - left_out / np.maximum(rest, 0.1)[:, np.newaxis]
    gain = np.zeros(FOLDS)
    for one in fit.held_out:
        bias = _bias(one, theta)
        bias *= min(1.0, MAX_BIAS / max(float(np.hypot(*bias)), 1e-9))
        linear = one.linear - one.bias @ bias
        gain += 2.0 * (at * linear).sum(axis=1)
        gain -= np.einsum("fi,fij,fj->f", at, one.square, at)
    seen = weight > 0
    mean = float(gain.sum() / weight.sum())
    apart = gain[seen] - mean * weight[seen]
    number = np.count_nonzero(seen)
    error = np.sqrt(float(apart @ apart) * number / (number - 1)) / weight.sum()
    return Improvement(mean, float(error))


def _matched(covariance: Array, published: Array) -> Array:
    """Matrix that brings influences of one covariance to another."""
    old, new = np.linalg.cholesky(covariance), np.linalg.cholesky(published)
    return np.asarray(np.linalg.solve(old.T, new.T))


def _bias(sums: HeldOut, theta: Array) -> Array:
    """Mean difference from a reference that the deviation leaves, (2,), m s-1."""
    total = sums.offset.sum(axis=0) - theta @ sums.bias.sum(axis=0)
    return np.asarray(total / max(float(sums.weight.sum()), 1e-9))


def is_implausible(fit: AircraftFit, theta: Array) -> bool:
    """Return True where the winds differ from all references by more than any model's bias.

    False where no bias was fitted: on few headings an error of the airspeed looks like one.

    Parameters
    ----------
    fit : AircraftFit
        Fit of the aircraft without the fleet.
    theta : array, shape (5,)
        Coefficients A to E, radians.
    """
    if fit.free[-1] <= COMPASS:
        return False
    return all(float(np.hypot(*_bias(one, theta))) > IMPLAUSIBLE for one in fit.held_out)


def is_zero(theta: Array, covariance: Array) -> bool:
    """Return True where a curve is zero within its error.

    Parameters
    ----------
    theta : array, shape (5,)
        Coefficients A to E; D and E are zero where one cycle was chosen.
    covariance : array, shape (5, 5)
        In the square of their unit.
    """
    from scipy.special import chdtri

    size = 5 if theta[3:].any() else 3
    statistic = theta[:size] @ np.linalg.solve(covariance[:size, :size], theta[:size])
    return bool(statistic < chdtri(size, SIGNIFICANCE))
