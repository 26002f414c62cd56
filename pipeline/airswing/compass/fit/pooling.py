"""Fleet estimates for the fits of single aircraft: bias of the reference, and constants.

*Partial pooling of the bias.* The reference bias b of an aircraft is the fleet's mean mu plus a
part of the aircraft (its network's region, levels and hours), normal with variance tau^2 a
component. tau is averaged over its restricted likelihood with a flat prior, which does not collapse
to zero in a small fleet. The second pass is closed-form on the first one's normal equations:
theta + Cov(theta, b) (Cov(b) + tau^2)^-1 (mu - b), so that a smaller error of b reduces those of B
and C. Both sandwiches use every aircraft's influence on the final estimate (mu included); the one
by flight is enlarged by the fleet's mean ratio of day to flight variance, parameter by parameter,
because a single aircraft's days are too few to estimate it.

*One constant* for an aircraft whose headings or flights do not allow a curve: psi_err = A over the
headings flown. The reference's bias enters as (b_u cos psi - b_v sin psi) / V and cannot be
separated from A on one heading. It comes from the aircraft with curves where there are two or more,
else from the along-track errors of the aircraft without, which do not depend on the compass; their
scatter between aircraft includes the airspeed errors, so that the interval is wider than necessary.
The covariance of A to E is that of a curve whose cycles are as large as the fleet's and whose mean
over the headings flown is the constant. Fewer than `MIN_FLIGHTS` flights are too few to estimate
the reference's error of a flight: their clusters are stretches of `STRETCH`, and the error of a
flight is that of the along-track errors of `FEWEST_AIRCRAFT` such aircraft or more.

Radians and m/s.

References
----------
Morris 1983 (J. Amer. Stat. Assoc. 78); DerSimonian & Laird 1986; Searle et al. 1992, ch. 7; de Haan
2011 (J. Geophys. Res. 116, D10111): one heading correction an aircraft from Mode-S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from airswing.compass.fit.kernel import COMPASS, AircraftFit
from airswing.compass.fleet.field import Array
from airswing.units import NORMAL_95

TAU_GRID = np.linspace(0.0, 3.0, 61)
"""m/s: scatter of the reference bias between aircraft over which the likelihood is averaged."""
FIRST_BIAS = COMPASS + 1
_BIASES, _CYCLES = slice(FIRST_BIAS, None), slice(1, COMPASS)  # in theta
MIN_FLIGHTS = 5  # number of flights below which the clusters are stretches within flights
STRETCH = 120  # seconds of a cluster within a flight where there are too few flights
FEWEST_CURVES = 3  # fewest aircraft with curves from which the size of the cycles is estimated
USUAL_CYCLE = (np.radians(3.0), np.radians(1.0))
"""Radians: rms amplitude of one and of two cycles in the sample fleets and published tables."""
FEWEST_AIRCRAFT = 6
"""Fewest aircraft whose along-track errors give the scatter of the reference's bias."""
USUAL_BIAS = 0.5
"""m/s: scatter of the reference's bias between aircraft where it cannot be estimated."""
HALVES_DIFFERENCE, HALVES_CHI2 = np.radians(1.0), 18.7
"""Least difference between the halves of the period, and its chi-square, of a changed compass: on
one degree of freedom as rare as 25 on three, the limit for curves."""


@dataclass(frozen=True)
class Fleet:
    """Estimates after pooling."""

    theta: Array  # (aircraft, p)
    covariance: Array  # (aircraft, p, p)
    bias: Array  # fleet mean mu of the reference bias, (2 * members,) m/s
    bias_covariance: Array
    tau: Array  # between-aircraft scatter, (members,) m/s


@dataclass(frozen=True)
class Offset:
    """A constant and its variance, radians; ``stable`` where both halves of the period agree.

    ``covariance`` (5, 5) is that of A to E, cycles included.
    """

    value: float
    variance: float
    stable: bool
    covariance: Array


def t_inflation(freedom: Array) -> Array:
    """Factor with which +-1.96 standard errors are Student's 95 % interval."""
    # scipy gives NaN at infinity
    return np.asarray(stdtrit(np.clip(freedom, 1.0, 1e6), 0.975) / NORMAL_95)


def day_ratio(fits: list[AircraftFit]) -> Array:
    """Fleet's mean ratio (p,) of variances clustered by day and by flight, at least one.

    Weighted with the numbers of days less one. One value for A and for s, one for B and C, for D
    and E, for b_u and b_v.
    """
    flight = np.array([np.diagonal(fit.covariance) for fit in fits])
    return _mean_ratio(flight, np.array([np.diagonal(fit.day_covariance) for fit in fits]), fits)


