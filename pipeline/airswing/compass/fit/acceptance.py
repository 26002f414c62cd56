"""From the sums of every aircraft to the published fits: the fleet's part, choices, status.

Assumes what :mod:`airswing.compass.fit.deviation` says of the fits. Works on what is kept of each
aircraft (a few hundred kilobytes), not on reports, so a fleet may be summed in any parts first.

Without the reference's shared error the biases are pooled over the fleet
(:mod:`airswing.compass.fit.pooled_bias`) and errors are clustered by flight, wider where days
scatter more; with it the whole fleet is solved at once (:mod:`airswing.compass.fleet.solution`) and
errors are clustered by day. Where headings or flights do not allow a curve the constant alone is
published (:mod:`airswing.compass.fit.offset_alone`): A, the other coefficients zero with the
variance of cycles as large as the fleet's, no amplitude. NaN coefficients wherever the status is
neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypedDict

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.cycles import (
    choice_covariance,
    choose_cycles,
    cycles_statistic,
    halves_apart,
    one_cycle_map,
    sinusoid,
    t_inflation,
)
from airswing.compass.fit.held_out import held_out_improvement, is_implausible, is_zero
from airswing.compass.fit.kernel import COMPASS, AircraftFit
from airswing.compass.fit.offset_alone import MIN_FLIGHTS, offsets
from airswing.compass.fit.pooled_bias import day_ratio, pool, widened
from airswing.compass.fit.sandwich import Array
from airswing.compass.fleet.solution import solve_fleet
from airswing.flags import STATUS

# Of the heading design, 1 where headings are spread evenly: beyond, two cycles become one, and one
# an offset alone.
MAX_CONDITION = 12.0
MAX_STANDARD_ERROR = 1.5  # Degrees: a coefficient less certain than this is not published
# The halves of the period disagree if their curves differ by this much (degrees rms) and by this
# much more than chance.
HALVES_RMS, HALVES_CHI2 = 1.0, 25.0
# Reports of trusted fits below which the reference's shared error is left alone.
LEAST_REPORTS = 500
# Columns of the fits by name: numbers, counts and codes.
_Table = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Options:
    """What is asked of the fit."""

    # {"auto", 1, 2}; cycles of the curve; "auto" keeps the second where the data show it
    harmonics: Literal["auto", 1, 2] = "auto"
    # fit airspeed errors jointly, with airspeed scale and reference bias; else the heading error
    # alone
    joint: bool = True
    # with ``joint``, also fit the reference's error that the fleet shares, as a field (see
    # :mod:`airswing.compass.fleet.reference_error`)
    shared_error: bool = True
    # min_reports, min_compass_points: fewer give status ``too_few_reports``,
    # ``poor_heading_coverage``; fewer than five flights ``too_few_flights``. ``offset_only`` stands
    # for the last two where a constant is found.
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
    """What :func:`airswing.compass.fit.deviation.fit_deviation` takes to say how a fit is made."""

    abscissa: Literal["magnetic", "true"]


@dataclass
class AircraftSums:
    """What is known of one aircraft before the fleet."""

    reports: int
    flights: int
    compass_points: int
    fit: AircraftFit | None  # its own fit, with the sums of its blocks
    status: int  # code of `airswing.flags.STATUS`
    field: float  # mean horizontal field of the reports that count, nT; NaN where unknown
    constant: AircraftFit | None = None  # the fit of the constant alone, where there is no curve


@dataclass(frozen=True)
class _Estimate:
    """Coefficients of the fleet with their covariance, cycles chosen."""

    theta: Array
    covariance: Array
    cycles: list[int]
    bias: Array
    bias_covariance: Array
    regions: int = 1


def condition_number(normal: Array, harmonics: int) -> float:
    """Condition number of the heading design, its columns scaled to unit mean square.

    The normal matrix (p, p) has A, B, C, D, E first. 1 for headings spread evenly; infinite where
    a column cannot be told from the others.
    """
    size = 1 + 2 * harmonics
    # Sines and cosines spread evenly have half the mean square of the constant.
    scale = np.array([1.0, *[np.sqrt(2.0)] * (size - 1)])
    values = np.linalg.eigvalsh(normal[:size, :size] * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def publish(aircraft: list[AircraftSums], options: Options) -> xr.Dataset:
    """Fits of a fleet against one reference or pool.

    Dimensions ``aircraft``, ``coefficient``, ``coefficient_2``, ``component``.
    """
    table = _empty(len(aircraft))
    for k, one in enumerate(aircraft):
        table["report_count"][k], table["flight_count"][k] = one.reports, one.flights
        table["compass_points"][k], table["status"][k] = one.compass_points, one.status
        table["mean_horizontal_field"][k] = one.field
        if one.fit is not None:
            table["condition_number"][k] = condition_number(one.fit.normal, _cycles(one.fit))
    # `ok` here means not refused yet: an aircraft's own fit is judged next.
    chosen = np.flatnonzero(table["status"] == STATUS["ok"])
    if chosen.size:
        fits = [_fit_of(aircraft[k]) for k in chosen]
        table["shared_error_regions"] = np.array(
            _publish_fits(table, chosen, fits, options), dtype=np.int16
        )
    _publish_offsets(table, aircraft, options)
    return _dataset(table)


def _fit_of(one: AircraftSums) -> AircraftFit:
    if one.fit is None:
        raise ValueError("an aircraft without a fit was to be published")
    return one.fit


def _cycles(fit: AircraftFit) -> int:
    return 2 if 4 in fit.free else 1


def _publish_fits(
    table: _Table,
    chosen: NDArray[np.int64],
    fits: list[AircraftFit],
    options: Options,
) -> int:
    """Fill the table; return in how many regions the shared error was worked."""
    ratio = day_ratio(
        [np.diagonal(fit.covariance) for fit in fits],
        [np.diagonal(fit.day_covariance) for fit in fits],
        [max(fit.day_number.size - 1, 1) for fit in fits],
    )
    wide = [widened(fit.covariance, ratio) for fit in fits]
    for k, fit, one in zip(chosen, fits, wide, strict=True):
        _judge(table, int(k), fit, one)
    trusted = np.flatnonzero(table["status"][chosen] == STATUS["ok"])
    fits, wide = [fits[k] for k in trusted], [wide[k] for k in trusted]
    if not fits:
        return 1
    shared = options.joint and options.shared_error and all(fit.blocks for fit in fits)
    shared &= int(table["report_count"][chosen[trusted]].sum()) >= LEAST_REPORTS
    found = _with_field(fits, options) if shared else _alone(fits, wide, options)
    for row, (k, fit) in enumerate(zip(chosen[trusted], fits, strict=True)):
        _fill(table, int(k), fit, found, row, options.joint)
    if options.joint:
        bias = found.bias.reshape(-1, 2)
        average = np.tile(np.eye(2), bias.shape[0]) / bias.shape[0]
        table["reference_bias"] = bias.mean(axis=0)
        table["reference_bias_standard_error"] = np.sqrt(
            np.diagonal(average @ found.bias_covariance @ average.T)
        )
    return found.regions


def _publish_offsets(table: _Table, aircraft: list[AircraftSums], options: Options) -> None:
    """The constant of every aircraft that has no curve."""
    own = [k for k, one in enumerate(aircraft) if one.constant is not None]
    alone = [one.constant for one in aircraft if one.constant is not None]
    ok = np.flatnonzero(table["status"] == STATUS["ok"])
    found = offsets(
        alone,
        [aircraft[k].flights < MIN_FLIGHTS for k in own],
        [_fit_of(aircraft[k]) for k in ok],
        joint=options.joint,
    )
    for k, fit, offset in zip(own, alone, found, strict=True):
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
        table["offset_standard_error"][k] = error
        table["residual_rms_before"][k] = np.degrees(fit.rms_before)
        table["residual_rms_after"][k] = np.degrees(fit.rms_after)


def _with_field(fits: list[AircraftFit], options: Options) -> _Estimate:
    """The whole fleet at once, beside the error of its references."""
    free = np.zeros((len(fits), COMPASS + 1), dtype=np.bool_)
    for row, fit in zip(free, fits, strict=True):
        row[fit.free[fit.free <= COMPASS]] = True
    joint = solve_fleet([fit.blocks for fit in fits], free)
    thetas, covariances, cycles = [], [], []
    for k, fit in enumerate(fits):
        theta, square = fit.theta[: COMPASS + 1] + joint.step[k], joint.covariance[k]
        number, to_one, extra = _choice(
            theta,
            square,
            _cycles(fit),
            np.flatnonzero(free[k]),
            np.linalg.pinv(square),
            fit.day_number.size,
            options,
        )
        widen = t_inflation(fit.freedom[: COMPASS + 1])
        thetas.append(to_one @ theta)
        covariances.append((to_one @ square @ to_one.T + extra) * np.outer(widen, widen))
        cycles.append(number)
    return _Estimate(
        np.array(thetas),
        np.array(covariances),
        cycles,
        joint.bias,
        joint.bias_covariance,
        joint.regions,
    )


def _alone(fits: list[AircraftFit], wide: list[Array], options: Options) -> _Estimate:
    """Aircraft by aircraft, with the references' bias pooled over the fleet."""
    cycles, kept, added = [], [], []
    for fit, square in zip(fits, wide, strict=True):
        number, to_one, extra = _choice(
            fit.theta, square, _cycles(fit), fit.free, fit.normal, fit.day_number.size, options
        )
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
    return _Estimate(fleet.theta, covariance, cycles, fleet.bias, fleet.bias_covariance)


