"""One constant for an aircraft whose headings or flights do not allow a curve.

Assumptions
-----------
psi_err = A over the headings flown; other headings are unknown, and no amplitude is estimated. The
reference's bias b enters as (b_u cos psi - b_v sin psi) / V and cannot be separated from A on one
heading. It therefore comes from the rest of the fleet: from the aircraft with curves where there
are two or more, else from the along-track errors of the aircraft without, which do not depend on
the compass. Its scatter between aircraft widens the interval; from along-track errors that scatter
includes the airspeed errors, so that the interval is rather too wide than too narrow.

The covariance of A to E is that of a curve whose cycles are as large as the fleet's (`USUAL_CYCLE`
where there are fewer than `FEWEST_CURVES` curves) and whose mean over the headings flown is the
constant. At the headings of one route it adds nothing; flown out and back, or at other headings, it
is the amplitude itself.

Errors are clustered by flight. Fewer than `MIN_FLIGHTS` flights are too few to estimate the
reference's error of a flight: their clusters are stretches of `STRETCH`, and the error of a flight
is that of the along-track errors of all such aircraft, `FEWEST_AIRCRAFT` of them or more.

Radians and m/s inside.

References
----------
de Haan 2011 (J. Geophys. Res. 116, D10111): one heading correction an aircraft from Mode-S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airswing.compass.fit.kernel import COMPASS, AircraftFit
from airswing.compass.fit.pooled_bias import FIRST_BIAS, day_ratio, pool
from airswing.compass.fit.sandwich import Array, t_inflation

MIN_FLIGHTS = 5
"""Flights below which the clusters are stretches within flights."""
STRETCH = np.timedelta64(120, "s")
"""Length of a cluster within a flight where there are too few flights."""
FEWEST_CURVES = 3
"""Aircraft with curves from which the size of the cycles is estimated."""
USUAL_CYCLE = (np.radians(3.0), np.radians(1.0))
"""Radians: rms amplitude of one and of two cycles in the sample fleets and published tables."""
FEWEST_AIRCRAFT = 6
"""Aircraft from whose along-track errors the scatter of the reference's bias is estimated."""
USUAL_BIAS = 0.5
"""m/s: scatter of the reference's bias between aircraft where it cannot be estimated."""
HALVES_APART, HALVES_CHI2 = np.radians(1.0), 18.7
"""Difference between the halves of the period, and its chi-square, from which on a compass has
changed: as for curves, whose chi-square of 25 on three degrees of freedom is as rare as this on
one."""


@dataclass(frozen=True)
class Offset:
    """A constant and its variance, radians; ``stable`` where both halves of the period agree.

    ``covariance`` (5, 5) is that of A to E, cycles included.
    """

    value: float
    variance: float
    stable: bool
    covariance: Array


@dataclass(frozen=True)
class _Bias:
    """Reference's bias of all members: mean, covariance, scatter between aircraft (members,)."""

    mean: Array
    covariance: Array
    scatter: Array


def offsets(
    fits: list[AircraftFit], few: list[bool], curves: list[AircraftFit], *, joint: bool
) -> list[Offset | None]:
    """Return the offset of every aircraft that has no curve.

    Parameters
    ----------
    fits : list of AircraftFit
        Fitted with ``harmonics=0``.
    few : list of bool
        Whether an aircraft has fewer than `MIN_FLIGHTS` flights, its clusters being stretches.
    curves : list of AircraftFit
        Of the aircraft with curves, against the same references.
    joint : bool
        Whether along-track errors were fitted.

    Returns
    -------
    list of Offset or None
        None where too few aircraft show the error of a single flight.
    """
    if not fits:
        return []
    found: list[Offset | None] = [None] * len(fits)
    cycles = _usual_cycles(curves)
    for kind in (False, True):
        place = [k for k, one in enumerate(few) if one == kind]
        group = [fits[k] for k in place]
        if not group or (kind and (len(group) < FEWEST_AIRCRAFT or not joint)):
            continue
        bias = _bias(group, [] if kind else curves, joint)
        ratio = day_ratio(group)[0]
        for k, fit in zip(place, group, strict=True):
            found[k] = _offset(fit, bias, float(ratio), cycles)
    return found


def _usual_cycles(curves: list[AircraftFit]) -> Array:
    """Variance of B, C, D and E over a fleet, (4,), radians squared."""
    mean = np.square(USUAL_CYCLE)
    if len(curves) >= FEWEST_CURVES:
        square = np.array([fit.theta[1:COMPASS] ** 2 for fit in curves])
        once = square[:, :2].sum(axis=1).mean()
        fitted = [row[2:].sum() for row, fit in zip(square, curves, strict=True) if 4 in fit.free]
        mean = np.array([once, np.mean(fitted) if fitted else mean[1]])
    return np.asarray(np.repeat(mean / 2.0, 2))


