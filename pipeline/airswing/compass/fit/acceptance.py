"""From the fits of single aircraft to the published fits: the fleet, choice of cycles, status.

Works on the sums of each aircraft. Without the shared error of the reference, biases are pooled
over the fleet (`airswing.compass.fit.pooling`) and errors are clustered by flight, enlarged where
days scatter more; with it, the whole fleet is solved together (`airswing.compass.fleet.solution`)
and errors are clustered by day. Where headings or flights do not allow a curve only the constant is
published: A, the other coefficients zero with the variance of cycles as large as the fleet's.

*Held-out days.* The days of an aircraft are divided into `FOLDS` parts (its flights, where there
are fewer than five days). Without the reports of one part the coefficients are, to first order, the
published ones minus the sum of the influences of the part's flights, scaled to the published
covariance and enlarged by the weight of the others. The squared vector disagreement with the
reference is a quadratic function of the coefficients, whose sums by part the fit has kept. The bias
of the reference is removed before and after the correction, but at most `MAX_BIAS` of it. Where a
significant curve does not improve held-out days, the model does not describe the reports.

References
----------
Schwarz 1978, Ann. Stat. 6, 461-464 (BIC); Stein 1956 (shrinkage); Stone 1974, J. Roy. Stat. Soc. B
36 (cross-validation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import chdtri

from airswing.compass.fit.kernel import COMPASS, FOLDS, AircraftFit, HeldOut
from airswing.compass.fit.pooling import (
    MIN_FLIGHTS,
    day_ratio,
    enlarged,
    offsets,
    pool,
    t_inflation,
)
from airswing.compass.fleet.field import Array, Index
from airswing.compass.fleet.solution import SEGMENTS_A_DAY, solve_fleet
from airswing.config import Fit
from airswing.flags import STATUS, published
from airswing.units import NORMAL_95
from airswing.vocabulary import lookup

MAX_CONDITION = 12.0
"""Condition number of the heading design, 1 for evenly spread headings: above it two cycles become
one, and one becomes an offset."""
MAX_STANDARD_ERROR = 1.5  # degrees: largest standard error of A, B and C of a published fit
HALVES_RMS, HALVES_CHI2 = 1.0, 25.0
"""The compass changed where the curves of both halves of the period differ by more than this, in
degrees rms and in Wald's statistic on three degrees of freedom (probability 1.5e-5)."""
LEAST_REPORTS = 500
"""Reports of usable fits below which no shared error of the reference is estimated."""
MAX_BIAS = 1.5
"""m s-1: largest mean difference of an aircraft's winds from a reference that is removed as the
bias of the reference: twice that of the worked example of the joint fit, 0.8 m s-1."""
SIGNIFICANCE = 0.05  # probability that an aircraft without deviation is found to have one
IMPLAUSIBLE = 5.0
"""m s-1: mean vector difference from a reference, deviation removed, that is an error of the
reports: more than three times `MAX_BIAS`, and twice the rms of a component of Mode-S and AMDAR
winds against a model (2.1 to 2.5 m s-1; Stone & Pearce 2016, J. Atmos. Oceanic Technol. 33). Winds
in m/s read as kt give about half the mean wind, 10 m s-1 at cruise."""

_Table = dict[str, NDArray[Any]]
_SINUSOID = ("offset", "amplitude", "phase")


class FitOptions(TypedDict, total=False):
    """Fields of :class:`airswing.config.Fit` as keywords."""

    abscissa: Literal["magnetic", "true"]
    harmonics: Literal["auto", 1, 2]
    joint: bool
    shared_error: bool
    min_reports: int
    min_compass_points: int


