"""The wind again, from the corrected heading.

Assumptions
-----------
What the unit did wrong is the direction of its air vector alone: psi_corr = psi_ind -
psi_err(m), m the indicated magnetic heading. With V_A = V_G - W_reported the ground vector drops
out: W_corrected = W_reported + V_A - R V_A, R the turn by -psi_err. So only the air vector
(airspeed and indicated heading) is needed, and every report that has one is corrected, whether or
not the fit used it. The airspeed scale can be removed too, on request: V_A / (1 + s).

The curve's one cycle (B, C) is that at the mean horizontal field of the reports it was fitted to
and grows as the field weakens; it is scaled to the field of every report where both are known. A
unit's table is one for all places: it is applied as it stands.

The standard error is that of the vector wind against the report a right compass would have sent
(:mod:`airswing.compass.correction_error`): what is uncertain of the fit, what the table differs
from the fitted curve, the doubt of heading and airspeed at the report, coding. Gusts and noise of
the sensors, which are in either report, are not in it.

Degrees in the Datasets, radians and m/s inside.

References
----------
Jacobs et al. 2010 (seed paper), step f.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.compass.correction_error import (
    At,
    coding_variance,
    correction_error,
    curve_slope,
    table_slope,
)
from airswing.compass.fit.sandwich import Array
from airswing.compass.table import deviation_curve, error_from_table, unit_interpolation
from airswing.errors import InputError
from airswing.flags import CORRECTION, SCREENING, STATUS, mended, published
from airswing.products.ragged import aircraft_of_report
from airswing.vocabulary import describe

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
"""Variables of the reports that the corrected product carries on, where they are there."""
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
"""Variables a correction looks at; without the last five it is made for the mean field, and its
standard error is that of the fit and the table alone."""


def corrected_wind(
    u: ArrayLike,
    v: ArrayLike,
    airspeed: ArrayLike,
    heading: ArrayLike,
    error: ArrayLike,
    scale: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """Wind (m/s) that the unit would have computed along the corrected heading.

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
    """Standard error of the deviation curve (degrees) at given headings (degrees).

    Parameters
    ----------
    covariance : array_like, shape (n, 5, 5) or (5, 5)
        degree2.
    heading : array_like, shape (n,)
    gain : array_like, shape (n,), default 1
        What the one cycle (B, C) is multiplied by there.
    """
    angle = np.radians(np.asarray(heading, dtype=np.float64))
    sine, cosine = gain * np.sin(angle), gain * np.cos(angle)
    slopes = (np.ones_like(angle), sine, cosine, np.sin(2 * angle), np.cos(2 * angle))
    known = np.asarray(covariance, dtype=np.float64)
    square = np.zeros(np.broadcast_shapes(angle.shape, known.shape[:-2]))
    for i, slope in enumerate(slopes):
        part = known[..., i, i] * slope
        for j in range(i):
            part = part + 2.0 * known[..., i, j] * slopes[j]
        square += part * slope
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _error_of_each(covariance: Array, own: NDArray[np.int64], heading: Array, gain: Array) -> Array:
    """Standard error of each report's own curve, aircraft by aircraft: one matrix at a time.

    A matrix for each report is 200 bytes a report, and takes longer.
    """
    found = np.empty(own.size)
    start = np.flatnonzero(np.diff(own, prepend=-1))
    for first, stop in zip(start, np.append(start[1:], own.size)[: start.size], strict=True):
        run = slice(first, stop)
        found[run] = curve_standard_error(covariance[own[first]], heading[run], gain[run])
    return found


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
        Whose fit to apply; the first pool, else the first reference, when not given.
    method : {"table", "curve"}
        What the unit would do with its table, or the fitted curve itself.
    apply_airspeed_scale : bool
        Remove the airspeed scale as well.

    Returns
    -------
    Dataset
        The reports with ``corrected_*`` and ``correction_applied``. A report that cannot be
        corrected keeps its wind as reported, and the flag says why.

    Raises
    ------
    InputError
        If the reference has no fits or the tables are missing.
    """
    fit = _chosen(fits, reference, method)
    row = _aircraft_rows(headings, fit)
    known = row >= 0
    # Row -1 is the last aircraft: `known` takes it out again.
    ok = known & published(fit["status"].to_numpy())[row]
    column = {
        name: headings[name].to_numpy().astype(np.float64)
        for name in ("eastward_wind", "northward_wind", "airspeed", "heading", "magnetic_heading")
    }
    m = column[
        "magnetic_heading" if fits.attrs.get("abscissa", "magnetic") == "magnetic" else "heading"
    ]
    has_heading = np.isfinite(m) & np.isfinite(column["airspeed"]) & np.isfinite(column["heading"])
    has_wind = np.isfinite(column["eastward_wind"]) & np.isfinite(column["northward_wind"])
    by_unit = np.zeros(m.size, dtype=bool)
    if "screening" in headings:
        by_unit = (headings["screening"].to_numpy() & SCREENING["field_test"]) > 0
    # The first reason that holds, the least mendable first.
    flag = np.select(
        [~has_wind, by_unit, ~ok, ~has_heading],
        [CORRECTION[why] for why in ("missing_wind", "already_corrected", "no_fit", "no_heading")],
        CORRECTION["corrected"],
    ).astype(np.int8)
    alone = known & (fit["status"].to_numpy()[row] == STATUS["offset_only"])
    flag[alone & (flag == CORRECTION["corrected"])] = CORRECTION["offset_only"]
    done = mended(flag)
    column["gain"] = _gain(headings, fit, row)
    column |= _doubts(headings, column)
    found = _corrected(column, m, fit, row, done, method, apply_airspeed_scale)
    kept = headings[[name for name in KEPT if name in headings]]
    ds = kept.assign({name: ("report", values) for name, values in found.items()})
    ds["correction_applied"] = ("report", flag)
    ds.attrs.update(correction_reference=str(fit["reference"].item()), correction_method=method)
    return describe(ds)


def chosen_reference(fits: xr.Dataset, reference: str | None) -> int:
    """Place of a reference; of the first pool, else the first reference, where none is named."""
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


def _chosen(fits: xr.Dataset, reference: str | None, method: str) -> xr.Dataset:
    place = chosen_reference(fits, reference)
    if method == "table" and "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables",
            field="table_correction",
            remedy="Call add_tables first, or use method='curve'",
        )
    fit = fits.isel(reference=place)
    return fit.assign(table_error=error_from_table(fit)) if "table_correction" in fit else fit


def _aircraft_rows(headings: xr.Dataset, fit: xr.Dataset) -> NDArray[np.int64]:
    place = {str(name): k for k, name in enumerate(fit["aircraft"].to_numpy())}
    rows = np.array(
        [place.get(str(name), -1) for name in headings["aircraft"].to_numpy()], dtype=np.int64
    )
    return np.asarray(rows[aircraft_of_report(headings)])


def _gain(headings: xr.Dataset, fit: xr.Dataset, row: NDArray[np.int64]) -> Array:
    """Mean field of the fit over that of every report; one where either is not known."""
    found = np.ones(row.size)
    if "horizontal_field" not in headings or "mean_horizontal_field" not in fit:
        return found
    field = headings["horizontal_field"].to_numpy().astype(np.float64)
    mean = np.where(row >= 0, fit["mean_horizontal_field"].to_numpy()[row], np.nan)
    return np.divide(mean, field, out=found, where=np.isfinite(mean) & (field > 0))


def _doubts(headings: xr.Dataset, column: dict[str, Array]) -> dict[str, Array]:
    """Errors of heading (radians) and airspeed and what coding leaves; zero where not known."""
    speed = column["airspeed"]
    heading_error = np.radians(_known(headings, "heading_standard_error", speed))
    ground = _known(headings, "ground_velocity_error", speed)
    # The product has the mean of both components: what is not across the heading is along it.
    along = np.maximum(2.0 * ground**2 - (speed * heading_error) ** 2, 0.0)
    own = aircraft_of_report(headings)
    steps = [
        _known(headings, f"wind_{name}_resolution", own)[own] for name in ("speed", "direction")
    ]
    wind = np.hypot(column["eastward_wind"], column["northward_wind"])
    return {
        "heading_error": heading_error,
        "airspeed_error": np.sqrt(along),
        "coding": coding_variance(wind, steps[0], np.radians(steps[1])),
    }


def _known(headings: xr.Dataset, name: str, like: NDArray[np.generic]) -> Array:
    if name not in headings:
        return np.zeros(like.size)
    return np.nan_to_num(headings[name].to_numpy().astype(np.float64))


def _corrected(
    column: dict[str, Array],
    m: Array,
    fit: xr.Dataset,
    row: NDArray[np.int64],
    done: NDArray[np.bool_],
    method: str,
    apply_scale: bool,
) -> dict[str, Array]:
    at, own, gain = m[done], row[done], column["gain"][done]
    speed, heading = column["airspeed"][done], column["heading"][done]
    coefficients = fit["deviation"].to_numpy()[own]
    coefficients[:, 1:3] *= gain[:, np.newaxis]
    error = deviation_curve(coefficients, at[:, np.newaxis])[:, 0]
    slope = curve_slope(coefficients, at)
    known = _error_of_each(fit["deviation_covariance"].to_numpy(), own, at, gain)
    if method == "table":
        table = fit["table_error"].to_numpy()[own]
        by_table = unit_interpolation(table, at)
        # What the table is off the curve here is known, sign and all, but is not taken
        # off: the unit would not.
        known, error, slope = np.hypot(known, by_table - error), by_table, table_slope(table, at)
    scale, scale_error = np.zeros(own.size), np.zeros(own.size)
    if apply_scale:  # an offset alone comes without one
        scale = np.nan_to_num(fit["airspeed_scale"].to_numpy()[own])
        scale_error = np.nan_to_num(fit["airspeed_scale_standard_error"].to_numpy()[own])
    where = At(
        speed,
        column["airspeed_error"][done],
        column["heading_error"][done],
        np.radians(error),
        slope,
    )
    u, v = corrected_wind(
        column["eastward_wind"][done],
        column["northward_wind"][done],
        speed,
        np.radians(heading),
        np.radians(error),
        scale,
    )
    values = {
        "corrected_eastward_wind": u,
        "corrected_northward_wind": v,
        "corrected_heading": np.mod(heading - error, 360.0),
        "corrected_wind_standard_error": correction_error(
            where, np.hypot(np.radians(known), scale_error), column["coding"][done]
        ),
    }
    plain = {
        "corrected_eastward_wind": column["eastward_wind"],
        "corrected_northward_wind": column["northward_wind"],
        "corrected_heading": column["heading"],
        "corrected_wind_standard_error": np.full(done.size, np.nan),
    }
    for name, part in values.items():
        # columns that are as reported share memory with the reports
        plain[name] = plain[name].copy()
        plain[name][done] = part
    return plain