def _mean_ratio(flight: Array, day: Array, fits: list[AircraftFit]) -> Array:
    weight = np.array([max(fit.day_number.size - 1, 1) for fit in fits])[:, np.newaxis]
    weight = weight * (flight > 0)
    above = (weight * np.divide(day, flight, out=np.zeros(day.shape), where=flight > 0)).sum(axis=0)
    below = weight.sum(axis=0)
    ratio = np.divide(above, below, out=np.ones(above.size), where=below > 0)
    for pair in [(1, 2), (3, 4)] + [(k, k + 1) for k in range(FIRST_BIAS, ratio.size - 1, 2)]:
        ratio[list(pair)] = ratio[list(pair)].mean()
    return np.asarray(np.maximum(ratio, 1.0))


def enlarged(covariance: Array, ratio: Array) -> Array:
    """Covariance with its variances multiplied by ``ratio``, correlations unchanged."""
    root = np.sqrt(ratio)
    return np.asarray(covariance * root[..., np.newaxis] * root)


def _between_scatter(estimate: Array, covariance: Array) -> float:
    """Root mean of tau^2 (m/s) under its restricted likelihood, from biases (aircraft, 2)."""
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
    difference = estimate - mean[..., 0][:, np.newaxis]
    square = np.einsum("tai,taij,taj->t", difference, inverse, difference)
    log = -0.5 * (
        square + np.linalg.slogdet(total)[1].sum(axis=1) + np.linalg.slogdet(information)[1]
    )
    weight = np.exp(log - log.max())
    return float(np.sqrt(np.sum(weight * TAU_GRID**2) / weight.sum()))


def pool(fits: list[AircraftFit], *, joint: bool) -> Fleet:
    """Pool the bias of one reference or pool over the fleet, after the choice of cycles.

    Without ``joint`` there is no bias, and only the covariances are enlarged.
    """
    raw = np.array([fit.covariance for fit in fits])
    wide, thetas = enlarged(raw, day_ratio(fits)), np.array([fit.theta for fit in fits])
    b = slice(FIRST_BIAS, thetas.shape[1])
    estimate, spread = thetas[:, b], wide[:, b, b]
    size = estimate.shape[1]
    if not joint:
        missing = np.full(size, np.nan)
        return Fleet(thetas, wide, missing, np.outer(missing, missing), np.empty(0))
    pairs = [slice(k, k + 2) for k in range(0, size, 2)]
    tau = np.array([_between_scatter(estimate[:, pair], spread[:, pair, pair]) for pair in pairs])
    if len(fits) < 2:
        return Fleet(thetas, wide, estimate[0], spread[0], tau)
    prior = np.repeat(tau, 2) ** 2
    between = np.diag(prior)
    inverse = np.linalg.inv(spread + between)
    share = np.linalg.solve(inverse.sum(axis=0), inverse)
    mean = np.einsum("aij,aj->i", share, estimate)
    gain = wide[:, :, b] @ inverse
    theta = thetas + np.einsum("aij,aj->ai", gain, mean - estimate)
    flight_mean = share @ raw[:, b, b] @ share.transpose(0, 2, 1)
    flight_total = flight_mean.sum(axis=0)
    days = np.unique(np.concatenate([fit.day_number for fit in fits]))
    places = [np.searchsorted(days, fit.day_number) for fit in fits]
    common_day = np.zeros((days.size, size))
    for fit, place, w in zip(fits, places, share, strict=True):
        common_day[place] += fit.day[:, b] @ w.T
    # scatter between aircraft of the difference of a bias and the mean
    total_random = np.einsum("aij,j,akj->ik", share, prior, share)
    by_flight, by_day, random = np.empty((3, *wide.shape))
    for k, (fit, place, k_gain) in enumerate(zip(fits, places, gain, strict=True)):
        mapped = np.eye(thetas.shape[1])
        mapped[:, b] += k_gain @ (share[k] - np.eye(size))
        rest = k_gain @ (flight_total - flight_mean[k]) @ k_gain.T
        by_flight[k] = mapped @ raw[k] @ mapped.T + rest
        daily = common_day @ k_gain.T
        daily[place] += fit.day - fit.day[:, b] @ k_gain.T
        by_day[k] = daily.T @ daily
        twice = share[k] * prior
        random[k] = k_gain @ (total_random + between - twice - twice.T) @ k_gain.T
    flight, day = (np.diagonal(covariance, axis1=1, axis2=2) for covariance in (by_flight, by_day))
    mean_covariance = np.linalg.inv(inverse.sum(axis=0))
    day_part = common_day.T @ common_day + total_random
    wider = np.maximum(np.diagonal(day_part) / np.diagonal(mean_covariance), 1.0)
    return Fleet(
        theta,
        enlarged(by_flight, _mean_ratio(flight, day, fits)) + random,
        mean,
        enlarged(mean_covariance, wider),
        tau,
    )