@dataclass
class AircraftSums:
    """Fit of a single aircraft, before the fit of the fleet."""

    reports: int
    flights: int
    compass_points: int
    fit: AircraftFit | None
    status: int  # code of `airswing.flags.STATUS`
    field: float  # mean horizontal field of the reports used, nT; NaN where unknown
    constant: AircraftFit | None = None  # fit of the constant only, without a curve


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
        *("deviation", "deviation_covariance", "held_out_deviation"),
        *(f"{name}{suffix}" for name in _WITH_ERROR for suffix in ("", "_standard_error")),
        *("condition_number", "residual_rms_before", "residual_rms_after"),
        *("mean_horizontal_field", "report_count", "flight_count", "compass_points"),
        *("status", "harmonics", "shared_error_regions"),
    )
}
"""Variables of the fit against one reference; their last dimensions are those of the table."""
_COPIED = {
    **{"report_count": "reports", "flight_count": "flights", "compass_points": "compass_points"},
    **{"status": "status", "mean_horizontal_field": "field"},
}
"""Variables of the fit, and the attribute of `AircraftSums` that each holds."""
_SIZES = {"coefficient": COMPASS, "coefficient_2": COMPASS, "fold": FOLDS, "component": 2}


def publish(aircraft: list[AircraftSums], options: Fit) -> xr.Dataset:
    """Fit a fleet against one reference or pool.

    Returns the variables of ``fits.nc`` with the dimensions ``aircraft``, ``coefficient``,
    ``coefficient_2``, ``component`` and ``fold``.
    """
    sizes = {"aircraft": len(aircraft)} | _SIZES
    table: _Table = {}
    for name, entry in _PUBLISHED.items():
        shape = [sizes[dim] for dim in entry.dims[1:]]
        table[name] = np.full(shape, 0 if entry.dtype.startswith("i") else np.nan)
    for name, attribute in _COPIED.items():
        table[name][:] = [getattr(sums, attribute) for sums in aircraft]
    table["shared_error_regions"][...] = 1
    fitted = {k: sums.fit for k, sums in enumerate(aircraft) if sums.fit is not None}
    for k, fit in fitted.items():
        table["condition_number"][k] = condition_number(fit.normal, fit.cycles)
    ok = STATUS["ok"]
    _publish_curves(table, {k: f for k, f in fitted.items() if aircraft[k].status == ok}, options)
    usable = published(table["status"])
    _publish_offsets(
        table,
        {k: sums.constant for k, sums in enumerate(aircraft) if sums.constant is not None},
        [sums.flights < MIN_FLIGHTS for sums in aircraft if sums.constant is not None],
        [fit for k, fit in fitted.items() if usable[k]],
        joint=options.joint,
    )
    return xr.Dataset(
        {name: (e.dims[1:], table[name].astype(e.dtype)) for name, e in _PUBLISHED.items()}
    )


