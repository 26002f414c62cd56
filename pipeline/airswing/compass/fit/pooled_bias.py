"""Partial pooling of the reference bias over a fleet, and the covariance that goes with it.

Assumptions
-----------
The reference bias b of an aircraft is the fleet's mean mu plus a part of the aircraft (its
network's region, levels and hours), normal with variance tau^2 a component. tau is averaged over
its restricted likelihood with a flat prior, which does not collapse to zero in a small fleet. The
second pass is closed-form on the first one's normal equations: theta + Cov(theta, b)
(Cov(b) + tau^2)^-1 (mu - b), so knowing b better sharpens B and C.

Errors are independent between flights except that the flights of a day share the model's error.
Both sandwiches use every aircraft's influence on the final estimate (mu included); the one by
flight is enlarged by the fleet's mean ratio of day to flight variance, parameter by parameter,
where that exceeds one, because a single aircraft's days are too few to estimate it.

References
----------
Morris 1983 (J. Amer. Stat. Assoc. 78); DerSimonian & Laird 1986; Searle et al. 1992, ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airswing.compass.fit.kernel import COMPASS, AircraftFit
from airswing.compass.fit.sandwich import Array

TAU_GRID = np.linspace(0.0, 3.0, 61)
"""m/s: scatter of the reference bias between aircraft over which the likelihood is averaged."""
FIRST_BIAS = COMPASS + 1


@dataclass(frozen=True)
class Fleet:
    """Estimates after pooling."""

    theta: Array  # (aircraft, p)
    covariance: Array  # (aircraft, p, p)
    bias: Array  # fleet mean mu of the reference bias, (2 * members,) m/s
    bias_covariance: Array
    tau: Array  # between-aircraft scatter, (members,) m/s


def day_ratio(fits: list[AircraftFit]) -> Array:
    """Return the fleet's mean ratio of variances clustered by day and by flight, at least one.

    Parameters
    ----------
    fits : list of AircraftFit
        Weighted with their numbers of days less one.

    Returns
    -------
    array, shape (p,)
        One value for A and for s, one for B and C, for D and E, for b_u and b_v.
    """
    return _mean_ratio(
        [np.diagonal(fit.covariance) for fit in fits],
        [np.diagonal(fit.day_covariance) for fit in fits],
        fits,
    )


def _mean_ratio(flight: list[Array], day: list[Array], fits: list[AircraftFit]) -> Array:
    above = np.zeros(flight[0].size)
    below = np.zeros(flight[0].size)
    for one, other, fit in zip(flight, day, fits, strict=True):
        weight = max(fit.day_number.size - 1, 1)
        good = one > 0
        above[good] += weight * other[good] / one[good]
        below[good] += weight
    ratio = np.divide(above, below, out=np.ones(above.size), where=below > 0)
    pairs = [(1, 2), (3, 4)] + [(k, k + 1) for k in range(FIRST_BIAS, ratio.size - 1, 2)]
    for pair in pairs:
        ratio[list(pair)] = ratio[list(pair)].mean()
    return np.maximum(ratio, 1.0)


def enlarged(covariance: Array, ratio: Array) -> Array:
    """Return a covariance with its variances multiplied by ``ratio``, correlations unchanged."""
    root = np.sqrt(ratio)
    return np.asarray(covariance * np.outer(root, root))


def _between_scatter(estimate: Array, covariance: Array) -> float:
    """Root mean of tau^2 (m/s) under its restricted likelihood, from biases (aircraft, 2).

    Infinite for fewer than two aircraft.
    """
    if estimate.shape[0] < 2:
        return float("inf")
    # Averaged and not maximised: with few aircraft the maximum is often zero, and the second pass
    # would then give all of them the fleet's bias as if it were known.
    between = TAU_GRID[:, np.newaxis, np.newaxis, np.newaxis] ** 2 * np.eye(2)
    total = covariance[np.newaxis] + between
    inverse = np.linalg.inv(total)
    information = inverse.sum(axis=1)
    weighted = np.einsum("taij,aj->ti", inverse, estimate)
    mean = np.linalg.solve(information, weighted[..., np.newaxis])
    apart = estimate - mean[..., 0][:, np.newaxis]
    square = np.einsum("tai,taij,taj->t", apart, inverse, apart)
    log = -0.5 * (
        square + np.linalg.slogdet(total)[1].sum(axis=1) + np.linalg.slogdet(information)[1]
    )
    weight = np.exp(log - log.max())
    return float(np.sqrt(np.sum(weight * TAU_GRID**2) / weight.sum()))


def pool(fits: list[AircraftFit], *, joint: bool) -> Fleet:
    """Pool the bias of one reference or pool over the fleet, after the choice of cycles.

    Parameters
    ----------
    fits : list of AircraftFit
    joint : bool
        False: there is no bias, and only the covariances are enlarged.

    Returns
    -------
    Fleet
    """
    ratio = day_ratio(fits)
    wide = [enlarged(fit.covariance, ratio) for fit in fits]
    thetas = [fit.theta for fit in fits]
    size = thetas[0].size
    if not joint:
        none = np.full(size - FIRST_BIAS, np.nan)
        return Fleet(np.array(thetas), np.array(wide), none, np.outer(none, none), np.empty(0))
    b = slice(FIRST_BIAS, size)
    estimate = np.array([theta[b] for theta in thetas])
    spread = np.array([one[b, b] for one in wide])
    tau = np.array(
        [
            _between_scatter(estimate[:, k : k + 2], spread[:, k : k + 2, k : k + 2])
            for k in range(0, size - FIRST_BIAS, 2)
        ]
    )
    if len(fits) < 2:
        return Fleet(np.array(thetas), np.array(wide), estimate[0], spread[0], tau)
    return _second_pass(fits, wide, np.repeat(tau, 2) ** 2, tau)


def _second_pass(fits: list[AircraftFit], wide: list[Array], prior: Array, tau: Array) -> Fleet:
    thetas = [fit.theta for fit in fits]
    b = slice(FIRST_BIAS, thetas[0].size)
    between = np.diag(prior)
    total = np.array([one[b, b] + between for one in wide])
    inverse = np.linalg.inv(total)
    share = np.linalg.solve(inverse.sum(axis=0), inverse)
    mean = np.einsum("aij,aj->i", share, np.array([theta[b] for theta in thetas]))
    gain = [one[:, b] @ inv for one, inv in zip(wide, inverse, strict=True)]
    theta = np.array([one + k @ (mean - one[b]) for one, k in zip(thetas, gain, strict=True)])
    raw = [fit.covariance for fit in fits]
    flight_mean = [w @ one[b, b] @ w.T for one, w in zip(raw, share, strict=True)]
    flight_total = np.sum(flight_mean, axis=0)
    days = np.unique(np.concatenate([fit.day_number for fit in fits]))
    common_day = np.zeros((days.size, prior.size))
    for fit, w in zip(fits, share, strict=True):
        common_day[np.searchsorted(days, fit.day_number)] += fit.day[:, b] @ w.T
    # scatter between aircraft of the difference of a bias and the mean
    total_random = np.einsum("aij,j,akj->ik", share, prior, share)
    by_flight, by_day, random = [], [], []
    for k, fit in enumerate(fits):
        mapped = np.eye(fit.theta.size)
        mapped[:, b] += gain[k] @ (share[k] - np.eye(prior.size))
        rest = gain[k] @ (flight_total - flight_mean[k]) @ gain[k].T
        by_flight.append(mapped @ raw[k] @ mapped.T + rest)
        daily = common_day @ gain[k].T
        daily[np.searchsorted(days, fit.day_number)] += fit.day - fit.day[:, b] @ gain[k].T
        by_day.append(daily.T @ daily)
        twice = share[k] * prior
        random.append(gain[k] @ (total_random + between - twice - twice.T) @ gain[k].T)
    ratio = _mean_ratio(
        [np.diagonal(one) for one in by_flight], [np.diagonal(one) for one in by_day], fits
    )
    covariance = np.array(
        [enlarged(one, ratio) + two for one, two in zip(by_flight, random, strict=True)]
    )
    mean_covariance = np.linalg.inv(inverse.sum(axis=0))
    day_part = common_day.T @ common_day + total_random
    wider = np.maximum(np.diagonal(day_part) / np.diagonal(mean_covariance), 1.0)
    return Fleet(theta, covariance, mean, enlarged(mean_covariance, wider), tau)
