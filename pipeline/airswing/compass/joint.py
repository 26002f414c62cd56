"""Deviations and the reference's error together: the fit repeated until both agree.

Assumes what :mod:`airswing.compass.fleet_error` assumes of the field. The deviation fit and the
field's are each the best given the other; stepping from one to the other converges to the joint
generalized least squares, and a Newton step takes the many small steps at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse

from airswing.compass.columns import Columns
from airswing.compass.derived import sinusoid
from airswing.compass.fleet_error import (
    FieldBasis,
    FieldFit,
    adjusted_errors,
    deviation_columns,
    fit_field,
    reference_air,
    widening,
)
from airswing.vocabulary import STATUS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEPS = 4
TOLERANCE = np.radians(0.005)
MOST_REPORTS = 400_000
"""The field is estimated from at most about this many reports, evenly taken."""
LEAST_REPORTS = 500
BLOCK = 500_000
SIZE = 6
"""Coefficients A to E and the airspeed scale."""


@dataclass(frozen=True)
class _Places:
    """Where and when the reports are, and whose."""

    latitude: Floats
    longitude: Floats
    log_pressure: Floats
    seconds: Floats
    flight: Ints
    aircraft: Ints

    def at(self, index: Ints | slice) -> tuple[Floats, Floats, Floats, Floats]:
        """Coordinates of some reports."""
        return (
            self.latitude[index], self.longitude[index],
            self.log_pressure[index], self.seconds[index],
        )  # fmt: skip


def fit_with_field(
    headings: xr.Dataset,
    columns: Columns,
    members: list[int],
    fit_once: Callable[[], xr.Dataset],
) -> xr.Dataset:
    """Fit the deviations of a fleet beside the error of its references.

    Parameters
    ----------
    headings : Dataset
    columns : Columns
        The report columns ``fit_once`` reads; left as they were found.
    members : list of int
        References fitted together.
    fit_once : callable
        Fits every aircraft to the errors ``columns`` holds.

    Returns
    -------
    Dataset
        As of ``fit_once``, with the covariance of the joint fit.
    """
    first = fit_once()
    places = _places(headings, columns)
    index = _reports(columns, members, places, first)
    if index.size < LEAST_REPORTS:
        return first
    original = {k: columns.read[k] for k in members}
    try:
        found, factor, bias = _iterate(columns, original, places, index, first, fit_once)
    finally:
        columns.read.update(original)
    return _published(first, found, factor, bias)


def _iterate(
    columns: Columns,
    original: dict[int, list[NDArray[np.floating]]],
    places: _Places,
    index: Ints,
    first: xr.Dataset,
    fit_once: Callable[[], xr.Dataset],
) -> tuple[xr.Dataset, Floats, Floats]:
    """Step between fit and field until the coefficients stand still."""
    basis = FieldBasis.of(*places.at(index))
    design, part = basis.design(*places.at(index)), basis.part
    theta = _coefficients(first)
    found, factor, bias = first, np.eye(theta.size), np.zeros(2)
    starts: list[Floats | None] = [None] * len(original)
    for step in range(STEPS):
        fields = [
            _field(columns, errors, places, index, theta, design, part, start)
            for errors, start in zip(original.values(), starts, strict=True)
        ]
        starts = [field.variance for field in fields]
        if step == 0:
            factor = _factor(columns, places, index, theta, design, part, fields, first)
        bias = np.mean([(design @ field.coefficients).mean(axis=0) for field in fields], axis=0)
        for (k, errors), field in zip(original.items(), fields, strict=True):
            columns.read[k] = _adjusted(columns, errors, places, basis, field)
        found = fit_once()
        change = np.nan_to_num(_coefficients(found) - theta)
        theta = theta + (factor @ change.ravel()).reshape(theta.shape)
        if np.abs(change[:, : SIZE - 1]).max() < TOLERANCE:
            break
    return found, factor, bias


def _places(headings: xr.Dataset, columns: Columns) -> _Places:
    time = columns.time.astype("datetime64[ms]").astype(np.int64) / 1000.0
    row_size = headings["row_size"].to_numpy()
    return _Places(
        headings["latitude"].to_numpy().astype(np.float64),
        headings["longitude"].to_numpy().astype(np.float64),
        np.log(headings["pressure"].to_numpy().astype(np.float64)),
        time,
        np.asarray(columns.flight, dtype=np.int64),
        np.repeat(np.arange(row_size.size), row_size),
    )


def _reports(columns: Columns, members: list[int], places: _Places, first: xr.Dataset) -> Ints:
    """Reports the field is estimated from: those of trusted fits with every reference."""
    trusted = first["status"].to_numpy() == STATUS["ok"]
    good = (columns.screening == 0) & trusted[places.aircraft]
    good &= np.isfinite(columns.heading + columns.abscissa + columns.airspeed)
    good &= np.isfinite(places.latitude + places.longitude + places.log_pressure)
    for k in members:
        good &= np.isfinite(columns.read[k][0] + columns.read[k][1])
    index = np.flatnonzero(good)
    return index[:: max(1, -(-index.size // MOST_REPORTS))]


def _coefficients(fits: xr.Dataset) -> Floats:
    """A to E in radians and the airspeed scale, NaN where there is no fit."""
    scale = fits["airspeed_scale"].to_numpy()[:, np.newaxis]
    return np.hstack([np.radians(fits["deviation"].to_numpy()), scale])


def _vectors(
    columns: Columns, places: _Places, index: Ints, theta: Floats
) -> tuple[Floats, Floats]:
    """Corrected air vectors of some reports and their derivatives by the coefficients."""
    heading, abscissa = np.radians(columns.heading[index]), np.radians(columns.abscissa[index])
    speed = columns.airspeed[index].astype(np.float64)
    vector, slope = np.empty((2, index.size)), np.empty((index.size, 2, SIZE))
    for k in np.unique(places.aircraft[index]):
        own = places.aircraft[index] == k
        vector[:, own], slope[own] = deviation_columns(
            np.nan_to_num(theta[k, :-1]), float(np.nan_to_num(theta[k, -1])),
            heading[own], abscissa[own], speed[own],
        )  # fmt: skip
    return vector, slope


def _field(
    columns: Columns,
    errors: list[NDArray[np.floating]],
    places: _Places,
    index: Ints,
    theta: Floats,
    design: sparse.csr_matrix,
    part: Ints,
    start: Floats | None,
) -> FieldFit:
    """Field of one reference given the deviations."""
    vector, _ = _vectors(columns, places, index, theta)
    implied = reference_air(
        np.radians(columns.heading[index]), columns.airspeed[index],
        np.radians(errors[0][index]), errors[1][index],
    )  # fmt: skip
    return fit_field(design, part, vector - implied, places.flight[index], start=start)


def _adjusted(
    columns: Columns,
    errors: list[NDArray[np.floating]],
    places: _Places,
    basis: FieldBasis,
    field: FieldFit,
) -> list[NDArray[np.floating]]:
    """Errors of every report with the field taken off the reference, degrees and m/s."""
    turned, slowed = errors[0].copy(), errors[1].copy()
    usable = (columns.screening == 0) & np.isfinite(errors[0] + places.log_pressure)
    rows = np.flatnonzero(usable)
    for start in range(0, rows.size, BLOCK):
        block = rows[start : start + BLOCK]
        inside = block[basis.segment_of(places.seconds[block]) >= 0]
        error = (basis.design(*places.at(inside)) @ field.coefficients).T
        heading_error, airspeed_error = adjusted_errors(
            np.radians(columns.heading[inside]), columns.airspeed[inside],
            np.radians(errors[0][inside]), errors[1][inside], error,
        )  # fmt: skip
        turned[inside], slowed[inside] = np.degrees(heading_error), airspeed_error
    return [turned, slowed, errors[2]]


def _factor(
    columns: Columns,
    places: _Places,
    index: Ints,
    theta: Floats,
    design: sparse.csr_matrix,
    part: Ints,
    fields: list[FieldFit],
    fits: xr.Dataset,
) -> Floats:
    """Newton and covariance factor of every coefficient of every aircraft."""
    _, slope = _vectors(columns, places, index, theta)
    one_cycle = fits["harmonics"].to_numpy() < 2
    aircraft = places.aircraft[index]
    slope[one_cycle[aircraft], :, 3:5] = 0.0
    rows = [np.flatnonzero(aircraft == k) for k in range(theta.shape[0])]
    return widening(design, part, fields, [slope[row] for row in rows], rows)


def _published(first: xr.Dataset, found: xr.Dataset, factor: Floats, bias: Floats) -> xr.Dataset:
    """Fits with the joint covariance and what follows from it."""
    fits = found.copy(deep=True)
    size = fits.sizes["aircraft"]
    covariance = np.zeros((size, SIZE, SIZE))
    covariance[:, :-1, :-1] = np.radians(np.radians(fits["deviation_covariance"].to_numpy()))
    covariance[:, -1, -1] = fits["airspeed_scale_standard_error"].to_numpy() ** 2
    blocks = factor.reshape(size, SIZE, size, SIZE)
    usable = np.nan_to_num(covariance)
    joint = np.einsum("aibj,bjk,albk->ail", blocks, usable, blocks)
    for k in np.flatnonzero(fits["status"].to_numpy() == STATUS["ok"]):
        square = np.degrees(np.degrees(joint[k, :-1, :-1]))
        _, error = sinusoid(fits["deviation"].to_numpy()[k], square)
        fits["deviation_covariance"][k] = square
        for name, one in zip(("offset", "amplitude", "phase"), error, strict=True):
            fits[f"{name}_standard_error"][k] = one
        fits["airspeed_scale_standard_error"][k] = np.sqrt(joint[k, -1, -1])
    for name in ("residual_rms_before", "residual_rms_after"):
        fits[name] = first[name]
    fits["reference_bias"] = fits["reference_bias"] + bias
    return fits
