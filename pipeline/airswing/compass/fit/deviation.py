"""Deviation of the compass of each aircraft: the fit of a fleet and its status.

One deviation curve an aircraft over the whole period, a function of the indicated magnetic heading
(A to E of `airswing.physics.compass_deviation`); one airspeed scale an aircraft; a bias of the
reference wind that the fleet shares in part. B and C are those at the mean horizontal field of the
aircraft's reports used, ``mean_horizontal_field``; without ``horizontal_field`` in the headings
they are taken as constant. Where headings or flights do not allow a curve, one constant is fitted,
status ``offset_only``.

Each aircraft is fitted first (`airswing.compass.fit.kernel`), by `xarray.apply_ufunc` over batches
of whole aircraft; then the fleet is solved on the sums of these fits
(`airswing.compass.fit.acceptance`). Standard errors allow for errors common to a flight and to a
day, for the number of clusters (+-1.96 of them is a 95 % interval) and for the choice of one or two
cycles.

References
----------
Jacobs et al. 2010, eq. 3 and step d; NGA Handbook of Magnetic Compass Adjustment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

import numpy as np
import xarray as xr
from dask.delayed import delayed
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import (
    MAX_CONDITION,
    AircraftSums,
    FitOptions,
    condition_number,
    publish,
)
from airswing.compass.fit.kernel import AircraftFit, fit_aircraft
from airswing.compass.fit.pooling import MIN_FLIGHTS, STRETCH
from airswing.compass.fleet.field import Array, Index, Reports
from airswing.compass.whole_aircraft import aircraft_batches, lazy_dataset, single_task
from airswing.config import Fit
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.physics.compass_deviation import COEFFICIENTS, deviation_basis
from airswing.products.ragged import BLOCK_REPORTS, row_bounds
from airswing.vocabulary import describe

_PER_REPORT = (
    *("heading", "magnetic_heading", "airspeed", "screening", "flight"),
    *("time", "latitude", "longitude", "pressure"),
)
_PER_REFERENCE = ("heading_error", "airspeed_error", "heading_error_standard_error")
FITTED_FROM = (*_PER_REPORT, *_PER_REFERENCE, "row_size", "horizontal_field")
"""Variables a fit reads; the last one is optional."""


def fit_deviation(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    alone: bool = True,
    **options: Unpack[FitOptions],
) -> xr.Dataset:
    """Fit the deviation of every aircraft against every reference and every pool.

    Parameters
    ----------
    headings : Dataset
        Headings of every report (``report``, ``reference``, ``aircraft``); only reports with
        ``screening`` 0 and finite values count. With dask arrays nothing is computed yet.
    pools : mapping of str to list of str, optional
        Name of a pool -> its references, fitted together.
    alone : bool
        Also fit each reference separately (always done without pools).
    **options
        ``abscissa``, ``harmonics``, ``joint``, ``shared_error``, ``min_reports``,
        ``min_compass_points``: see :class:`airswing.config.Fit`.

    Returns
    -------
    Dataset
        Every variable of ``fits.nc`` except the table's, dimensions ``reference``, ``aircraft``,
        ``coefficient``, ``coefficient_2``, ``component``, ``fold``; dask-backed where the headings
        are.

    Raises
    ------
    InputError
        If a variable is missing or a pool names an unknown reference.

    References
    ----------
    Jacobs et al. 2010, eq. 3 and step d; NGA Handbook of Magnetic Compass Adjustment.

    Examples
    --------
    >>> fits = airswing.fit_deviation(headings, pools={"ruc": ["ruc"]})
    >>> fits["deviation"].dims
    ('reference', 'aircraft', 'coefficient')
    """
    return fit_sums(sum_aircraft(headings, pools=pools, alone=alone, **options))


def sum_aircraft(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    alone: bool = True,
    **options: Unpack[FitOptions],
) -> xr.DataArray:
    """Fit each aircraft separately: the part of :func:`fit_deviation` that reads reports.

    The result (reference, aircraft) holds objects. That of an aircraft depends only on its reports,
    so that parts of a fleet may be summed and concatenated for :func:`fit_sums`.
    """
    for name in FITTED_FROM[:-1]:
        if name not in headings:
            raise InputError("the headings lack a variable the fit needs", field=name)
    references = [str(name) for name in headings["reference"].to_numpy()]
    groups = {name: [k] for k, name in enumerate(references)} if alone or not pools else {}
    for pool_name, members in (pools or {}).items():
        unknown = [name for name in members if name not in references]
        if unknown or not members:
            raise InputError(
                "the pool names a reference that is not in the headings",
                field=pool_name,
                found=", ".join(unknown) or "no member",
                remedy=f"References: {', '.join(references)}",
            )
        groups[pool_name] = [references.index(name) for name in members]
    settings = Fit(**options)
    read = headings[[name for name in FITTED_FROM if name in headings]]
    read = read.drop_vars(["aircraft", "reference"], errors="ignore")
    names = [name for name in FITTED_FROM if name in read]
    dims = {"row_size": ["aircraft"]} | {name: ["reference", "report"] for name in _PER_REFERENCE}
    batches = [
        xr.apply_ufunc(
            _fit_batch,
            *(batch[name] for name in names),
            input_core_dims=[dims.get(name, ["report"]) for name in names],
            output_core_dims=[["reference", "aircraft"]],
            exclude_dims={"reference"},
            kwargs={"names": names, "groups": list(groups.values()), "options": settings},
            dask="parallelized",
            output_dtypes=[object],
            dask_gufunc_kwargs={"output_sizes": {"reference": len(groups)}, "allow_rechunk": True},
        )
        for batch in aircraft_batches(read, BLOCK_REPORTS)
    ]
    sums: xr.DataArray = xr.concat(batches, dim="aircraft")
    return sums.assign_coords(
        reference=("reference", np.array(list(groups), dtype=object)),
        aircraft=("aircraft", headings["aircraft"].to_numpy().astype(object)),
    ).assign_attrs(options=settings, reference_count=len(references))


def fit_sums(sums: xr.DataArray) -> xr.Dataset:
    """Fit the fleet on the sums of its aircraft, of :func:`sum_aircraft`."""
    if sums.chunks is not None:
        unfitted = np.empty(sums.shape, dtype=object)
        unfitted[...] = AircraftSums(0, 0, 0, None, STATUS["too_few_reports"], np.nan)
        empty = sums.copy(data=unfitted)
        template = fit_sums(empty)
        task = delayed(lambda values: fit_sums(empty.copy(data=values)))(single_task(sums.data))
        return lazy_dataset(task, template, {}, template)
    options: Fit = sums.attrs["options"]
    fits = xr.concat(
        [publish(list(row), options) for row in sums.to_numpy()],
        dim="reference",
        join="override",
        combine_attrs="drop",
    )
    fits = fits.assign_coords(
        reference=sums["reference"].variable,
        aircraft=sums["aircraft"].variable,
        coefficient=("coefficient", np.array(COEFFICIENTS, dtype=object)),
        coefficient_2=("coefficient_2", np.array(COEFFICIENTS, dtype=object)),
        component=("component", np.array(["eastward", "northward"], dtype=object)),
    )
    fits.attrs.update(
        abscissa=options.abscissa,
        joint=int(options.joint),
        harmonics_asked=str(options.harmonics),
        reference_count=sums.attrs["reference_count"],
    )
    return describe(fits)


def _fit_batch(
    *arrays: NDArray[Any], names: list[str], groups: list[list[int]], options: Fit
) -> NDArray[np.object_]:
    """Kernel of the fits over the aircraft of a batch, whose reports are concatenated."""
    columns = dict(zip(names, arrays, strict=True))
    row_size = columns.pop("row_size")
    sums = np.empty((len(groups), row_size.size), dtype=object)
    for k, (begin, end) in enumerate(zip(*row_bounds(row_size), strict=True)):
        reports = {name: column[..., begin:end] for name, column in columns.items()}
        for j, members in enumerate(groups):
            sums[j, k] = _fit_single(reports, members, options)
    return sums


def _observations(
    columns: dict[str, NDArray[Any]], members: list[int], abscissa: str
) -> tuple[list[Reports], Index, Array, float]:
    """Input of the kernel from the usable reports of one aircraft.

    The reports usable for each member; the days (since 1970) on which the flights began; the
    abscissa (radians) of the reports usable for any member; their mean horizontal field, nT, NaN
    where unknown.
    """
    flight, time = columns["flight"], columns["time"]
    if np.any(flight[1:] < flight[:-1]):
        order = np.lexsort((time, flight))
        columns = {name: column[..., order] for name, column in columns.items()}
        flight, time = columns["flight"], columns["time"]
    argument = columns["magnetic_heading" if abscissa == "magnetic" else "heading"]
    common = columns["heading"] + argument + columns["airspeed"]
    used = (columns["screening"] == 0) & np.isfinite(common)
    errors, speeds, standard_errors = (
        columns[name][members].astype(np.float64) for name in _PER_REFERENCE
    )
    masks = used & np.isfinite(errors + speeds)
    used = masks.any(axis=0)
    begins = np.ones(np.count_nonzero(used), dtype=np.bool_)
    begins[1:] = flight[used][1:] != flight[used][:-1]
    days = time[used][begins].astype("datetime64[D]").astype(np.int64)
    flights = np.zeros(used.size, dtype=np.int64)
    flights[used] = np.cumsum(begins) - 1
    # mean horizontal field of the reports used over that of each report
    gain, mean, field = np.ones(used.size), np.nan, columns.get("horizontal_field")
    if field is not None:
        has_field = np.isfinite(field) & (field > 0)
        if (used & has_field).any():
            mean = float(field[used & has_field].mean(dtype=np.float64))
            gain[has_field] = mean / field[has_field]
    angle = np.radians(argument.astype(np.float64))
    heading = np.radians(columns["heading"].astype(np.float64))
    airspeed, latitude, longitude, pressure = (
        columns[name].astype(np.float64)
        for name in ("airspeed", "latitude", "longitude", "pressure")
    )
    basis = deviation_basis(angle, gain)
    sets = []
    for mask, error, speed, deviation in zip(masks, errors, speeds, standard_errors, strict=True):
        variance = (np.radians(deviation) * airspeed) ** 2
        reports = Reports(
            basis,
            heading,
            np.radians(error),
            airspeed,
            airspeed - speed,
            np.nan_to_num(variance, posinf=0.0),
            flights,
            latitude,
            longitude,
            pressure,
            time,
        )
        sets.append(reports if mask.all() else reports.take(np.flatnonzero(mask)))
    return sets, days, angle[used], mean


def _fit_single(reports: dict[str, NDArray[Any]], members: list[int], options: Fit) -> AircraftSums:
    sets, flight_day, angle, field = _observations(reports, members, options.abscissa)
    # compass points with at least three headings and one in 500; fewer are turns or errors
    counts = np.bincount(np.rint(angle / (np.pi / 4)).astype(np.int64) % 8, minlength=8)
    points = int(np.count_nonzero(counts >= max(3.0, 0.002 * angle.size)))
    sums = AircraftSums(angle.size, flight_day.size, points, None, STATUS["ok"], field)
    if angle.size < options.min_reports:
        sums.status = STATUS["too_few_reports"]
    elif flight_day.size < MIN_FLIGHTS:
        sums.status = STATUS["too_few_flights"]
    elif points < options.min_compass_points:
        sums.status = STATUS["poor_heading_coverage"]
    blocks = options.joint and options.shared_error
    fit_sets = partial(fit_aircraft, sets, flight_day, joint=options.joint)
    # also where no curve will be published, because its condition number is published
    if points >= 3 and flight_day.size >= 2 and angle.size >= 20:
        fit = fit_sets(harmonics=1 if options.harmonics == 1 else 2, with_blocks=blocks)
        if options.harmonics == "auto" and fit and condition_number(fit.normal, 2) > MAX_CONDITION:
            fit = fit_sets(harmonics=1, with_blocks=blocks)
        sums.fit = fit
    if sums.status == STATUS["ok"]:
        if sums.fit is None:
            sums.status = STATUS["too_few_reports"]
        elif condition_number(sums.fit.normal, sums.fit.cycles) > MAX_CONDITION:
            sums.status = STATUS["poor_heading_coverage"]
    if sums.status == STATUS["poor_heading_coverage"]:
        sums.constant = fit_sets(harmonics=0)
    elif sums.status == STATUS["too_few_flights"]:
        sums.constant = _fit_of_stretches(sets, options)
    return sums


def _fit_of_stretches(sets: list[Reports], options: Fit) -> AircraftFit | None:
    """Constant of an aircraft with too few flights, with stretches of flight as clusters."""
    # flight and stretch as one number: stretches since 1970 are far fewer than 10^9
    numbers = [
        reports.flight * 10**9 + reports.time.astype("datetime64[s]").astype(np.int64) // STRETCH
        for reports in sets
    ]
    clusters, index = np.unique(np.concatenate(numbers), return_inverse=True)
    if clusters.size < MIN_FLIGHTS:
        return None
    indices = np.split(index, np.cumsum([number.size for number in numbers])[:-1])
    stretched = [
        replace(reports, flight=index).take(np.argsort(index, kind="stable"))
        for reports, index in zip(sets, indices, strict=True)
    ]
    day = (clusters % 10**9) * STRETCH // 86_400
    return fit_aircraft(stretched, day, joint=options.joint, harmonics=0)