def condition_number(normal: Array, harmonics: int) -> float:
    """Condition number of the heading design, columns scaled to unit mean square.

    1 for headings spread evenly; infinite where a column depends on the others. ``normal`` (p, p)
    has A, B, C, D, E first.
    """
    size = 1 + 2 * harmonics
    # sines and cosines spread evenly have half the mean square of the constant
    scale = np.array([1.0, *[np.sqrt(2.0)] * (size - 1)])
    values = np.linalg.eigvalsh(normal[:size, :size] * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def _publish_curves(table: _Table, curves: dict[int, AircraftFit], options: Fit) -> None:
    if not curves:
        return
    ratio = day_ratio(list(curves.values()))
    for k, fit in curves.items():
        # difference of the one-cycle curves of the first and second half of the flights: the
        # estimate from one half differs by twice the sum of its influences, that from the other
        # half by the opposite, because all influences add up to zero
        first = fit.flight_order[: fit.flight_order.size // 2]
        change = 4.0 * fit.flight[first].sum(axis=0)[:3]
        covariance = 4.0 * enlarged(fit.covariance, ratio)[:3, :3]
        rms = np.degrees(np.sqrt(change[0] ** 2 + 0.5 * (change[1] ** 2 + change[2] ** 2)))
        changed = rms > HALVES_RMS and change @ np.linalg.solve(covariance, change) > HALVES_CHI2
        if changed or not fit.converged:
            table["status"][k] = STATUS["unstable_fit"]
    curves = {k: fit for k, fit in curves.items() if table["status"][k] == STATUS["ok"]}
    fits = list(curves.values())
    if not fits:
        return
    shared = options.joint and options.shared_error and all(fit.blocks for fit in fits)
    if shared and table["report_count"][list(curves)].sum() >= LEAST_REPORTS:
        estimate = _with_field(fits, options)
    else:
        estimate = _without_field(fits, ratio, options)
    for row, (k, fit) in enumerate(curves.items()):
        _publish_curve(table, k, fit, estimate, row, options.joint)
    table["shared_error_regions"][...] = estimate.regions
    if options.joint:
        bias = estimate.bias.reshape(-1, 2)
        average = np.tile(np.eye(2), bias.shape[0]) / bias.shape[0]
        variance = np.diagonal(average @ estimate.bias_covariance @ average.T)
        table["reference_bias"][:] = bias.mean(axis=0)
        table["reference_bias_standard_error"][:] = np.sqrt(variance)


def _with_field(fits: list[AircraftFit], options: Fit) -> _Estimate:
    """Solve the fleet together with the error of its references."""
    free = np.array([[k in fit.free for k in range(COMPASS + 1)] for fit in fits])
    fleet = solve_fleet([fit.blocks for fit in fits], free)
    thetas, covariances, cycles, without = [], [], [], []
    for k, fit in enumerate(fits):
        weight = np.zeros(FOLDS)
        for blocks in fit.blocks:
            weight += np.bincount(blocks.segment // SEGMENTS_A_DAY % FOLDS, blocks.sums[0], FOLDS)
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


def _without_field(fits: list[AircraftFit], ratio: Array, options: Fit) -> _Estimate:
    """Fit aircraft by aircraft, with the references' bias pooled over the fleet."""
    choices, reduced = [], []
    for fit in fits:
        square = enlarged(fit.covariance, ratio)
        choices.append(_choice(fit, fit.theta, square, fit.free, fit.normal, options))
        mapping = choices[-1][1]  # the identity if no cycle is dropped
        flight, day = fit.flight @ mapping.T, fit.day @ mapping.T
        reduced.append(replace(fit, theta=mapping @ fit.theta, flight=flight, day=day))
    cycles, _, added = zip(*choices, strict=True)
    fleet = pool(reduced, joint=options.joint)
    widen = np.array([t_inflation(fit.freedom) for fit in fits])
    covariance = (fleet.covariance + np.array(added)) * widen[:, :, None] * widen[:, None]
    without = np.array(
        [
            theta[:COMPASS] + _without_days(fit, square)
            for fit, theta, square in zip(reduced, fleet.theta, fleet.covariance, strict=True)
        ]
    )
    fields = fleet.theta, covariance, list(cycles), without, fleet.bias, fleet.bias_covariance
    return _Estimate(*fields)


def _without_days(fit: AircraftFit, covariance: Array) -> Array:
    """Change of A to E (FOLDS, 5) without each part of the days, from their influences."""
    used = np.flatnonzero(np.diagonal(fit.day_covariance)[:COMPASS])
    influence = fit.day[:, used] @ _matched(fit.covariance, covariance, used)
    fold = fit.day_number % FOLDS
    change = np.zeros((FOLDS, COMPASS))
    np.add.at(change, (fold[:, np.newaxis], used), -influence)
    return change * _enlargement(np.bincount(fold, minlength=FOLDS))[:, np.newaxis]


def _matched(covariance: Array, target: Array, used: Index) -> Array:
    """Matrix that scales influences from one covariance of some parameters to another."""
    square = np.ix_(used, used)
    old, new = np.linalg.cholesky(covariance[square]), np.linalg.cholesky(target[square])
    return np.asarray(np.linalg.solve(old.T, new.T))


def _enlargement(weight: NDArray[Any]) -> Array:
    """Weight of all parts over that without each; NaN for a part of more than half."""
    share = weight / max(float(weight.sum()), 1e-30)
    return np.where(share <= 0.5, 1.0 / np.maximum(1.0 - share, 0.5), np.nan)


def _choice(
    fit: AircraftFit, theta: Array, covariance: Array, free: Index, normal: Array, options: Fit
) -> tuple[int, Array, Array]:
    """Number of cycles, the matrix that maps to the estimate with it, and the covariance to add."""
    mapping, added = np.eye(theta.size), np.zeros_like(covariance)
    if fit.cycles == 1 or options.harmonics != "auto":
        return fit.cycles, mapping, added
    statistic = float(theta[3:5] @ np.linalg.solve(covariance[3:5, 3:5], theta[3:5]))
    # a quasi-BIC that counts independent clusters instead of reports; with one or two days the
    # price of the two parameters would be close to zero
    if statistic > 2.0 * np.log(max(fit.day_number.size, 3)):
        return 2, mapping, added
    retained = free[(free != 3) & (free != 4)]
    mapping[3:5, 3:5] = 0.0
    mapping[np.ix_(retained, [3, 4])] = np.linalg.solve(
        normal[np.ix_(retained, retained)], normal[np.ix_(retained, [3, 4])]
    )
    # for A, B and C the shift is possible bias plus noise; the positive part of Stein's factor
    # removes the noise
    shift = theta - mapping @ theta
    added += (max(0.0, 1.0 - 2.0 / statistic) if statistic > 0 else 0.0) * np.outer(shift, shift)
    # D and E, published as zero, keep their covariance, plus the square of their estimate: their
    # interval then holds a small second cycle that the data could not show
    added[3:5, 3:5] = covariance[3:5, 3:5] + np.outer(shift[3:5], shift[3:5])
    return 1, mapping, added


def _publish_curve(
    table: _Table, k: int, fit: AircraftFit, estimate: _Estimate, row: int, joint: bool
) -> None:
    theta, covariance = estimate.theta[row], estimate.covariance[row]
    deviation = np.degrees(theta[:COMPASS])
    square = covariance[:COMPASS, :COMPASS] * np.degrees(1.0) ** 2
    if np.sqrt(np.diagonal(square)[:3].max()) > MAX_STANDARD_ERROR:
        table["status"][k] = STATUS["unstable_fit"]
        return
    if not _improves(table, k, fit, theta[:COMPASS], covariance[:COMPASS, :COMPASS]):
        return
    table["deviation"][k], table["deviation_covariance"][k] = deviation, square
    table["held_out_deviation"][k] = np.degrees(estimate.without[row])
    for name, value, error in zip(_SINUSOID, *sinusoid(deviation, square), strict=True):
        table[name][k], table[f"{name}_standard_error"][k] = value, error
    table["harmonics"][k] = estimate.cycles[row]
    if joint:
        table["airspeed_scale"][k] = theta[COMPASS]
        table["airspeed_scale_standard_error"][k] = np.sqrt(covariance[COMPASS, COMPASS])


def _publish_offsets(
    table: _Table,
    constants: dict[int, AircraftFit],
    few: list[bool],
    curves: list[AircraftFit],
    *,
    joint: bool,
) -> None:
    estimates = offsets(list(constants.values()), few, curves, joint=joint)
    for (k, fit), offset in zip(constants.items(), estimates, strict=True):
        if offset is None:
            continue
        error = np.degrees(np.sqrt(offset.variance))
        if not offset.stable or error > MAX_STANDARD_ERROR:
            table["status"][k] = STATUS["unstable_fit"]
            continue
        table["status"][k] = STATUS["offset_only"]
        theta = np.array([offset.value, 0.0, 0.0, 0.0, 0.0])
        if _improves(table, k, fit, theta, fit.covariance[:COMPASS, :COMPASS]):
            table["deviation"][k], table["offset"][k] = np.degrees(theta), np.degrees(offset.value)
            table["deviation_covariance"][k] = offset.covariance * np.degrees(1.0) ** 2
            table["held_out_deviation"][k] = np.degrees(theta + _without_days(fit, fit.covariance))
            table["offset_standard_error"][k] = error


def _improves(table: _Table, k: int, fit: AircraftFit, theta: Array, covariance: Array) -> bool:
    """Set status and residuals from held-out days; False where nothing is to be published."""
    gain = _held_out_improvement(table, k, fit, theta, covariance)
    # on few headings no bias was fitted, and an error of the airspeed looks like one
    biased = fit.free[-1] > COMPASS and fit.held_out
    if biased and all(np.hypot(*_bias(sums, theta)) > IMPLAUSIBLE for sums in fit.held_out):
        table["status"][k] = STATUS["implausible_reports"]
        return False
    size = 5 if theta[3:].any() else 3
    if table["status"][k] == STATUS["ok"] and theta[:size] @ np.linalg.solve(
        covariance[:size, :size], theta[:size]
    ) < chdtri(size, SIGNIFICANCE):
        table["status"][k] = STATUS["no_correction_needed"]
    elif gain is not None and gain <= 0.0:
        table["status"][k] = STATUS["no_improvement"]
        return False
    table["residual_rms_before"][k] = np.degrees(fit.rms_before)
    table["residual_rms_after"][k] = np.degrees(fit.rms_after)
    return True


def _held_out_improvement(
    table: _Table, k: int, fit: AircraftFit, theta: Array, covariance: Array
) -> float | None:
    """Decrease of the mean square vector disagreement on held-out days, m2 s-2.

    None with fewer than two parts with reports that are not gross errors.
    """
    used = np.flatnonzero(theta)
    weight = np.sum([sums.weight for sums in fit.held_out], axis=0)
    seen = weight > 0
    number = np.count_nonzero(seen)
    if not used.size or number < 2:
        return None
    influence = fit.flight[:, used] @ _matched(fit.covariance, covariance, used)
    left_out = np.zeros((FOLDS, COMPASS))
    np.add.at(left_out, (fit.fold[:, np.newaxis], used), influence)
    at = theta - left_out / np.maximum(1.0 - weight / weight.sum(), 0.1)[:, np.newaxis]
    gain = np.zeros(FOLDS)
    for sums in fit.held_out:
        bias = _bias(sums, theta)
        bias *= min(1.0, MAX_BIAS / max(float(np.hypot(*bias)), 1e-9))
        gain += 2.0 * (at * (sums.linear - sums.bias @ bias)).sum(axis=1)
        gain -= np.einsum("fi,fij,fj->f", at, sums.square, at)
    mean = float(gain.sum() / weight.sum())
    # from the scatter between the parts
    difference = gain[seen] - mean * weight[seen]
    error = np.sqrt(float(difference @ difference) * number / (number - 1)) / weight.sum()
    table["held_out_improvement"][k], table["held_out_improvement_standard_error"][k] = mean, error
    return mean


def _bias(sums: HeldOut, theta: Array) -> Array:
    """Mean difference from a reference after removal of the deviation, (2,), m s-1."""
    total = sums.offset.sum(axis=0) - theta @ sums.bias.sum(axis=0)
    return np.asarray(total / max(float(sums.weight.sum()), 1e-9))


def sinusoid(coefficients: Array, covariance: Array) -> tuple[Array, Array]:
    """Offset, amplitude and phase of offset + amplitude sin(m + phase), (3,), and their errors.

    ``coefficients`` A, B, C ... and ``covariance`` in degrees. The error of the amplitude is that
    along (B, C); the error of the phase is that across it over the amplitude, and tends to the half
    circle near zero amplitude.
    """
    a, b, c = coefficients[:3]
    amplitude = float(np.hypot(b, c))
    square = covariance[1:3, 1:3]
    # at zero amplitude the direction is undefined: use that with the largest variance
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
