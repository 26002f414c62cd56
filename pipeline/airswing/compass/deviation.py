"""Deviation of every aircraft's compass from its headings' errors: the fit and its status.

Assumptions
-----------
One deviation curve an aircraft over the whole period, a function of the indicated magnetic heading
(A constant, one or two cycles: Archibald Smith's coefficients); one airspeed scale an aircraft; a
reference wind whose bias is shared by the fleet in part. See :mod:`airswing.compass.kernel` for the
equations and :mod:`airswing.compass.pooling` for the bias. B and C are those of the region flown:
they scale with 1/H (hard iron).

Standard errors allow for flights' and days' common errors, for the number of clusters (they are
made wider so that +-1.96 of them is a 95 % interval) and for the choice of one or two cycles
(where one was chosen, what that may have cost is in the covariance, D and E included).

Inside degrees; NaN coefficients wherever the status is not ``ok``.

References
----------
Jacobs et al. 2010 (seed paper), eq. 3 and step d; NGA Handbook of Magnetic Compass Adjustment.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.clusters import Array
from airswing.compass.columns import Columns
from airswing.compass.derived import (
    choice_covariance,
    choose_cycles,
    cycles_statistic,
    halves_apart,
    one_cycle_map,
    sinusoid,
    t_inflation,
)
from airswing.compass.joint import fit_with_field
from airswing.compass.kernel import COMPASS, plain_sinusoid
from airswing.compass.pooling import day_ratio, pool, widened
from airswing.compass.robustfit import AircraftFit, fit_aircraft
from airswing.errors import InputError
from airswing.ragged import row_bounds
from airswing.vocabulary import STATUS, describe

COEFFICIENTS = ("A", "B", "C", "D", "E")
MIN_FLIGHTS = 5
MAX_CONDITION = 12.0
MAX_STANDARD_ERROR = 1.5
"""Degrees: a coefficient less certain than this is not published."""
HALVES_RMS, HALVES_CHI2 = 1.0, 25.0
"""The halves of the period disagree if their curves differ by this much (degrees rms) and by this
much more than chance."""
CHUNKS = 8
"""Tasks the aircraft are shared between. They run one after the other: the kernel's blocks are
so short that threads spend more on the interpreter's lock than they gain."""
_NEEDED = (
    "heading",
    "magnetic_heading",
    "airspeed",
    "heading_error",
    "airspeed_error",
    "heading_error_standard_error",
    "screening",
    "flight",
    "time",
    "row_size",
    "latitude",
    "longitude",
    "pressure",
)


@dataclass(frozen=True)
class _Options:
    harmonics: Literal["auto", 1, 2]
    joint: bool
    min_reports: int
    min_compass_points: int


@dataclass
class _Aircraft:
    """What is known of one aircraft before the fleet."""

    reports: int
    flights: int
    compass_points: int
    fit: AircraftFit | None
    status: int


def fit_deviation(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    harmonics: Literal["auto", 1, 2] = "auto",
    abscissa: Literal["magnetic", "true"] = "magnetic",
    joint: bool = True,
    shared_error: bool = True,
    min_reports: int = 200,
    min_compass_points: int = 6,
    alone: bool = True,
) -> xr.Dataset:
    """Fit the deviation of every aircraft against every reference and every pool.

    Parameters
    ----------
    headings : Dataset
        Headings of every report (``report``, ``reference``, ``aircraft``); only reports with
        ``screening`` 0 and finite values count.
    pools : mapping of str to list of str, optional
        Name of a pool -> its references, fitted together.
    harmonics : {"auto", 1, 2}
        Cycles of the curve; "auto" keeps the second where the data show it.
    abscissa : {"magnetic", "true"}
        Argument of the curve: indicated magnetic heading, or (the seed's) true heading.
    joint : bool
        Fit airspeed errors jointly, with airspeed scale and reference bias; else the heading
        error alone.
    shared_error : bool
        With ``joint``, also fit the reference's error that the fleet shares, as a field (see
        :mod:`airswing.compass.joint`).
    min_reports, min_compass_points : int
        Fewer give status ``too_few_reports``, ``poor_heading_coverage``.
    alone : bool
        Also fit each reference alone, beside the pools; without pools always.

    Returns
    -------
    Dataset
        Every variable of ``fits.nc`` except the table's.

    Raises
    ------
    InputError
        If a variable is missing or a pool names an unknown reference.
    """
    groups = _groups(headings, pools or {}, alone=alone or not pools)
    options = _Options(harmonics, joint, min_reports, min_compass_points)
    columns = Columns(headings, abscissa)
    parts = []
    for members in groups.values():
        columns.use(members)
        once = partial(_fit_reference, columns, members, options)
        shared = joint and shared_error
        parts.append(fit_with_field(headings, columns, members, once) if shared else once())
    fits = xr.concat(parts, dim="reference", join="override", combine_attrs="override")
    fits = fits.assign_coords(
        reference=("reference", np.array(list(groups), dtype=object)),
        aircraft=("aircraft", headings["aircraft"].to_numpy().astype(object)),
        coefficient=("coefficient", np.array(COEFFICIENTS, dtype=object)),
        coefficient_2=("coefficient_2", np.array(COEFFICIENTS, dtype=object)),
        component=("component", np.array(["eastward", "northward"], dtype=object)),
    )
    fits.attrs.update(
        abscissa=abscissa,
        joint=int(joint),
        harmonics_asked=str(harmonics),
        reference_count=headings.sizes["reference"],
    )
    return describe(fits)


