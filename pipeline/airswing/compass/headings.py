"""Headings and heading errors of every report: ground vector, both air vectors, magnetic field.

Assumptions
-----------
Reports in the ragged order (aircraft, then time) with flights numbered over the archive; model
winds relative to true north at the same reports. The unit computed its wind as ground velocity
minus true airspeed along its indicated heading, so that the indicated heading is the argument of
V_A = V_G - V_W,reported: it is derived, and needs no heading column. Where an aircraft does report
true heading and airspeed, and they agree with its fixes, they are believed before the chords
(`airswing.compass.ground_vector`).

Where the path turns, chords tell neither heading nor speed at the report: they are then those of
the legs around it (`airswing.physics.turns`), and the ground vector follows from them,
so that V_G = V_A + W holds everywhere and the standard errors say how much a turn leaves open.

What the standard errors mean
-----------------------------
``ground_velocity_error`` is one standard error of each component of V_G: rounding of positions
and times, and wandering between fixes. ``heading_standard_error`` is that error carried to the
indicated heading, ``heading_error_standard_error`` through psi_err to first order: V_G enters both
air vectors, so an error of it nearly cancels and only the part that scales or shears the difference
of the two winds is left. It says nothing about the model's error nor the unit's coding of its wind:
the fit estimates that scatter itself.

Laziness
--------
What depends on the reports alone is computed at once (an archive is sorted, so it is whole
anyway); what depends on the model winds stays lazy when they are dask arrays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.reported_motion import (
    Account,
    Motion,
    accounts_of,
    column_of,
    motion_of,
    seconds_of,
    sum_of_accounts,
)
from airswing.errors import InputError
from airswing.physics import triangle
from airswing.physics.geomagnetism import FieldLattice
from airswing.physics.track import ACCELERATION_DENSITY
from airswing.vocabulary import VARIABLES, describe

Array = NDArray[np.float64]

_NEEDED = (
    "time",
    "latitude",
    "longitude",
    "pressure_altitude",
    "eastward_wind",
    "northward_wind",
    "flight",
    "row_size",
)
DERIVED = (
    "ground_eastward_velocity",
    "ground_northward_velocity",
    "ground_speed",
    "track",
    "ground_velocity_error",
    "turn",
    "longitudinal_acceleration",
    "climb_rate",
    "bank",
    "heading",
    "heading_standard_error",
    "airspeed",
    "magnetic_heading",
    "declination",
    "horizontal_field",
    "dip",
    "heading_error",
    "heading_error_standard_error",
    "airspeed_error",
)
"""What is added to reports and winds."""
# Standard error of a heading of which nothing is known, rad.
LARGEST_ERROR = float(np.pi / np.sqrt(3.0))
_WIND_NAMES = ("reference_eastward_wind", "reference_northward_wind")


def derive_headings(
    reports: xr.Dataset,
    winds: xr.Dataset,
    *,
    acceleration_density: float = ACCELERATION_DENSITY,
    widen: bool = True,
) -> xr.Dataset:
    """Headings, magnetic field and heading errors of reports against model winds.

    Parameters
    ----------
    reports : Dataset
        Canonical reports (dimensions ``report`` and ``aircraft``).
    winds : Dataset
        Collocated model winds (dimensions ``reference`` and ``report``), in memory or dask-backed.
    acceleration_density : float
        How the ground velocity wanders between fixes, m2 s-3; see `airswing.physics.track`.
    widen : bool
        Whether ground vectors may reach past the neighbouring fixes.

    Returns
    -------
    Dataset
        Reports and winds with ``ground_speed, track, ground_eastward_velocity,
        ground_northward_velocity, ground_velocity_error, turn, longitudinal_acceleration,
        climb_rate, bank, heading, heading_standard_error, magnetic_heading, airspeed, declination,
        horizontal_field, dip``
        (report) and ``heading_error, heading_error_standard_error, airspeed_error`` (reference,
        report); angles in degrees. The attribute ``ground_vector_evidence`` (JSON) counts which
        ground vector was believed and says why an aircraft's own was not.

    Raises
    ------
    InputError
        If a variable is missing, or the two Datasets do not hold the same reports.

    References
    ----------
    Jacobs et al. 2010, steps a-c and equation 3.
    """
    reports = reports.compute()
    derived, accounts = derive_columns(
        reports, winds, acceleration_density=acceleration_density, widen=widen
    )
    found = with_columns(reports, winds, derived)
    found.attrs["ground_vector_evidence"] = json.dumps(sum_of_accounts(accounts))
    return found


def derive_columns(
    reports: xr.Dataset,
    winds: xr.Dataset,
    *,
    acceleration_density: float = ACCELERATION_DENSITY,
    widen: bool = True,
) -> tuple[dict[str, xr.DataArray], list[Account]]:
    """What :func:`derive_headings` adds to the reports (in memory) and the winds, alone.

    Returns
    -------
    columns : dict of str to DataArray
        (report) or (reference, report), of the type they have on disk: a stage run from the
        product gives the same bits.
    accounts : list of dict
        Of ``ground_vector_evidence``, one an aircraft.
    """
    _check(reports, winds)
    motion = motion_of(reports, acceleration_density=acceleration_density, widen=widen)
    own = _report_columns(motion) | _field_columns(reports, motion)
    columns = {name: xr.DataArray(values, dims="report") for name, values in own.items()}
    columns |= _reference_columns(winds, motion)
    typed = {name: values.astype(VARIABLES[name].dtype) for name, values in columns.items()}
    return typed, accounts_of(reports, motion)


def with_columns(
    reports: xr.Dataset, winds: xr.Dataset, columns: Mapping[str, object]
) -> xr.Dataset:
    """Reports, winds and columns of :func:`derive_columns` as one described Dataset."""
    # Both hold the reports' coordinates; comparing them would load what is lazy.
    found = reports.merge(winds, compat="override", combine_attrs="override")
    found = found.assign(columns)
    found.attrs = {**winds.attrs, **reports.attrs}
    return describe(found)


def _heading_error_sensitivity(
    air_east: Array, air_north: Array, implied_east: Array, implied_north: Array
) -> tuple[Array, Array]:
    """Derivative of the heading error by the ground velocity, east and north, radians per m s-1.

    The heading of a vector V turns by n.dV/|V|, n its right-hand normal; the same dV enters both
    vectors, so what is left is the difference of the two n/|V|.
    """
    used = air_east**2 + air_north**2
    implied = implied_east**2 + implied_north**2
    with np.errstate(divide="ignore", invalid="ignore"):
        by_east = air_north / used - implied_north / implied
        by_north = implied_east / implied - air_east / used
    return by_east, by_north


def _check(reports: xr.Dataset, winds: xr.Dataset) -> None:
    for name in _NEEDED:
        if name not in reports:
            raise InputError("the reports lack a variable", field=name)
    for name in _WIND_NAMES:
        if name not in winds:
            raise InputError("the model winds lack a variable", field=name)
    if winds.sizes.get("report") != reports.sizes["report"]:
        raise InputError(
            "model winds and reports do not hold the same reports",
            field="report",
            found=f"{winds.sizes.get('report')} winds for {reports.sizes['report']} reports",
            remedy="Collocate these reports again",
        )
    total = int(reports["row_size"].sum())
    if total != reports.sizes["report"]:
        raise InputError(
            "row_size does not add up to the reports",
            field="row_size",
            found=f"{total} for {reports.sizes['report']} reports",
        )


def _report_columns(motion: Motion) -> dict[str, Array]:
    ground, path = motion.ground, motion.path
    return {
        "ground_eastward_velocity": ground.eastward,
        "ground_northward_velocity": ground.northward,
        "ground_speed": triangle.speed_of_vector(ground.eastward, ground.northward),
        "track": np.degrees(triangle.bearing(ground.eastward, ground.northward)),
        # a component's: half of the vector's mean square
        "ground_velocity_error": np.sqrt(0.5 * (ground.along_error**2 + ground.cross_error**2)),
        "turn": np.degrees(path.turn),
        "longitudinal_acceleration": path.longitudinal_acceleration,
        "climb_rate": path.climb_rate,
        "bank": np.degrees(path.bank),
        "heading": np.degrees(triangle.bearing(motion.air_east, motion.air_north)),
        "heading_standard_error": _heading_error(motion),
        "airspeed": triangle.speed_of_vector(motion.air_east, motion.air_north),
    }


def _heading_error(motion: Motion) -> Array:
    """Standard error of the indicated heading, degrees: that of the ground vector across it."""
    ground = motion.ground
    track = triangle.bearing(ground.eastward, ground.northward)
    along, cross = triangle.along_cross(motion.air_east, motion.air_north, track)
    speed = triangle.speed_of_vector(motion.air_east, motion.air_north)
    # across the heading stands -cross of the ground's direction along, and along of that across
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.hypot(cross * ground.along_error, along * ground.cross_error) / speed
        # an angle of which nothing is known has this error; beyond it the linear step means nothing
        return np.asarray(np.degrees(np.minimum(across / speed, LARGEST_ERROR)))


def _field_columns(reports: xr.Dataset, motion: Motion) -> dict[str, Array]:
    place = (
        column_of(reports, "latitude"),
        column_of(reports, "longitude"),
        np.nan_to_num(column_of(reports, "pressure_altitude")),
        seconds_of(reports),
    )
    field = FieldLattice.covering(*place).at(*place)
    heading = triangle.bearing(motion.air_east, motion.air_north)
    return {
        "magnetic_heading": np.degrees(triangle.wrap_positive(heading - field.declination)),
        "declination": np.degrees(field.declination),
        "horizontal_field": field.horizontal,
        "dip": np.degrees(field.dip),
    }


def _reference_columns(winds: xr.Dataset, motion: Motion) -> dict[str, xr.DataArray]:
    per_report = (
        motion.ground.eastward,
        motion.ground.northward,
        motion.air_east,
        motion.air_north,
        motion.ground.along_error,
        motion.ground.cross_error,
    )
    error, standard_error, speed_error = xr.apply_ufunc(
        _compare,
        *(winds[name] for name in _WIND_NAMES),
        *(xr.DataArray(values, dims="report") for values in per_report),
        output_core_dims=[[], [], []],
        output_dtypes=[np.float64] * 3,
        dask="parallelized",
        keep_attrs=False,
    )
    return {
        "heading_error": error,
        "heading_error_standard_error": standard_error,
        "airspeed_error": speed_error,
    }


def _compare(
    wind_east: Array,
    wind_north: Array,
    ground_east: Array,
    ground_north: Array,
    air_east: Array,
    air_north: Array,
    along_error: Array,
    cross_error: Array,
) -> tuple[Array, Array, Array]:
    """Heading error and its standard error (degrees), airspeed error; m s-1 in."""
    implied = triangle.air_vector(ground_east, ground_north, wind_east, wind_north)
    error = triangle.heading_error(air_east, air_north, *implied)
    slope = _heading_error_sensitivity(air_east, air_north, *implied)
    along, cross = triangle.along_cross(*slope, triangle.bearing(ground_east, ground_north))
    standard_error = np.hypot(along * along_error, cross * cross_error)
    speed_error = triangle.airspeed_error(air_east, air_north, *implied)
    return np.degrees(error), np.degrees(standard_error), speed_error
