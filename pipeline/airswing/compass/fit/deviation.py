"""Deviation of the compass of each aircraft: the fit of a fleet and its status.

Assumptions
-----------
One deviation curve an aircraft over the whole period, a function of the indicated magnetic heading
(A to E of `airswing.physics.compass_deviation`); one airspeed scale an aircraft; a bias of the
reference wind that the fleet shares in part. B and C are those at the mean horizontal field of the
aircraft's reports used, ``mean_horizontal_field``; without ``horizontal_field`` in the headings
they are taken as constant.

Each aircraft is fitted first (`airswing.compass.fit.kernel`), by `xarray.apply_ufunc` over batches
of whole aircraft; then the fleet is solved on the sums of these fits
(`airswing.compass.fit.acceptance`). Standard errors allow for errors common to a flight and to a
day, for the number of clusters (+-1.96 of them is a 95 % interval) and for the choice of one or two
cycles.

Where headings or flights do not allow a curve, one constant is fitted
(`airswing.compass.fit.offset_alone`), status ``offset_only``.

References
----------
Jacobs et al. 2010 (seed paper), eq. 3 and step d; NGA Handbook of Magnetic Compass Adjustment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Unpack

import numpy as np
import xarray as xr
from dask.delayed import delayed
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import (
    MAX_CONDITION,
    AircraftSums,
    Asked,
    Options,
    condition_number,
    publish,
)
from airswing.compass.fit.kernel import AircraftFit, fit_aircraft
from airswing.compass.fit.offset_alone import MIN_FLIGHTS, STRETCH
from airswing.compass.fleet.blocks import Reports
from airswing.compass.whole_aircraft import aircraft_batches, is_lazy, lazy_dataset, single_task
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.physics.compass_deviation import COEFFICIENTS, deviation_basis
from airswing.products.ragged import row_bounds
from airswing.vocabulary import describe

Array = NDArray[np.float64]

_PER_REPORT = (
    "heading",
    "magnetic_heading",
    "airspeed",
    "screening",
    "flight",
    "time",
    "latitude",
    "longitude",
    "pressure",
)
_PER_REFERENCE = ("heading_error", "airspeed_error", "heading_error_standard_error")
FITTED_FROM = (*_PER_REPORT, *_PER_REFERENCE, "row_size", "horizontal_field")
"""Variables a fit reads; the last one is optional."""
BATCH_REPORTS = 500_000
"""Reports of one batch of aircraft, where no single aircraft has more."""


@dataclass(frozen=True)
class FleetSums:
    """Fits of some aircraft by themselves, with the sums that the fit of the fleet needs."""

    aircraft: NDArray[np.object_]
    groups: dict[str, list[AircraftSums]]  # by reference and pool, one an aircraft
    options: Options
    attributes: dict[str, object]  # attributes of the Dataset of the fits


def fit_deviation(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    abscissa: Literal["magnetic", "true"] = "magnetic",
    alone: bool = True,
    **options: Unpack[Asked],
) -> xr.Dataset:
    """Fit the deviation of every aircraft against every reference and every pool.

    Parameters
    ----------
    headings : Dataset
        Headings of every report (``report``, ``reference``, ``aircraft``); only reports with
        ``screening`` 0 and finite values count. With dask arrays nothing is computed yet.
    pools : mapping of str to list of str, optional
        Name of a pool -> its references, fitted together.
    abscissa : {"magnetic", "true"}
        Argument of the curve: indicated magnetic heading, or (seed paper) true heading.
    alone : bool
        Also fit each reference by itself; without pools always.
    **options
        ``harmonics``, ``joint``, ``shared_error``, ``min_reports``, ``min_compass_points``: see
        :class:`airswing.compass.fit.acceptance.Options`.

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
    groups = groups_of(headings, pools or {}, alone=alone or not pools)
    fits = _local_fits(headings, groups, abscissa, Options(**options))
    # the fleet's part needs the names of aircraft and references, no reports
    names = headings[["aircraft", "reference"]].drop_dims("report", errors="ignore")
    rest = names, groups, abscissa, Options(**options)
    if not is_lazy(headings, FITTED_FROM):
        return _solved(fits.to_numpy(), *rest)
    unfitted = np.empty(fits.shape, dtype=object)
    unfitted[...] = AircraftSums(0, 0, 0, None, STATUS["too_few_reports"], np.nan)
    template = _solved(unfitted, *rest)
    task = delayed(_solved)(single_task(fits.data), *rest)
    return lazy_dataset(task, template, {}, template)