def fit_sinusoid(
    headings: xr.Dataset, *, abscissa: Literal["magnetic", "true"] = "magnetic"
) -> xr.Dataset:
    """Fit the seed's plain sinusoid: ordinary least squares of the heading error, nothing more.

    Parameters
    ----------
    headings : Dataset
        As for :func:`fit_deviation`; only screened reports with finite values count.
    abscissa : {"magnetic", "true"}

    Returns
    -------
    Dataset
        ``offset``, ``amplitude``, ``phase`` (reference, aircraft), degrees; NaN with fewer than
        three reports.
    """
    start, stop = row_bounds(headings["row_size"].to_numpy())
    m = headings["magnetic_heading" if abscissa == "magnetic" else "heading"].to_numpy()
    kept = headings["screening"].to_numpy() == 0
    error = headings["heading_error"].transpose("reference", "report")
    curves = np.full((error.shape[0], start.size, 3), np.nan)
    for k in range(error.shape[0]):
        values = error[k].to_numpy()
        for row, (begin, end) in enumerate(zip(start, stop, strict=True)):
            one, other = values[begin:end], m[begin:end]
            good = kept[begin:end] & np.isfinite(one) & np.isfinite(other)
            if not good.all():
                one, other = one[good], other[good]
            if one.size >= 3:
                curves[k, row] = plain_sinusoid(one, other)[0]
    names = ("offset", "amplitude", "phase")
    return describe(
        xr.Dataset(
            {name: (("reference", "aircraft"), curves[..., j]) for j, name in enumerate(names)},
            coords={name: headings[name] for name in ("reference", "aircraft")},
        )
    )


def _groups(
    headings: xr.Dataset, pools: Mapping[str, Sequence[str]], *, alone: bool
) -> dict[str, list[int]]:
    for name in _NEEDED:
        if name not in headings:
            raise InputError("the headings lack a variable the fit needs", field=name)
    names = [str(name) for name in headings["reference"].to_numpy()]
    groups = {name: [k] for k, name in enumerate(names)} if alone else {}
    for pool_name, members in pools.items():
        unknown = [name for name in members if name not in names]
        if unknown or not members:
            raise InputError(
                "the pool names a reference that is not there",
                field=pool_name,
                found=", ".join(unknown) or "no member",
                remedy=f"References: {', '.join(names)}",
            )
        groups[pool_name] = [names.index(name) for name in members]
    return groups


class _Fitter:
    """The kernel that runs over the aircraft; hashed by identity, not by its columns."""

    def __init__(self, columns: Columns, members: list[int], options: _Options) -> None:
        self.columns, self.members, self.options = columns, members, options

    def __call__(self, aircraft: NDArray[Any]) -> NDArray[Any]:
        found = np.empty(aircraft.shape, dtype=object)
        for k, number in enumerate(aircraft):
            found[k] = _fit_one(self.columns, int(number), self.members, self.options)
        return found

    def __dask_tokenize__(self) -> str:
        return uuid.uuid4().hex


