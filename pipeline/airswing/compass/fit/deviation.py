"""Deviation of every aircraft's compass from its headings' errors: the fit and its status.

Assumptions
-----------
One deviation curve an aircraft over the whole period, a function of the indicated magnetic heading
(A constant, one or two cycles: Archibald Smith's coefficients); one airspeed scale an aircraft; a
reference wind whose bias is shared by the fleet in part. See
:mod:`airswing.compass.fit.normal_equations` for the equations and
:mod:`airswing.compass.fit.pooled_bias` for the bias. B and C are those at the mean horizontal field
of the aircraft's reports that count, ``mean_horizontal_field``: they scale with 1/H. Where the
headings say no ``horizontal_field`` they are taken as constant.

Standard errors allow for flights' and days' common errors, for the number of clusters (they are
made wider so that +-1.96 of them is a 95 % interval) and for the choice of one or two cycles
(where one was chosen, what that may have cost is in the covariance, D and E included).

Where headings or flights do not allow a curve, one constant an aircraft stands for it
(:mod:`airswing.compass.fit.offset_alone`), status ``offset_only``.

Inside degrees; NaN coefficients wherever the status is neither ``ok`` nor ``offset_only``.

References
----------
Jacobs et al. 2010 (seed paper), eq. 3 and step d; NGA Handbook of Magnetic Compass Adjustment.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import (
    MAX_CONDITION,
    REGIONS,
    AircraftSums,
    Asked,
    Options,
    condition_number,
    publish,
)
from airswing.compass.fit.aircraft import AircraftFit, fit_aircraft
from airswing.compass.fit.observations import Reports
from airswing.compass.fit.offset_alone import MIN_FLIGHTS, STRETCH
from airswing.compass.fit.report_columns import Columns
from airswing.compass.fit.row_blocks import BLOCK
from airswing.compass.fleet.flight_segments import Places
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.products.ragged import blocks
from airswing.vocabulary import describe

COEFFICIENTS = ("A", "B", "C", "D", "E")
# Tasks the aircraft are shared between, where there are more of them than that: a task graph costs
# half an aircraft's fit. They run one after the other: the kernel's blocks are so short that
# threads spend more on the interpreter's lock than they gain.
CHUNKS = 8
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
_FIRST = np.datetime64("1970-01-01", "s")
_USEFUL = ("horizontal_field",)  # Read where they are there
FITTED_FROM = (*_NEEDED, *_USEFUL)
"""Variables a fit reads."""


@dataclass(frozen=True)
class FleetSums:
    """What the fit of a fleet needs of some of its aircraft: their own fits and block sums."""

    aircraft: NDArray[np.object_]
    groups: dict[str, list[AircraftSums]]  # by reference and pool, one an aircraft
    members: dict[str, int]  # references in each
    options: Options
    attributes: dict[str, object]  # what the fits say about themselves


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
        Headings of every report (``report``, ``reference``, ``aircraft``), in memory or opened
        lazily; only reports with ``screening`` 0 and finite values count.
    pools : mapping of str to list of str, optional
        Name of a pool -> its references, fitted together.
    abscissa : {"magnetic", "true"}
        Argument of the curve: indicated magnetic heading, or (the seed's) true heading.
    alone : bool
        Also fit each reference alone, beside the pools; without pools always.
    **options
        ``harmonics``, ``joint``, ``shared_error``, ``min_reports``, ``min_compass_points``: see
        :class:`airswing.compass.fit.acceptance.Options`.

    Returns
    -------
    Dataset
        Every variable of ``fits.nc`` except the table's; attribute ``shared_error_regions`` where
        the references' error covers so much that it was worked in regions.

    Raises
    ------
    InputError
        If a variable is missing or a pool names an unknown reference.
    """
    groups_of(headings, pools or {}, alone=True)
    parts = [headings] if _in_memory(headings) else blocks(headings, FITTED_FROM)
    return fit_sums(
        [
            sum_aircraft(part, pools=pools, abscissa=abscissa, alone=alone, **options)
            for part in parts
        ]
    )


def _in_memory(headings: xr.Dataset) -> bool:
    """Whether nothing is left to read: cutting such a fleet in parts saves no memory."""
    own = [headings.variables[name] for name in FITTED_FROM if name in headings.variables]
    # no public name tells; where a later xarray has none, the fleet is cut, to the same end
    return all(getattr(variable, "_in_memory", False) for variable in own)


def sum_aircraft(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, Sequence[str]] | None = None,
    abscissa: Literal["magnetic", "true"] = "magnetic",
    alone: bool = True,
    **options: Unpack[Asked],
) -> FleetSums:
    """Fit every aircraft by itself and sum its blocks: all that looks at reports.

    An aircraft's sums depend on its own reports alone, so a fleet may be summed in any parts.

    Parameters
    ----------
    headings : Dataset
        Of a fleet, or of some of its aircraft.
    pools, abscissa, alone, **options
        As for :func:`fit_deviation`.

    Raises
    ------
    InputError
        If a variable is missing or a pool names an unknown reference.
    """
    groups = groups_of(headings, pools or {}, alone=alone or not pools)
    asked = Options(**options)
    columns = Columns(headings, abscissa)
    found = {}
    for name, members in groups.items():
        columns.use(members)
        found[name] = _sum_reference(columns, members, asked)
    return FleetSums(
        headings["aircraft"].to_numpy().astype(object),
        found,
        {name: len(members) for name, members in groups.items()},
        asked,
        {
            "abscissa": abscissa,
            "joint": int(asked.joint),
            "harmonics_asked": str(asked.harmonics),
            "reference_count": headings.sizes["reference"],
        },
    )