def sum_aircraft(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    abscissa: Literal["magnetic", "true"] = "magnetic",
    alone: bool = True,
    **options: Unpack[Asked],
) -> FleetSums:
    """Fit each aircraft by itself: the part of :func:`fit_deviation` that reads reports.

    The result for an aircraft depends on its reports alone, so that a fleet larger than memory
    may be given in parts, and all parts to :func:`fit_sums`.

    Parameters
    ----------
    headings, pools, abscissa, alone, **options
        As for :func:`fit_deviation`; of some aircraft of the fleet.

    Returns
    -------
    FleetSums
    """
    groups = groups_of(headings, pools or {}, alone=alone or not pools)
    asked = Options(**options)
    fits = _local_fits(headings, groups, abscissa, asked).to_numpy()
    return _fleet_sums(fits, headings, groups, abscissa, asked)


def fit_sums(parts: Sequence[FleetSums]) -> xr.Dataset:
    """Fit the fleet on the sums of its aircraft, as :func:`fit_deviation` does.

    Parameters
    ----------
    parts : sequence of FleetSums
        Of different aircraft, made with the same options.

    Returns
    -------
    Dataset
        As of :func:`fit_deviation`, in memory.
    """
    first = parts[0]
    found = [
        publish([one for part in parts for one in part.groups[name]], first.options)
        for name in first.groups
    ]
    fits = xr.concat(found, dim="reference", join="override", combine_attrs="drop")
    fits = fits.assign_coords(
        reference=("reference", np.array(list(first.groups), dtype=object)),
        aircraft=("aircraft", np.concatenate([part.aircraft for part in parts])),
        coefficient=("coefficient", np.array(COEFFICIENTS, dtype=object)),
        coefficient_2=("coefficient_2", np.array(COEFFICIENTS, dtype=object)),
        component=("component", np.array(["eastward", "northward"], dtype=object)),
    )
    fits.attrs.update(first.attributes)
    return describe(fits)


def groups_of(
    headings: xr.Dataset, pools: Mapping[str, Sequence[str]], *, alone: bool
) -> dict[str, list[int]]:
    """Return the places of the references that are fitted together, by the name of the group.

    Raises
    ------
    InputError
        If a variable is missing or a pool names an unknown reference.
    """
    for name in FITTED_FROM[:-1]:
        if name not in headings:
            raise InputError("the headings lack a variable the fit needs", field=name)
    names = [str(name) for name in headings["reference"].to_numpy()]
    groups = {name: [k] for k, name in enumerate(names)} if alone else {}
    for pool_name, members in pools.items():
        unknown = [name for name in members if name not in names]
        if unknown or not members:
            raise InputError(
                "the pool names a reference that is not in the headings",
                field=pool_name,
                found=", ".join(unknown) or "no member",
                remedy=f"References: {', '.join(names)}",
            )
        groups[pool_name] = [names.index(name) for name in members]
    return groups


def _fleet_sums(
    fits: NDArray[np.object_],
    headings: xr.Dataset,
    groups: dict[str, list[int]],
    abscissa: str,
    options: Options,
) -> FleetSums:
    return FleetSums(
        headings["aircraft"].to_numpy().astype(object),
        {name: list(row) for name, row in zip(groups, fits, strict=True)},
        options,
        {
            "abscissa": abscissa,
            "joint": int(options.joint),
            "harmonics_asked": str(options.harmonics),
            "reference_count": headings.sizes["reference"],
        },
    )