def _curve_covariance(variance: float, flown: Array, cycles: Array) -> Array:
    """Covariance (5, 5) of A to E where only their mean over the headings flown is known.

    ``flown`` (4,) is the mean over these headings of what B to E are multiplied by, ``cycles``
    (4,) their variance.
    """
    found = np.diag(np.concatenate([[variance + flown**2 @ cycles], cycles]))
    found[0, 1:] = found[1:, 0] = -flown * cycles
    return found


def _offset(fit: AircraftFit, bias: _Bias, ratio: float, cycles: Array) -> Offset:
    slope = fit.normal[0, FIRST_BIAS:] / fit.normal[0, 0]
    sampling = float(fit.covariance[0, 0] * t_inflation(fit.freedom[:1])[0] ** 2) * ratio
    changed = _changed(fit, float(fit.covariance[0, 0]) * ratio)
    # errors of the references of a pool are correlated: their scatters add up, not their squares
    shared = ((np.abs(slope.reshape(-1, 2)) * bias.scatter[:, np.newaxis]).sum(axis=0) ** 2).sum()
    variance = sampling + float(slope @ bias.covariance @ slope) + float(shared)
    flown = fit.normal[0, 1:COMPASS] / fit.normal[0, 0]
    return Offset(
        float(fit.theta[0] - slope @ bias.mean),
        variance,
        fit.converged and not changed,
        _curve_covariance(variance, flown, cycles),
    )


def _changed(fit: AircraftFit, variance: float) -> bool:
    """Whether the halves of the period have different offsets."""
    first = fit.flight_order[: fit.flight_order.size // 2]
    apart = 4.0 * float(fit.flight[first, 0].sum())
    # a step increases the scatter of the clusters itself, which is subtracted
    inside = max(variance - apart**2 / (4.0 * fit.flight_order.size), 0.05 * variance)
    return abs(apart) > HALVES_APART and apart**2 > HALVES_CHI2 * 4.0 * inside


def _bias(group: list[AircraftFit], curves: list[AircraftFit], joint: bool) -> _Bias:
    members = (group[0].theta.size - FIRST_BIAS) // 2
    if joint and len(curves) >= 2:
        fleet = pool(curves, joint=True)
        return _Bias(fleet.bias, fleet.bias_covariance, fleet.tau)
    mean, covariance, scatter = np.zeros(2), np.zeros((2, 2)), USUAL_BIAS
    if joint and len(group) >= FEWEST_AIRCRAFT:
        mean, covariance, scatter = _from_airspeed(group)
    return _Bias(
        np.tile(mean, members), np.tile(covariance, (members, members)), np.full(members, scatter)
    )


def _from_airspeed(group: list[AircraftFit]) -> tuple[Array, Array, float]:
    """Bias common to all members from along-track errors: s_k V = s V + b along heading k.

    Its mean is used only where the headings of the fleet separate it from the mean airspeed scale.
    """
    along = np.array([fit.normal[COMPASS, FIRST_BIAS:] for fit in group])
    along = along.reshape(len(group), -1, 2).sum(axis=1)
    strength = np.array([fit.normal[COMPASS, COMPASS] for fit in group])[:, np.newaxis]
    design = np.hstack([np.ones((len(group), 1)), along / strength])
    scale = np.array([fit.theta[COMPASS] for fit in group])
    speed = np.array([_airspeed(fit) for fit in group])
    design, error = design * speed[:, np.newaxis], scale * speed
    size = np.sqrt((design**2).mean(axis=0))
    # in a fleet that flies one way the bias is no different from a scale: only the scatter is used
    if np.linalg.cond(design / size) > 10.0 or len(group) < 2 * FEWEST_AIRCRAFT:
        spread = error - np.median(error)
        return np.zeros(2), np.zeros((2, 2)), float(np.sqrt((spread**2).sum() / (len(group) - 1)))
    inverse = np.linalg.inv(design.T @ design)
    found = inverse @ design.T @ error
    rest = error - design @ found
    variance = float(rest @ rest) / (len(group) - 3)
    return found[1:], inverse[1:, 1:] * variance, float(np.sqrt(variance))


def _airspeed(fit: AircraftFit) -> float:
    """Mean airspeed, m/s: the normal matrix holds sums of weights with and without its square."""
    weights = np.trace(fit.normal[FIRST_BIAS:, FIRST_BIAS:])
    return float(np.sqrt((fit.normal[0, 0] + fit.normal[COMPASS, COMPASS]) / weights))
