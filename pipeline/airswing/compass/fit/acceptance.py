"""From the fits of single aircraft to the published fits: the fleet, choice of cycles, status.

Assumes what `airswing.compass.fit.deviation` says of the fits. Works on the sums that are kept of
each aircraft, not on reports.

Without the shared error of the reference, biases are pooled over the fleet
(`airswing.compass.fit.pooled_bias`) and errors are clustered by flight, enlarged where days scatter
more. With it, the whole fleet is solved together (`airswing.compass.fleet.solution`) and errors are
clustered by day. Where headings or flights do not allow a curve the constant alone is published
(`airswing.compass.fit.offset_alone`): A, the other coefficients zero with the variance of cycles as
large as the fleet's, without amplitude. A fit that does not improve the winds of held-out days is
not published (`airswing.compass.fit.held_out`). Coefficients are NaN where nothing is published.

Intervals: coefficients are taken as normal; functions of them to first order (delta method), except
that the phase's error near zero amplitude is that of the arc sine.

References
----------
Schwarz 1978, Ann. Stat. 6, 461-464 (BIC); Stein 1956 (shrinkage).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.held_out import held_out_improvement, is_implausible, is_zero
from airswing.compass.fit.kernel import COMPASS, FOLDS, AircraftFit
from airswing.compass.fit.offset_alone import MIN_FLIGHTS, offsets
from airswing.compass.fit.pooled_bias import day_ratio, enlarged, pool
from airswing.compass.fit.sandwich import Array, Index, t_inflation
from airswing.compass.fleet.solution import SEGMENTS_A_DAY, solve_fleet
from airswing.flags import STATUS, published
from airswing.units import NORMAL_95
from airswing.vocabulary import lookup

MAX_CONDITION = 12.0
"""Condition number of the heading design, 1 for evenly spread headings: above it two cycles become
one, and one becomes an offset."""
MAX_STANDARD_ERROR = 1.5
"""Degrees: largest standard error of A, B and C of a published fit."""
HALVES_RMS, HALVES_CHI2 = 1.0, 25.0
"""The compass changed where the curves of both halves of the period differ by more than this, in
degrees rms and in Wald's statistic on three degrees of freedom (probability 1.5e-5)."""
LEAST_REPORTS = 500
"""Reports of usable fits below which no shared error of the reference is estimated."""

_Table = dict[str, NDArray[Any]]
_SINUSOID = ("offset", "amplitude", "phase")


@dataclass(frozen=True)
class Options:
    """Options of the fit.

    Attributes
    ----------
    harmonics : {"auto", 1, 2}
        Cycles of the curve; "auto" keeps the second where the data show it.
    joint : bool
        Fit airspeed errors jointly, with airspeed scale and reference bias; else the heading error
        alone.
    shared_error : bool
        With ``joint``, also fit the error of the reference that the fleet shares, as a field (see
        `airswing.compass.fleet.field`).
    min_reports, min_compass_points : int
        Fewer give status ``too_few_reports``, ``poor_heading_coverage``; fewer than five flights
        ``too_few_flights``. Where a constant is found instead, the last two are ``offset_only``.
    """

    harmonics: Literal["auto", 1, 2] = "auto"
    joint: bool = True
    shared_error: bool = True
    min_reports: int = 200
    min_compass_points: int = 6


class Asked(TypedDict, total=False):
    """Fields of :class:`Options` as keywords."""

    harmonics: Literal["auto", 1, 2]
    joint: bool
    shared_error: bool
    min_reports: int
    min_compass_points: int


class FitOptions(Asked, total=False):
    """Options of :func:`airswing.compass.fit.deviation.fit_deviation` except the pools."""

    abscissa: Literal["magnetic", "true"]


@dataclass
class AircraftSums:
    """Fit of one aircraft by itself, before the fleet."""

    reports: int
    flights: int
    compass_points: int
    fit: AircraftFit | None
    status: int  # code of `airswing.flags.STATUS`
    field: float  # mean horizontal field of the reports used, nT; NaN where unknown
    constant: AircraftFit | None = None  # fit of the constant alone, where there is no curve


