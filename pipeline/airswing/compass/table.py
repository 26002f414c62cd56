"""The 8-point correction table a unit's firmware holds, and the firmware's look-up.

Assumptions
-----------
The firmware holds one number a node at indicated magnetic headings 0, 45, ... 315 degrees and
interpolates linearly between them, round the circle. The best table is then not the curve at its
nodes (which multiplies harmonic k by sinc^2(k/8): 0.950, 0.811) but the least-squares projection
of the curve on that piecewise-linear basis, weighted by the headings the aircraft flies; sectors
it never flies follow the curve all the same, through a small even weight.

Signs
-----
``subtract_error``: the table holds the degrees to ADD to the indicated heading, minus the heading
error. That is a navigator's deviation card too (east positive = magnetic - compass).
``add_error``: the table holds the heading error itself, which the unit subtracts.
The argument is the indicated magnetic heading: psi_corr = psi_ind - psi_err(psi_ind).

Degrees throughout.

References
----------
Jacobs et al. 2010 (seed paper), steps e and f.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.compass.fit.sandwich import Array
from airswing.errors import InputError
from airswing.products.ragged import aircraft_of_report, blocks
from airswing.vocabulary import describe

NODES = np.arange(0.0, 360.0, 45.0)
FINE = np.arange(0.5, 360.0, 1.0)
"""Headings at which curve and table are compared: the middles of 1-degree bins."""
# Share of the weight that is spread evenly, so that empty sectors follow the curve.
EVEN_SHARE = 0.05
Sign = Literal["subtract_error", "add_error"]
SIGNS: dict[str, float] = {"subtract_error": -1.0, "add_error": 1.0}


def deviation_curve(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Heading error A + B sin m + C cos m + D sin 2m + E cos 2m, (..., m), degrees.

    Parameters
    ----------
    coefficients : array_like, shape (..., 5)
        Degrees.
    heading : array_like, shape (m,) or broadcastable to (..., m)
        Indicated magnetic heading, degrees.
    """
    angle = np.radians(np.asarray(heading, dtype=np.float64))
    a, b, c, d, e = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)[..., np.newaxis]
    return np.asarray(
        a + b * np.sin(angle) + c * np.cos(angle) + d * np.sin(2 * angle) + e * np.cos(2 * angle)
    )


def unit_interpolation(table: ArrayLike, heading: ArrayLike) -> Array:
    """Look headings (n,) up in a table exactly as the unit does; degrees, NaN where any is NaN.

    Parameters
    ----------
    table : array_like, shape (node,) or (n, node)
        One table, or one for each heading; nodes evenly spaced from 0 degrees.
    heading : array_like, shape (n,)
        Indicated magnetic heading, degrees, any turn.
    """
    values = np.asarray(table, dtype=np.float64)
    nodes = values.shape[-1]
    place = np.mod(np.asarray(heading, dtype=np.float64), 360.0) * (nodes / 360.0)
    known = np.isfinite(place)
    # NaN has no place; its share is NaN all the same.
    lower = np.where(known, np.floor(place), 0).astype(np.int64) % nodes
    share = place - np.floor(place)
    upper = (lower + 1) % nodes
    if values.ndim == 1:
        return np.asarray(values[lower] * (1 - share) + values[upper] * share)
    row = np.arange(values.shape[0])
    return np.asarray(values[row, lower] * (1 - share) + values[row, upper] * share)


def _project_curve(error: ArrayLike, histogram: ArrayLike | None = None) -> tuple[Array, Array]:
    """Least-squares projection (8,) of a curve (360,) on the periodic piecewise-linear basis.

    Also the weight (360,) used, by the reports in each bin of `FINE`; even without a histogram.
    """
    weight = np.full(FINE.size, 1.0 / FINE.size)
    total = 0.0 if histogram is None else float(np.sum(histogram))
    if total > 0:
        share = np.asarray(histogram, dtype=np.float64) / total
        weight = (1 - EVEN_SHARE) * share + EVEN_SHARE * weight
    basis = np.stack([unit_interpolation(row, FINE) for row in np.eye(NODES.size)], axis=1)
    normal = basis.T @ (basis * weight[:, np.newaxis])
    nodes = np.linalg.solve(normal, basis.T @ (weight * np.asarray(error, dtype=np.float64)))
    return np.asarray(nodes), weight