def _solved(fits: NDArray[np.object_], *rest: Any) -> xr.Dataset:
    return fit_sums([_fleet_sums(fits, *rest)])


def _local_fits(
    headings: xr.Dataset, groups: dict[str, list[int]], abscissa: str, options: Options
) -> xr.DataArray:
    """Fits of each aircraft by itself, objects (group, aircraft)."""
    heads = headings[[name for name in FITTED_FROM if name in headings]]
    heads = heads.drop_vars(["aircraft", "reference"], errors="ignore")
    names = [name for name in (*_PER_REPORT, *_PER_REFERENCE) if name in heads]
    inputs: list[list[str]] = [["report"]] * len(_PER_REPORT)
    inputs += [["reference", "report"]] * len(_PER_REFERENCE)
    if "horizontal_field" in heads:
        names.append("horizontal_field")
        inputs.append(["report"])
    batches = [
        xr.apply_ufunc(
            _fit_batch,
            *(batch[name] for name in names),
            batch["row_size"],
            input_core_dims=[*inputs, ["aircraft"]],
            output_core_dims=[["group", "aircraft"]],
            kwargs={
                "names": names,
                "groups": list(groups.values()),
                "abscissa": abscissa,
                "options": options,
            },
            dask="parallelized",
            output_dtypes=[object],
            dask_gufunc_kwargs={
                "output_sizes": {"group": len(groups)},
                "allow_rechunk": True,
            },
        )
        for batch in aircraft_batches(heads, BATCH_REPORTS)
    ]
    found: xr.DataArray = xr.concat(batches, dim="aircraft")
    return found


def _fit_batch(
    *arrays: NDArray[Any],
    names: list[str],
    groups: list[list[int]],
    abscissa: str,
    options: Options,
) -> NDArray[np.object_]:
    """Kernel of the fits over the aircraft of a batch, whose reports are concatenated."""
    *values, row_size = arrays
    columns = dict(zip(names, values, strict=True))
    found = np.empty((len(groups), row_size.size), dtype=object)
    for k, (begin, end) in enumerate(zip(*row_bounds(row_size), strict=True)):
        one = {name: column[..., begin:end] for name, column in columns.items()}
        for j, members in enumerate(groups):
            found[j, k] = _fit_one(one, members, abscissa, options)
    return found