@dataclass(frozen=True)
class _Estimate:
    """Coefficients of the fleet with their covariance, cycles chosen."""

    theta: Array
    covariance: Array
    cycles: list[int]
    without: Array  # (aircraft, FOLDS, 5): A to E without the days of each part; NaN where unknown
    bias: Array
    bias_covariance: Array
    regions: int = 1


_WITH_ERROR = (*_SINUSOID, "airspeed_scale", "held_out_improvement", "reference_bias")
_PUBLISHED = {
    name: lookup(name, ("reference", "aircraft"))
    for name in (
        "deviation",
        "deviation_covariance",
        "held_out_deviation",
        *(f"{name}{suffix}" for name in _WITH_ERROR for suffix in ("", "_standard_error")),
        "condition_number",
        "residual_rms_before",
        "residual_rms_after",
        "mean_horizontal_field",
        "report_count",
        "flight_count",
        "compass_points",
        "status",
        "harmonics",
        "shared_error_regions",
    )
}
"""Variables of the fit against one reference; their last dimensions are those of the table."""


def publish(aircraft: list[AircraftSums], options: Options) -> xr.Dataset:
    """Fit a fleet against one reference or pool.

    Parameters
    ----------
    aircraft : list of AircraftSums
    options : Options

    Returns
    -------
    Dataset
        Dimensions ``aircraft``, ``coefficient``, ``coefficient_2``, ``component``, ``fold``.
    """
    sizes = {
        "aircraft": len(aircraft),
        "coefficient": COMPASS,
        "coefficient_2": COMPASS,
        "fold": FOLDS,
        "component": 2,
    }
    table: _Table = {}
    for name, entry in _PUBLISHED.items():
        shape = [sizes[dim] for dim in entry.dims[1:]]
        table[name] = np.full(shape, 0 if entry.dtype.startswith("i") else np.nan)
    for k, one in enumerate(aircraft):
        table["report_count"][k], table["flight_count"][k] = one.reports, one.flights
        table["compass_points"][k], table["status"][k] = one.compass_points, one.status
        table["mean_horizontal_field"][k] = one.field
        if one.fit is not None:
            table["condition_number"][k] = condition_number(one.fit.normal, _cycles(one.fit))
    table["shared_error_regions"][...] = 1
    curves = {k: one.fit for k, one in enumerate(aircraft) if one.status == STATUS["ok"]}
    _publish_curves(table, {k: fit for k, fit in curves.items() if fit is not None}, options)
    _publish_offsets(table, aircraft, options)
    return xr.Dataset(
        {name: (e.dims[1:], table[name].astype(e.dtype)) for name, e in _PUBLISHED.items()}
    )