def offsets(
    fits: list[AircraftFit], few: list[bool], curves: list[AircraftFit], *, joint: bool
) -> list[Offset | None]:
    """Offset of every aircraft that has no curve, from its fit with ``harmonics=0``.

    ``few``: aircraft with fewer than `MIN_FLIGHTS` flights, whose clusters are stretches;
    ``curves``: fits of the other aircraft against the same references; ``joint``: along-track
    errors were fitted. None where too few aircraft show the error of a single flight.
    """
    estimates: list[Offset | None] = [None] * len(fits)
    # variance of B, C, D and E over the fleet
    mean = np.square(USUAL_CYCLE)
    if len(curves) >= FEWEST_CURVES:
        squares = np.array([fit.theta[1:COMPASS] ** 2 for fit in curves])
        twice = squares[[fit.cycles == 2 for fit in curves], 2:].sum(axis=1)
        mean = np.array(
            [squares[:, :2].sum(axis=1).mean(), twice.mean() if twice.size else mean[1]]
        )
    cycles = np.repeat(mean / 2.0, 2)
    for kind in (False, True):
        place = [k for k, is_few in enumerate(few) if is_few == kind]
        group = [fits[k] for k in place]
        if not group or (kind and (len(group) < FEWEST_AIRCRAFT or not joint)):
            continue
        bias = _bias(group, [] if kind else curves, joint)
        ratio = float(day_ratio(group)[0])
        for k, fit in zip(place, group, strict=True):
            estimates[k] = _offset(fit, bias, ratio, cycles)
    return estimates


_Bias = tuple[Array, Array, Array]
"""Reference's bias of all members: mean, covariance, scatter between aircraft (members,)."""


def _offset(fit: AircraftFit, bias: _Bias, ratio: float, cycles: Array) -> Offset:
    mean, covariance, scatter = bias
    slope, flown = (fit.normal[0, columns] / fit.normal[0, 0] for columns in (_BIASES, _CYCLES))
    raw = float(fit.covariance[0, 0])
    # errors of the references of a pool are correlated: their scatters add up, not their squares
    shared = ((np.abs(slope.reshape(-1, 2)) * scatter[:, np.newaxis]).sum(axis=0) ** 2).sum()
    sampling = raw * float(t_inflation(fit.freedom[:1])[0] ** 2) * ratio
    variance = sampling + float(slope @ covariance @ slope) + float(shared)
    # only the mean of A to E over the headings flown is known
    square = np.diag(np.concatenate([[variance + flown**2 @ cycles], cycles]))
    square[0, 1:] = square[1:, 0] = -flown * cycles
    first = fit.flight_order[: fit.flight_order.size // 2]
    change = 4.0 * float(fit.flight[first, 0].sum())
    # a step increases the scatter of the clusters itself, which is subtracted
    inside = max(raw * ratio - change**2 / (4.0 * fit.flight_order.size), 0.05 * raw * ratio)
    changed = abs(change) > HALVES_DIFFERENCE and change**2 > HALVES_CHI2 * 4.0 * inside
    value = float(fit.theta[0] - slope @ mean)
    return Offset(value, variance, fit.converged and not changed, square)


def _bias(group: list[AircraftFit], curves: list[AircraftFit], joint: bool) -> _Bias:
    members = (group[0].theta.size - FIRST_BIAS) // 2
    if joint and len(curves) >= 2:
        fleet = pool(curves, joint=True)
        return fleet.bias, fleet.bias_covariance, fleet.tau
    mean, covariance, scatter = np.zeros(2), np.zeros((2, 2)), USUAL_BIAS
    if joint and len(group) >= FEWEST_AIRCRAFT:
        mean, covariance, scatter = _from_airspeed(group)
    return np.tile(mean, members), np.tile(covariance, (members,) * 2), np.full(members, scatter)


def _from_airspeed(group: list[AircraftFit]) -> tuple[Array, Array, float]:
    """Bias common to all members from along-track errors: s_k V = s V + b along heading k.

    Its mean is used only where the headings of the fleet separate it from the mean airspeed scale.
    """
    normal = np.array([fit.normal for fit in group])
    along = normal[:, COMPASS, FIRST_BIAS:].reshape(len(group), -1, 2).sum(axis=1)
    strength = normal[:, COMPASS, COMPASS]
    # mean airspeed: the normal matrix holds sums of weights with and without its square
    weights = np.trace(normal[:, FIRST_BIAS:, FIRST_BIAS:], axis1=1, axis2=2)
    speed = np.sqrt((normal[:, 0, 0] + strength) / weights)
    design = np.column_stack([np.ones(len(group)), along / strength[:, np.newaxis]])
    design *= speed[:, np.newaxis]
    error = speed * [fit.theta[COMPASS] for fit in group]
    # in a fleet that flies one way the bias is no different from a scale: only the scatter is used
    condition = np.linalg.cond(design / np.sqrt((design**2).mean(axis=0)))
    if condition > 10.0 or len(group) < 2 * FEWEST_AIRCRAFT:
        spread = error - np.median(error)
        return np.zeros(2), np.zeros((2, 2)), float(np.sqrt((spread**2).sum() / (len(group) - 1)))
    inverse = np.linalg.inv(design.T @ design)
    coefficients = inverse @ design.T @ error
    residual = error - design @ coefficients
    variance = float(residual @ residual) / (len(group) - 3)
    return coefficients[1:], inverse[1:, 1:] * variance, float(np.sqrt(variance))