def _observations(
    columns: dict[str, NDArray[Any]], members: list[int], abscissa: str
) -> tuple[list[Reports], NDArray[np.int64], Array, float]:
    """Reports of one aircraft that count, ready for the kernel.

    Returns
    -------
    sets : list of Reports
        One a member.
    days : array of int, shape (flights,)
        Days since 1970 on which the flights began.
    abscissa : array, shape (n,), radians
        Of the reports that count for any member.
    field : float
        Mean horizontal field of the reports that count, nT; NaN where none is known.
    """
    flight, time = columns["flight"], columns["time"]
    if np.any(flight[1:] < flight[:-1]):
        order = np.lexsort((time, flight))
        columns = {name: column[..., order] for name, column in columns.items()}
        flight, time = columns["flight"], columns["time"]
    argument = columns["magnetic_heading" if abscissa == "magnetic" else "heading"]
    common = columns["heading"] + argument + columns["airspeed"]
    used = (columns["screening"] == 0) & np.isfinite(common)
    errors, speeds, known_errors = (
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
    known = np.zeros(used.size, bool) if field is None else np.isfinite(field) & (field > 0)
    if field is not None and (used & known).any():
        mean = float(field[used & known].mean(dtype=np.float64))
        gain[known] = mean / field[known]
    angle = np.radians(argument.astype(np.float64))
    heading = np.radians(columns["heading"].astype(np.float64))
    airspeed = columns["airspeed"].astype(np.float64)
    latitude, longitude, pressure = (
        columns[name].astype(np.float64) for name in ("latitude", "longitude", "pressure")
    )
    basis = deviation_basis(angle, gain)
    sets = []
    for mask, error, speed, deviation in zip(masks, errors, speeds, known_errors, strict=True):
        kept: slice | NDArray[np.bool_] = slice(None) if mask.all() else mask
        variance = (np.radians(deviation[kept]) * airspeed[kept]) ** 2
        sets.append(
            Reports(
                basis[:, kept],
                heading[kept],
                np.radians(error[kept]),
                airspeed[kept],
                airspeed[kept] - speed[kept],
                np.nan_to_num(variance, posinf=0.0),
                flights[kept],
                latitude[kept],
                longitude[kept],
                pressure[kept],
                time[kept],
            )
        )
    return sets, days, angle[used], mean


def _compass_points(angle: Array) -> int:
    """Number of compass points that three headings (radians), or one in 500, are nearest to."""
    counts = np.bincount(np.rint(angle / (np.pi / 4)).astype(np.int64) % 8, minlength=8)
    # fewer than these are turns or gross errors
    return int(np.count_nonzero(counts >= max(3.0, 0.002 * angle.size)))


def _fit_one(
    columns: dict[str, NDArray[Any]], members: list[int], abscissa: str, options: Options
) -> AircraftSums:
    sets, flight_day, angle, field = _observations(columns, members, abscissa)
    points = _compass_points(angle)
    found = AircraftSums(angle.size, flight_day.size, points, None, STATUS["ok"], field)
    if angle.size < options.min_reports:
        found.status = STATUS["too_few_reports"]
    elif flight_day.size < MIN_FLIGHTS:
        found.status = STATUS["too_few_flights"]
    elif points < options.min_compass_points:
        found.status = STATUS["poor_heading_coverage"]
    fit = partial(
        fit_aircraft,
        sets,
        flight_day,
        joint=options.joint,
        with_blocks=options.joint and options.shared_error,
    )
    # also where no curve will be published: its condition number is
    if points >= 3 and flight_day.size >= 2 and angle.size >= 20:
        found.fit = fit(harmonics=1 if options.harmonics == 1 else 2)
        if (
            found.fit is not None
            and options.harmonics == "auto"
            and condition_number(found.fit.normal, 2) > MAX_CONDITION
        ):
            found.fit = fit(harmonics=1)
    if found.status == STATUS["ok"]:
        if found.fit is None:
            found.status = STATUS["too_few_reports"]
        elif condition_number(found.fit.normal, 2 if 4 in found.fit.free else 1) > MAX_CONDITION:
            found.status = STATUS["poor_heading_coverage"]
    if found.status == STATUS["poor_heading_coverage"]:
        found.constant = fit_aircraft(sets, flight_day, joint=options.joint, harmonics=0)
    elif found.status == STATUS["too_few_flights"]:
        found.constant = _fit_of_stretches(sets, options)
    return found


def _fit_of_stretches(sets: list[Reports], options: Options) -> AircraftFit | None:
    """Constant of an aircraft with too few flights, with stretches of flight as clusters."""
    step = STRETCH.astype(np.int64)
    # flight and stretch as one number: stretches since 1970 are far fewer than 10^9
    numbers = [
        part.flight * 10**9 + part.time.astype("datetime64[s]").astype(np.int64) // step
        for part in sets
    ]
    known, where = np.unique(np.concatenate(numbers), return_inverse=True)
    if known.size < MIN_FLIGHTS:
        return None
    parts = np.split(where, np.cumsum([number.size for number in numbers])[:-1])
    stretched = [
        replace(reports, flight=part).take(np.argsort(part, kind="stable"))
        for reports, part in zip(sets, parts, strict=True)
    ]
    day = (known % 10**9) * step // 86_400
    return fit_aircraft(stretched, day, joint=options.joint, harmonics=0)