def _round_to(values: ArrayLike, resolution: float) -> Array:
    """Round to the nearest multiple of a resolution, 0 for none; a negative zero becomes zero."""
    found = np.asarray(values, dtype=np.float64)
    if resolution <= 0:
        return found
    steps = np.rint(found / resolution)
    # Division by a whole number gives 0.3 where three times 0.1 gives 0.30000000000000004.
    inverse = round(1.0 / resolution)
    exact = abs(inverse * resolution - 1.0) < 1e-9
    return np.asarray((steps / inverse if exact else steps * resolution) + 0.0)


def heading_histogram(headings: xr.Dataset, *, abscissa: str = "magnetic") -> NDArray[np.int64]:
    """Used reports of each aircraft by 1-degree bin of heading, (aircraft, 360)."""
    name = "magnetic_heading" if abscissa == "magnetic" else "heading"
    counts = []
    for block in blocks(headings, [name, "screening"]):
        heading, size = block[name].to_numpy(), block.sizes["aircraft"]
        used = np.isfinite(heading) & (block["screening"].to_numpy() == 0)
        bins = np.floor(np.mod(heading[used], 360.0)).astype(np.int64) % FINE.size
        cell = aircraft_of_report(block)[used] * FINE.size + bins
        counts.append(np.bincount(cell, minlength=size * FINE.size).reshape(size, FINE.size))
    return np.concatenate(counts).astype(np.int64)


def add_tables(
    fits: xr.Dataset,
    headings: xr.Dataset | NDArray[np.int64],
    *,
    resolution: float = 0.1,
    sign: Sign = "subtract_error",
) -> xr.Dataset:
    """Add each aircraft's 8-point table to its fit.

    Parameters
    ----------
    fits : Dataset
        With ``deviation``.
    headings : Dataset, or array of int, shape (aircraft, 360)
        The reports of the fit: their headings weigh the projection; or their counts, of
        :func:`heading_histogram`.
    resolution : float
        Degrees; what the unit can hold. 0 for no rounding.
    sign : {"subtract_error", "add_error"}
        What the table holds, see the module.

    Returns
    -------
    Dataset
        ``fits`` with ``table_heading``, ``table_correction`` (NaN without a fit) and
        ``table_residual_rms``: table against curve over the headings flown, rounding included.

    Raises
    ------
    InputError
        If the sign is unknown.
    """
    if sign not in SIGNS:
        raise InputError(
            "unknown sign of the table",
            field="table.sign",
            found=sign,
            remedy=f"One of: {', '.join(SIGNS)}",
        )
    histogram = headings
    if isinstance(headings, xr.Dataset):
        histogram = heading_histogram(headings, abscissa=fits.attrs.get("abscissa", "magnetic"))
    deviation = fits["deviation"].transpose("reference", "aircraft", "coefficient").to_numpy()
    tables = np.full((*deviation.shape[:2], NODES.size), np.nan)
    residual = np.full(deviation.shape[:2], np.nan)
    for place in zip(*np.nonzero(np.isfinite(deviation).all(axis=-1)), strict=True):
        error = deviation_curve(deviation[place], FINE)
        nodes, weight = _project_curve(error, histogram[place[1]])
        tables[place] = _round_to(nodes, resolution)
        residual[place] = np.sqrt(
            np.sum(weight * (unit_interpolation(tables[place], FINE) - error) ** 2)
        )
    correction = SIGNS[sign] * tables + 0.0
    by_aircraft = ("reference", "aircraft")
    found = fits.assign(
        table_correction=((*by_aircraft, "node"), correction),
        table_residual_rms=(by_aircraft, residual),
        table_heading=("node", NODES),
    )
    found.attrs.update(table_sign=sign, table_resolution=float(resolution))
    return describe(found)


def error_from_table(fits: xr.Dataset) -> xr.DataArray:
    """Heading error (reference, aircraft, node) the tables stand for, indicated minus true."""
    sign = SIGNS[fits.attrs.get("table_sign", "subtract_error")]
    return sign * fits["table_correction"]