def condition_number(normal: Array, harmonics: int) -> float:
    """Return the condition number of the heading design, columns scaled to unit mean square.

    Parameters
    ----------
    normal : array, shape (p, p)
        Normal matrix with A, B, C, D, E first.
    harmonics : {1, 2}

    Returns
    -------
    float
        1 for headings spread evenly; infinite where a column depends on the others.
    """
    size = 1 + 2 * harmonics
    # sines and cosines spread evenly have half the mean square of the constant
    scale = np.array([1.0, *[np.sqrt(2.0)] * (size - 1)])
    values = np.linalg.eigvalsh(normal[:size, :size] * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def _cycles(fit: AircraftFit) -> int:
    return 2 if 4 in fit.free else 1


def _publish_curves(table: _Table, curves: dict[int, AircraftFit], options: Options) -> None:
    if not curves:
        return
    ratio = day_ratio(list(curves.values()))
    for k, fit in curves.items():
        rms, chi2 = halves_apart(fit.flight, fit.flight_order, enlarged(fit.covariance, ratio))
        changed = np.degrees(rms) > HALVES_RMS and chi2 > HALVES_CHI2
        if changed or not fit.converged:
            table["status"][k] = STATUS["unstable_fit"]
    curves = {k: fit for k, fit in curves.items() if table["status"][k] == STATUS["ok"]}
    fits = list(curves.values())
    if not fits:
        return
    shared = options.joint and options.shared_error and all(fit.blocks for fit in fits)
    if shared and table["report_count"][list(curves)].sum() >= LEAST_REPORTS:
        found = _with_field(fits, options)
    else:
        found = _without_field(fits, ratio, options)
    for row, (k, fit) in enumerate(curves.items()):
        _publish_curve(table, k, fit, found, row, options.joint)
    table["shared_error_regions"][...] = found.regions
    if options.joint:
        bias = found.bias.reshape(-1, 2)
        average = np.tile(np.eye(2), bias.shape[0]) / bias.shape[0]
        variance = np.diagonal(average @ found.bias_covariance @ average.T)
        table["reference_bias"][:] = bias.mean(axis=0)
        table["reference_bias_standard_error"][:] = np.sqrt(variance)


def _with_field(fits: list[AircraftFit], options: Options) -> _Estimate:
    """Solve the fleet together with the error of its references."""
    free = np.array([[k in fit.free for k in range(COMPASS + 1)] for fit in fits])
    fleet = solve_fleet([fit.blocks for fit in fits], free)
    thetas, covariances, cycles, without = [], [], [], []
    for k, fit in enumerate(fits):
        weight = np.zeros(FOLDS)
        for one in fit.blocks:
            weight += np.bincount(one.segment // SEGMENTS_A_DAY % FOLDS, one.sums[0], FOLDS)
        theta, square = fit.theta[: COMPASS + 1] + fleet.step[k], fleet.covariance[k]
        number, to_one, extra = _choice(
            fit, theta, square, np.flatnonzero(free[k]), np.linalg.pinv(square), options
        )
        widen = t_inflation(fit.freedom[: COMPASS + 1])
        thetas.append(to_one @ theta)
        left_out = fleet.without[:, k] * _enlargement(weight)[:, np.newaxis]
        without.append(((theta + left_out) @ to_one.T)[:, :COMPASS])
        covariances.append((to_one @ square @ to_one.T + extra) * np.outer(widen, widen))
        cycles.append(number)
    return _Estimate(
        np.array(thetas),
        np.array(covariances),
        cycles,
        np.array(without),
        fleet.bias,
        fleet.bias_covariance,
        fleet.regions,
    )


def _without_field(fits: list[AircraftFit], ratio: Array, options: Options) -> _Estimate:
    """Fit aircraft by aircraft, with the references' bias pooled over the fleet."""
    cycles, kept, added = [], [], []
    for fit in fits:
        square = enlarged(fit.covariance, ratio)
        number, to_one, extra = _choice(fit, fit.theta, square, fit.free, fit.normal, options)
        if number < _cycles(fit):
            fit = replace(
                fit, theta=to_one @ fit.theta, flight=fit.flight @ to_one.T, day=fit.day @ to_one.T
            )
        cycles.append(number)
        kept.append(fit)
        added.append(extra)
    fleet = pool(kept, joint=options.joint)
    widen = np.array([t_inflation(fit.freedom) for fit in fits])
    covariance = (fleet.covariance + np.array(added)) * widen[:, :, None] * widen[:, None]
    without = np.array(
        [
            theta[:COMPASS] + _without_days(fit, square)
            for fit, theta, square in zip(kept, fleet.theta, fleet.covariance, strict=True)
        ]
    )
    return _Estimate(fleet.theta, covariance, cycles, without, fleet.bias, fleet.bias_covariance)


def _without_days(fit: AircraftFit, covariance: Array) -> Array:
    """Change of A to E (FOLDS, 5) without each part of the days, from the influences of the days.

    Influences are brought to the published covariance, which holds what the fleet knows.
    """
    used = np.flatnonzero(np.diagonal(fit.day_covariance)[:COMPASS])
    square = np.ix_(used, used)
    roots = [np.linalg.cholesky(one[square]) for one in (fit.covariance, covariance)]
    influence = fit.day[:, used] @ np.linalg.solve(roots[0].T, roots[1].T)
    part = fit.day_number % FOLDS
    found = np.zeros((FOLDS, COMPASS))
    np.add.at(found, (part[:, np.newaxis], used), -influence)
    return found * _enlargement(np.bincount(part, minlength=FOLDS))[:, np.newaxis]


def _enlargement(weight: NDArray[Any]) -> Array:
    """Weight of all parts over that without each; NaN for a part of more than half."""
    share = weight / max(float(weight.sum()), 1e-30)
    return np.where(share <= 0.5, 1.0 / np.maximum(1.0 - share, 0.5), np.nan)


def _choice(
    fit: AircraftFit,
    theta: Array,
    covariance: Array,
    free: Index,
    normal: Array,
    options: Options,
) -> tuple[int, Array, Array]:
    """Number of cycles, the map to the estimate with so many, and the covariance to add."""
    cycles, keep, none = _cycles(fit), np.eye(theta.size), np.zeros_like(covariance)
    if cycles == 1 or options.harmonics != "auto":
        return cycles, keep, none
    statistic = float(theta[3:5] @ np.linalg.solve(covariance[3:5, 3:5], theta[3:5]))
    # a quasi-BIC that counts independent clusters instead of reports; with one or two days the
    # price of the two parameters would be close to zero
    if statistic > 2.0 * np.log(max(fit.day_number.size, 3)):
        return 2, keep, none
    to_one = one_cycle_map(normal, free)
    return 1, to_one, choice_covariance(theta - to_one @ theta, covariance, statistic)


def _publish_curve(
    table: _Table, k: int, fit: AircraftFit, found: _Estimate, row: int, joint: bool
) -> None:
    theta, covariance = found.theta[row], found.covariance[row]
    deviation = np.degrees(theta[:COMPASS])
    square = covariance[:COMPASS, :COMPASS] * np.degrees(1.0) ** 2
    if np.sqrt(np.diagonal(square)[:3].max()) > MAX_STANDARD_ERROR:
        table["status"][k] = STATUS["unstable_fit"]
        return
    if not _improves(table, k, fit, theta[:COMPASS], covariance[:COMPASS, :COMPASS]):
        return
    table["deviation"][k], table["deviation_covariance"][k] = deviation, square
    table["held_out_deviation"][k] = np.degrees(found.without[row])
    for name, value, error in zip(_SINUSOID, *sinusoid(deviation, square), strict=True):
        table[name][k], table[f"{name}_standard_error"][k] = value, error
    table["harmonics"][k] = found.cycles[row]
    table["residual_rms_before"][k] = np.degrees(fit.rms_before)
    table["residual_rms_after"][k] = np.degrees(fit.rms_after)
    if joint:
        table["airspeed_scale"][k] = theta[COMPASS]
        table["airspeed_scale_standard_error"][k] = np.sqrt(covariance[COMPASS, COMPASS])


def _publish_offsets(table: _Table, aircraft: list[AircraftSums], options: Options) -> None:
    """Publish the constant of every aircraft that has no curve."""
    alone = {k: one for k, one in enumerate(aircraft) if one.constant is not None}
    constants = [one.constant for one in alone.values() if one.constant is not None]
    curves = [
        one.fit
        for one, usable in zip(aircraft, published(table["status"]), strict=True)
        if usable and one.fit is not None
    ]
    few = [one.flights < MIN_FLIGHTS for one in alone.values()]
    found = offsets(constants, few, curves, joint=options.joint)
    for k, fit, offset in zip(alone, constants, found, strict=True):
        if offset is None:
            continue
        error = np.degrees(np.sqrt(offset.variance))
        if not offset.stable or error > MAX_STANDARD_ERROR:
            table["status"][k] = STATUS["unstable_fit"]
            continue
        table["status"][k] = STATUS["offset_only"]
        theta = np.array([offset.value, 0.0, 0.0, 0.0, 0.0])
        if not _improves(table, k, fit, theta, fit.covariance[:COMPASS, :COMPASS]):
            continue
        table["deviation"][k] = 0.0
        table["deviation"][k, 0] = table["offset"][k] = np.degrees(offset.value)
        table["deviation_covariance"][k] = offset.covariance * np.degrees(1.0) ** 2
        table["held_out_deviation"][k] = np.degrees(theta + _without_days(fit, fit.covariance))
        table["offset_standard_error"][k] = error
        table["residual_rms_before"][k] = np.degrees(fit.rms_before)
        table["residual_rms_after"][k] = np.degrees(fit.rms_after)


def _improves(table: _Table, k: int, fit: AircraftFit, theta: Array, covariance: Array) -> bool:
    """Set the status by the days held out; return False where nothing is to be published."""
    found = held_out_improvement(fit, theta, covariance)
    if found is not None:
        table["held_out_improvement"][k] = found.mean
        table["held_out_improvement_standard_error"][k] = found.standard_error
    if fit.held_out and is_implausible(fit, theta):
        table["status"][k] = STATUS["implausible_reports"]
        return False
    if table["status"][k] == STATUS["ok"] and is_zero(theta, covariance):
        table["status"][k] = STATUS["no_correction_needed"]
    elif found is not None and found.mean <= 0.0:
        table["status"][k] = STATUS["no_improvement"]
        return False
    return True


def sinusoid(coefficients: Array, covariance: Array) -> tuple[Array, Array]:
    """Return offset, amplitude and phase of offset + amplitude sin(m + phase), with their errors.

    Parameters
    ----------
    coefficients : array, shape (>= 3,)
        A, B, C ... in degrees.
    covariance : array, shape (>= 3, >= 3)
        degree2.

    Returns
    -------
    value, error : arrays, shape (3,)
        Degrees. The error of the amplitude is that along (B, C); the error of the phase is that
        across it over the amplitude, and tends to the half circle near zero amplitude.
    """
    a, b, c = coefficients[:3]
    amplitude = float(np.hypot(b, c))
    square = covariance[1:3, 1:3]
    # at zero amplitude no direction is given: the one with the largest variance
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


def one_cycle_map(normal: Array, free: Index) -> Array:
    """Return the map (p, p) from the two-cycle estimate to that with D = E = 0.

    Parameters
    ----------
    normal : array, shape (p, p)
        Normal matrix of the two-cycle estimate.
    free : array of int
        Parameters that were fitted.
    """
    kept = free[(free != 3) & (free != 4)]
    found = np.eye(normal.shape[0])
    found[3:5, 3:5] = 0.0
    found[np.ix_(kept, [3, 4])] = np.linalg.solve(
        normal[np.ix_(kept, kept)], normal[np.ix_(kept, [3, 4])]
    )
    return found


def choice_covariance(shift: Array, covariance: Array, statistic: float) -> Array:
    """Return the covariance (p, p) to add where one cycle was chosen.

    Parameters
    ----------
    shift : array, shape (p,)
        Two-cycle estimate minus the published one. Of A, B and C it is their possible bias plus
        noise; the positive part of Stein's factor, 1 - 2 / statistic, removes the noise.
    covariance : array, shape (p, p)
        Of the two-cycle estimate. D and E, published as zero, keep it, plus the square of their
        estimate: their interval then holds a small second cycle that the data could not show.
    statistic : float
        Wald's statistic of the second cycle.
    """
    factor = max(0.0, 1.0 - 2.0 / statistic) if statistic > 0 else 0.0
    added = factor * np.outer(shift, shift)
    added[3:5, 3:5] = covariance[3:5, 3:5] + np.outer(shift[3:5], shift[3:5])
    return np.asarray(added)


def halves_apart(influence: Array, order: Index, covariance: Array) -> tuple[float, float]:
    """Return the difference of the curves of the first and second half of the flights.

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
    # the estimate from one half differs by twice the sum of its influences, that from the other
    # half by the opposite, because all influences add up to zero
    apart = 4.0 * influence[first].sum(axis=0)[:3]
    rms = float(np.sqrt(apart[0] ** 2 + 0.5 * (apart[1] ** 2 + apart[2] ** 2)))
    return rms, float(apart @ np.linalg.solve(4.0 * covariance[:3, :3], apart))