def _fit_reference(columns: Columns, members: list[int], options: _Options) -> xr.Dataset:
    size = columns.start.size
    index = xr.DataArray(np.arange(size), dims="aircraft")
    index = index.chunk({"aircraft": max(1, -(-size // CHUNKS))})
    found = xr.apply_ufunc(
        _Fitter(columns, members, options), index, dask="parallelized", output_dtypes=[object]
    ).compute(scheduler="synchronous")
    return _published(list(found.to_numpy()), len(members), options)


def _fit_one(columns: Columns, aircraft: int, members: list[int], options: _Options) -> _Aircraft:
    sets, flight_day, abscissa = columns.observations(aircraft, members)
    # whole turns are added so that cutting the fraction off is rounding to the nearest point
    counts = np.bincount((abscissa * (1 / 45.0) + 16.5).astype(np.int64) & 7, minlength=8)
    points = int(np.sum(counts >= max(3, 0.002 * abscissa.size)))
    found = _Aircraft(int(abscissa.size), int(flight_day.size), points, None, STATUS["ok"])
    if abscissa.size < options.min_reports or flight_day.size < MIN_FLIGHTS:
        found.status = STATUS["too_few_reports"]
    elif points < options.min_compass_points:
        found.status = STATUS["poor_heading_coverage"]
    cycles = 1 if options.harmonics == 1 else 2
    if points >= 3 and flight_day.size >= 2 and abscissa.size >= 20:
        found.fit = fit_aircraft(sets, flight_day, joint=options.joint, harmonics=cycles)
        if (
            found.fit is not None
            and options.harmonics == "auto"
            and condition_number(found.fit.normal, 2) > MAX_CONDITION
        ):
            found.fit = fit_aircraft(sets, flight_day, joint=options.joint, harmonics=1)
    if found.status == STATUS["ok"] and found.fit is None:
        found.status = STATUS["too_few_reports"]
    return found


def condition_number(normal: Array, harmonics: int) -> float:
    """Condition number of the heading design, its columns scaled to unit mean square.

    Parameters
    ----------
    normal : array, shape (p, p)
        Normal matrix with A, B, C, D, E first.
    harmonics : int

    Returns
    -------
    float
        1 for headings spread evenly; infinite where a column cannot be told from the others.
    """
    size = 1 + 2 * harmonics
    scale = np.array([1.0, *[np.sqrt(2.0)] * (size - 1)])
    values = np.linalg.eigvalsh(normal[:size, :size] * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")


def _published(aircraft: list[_Aircraft], members: int, options: _Options) -> xr.Dataset:
    table = _empty(len(aircraft))
    for k, one in enumerate(aircraft):
        table["report_count"][k], table["flight_count"][k] = one.reports, one.flights
        table["compass_points"][k], table["status"][k] = one.compass_points, one.status
        if one.fit is not None:
            table["condition_number"][k] = condition_number(one.fit.normal, _cycles(one.fit))
            if table["condition_number"][k] > MAX_CONDITION and one.status == STATUS["ok"]:
                table["status"][k] = STATUS["poor_heading_coverage"]
    chosen = np.flatnonzero(table["status"] == STATUS["ok"])
    if chosen.size:
        _publish_fits(table, chosen, [_fit_of(aircraft[k]) for k in chosen], members, options)
    return _dataset(table)


def _fit_of(one: _Aircraft) -> AircraftFit:
    if one.fit is None:
        raise ValueError("an aircraft without a fit was to be published")
    return one.fit


def _cycles(fit: AircraftFit) -> int:
    return 2 if 4 in fit.free else 1


def _publish_fits(
    table: dict[str, NDArray[Any]],
    chosen: NDArray[np.int64],
    fits: list[AircraftFit],
    members: int,
    options: _Options,
) -> None:
    ratio = day_ratio(
        [np.diagonal(fit.covariance) for fit in fits],
        [np.diagonal(fit.day.T @ fit.day) for fit in fits],
        [max(fit.day_number.size - 1, 1) for fit in fits],
    )
    cycles, kept, added = [], [], []
    for k, fit in zip(chosen, fits, strict=True):
        number, one, extra = _with_cycles(fit, widened(fit.covariance, ratio), options)
        cycles.append(number)
        kept.append(one)
        added.append(extra)
        _judge(table, int(k), fit, widened(fit.covariance, ratio))
    fleet = pool(kept, joint=options.joint)
    for row, (k, fit) in enumerate(zip(chosen, fits, strict=True)):
        widen = t_inflation(fit.freedom)
        covariance = (fleet.covariance[row] + added[row]) * np.outer(widen, widen)
        _fill(table, int(k), fit, fleet.theta[row], covariance, cycles[row], options.joint)
    if options.joint:
        bias = fleet.bias.reshape(members, 2)
        average = np.tile(np.eye(2), members) / members
        table["reference_bias"] = bias.mean(axis=0)
        table["reference_bias_standard_error"] = np.sqrt(
            np.diagonal(average @ fleet.bias_covariance @ average.T)
        )


def _with_cycles(
    fit: AircraftFit, covariance: Array, options: _Options
) -> tuple[int, AircraftFit, Array]:
    number, nothing = _cycles(fit), np.zeros_like(covariance)
    if number == 1 or options.harmonics != "auto":
        return number, fit, nothing
    statistic = cycles_statistic(fit.theta, covariance)
    if choose_cycles(statistic, fit.day_number.size) == 2:
        return 2, fit, nothing
    to_one = one_cycle_map(fit.normal, fit.free)
    one = replace(
        fit, theta=to_one @ fit.theta, flight=fit.flight @ to_one.T, day=fit.day @ to_one.T
    )
    return 1, one, choice_covariance(fit.theta - one.theta, covariance, statistic)


def _judge(table: dict[str, NDArray[Any]], k: int, fit: AircraftFit, covariance: Array) -> None:
    rms, chi2 = halves_apart(fit.flight, fit.flight_order, covariance)
    apart = np.degrees(rms) > HALVES_RMS and chi2 > HALVES_CHI2
    if apart or not fit.converged:
        table["status"][k] = STATUS["unstable_fit"]


def _fill(
    table: dict[str, NDArray[Any]],
    k: int,
    fit: AircraftFit,
    theta: Array,
    covariance: Array,
    cycles: int,
    joint: bool,
) -> None:
    deviation = np.degrees(theta[:COMPASS])
    square = covariance[:COMPASS, :COMPASS] * np.degrees(1.0) ** 2
    if np.sqrt(np.diagonal(square)[:3].max()) > MAX_STANDARD_ERROR:
        table["status"][k] = STATUS["unstable_fit"]
    if table["status"][k] != STATUS["ok"]:
        return
    value, error = sinusoid(deviation, square)
    table["deviation"][k], table["deviation_covariance"][k] = deviation, square
    for name, one, one_error in zip(("offset", "amplitude", "phase"), value, error, strict=True):
        table[name][k], table[f"{name}_standard_error"][k] = one, one_error
    table["harmonics"][k] = cycles
    table["residual_rms_before"][k] = np.degrees(fit.rms_before)
    table["residual_rms_after"][k] = np.degrees(fit.rms_after)
    if joint:
        table["airspeed_scale"][k] = theta[COMPASS]
        table["airspeed_scale_standard_error"][k] = np.sqrt(covariance[COMPASS, COMPASS])


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
)
_COUNTS = ("report_count", "flight_count", "compass_points", "status", "harmonics")


def _empty(aircraft: int) -> dict[str, NDArray[Any]]:
    table: dict[str, NDArray[Any]] = {name: np.full(aircraft, np.nan) for name in _PER_AIRCRAFT}
    table |= {name: np.zeros(aircraft, dtype=np.int32) for name in _COUNTS}
    table["deviation"] = np.full((aircraft, COMPASS), np.nan)
    table["deviation_covariance"] = np.full((aircraft, COMPASS, COMPASS), np.nan)
    table["reference_bias"] = np.full(2, np.nan)
    table["reference_bias_standard_error"] = np.full(2, np.nan)
    return table


def _dataset(table: dict[str, NDArray[Any]]) -> xr.Dataset:
    dims = {name: ("aircraft",) for name in (*_PER_AIRCRAFT, *_COUNTS)}
    extra = {
        "deviation": ("aircraft", "coefficient"),
        "deviation_covariance": ("aircraft", "coefficient", "coefficient_2"),
        "reference_bias": ("component",),
        "reference_bias_standard_error": ("component",),
    }
    small = {"compass_points", "status", "harmonics"}
    return xr.Dataset(
        {
            name: (({**dims, **extra})[name], values.astype(np.int8) if name in small else values)
            for name, values in table.items()
        }
    )
