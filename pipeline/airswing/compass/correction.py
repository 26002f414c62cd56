"""Correction of the reported winds for the deviation of the compass.

Assumptions
-----------
The error of the unit is the direction of its air vector: psi_corr = psi_ind - psi_err(m), m the
indicated magnetic heading. With V_A = V_G - W_reported the ground vector cancels: W_corrected =
W_reported + V_A - R V_A, R the turn by -psi_err. So only airspeed and indicated heading are needed,
and every report that has them is corrected, whether or not the fit used it. On request the airspeed
scale s is removed too: V_A / (1 + s).

The one-cycle part of the curve (B, C) is that at the mean horizontal field of the reports it was
fitted to and is proportional to its inverse; it is scaled to the field of every report where both
are known. A unit's table is the same at all places and is applied unscaled.

Standard error
--------------
Of the corrected wind as a vector, against the report that an aircraft with a right compass would
have sent. The correction adds V (e^(-i delta) - 1) along the heading, of length V delta. Its errors
are independent and add in quadrature:

* the curve: V times its standard error at the heading, and V times the difference of the unit's
  table from the curve at this heading and field, which is known;
* the heading: with an error eps the curve is read at the wrong heading and the correction turned
  with it, ``V (delta, delta') eps`` along and across; a large eps saturates like the chord of a
  circle, ``2 (1 - exp(-sd^2 / 2))`` in place of ``sd^2``;
* the airspeed: ``delta`` times its error, and its scale where that is removed;
* coding: both reports are rounded to steps of speed and direction, twice the variance of one.

Gusts and noise of the sensors are in both reports and not included. Valid for deviations under 30
degrees. Degrees in the Datasets, radians and m/s inside.

References
----------
Jacobs et al. 2010 (seed paper), step f.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.compass.table import error_from_table, table_slope, unit_interpolation
from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import InputError
from airswing.flags import CORRECTION, SCREENING, STATUS, is_corrected, published
from airswing.physics.compass_deviation import deviation_basis, deviation_slope
from airswing.products.ragged import aircraft_of_report
from airswing.vocabulary import describe

Array = NDArray[np.float64]

KEPT = (
    "time",
    "latitude",
    "longitude",
    "pressure",
    "pressure_altitude",
    "eastward_wind",
    "northward_wind",
    "air_temperature",
    "reference_eastward_wind",
    "reference_northward_wind",
    "lead_time",
    "heading",
    "magnetic_heading",
    "airspeed",
    "phase",
    "flight",
    "screening",
    "row_size",
    "platform",
    "roll_flag",
    "temperature_qc",
)
"""Variables of the reports that the corrected product also holds, where they are present."""
NEEDED = (
    "eastward_wind",
    "northward_wind",
    "heading",
    "magnetic_heading",
    "airspeed",
    "screening",
    "row_size",
    "platform",
    "horizontal_field",
    "heading_standard_error",
    "ground_velocity_error",
    "wind_speed_resolution",
    "wind_direction_resolution",
)
"""Variables that the correction reads. Without the last five it is made for the mean field, and its
standard error is that of the fit and the table alone."""


def corrected_wind(
    u: ArrayLike,
    v: ArrayLike,
    airspeed: ArrayLike,
    heading: ArrayLike,
    error: ArrayLike,
    scale: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """Wind that the unit would have computed along the corrected heading.

    Parameters
    ----------
    u, v : array_like, shape (n,)
        Reported wind, m/s.
    airspeed : array_like, shape (n,)
        |V_A|, m/s.
    heading, error : array_like, shape (n,)
        Indicated true heading and heading error, radians.
    scale : array_like, default 0
        Relative error of the airspeed, to be removed.

    Returns
    -------
    u, v : arrays, shape (n,)
        m/s.
    """
    east, north, speed, psi, turn = (
        np.asarray(part, dtype=np.float64) for part in (u, v, airspeed, heading, error)
    )
    better = speed / (1.0 + np.asarray(scale, dtype=np.float64))
    return (
        np.asarray(east + speed * np.sin(psi) - better * np.sin(psi - turn)),
        np.asarray(north + speed * np.cos(psi) - better * np.cos(psi - turn)),
    )


def curve_standard_error(covariance: ArrayLike, heading: ArrayLike, gain: ArrayLike = 1.0) -> Array:
    """Standard error of a deviation curve.

    Parameters
    ----------
    covariance : array_like, shape (n, 5, 5) or (5, 5)
        degree2.
    heading : array_like, shape (n,)
        Indicated magnetic heading, degrees.
    gain : array_like, shape (n,), default 1
        Factor of the one-cycle part (B, C).

    Returns
    -------
    array, shape (n,)
        Degrees.
    """
    basis = deviation_basis(np.radians(heading), gain)
    product = np.einsum("...ij,j...->i...", np.asarray(covariance, dtype=np.float64), basis)
    return np.asarray(np.sqrt(np.maximum((product * basis).sum(axis=0), 0.0)))


def correction_error(
    airspeed: ArrayLike,
    deviation: ArrayLike,
    slope: ArrayLike,
    *,
    curve_error: ArrayLike = 0.0,
    heading_error: ArrayLike = 0.0,
    airspeed_error: ArrayLike = 0.0,
    coding: ArrayLike = 0.0,
) -> Array:
    """Standard error of the corrected wind as a vector; see the module.

    Parameters
    ----------
    airspeed : array_like, shape (n,)
        m/s.
    deviation, slope : array_like, shape (n,)
        Deviation that is removed (radians) and its derivative by the heading.
    curve_error : array_like, shape (n,)
        Standard error of the deviation, with that of the airspeed scale where it is removed,
        radians.
    heading_error : array_like, shape (n,)
        Standard error of the indicated heading at the report, radians.
    airspeed_error : array_like, shape (n,)
        That of the airspeed, m/s.
    coding : array_like, shape (n,)
        Variance from rounding, m2/s2, of :func:`coding_variance`.

    Returns
    -------
    array, shape (n,)
        m/s.
    """
    speed, delta, steep, of_curve, of_heading, of_speed, rounding = (
        np.asarray(part, dtype=np.float64)
        for part in (
            airspeed,
            deviation,
            slope,
            curve_error,
            heading_error,
            airspeed_error,
            coding,
        )
    )
    chord = 2.0 * (1.0 - np.exp(-0.5 * of_heading**2))
    angle = of_curve**2 + (delta**2 + steep**2) * chord
    return np.asarray(np.sqrt(speed**2 * angle + (delta * of_speed) ** 2 + rounding))


def coding_variance(speed: ArrayLike, speed_step: ArrayLike, direction_step: ArrayLike) -> Array:
    """Variance between a corrected and a right report from rounding both, as vectors.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Wind speed, m/s.
    speed_step, direction_step : array_like, shape (n,)
        Steps of speed (m/s) and direction (radians); 0 where unknown.

    Returns
    -------
    array, shape (n,)
        m2/s2: a uniform error has a twelfth of its step squared; twice, for two reports.
    """
    arc = np.asarray(speed, dtype=np.float64) * np.asarray(direction_step, dtype=np.float64)
    return np.asarray((np.asarray(speed_step, dtype=np.float64) ** 2 + arc**2) / 6.0)


def correct(
    headings: xr.Dataset,
    fits: xr.Dataset,
    *,
    reference: str | None = None,
    method: Literal["table", "curve"] = "table",
    apply_airspeed_scale: bool = False,
) -> xr.Dataset:
    """Correct the winds of every aircraft that has a fit.

    Parameters
    ----------
    headings : Dataset
        The reports with their headings, screened or not.
    fits : Dataset
        From :func:`~airswing.compass.fit.deviation.fit_deviation`, with tables for
        ``method="table"``.
    reference : str, optional
        Whose fit to apply; by default that of the first pool, without pools the first reference.
    method : {"table", "curve"}
        Apply what the unit would do with its table, or the fitted curve itself.
    apply_airspeed_scale : bool
        Remove the airspeed scale as well.

    Returns
    -------
    Dataset
        The reports with ``corrected_eastward_wind, corrected_northward_wind, corrected_heading,
        corrected_wind_standard_error`` and ``correction_applied``; dask-backed where the headings
        or the fits are. A report that is not corrected keeps its wind, and the flag says why.

    Raises
    ------
    InputError
        If the reference has no fits or the tables are missing.
    """
    place = chosen_reference(fits, reference)
    if method == "table" and "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables",
            field="table_correction",
            remedy="Call add_tables first, or use method='curve'",
        )
    fit = fits.isel(reference=place)
    read = headings[[name for name in NEEDED if name in headings]]
    found = map_aircraft(_correct, read, fit, method=method, scaled=apply_airspeed_scale)
    kept = headings[[name for name in KEPT if name in headings]]
    ds = kept.assign({str(name): found[name] for name in found.data_vars})
    ds.attrs.update(correction_reference=str(fit["reference"].item()), correction_method=method)
    return describe(ds)


def chosen_reference(fits: xr.Dataset, reference: str | None) -> int:
    """Return the place of a reference among the fits.

    Parameters
    ----------
    fits : Dataset
    reference : str or None
        None: the first pool, without pools the first reference.

    Raises
    ------
    InputError
        If there is no fit against this reference.
    """
    names = [str(name) for name in fits["reference"].to_numpy()]
    single = int(fits.attrs.get("reference_count", len(names)))
    wanted = names[single if single < len(names) else 0] if reference is None else reference
    if wanted not in names:
        raise InputError(
            "no fit against this reference",
            field="reference",
            found=wanted,
            remedy=f"Fitted: {', '.join(names)}",
        )
    return names.index(wanted)


def _correct(headings: xr.Dataset, fit: xr.Dataset, *, method: str, scaled: bool) -> xr.Dataset:
    """Corrected winds of the reports of some aircraft, in memory."""
    place = {str(name): k for k, name in enumerate(fit["aircraft"].to_numpy())}
    rows = [place.get(str(name), -1) for name in headings["aircraft"].to_numpy()]
    owner = aircraft_of_report(headings)
    row = np.array(rows, dtype=np.int64)[owner]
    column = {
        name: headings[name].to_numpy().astype(np.float64)
        for name in ("eastward_wind", "northward_wind", "airspeed", "heading", "magnetic_heading")
    }
    u, v = column["eastward_wind"], column["northward_wind"]
    magnetic = fit.attrs.get("abscissa", "magnetic") == "magnetic"
    argument = column["magnetic_heading" if magnetic else "heading"]
    flag = _flags(headings, column, argument, fit, row)
    done = is_corrected(flag)
    found = {
        "corrected_eastward_wind": u.copy(),
        "corrected_northward_wind": v.copy(),
        "corrected_heading": column["heading"].copy(),
        "corrected_wind_standard_error": np.full(row.size, np.nan),
    }
    # reports that are corrected, from here on
    row, m, owner = row[done], argument[done], owner[done]
    u, v, speed, heading = (
        column[name][done] for name in ("eastward_wind", "northward_wind", "airspeed", "heading")
    )
    gain = _gain(headings, fit, done, row)
    coefficients = fit["deviation"].to_numpy()[row]
    coefficients[:, 1:3] *= gain[:, np.newaxis]
    angle = np.radians(m)
    error = (coefficients.T * deviation_basis(angle)).sum(axis=0)
    slope = deviation_slope(np.radians(coefficients), angle)
    doubt = np.empty(row.size)
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    # one covariance matrix for each aircraft, not for each report
    for begin, end in pairwise([*starts, row.size]):
        covariance = fit["deviation_covariance"].to_numpy()[row[begin]]
        doubt[begin:end] = curve_standard_error(covariance, m[begin:end], gain[begin:end])
    if method == "table":
        table = error_from_table(fit).to_numpy()[row]
        from_table = unit_interpolation(table, m)
        # the difference of table and curve is known but stays: the unit would not remove it
        doubt, error = np.hypot(doubt, from_table - error), from_table
        slope = table_slope(table, m)
    scale, scale_error = np.zeros(row.size), np.zeros(row.size)
    if scaled:  # an offset comes without one
        scale = np.nan_to_num(fit["airspeed_scale"].to_numpy()[row])
        scale_error = np.nan_to_num(fit["airspeed_scale_standard_error"].to_numpy()[row])
    heading_error = np.radians(_known(headings, "heading_standard_error", "report")[done])
    ground = _known(headings, "ground_velocity_error", "report")[done]
    # the mean of both components is known: what is not across the heading is along it
    along = np.sqrt(np.maximum(2.0 * ground**2 - (speed * heading_error) ** 2, 0.0))
    steps = [
        _known(headings, f"wind_{name}_resolution", "aircraft")[owner]
        for name in ("speed", "direction")
    ]
    standard_error = correction_error(
        speed,
        np.radians(error),
        slope,
        curve_error=np.hypot(np.radians(doubt), scale_error),
        heading_error=heading_error,
        airspeed_error=along,
        coding=coding_variance(np.hypot(u, v), steps[0], np.radians(steps[1])),
    )
    u, v = corrected_wind(u, v, speed, np.radians(heading), np.radians(error), scale)
    values = (u, v, np.mod(heading - error, 360.0), standard_error)
    for name, part in zip(found, values, strict=True):
        found[name][done] = part
    ds = xr.Dataset({name: ("report", values) for name, values in found.items()})
    return ds.assign(correction_applied=("report", flag))


def _flags(
    headings: xr.Dataset,
    column: dict[str, Array],
    argument: Array,
    fit: xr.Dataset,
    row: NDArray[np.int64],
) -> NDArray[np.int8]:
    """Codes of `CORRECTION`; of several reasons the one that is hardest to remove."""
    status = np.append(fit["status"].to_numpy(), STATUS["too_few_reports"])[row]
    has_heading = np.isfinite(argument + column["airspeed"] + column["heading"])
    has_wind = np.isfinite(column["eastward_wind"] + column["northward_wind"])
    by_unit = np.zeros(row.size, dtype=bool)
    if "screening" in headings:
        by_unit = (headings["screening"].to_numpy() & SCREENING["field_test"]) > 0
    reasons = {
        "missing_wind": ~has_wind,
        "already_corrected": by_unit,
        "no_fit": ~published(status),
        "no_correction_needed": status == STATUS["no_correction_needed"],
        "no_heading": ~has_heading,
        "offset_only": status == STATUS["offset_only"],
    }
    codes = [CORRECTION[name] for name in reasons]
    return np.select(list(reasons.values()), codes, CORRECTION["corrected"]).astype(np.int8)


def _gain(
    headings: xr.Dataset, fit: xr.Dataset, done: NDArray[np.bool_], row: NDArray[np.int64]
) -> Array:
    """Mean field of the fit over that of each report; one where either is unknown."""
    gain = np.ones(row.size)
    if "horizontal_field" not in headings or "mean_horizontal_field" not in fit:
        return gain
    field = headings["horizontal_field"].to_numpy()[done].astype(np.float64)
    mean = fit["mean_horizontal_field"].to_numpy()[row]
    np.divide(mean, field, out=gain, where=np.isfinite(mean) & (field > 0))
    return gain


def _known(headings: xr.Dataset, name: str, dim: str) -> Array:
    """Values of a variable, zero where they are unknown."""
    if name not in headings:
        return np.zeros(headings.sizes[dim])
    return np.nan_to_num(headings[name].to_numpy().astype(np.float64))