def fit_sums(parts: Sequence[FleetSums]) -> xr.Dataset:
    """Fit the fleet on the sums of its aircraft, as :func:`fit_deviation` does.

    The parts are of different aircraft, made with the same options.
    """
    first = parts[0]
    found = [
        publish([one for part in parts for one in part.groups[name]], first.options)
        for name in first.members
    ]
    fits = xr.concat(found, dim="reference", join="override", combine_attrs="drop")
    if regions := [one.attrs[REGIONS] for one in found if REGIONS in one.attrs]:
        fits.attrs[REGIONS] = max(regions)
    fits = fits.assign_coords(
        reference=("reference", np.array(list(first.members), dtype=object)),
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
    """Places of the references that are fitted together, by the name of each such group."""
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

    def __init__(self, columns: Columns, members: list[int], options: Options) -> None:
        self.columns, self.members, self.options = columns, members, options

    def __call__(self, aircraft: NDArray[np.int64]) -> NDArray[np.object_]:
        found = np.empty(aircraft.shape, dtype=object)
        for k, number in enumerate(aircraft):
            found[k] = _fit_one(self.columns, int(number), self.members, self.options)
        return found

    def __dask_tokenize__(self) -> str:
        return uuid.uuid4().hex


def _sum_reference(columns: Columns, members: list[int], options: Options) -> list[AircraftSums]:
    size = columns.start.size
    index = xr.DataArray(np.arange(size), dims="aircraft")
    if size > CHUNKS:
        index = index.chunk({"aircraft": -(-size // CHUNKS)})
    found = xr.apply_ufunc(
        _Fitter(columns, members, options), index, dask="parallelized", output_dtypes=[object]
    ).compute(scheduler="synchronous")
    return list(found.to_numpy())


def compass_points(angle: NDArray[np.floating]) -> int:
    """Compass points that angles (degrees) are nearest to: three of them, or one in 500."""
    # so few are turns or gross headings, and no point that is flown on
    least = max(3, 0.002 * angle.size)
    counts = np.zeros(8, dtype=np.int64)
    for begin in range(0, angle.size, BLOCK):
        # whole turns are added so that cutting the fraction off is rounding to the nearest point
        point = (angle[begin : begin + BLOCK] * (1 / 45.0) + 16.5).astype(np.int8) & 7
        counts += [np.count_nonzero(point == k) for k in range(8)]
        if counts.min() >= least:
            break
    return int(np.count_nonzero(counts >= least))


def _fit_one(columns: Columns, aircraft: int, members: list[int], options: Options) -> AircraftSums:
    sets, flight_day, abscissa, places, field = columns.observations(aircraft, members)
    fit = partial(
        fit_aircraft,
        sets,
        flight_day,
        joint=options.joint,
        places=places if options.joint and options.shared_error else None,
    )
    points = compass_points(abscissa)
    found = AircraftSums(
        int(abscissa.size), int(flight_day.size), points, None, STATUS["ok"], field
    )
    if abscissa.size < options.min_reports:
        found.status = STATUS["too_few_reports"]
    elif flight_day.size < MIN_FLIGHTS:
        found.status = STATUS["too_few_flights"]
    elif points < options.min_compass_points:
        found.status = STATUS["poor_heading_coverage"]
    cycles = 1 if options.harmonics == 1 else 2
    # Also where a curve will not be published: what is known of it is told all the same.
    if points >= 3 and flight_day.size >= 2 and abscissa.size >= 20:
        found.fit = fit(harmonics=cycles)
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
        found.constant = _of_stretches(sets, places, options)
    return found


def _of_stretches(
    sets: list[Reports], places: list[Places], options: Options
) -> AircraftFit | None:
    """Constant of an aircraft with too few flights, stretches of them its clusters."""
    # A flight and a stretch of it as one number: stretches since 1970 stay far below 10^9.
    numbers = [
        reports.flight * 10**9 + (place.time.astype("datetime64[s]") - _FIRST) // STRETCH
        for reports, place in zip(sets, places, strict=True)
    ]
    known, where = np.unique(np.concatenate(numbers), return_inverse=True)
    if known.size < MIN_FLIGHTS:
        return None
    parts = np.split(where, np.cumsum([number.size for number in numbers])[:-1])
    stretched = [
        replace(reports, flight=part).sorted() for reports, part in zip(sets, parts, strict=True)
    ]
    # of the number above, what the stretch put into it
    day = (known % 10**9) * STRETCH.astype(np.int64) // 86_400
    return fit_aircraft(stretched, day, joint=options.joint, harmonics=0)