def _choice(
    theta: Array,
    covariance: Array,
    cycles: int,
    free: NDArray[np.int64],
    normal: Array,
    days: int,
    options: Options,
) -> tuple[int, Array, Array]:
    """Number of cycles, the map to the estimate with so many, and the covariance to add."""
    keep, nothing = np.eye(theta.size), np.zeros_like(covariance)
    if cycles == 1 or options.harmonics != "auto":
        return cycles, keep, nothing
    statistic = cycles_statistic(theta, covariance)
    if choose_cycles(statistic, days) == 2:
        return 2, keep, nothing
    to_one = one_cycle_map(normal, free)
    return 1, to_one, choice_covariance(theta - to_one @ theta, covariance, statistic)


def _judge(table: _Table, k: int, fit: AircraftFit, covariance: Array) -> None:
    rms, chi2 = halves_apart(fit.flight, fit.flight_order, covariance)
    apart = np.degrees(rms) > HALVES_RMS and chi2 > HALVES_CHI2
    if apart or not fit.converged:
        table["status"][k] = STATUS["unstable_fit"]


def _fill(
    table: _Table,
    k: int,
    fit: AircraftFit,
    found: _Estimate,
    row: int,
    joint: bool,
) -> None:
    theta, covariance = found.theta[row], found.covariance[row]
    deviation = np.degrees(theta[:COMPASS])
    square = covariance[:COMPASS, :COMPASS] * np.degrees(1.0) ** 2
    if np.sqrt(np.diagonal(square)[:3].max()) > MAX_STANDARD_ERROR:
        table["status"][k] = STATUS["unstable_fit"]
    if table["status"][k] != STATUS["ok"]:
        return
    if not _improves(table, k, fit, theta[:COMPASS], covariance[:COMPASS, :COMPASS]):
        return
    value, error = sinusoid(deviation, square)
    table["deviation"][k], table["deviation_covariance"][k] = deviation, square
    for name, one, one_error in zip(("offset", "amplitude", "phase"), value, error, strict=True):
        table[name][k], table[f"{name}_standard_error"][k] = one, one_error
    table["harmonics"][k] = found.cycles[row]
    table["residual_rms_before"][k] = np.degrees(fit.rms_before)
    table["residual_rms_after"][k] = np.degrees(fit.rms_after)
    if joint:
        table["airspeed_scale"][k] = theta[COMPASS]
        table["airspeed_scale_standard_error"][k] = np.sqrt(covariance[COMPASS, COMPASS])


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


_PER_AIRCRAFT = (
    "offset",
    "amplitude",
    "phase",
    "offset_standard_error",
    "amplitude_standard_error",
    "phase_standard_error",
    "airspeed_scale",
    "airspeed_scale_standard_error",
    "condition_number",
    "residual_rms_before",
    "residual_rms_after",
    "mean_horizontal_field",
    "held_out_improvement",
    "held_out_improvement_standard_error",
)
_COUNTS = ("report_count", "flight_count", "compass_points", "status", "harmonics")


def _empty(aircraft: int) -> _Table:
    table: _Table = {name: np.full(aircraft, np.nan) for name in _PER_AIRCRAFT}
    table |= {name: np.zeros(aircraft, dtype=np.int32) for name in _COUNTS}
    table["deviation"] = np.full((aircraft, COMPASS), np.nan)
    table["deviation_covariance"] = np.full((aircraft, COMPASS, COMPASS), np.nan)
    table["reference_bias"] = np.full(2, np.nan)
    table["reference_bias_standard_error"] = np.full(2, np.nan)
    table["shared_error_regions"] = np.array(1, dtype=np.int16)
    return table


def _dataset(table: _Table) -> xr.Dataset:
    dims = {name: ("aircraft",) for name in (*_PER_AIRCRAFT, *_COUNTS)}
    extra = {
        "deviation": ("aircraft", "coefficient"),
        "deviation_covariance": ("aircraft", "coefficient", "coefficient_2"),
        "reference_bias": ("component",),
        "reference_bias_standard_error": ("component",),
        "shared_error_regions": (),
    }
    small = {"compass_points", "status", "harmonics"}
    return xr.Dataset(
        {
            name: (({**dims, **extra})[name], values.astype(np.int8) if name in small else values)
            for name, values in table.items()
        }
    )
