"""The 8-point correction table of a unit's firmware, its interpolation, and its CSV file.

Assumptions
-----------
The firmware holds one number a node at indicated magnetic headings 0, 45, ... 315 degrees and
interpolates linearly between them, periodically. The best table is then not the curve at its nodes
(which multiplies harmonic k by sinc^2(k/8): 0.950, 0.811) but the least-squares projection of the
curve on that piecewise-linear basis, weighted by the headings that the aircraft flies. A small even
weight makes the table follow the curve at headings that are not flown. Where the status says that
no correction is needed, the table is zero.

Signs
-----
``subtract_error``: the table holds the degrees to ADD to the indicated heading, minus the heading
error, as a navigator's deviation card does (east positive = magnetic - compass).
``add_error``: the table holds the heading error itself, which the unit subtracts.
The argument is the indicated magnetic heading: psi_corr = psi_ind - psi_err(psi_ind).

Degrees throughout.

References
----------
Jacobs et al. 2010 (seed paper), steps e and f.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import InputError
from airswing.flags import STATUS, published
from airswing.physics.compass_deviation import deviation_basis
from airswing.products.ragged import aircraft_of_report
from airswing.products.whole_files import atomic
from airswing.vocabulary import describe

Array = NDArray[np.float64]

NODES = np.arange(0.0, 360.0, 45.0)
FINE = np.arange(0.5, 360.0, 1.0)
"""Headings at which curve and table are compared: the middles of 1-degree bins."""
EVEN_SHARE = 0.05
"""Share of the weight that is spread evenly over all headings."""
Sign = Literal["subtract_error", "add_error"]
SIGNS: dict[str, float] = {"subtract_error": -1.0, "add_error": 1.0}


def deviation_curve(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Heading error A + B sin m + C cos m + D sin 2m + E cos 2m.

    Parameters
    ----------
    coefficients : array_like, shape (..., 5)
        Degrees.
    heading : array_like, shape (m,)
        Indicated magnetic heading, degrees.

    Returns
    -------
    array, shape (..., m)
        Degrees.
    """
    basis = deviation_basis(np.radians(np.asarray(heading, dtype=np.float64)))
    return np.asarray(np.asarray(coefficients, dtype=np.float64) @ basis)


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


def unit_interpolation(table: ArrayLike, heading: ArrayLike) -> Array:
    """Interpolate in a table as the unit does.

    Parameters
    ----------
    table : array_like, shape (node,) or (n, node)
        One table, or one for each heading; nodes evenly spaced from 0 degrees.
    heading : array_like, shape (n,)
        Indicated magnetic heading, degrees, of any turn.

    Returns
    -------
    array, shape (n,)
        Degrees; NaN where the heading or a node is NaN.
    """
    lower, upper, share = _nodes_around(table, heading)
    return np.asarray(lower * (1 - share) + upper * share)


def table_slope(table: ArrayLike, heading: ArrayLike) -> Array:
    """Slope of tables, shape (n,), degrees per degree; arguments as of `unit_interpolation`."""
    lower, upper, _ = _nodes_around(table, heading)
    return np.asarray((upper - lower) * np.shape(table)[-1] / 360.0)


def _nodes_around(table: ArrayLike, heading: ArrayLike) -> tuple[Array, Array, Array]:
    """Values at the nodes below and above each heading; its distance from the lower, in steps."""
    values = np.asarray(table, dtype=np.float64)
    nodes = values.shape[-1]
    place = np.mod(np.asarray(heading, dtype=np.float64), 360.0) * (nodes / 360.0)
    lower = np.where(np.isfinite(place), np.floor(place), 0).astype(np.int64) % nodes
    row = () if values.ndim == 1 else (np.arange(values.shape[0]),)
    return values[*row, lower], values[*row, (lower + 1) % nodes], place - np.floor(place)


def _project_curve(error: Array, weight: Array) -> Array:
    """Least-squares projection (8,) of a curve (360,) on the periodic piecewise-linear basis."""
    basis = np.stack([unit_interpolation(row, FINE) for row in np.eye(NODES.size)], axis=1)
    normal = basis.T @ (basis * weight[:, np.newaxis])
    return np.asarray(np.linalg.solve(normal, basis.T @ (weight * error)))


def _round_to(values: Array, resolution: float) -> Array:
    """Round to the nearest multiple of a resolution, 0 for none; a negative zero becomes zero."""
    if resolution <= 0:
        return values
    steps = np.rint(values / resolution)
    # Division by a whole number gives 0.3 where three times 0.1 gives 0.30000000000000004.
    inverse = round(1.0 / resolution)
    exact = abs(inverse * resolution - 1.0) < 1e-9
    return np.asarray((steps / inverse if exact else steps * resolution) + 0.0)


def heading_histogram(headings: xr.Dataset, *, abscissa: str = "magnetic") -> xr.DataArray:
    """Count the reports used of each aircraft by 1-degree bin of heading.

    Parameters
    ----------
    headings : Dataset
        Screened.
    abscissa : {"magnetic", "true"}
        Which heading.

    Returns
    -------
    DataArray of int, dimensions (aircraft, heading_bin)
        Dask-backed where the headings are.
    """
    name = "magnetic_heading" if abscissa == "magnetic" else "heading"
    read = headings[[name, "screening", "row_size"]]
    return map_aircraft(_histogram, read, name=name)["histogram"]


def _histogram(headings: xr.Dataset, *, name: str) -> xr.Dataset:
    heading, number = headings[name].to_numpy(), headings.sizes["aircraft"]
    used = np.isfinite(heading) & (headings["screening"].to_numpy() == 0)
    bins = np.floor(np.mod(heading[used], 360.0)).astype(np.int64) % FINE.size
    cell = aircraft_of_report(headings)[used] * FINE.size + bins
    count = np.bincount(cell, minlength=number * FINE.size).reshape(number, FINE.size)
    return xr.Dataset({"histogram": (("aircraft", "heading_bin"), count)})


def add_tables(
    fits: xr.Dataset,
    headings: xr.Dataset | xr.DataArray | NDArray[np.integer],
    *,
    resolution: float = 0.1,
    sign: Sign = "subtract_error",
) -> xr.Dataset:
    """Add the 8-point table of each aircraft to its fit.

    Parameters
    ----------
    fits : Dataset
        With ``deviation`` and ``status``.
    headings : Dataset, or array of int, shape (aircraft, 360)
        The reports of the fit, whose headings weight the projection; or their counts, of
        :func:`heading_histogram`.
    resolution : float
        Degrees that the unit can hold; 0 for no rounding.
    sign : {"subtract_error", "add_error"}
        What the table holds, see the module.

    Returns
    -------
    Dataset
        ``fits`` with ``table_heading``, ``table_correction`` (NaN without a fit) and
        ``table_residual_rms``: table against curve over the headings flown, rounding included.
        Dask-backed where the fits or the headings are.

    Raises
    ------
    InputError
        If the sign is unknown.

    Examples
    --------
    >>> fits = airswing.fit_deviation(headings, pools={"ruc": ["ruc"]})
    >>> tables = airswing.add_tables(fits, headings, resolution=0.1)
    >>> tables["table_heading"].values.tolist()
    [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]
    """
    if sign not in SIGNS:
        raise InputError(
            "unknown sign of the table",
            field="table.sign",
            found=sign,
            remedy=f"One of: {', '.join(SIGNS)}",
        )
    histogram: object = headings
    if isinstance(headings, xr.Dataset):
        histogram = heading_histogram(headings, abscissa=fits.attrs.get("abscissa", "magnetic"))
    if isinstance(histogram, xr.DataArray):
        # the same aircraft, whether or not both name them
        histogram = histogram.drop_vars("aircraft", errors="ignore").variable
    correction, residual = xr.apply_ufunc(
        _tables,
        fits["deviation"].transpose("reference", "aircraft", "coefficient"),
        fits["status"].transpose("reference", "aircraft"),
        xr.Variable(("aircraft", "heading_bin"), getattr(histogram, "data", histogram)),
        input_core_dims=[["aircraft", "coefficient"], ["aircraft"], ["aircraft", "heading_bin"]],
        output_core_dims=[["aircraft", "node"], ["aircraft"]],
        kwargs={"resolution": resolution, "sign": SIGNS[sign]},
        dask="parallelized",
        output_dtypes=[np.float64, np.float64],
        dask_gufunc_kwargs={"output_sizes": {"node": NODES.size}, "allow_rechunk": True},
    )
    found = fits.assign(
        table_correction=correction.drop_attrs(),
        table_residual_rms=residual.drop_attrs(),
        table_heading=("node", NODES),
    )
    found.attrs.update(table_sign=sign, table_resolution=float(resolution))
    return describe(found)


def _tables(
    deviation: Array,
    status: NDArray[np.integer],
    histogram: NDArray[np.integer],
    *,
    resolution: float,
    sign: float,
) -> tuple[Array, Array]:
    """Tables (..., aircraft, node) and their rms difference (..., aircraft) from the curves."""
    tables = np.full((*deviation.shape[:-1], NODES.size), np.nan)
    residual = np.full(deviation.shape[:-1], np.nan)
    total = np.maximum(histogram.sum(axis=-1, keepdims=True), 1)
    weights = (1 - EVEN_SHARE) * histogram / total + EVEN_SHARE / FINE.size
    weights[histogram.sum(axis=-1) == 0] = 1.0 / FINE.size
    for place in zip(*np.nonzero(np.isfinite(deviation).all(axis=-1)), strict=True):
        weight, error = weights[place[-1]], deviation_curve(deviation[place], FINE)
        nodes = np.zeros(NODES.size)
        if status[place] != STATUS["no_correction_needed"]:
            nodes = _round_to(_project_curve(error, weight), resolution)
        tables[place] = sign * nodes + 0.0
        residual[place] = np.sqrt(weight @ (unit_interpolation(nodes, FINE) - error) ** 2)
    return tables, residual


def error_from_table(fits: xr.Dataset) -> xr.DataArray:
    """Return the heading error (..., aircraft, node) of the tables, degrees, indicated - true."""
    sign = SIGNS[fits.attrs.get("table_sign", "subtract_error")]
    return sign * fits["table_correction"]


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write the table of every aircraft as CSV, one row a node.

    Parameters
    ----------
    fits : Dataset
        With tables (:func:`add_tables`).
    path : str or path

    Returns
    -------
    Path
        The path written. A refused fit has rows with its status and without numbers.

    Raises
    ------
    InputError
        If the fits hold no tables or the file cannot be written.
    """
    if "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables", field="table_correction", remedy="Call add_tables first"
        )
    dims = "reference", "aircraft"
    covariance = fits["deviation_covariance"].transpose(*dims, ...).to_numpy()
    status = fits["status"].transpose(*dims).to_numpy()
    usable = published(status)[..., None]
    correction = fits["table_correction"].transpose(*dims, "node").to_numpy() + 0.0
    correction = np.where(usable, correction, np.nan)
    names = {code: name for name, code in STATUS.items()}
    shape = correction.shape

    def column(values: ArrayLike, axis: int) -> NDArray[np.object_]:
        sizes = [-1 if k == axis else 1 for k in range(3)]
        return np.broadcast_to(np.asarray(values, object).reshape(sizes), shape).ravel()

    basis = deviation_basis(np.radians(NODES))
    variance = np.einsum("in,raij,jn->ran", basis, covariance, basis)
    error = np.where(usable, np.sqrt(np.maximum(variance, 0.0)), np.nan)
    table = pd.DataFrame(
        {
            "aircraft": column(fits["aircraft"].to_numpy(), 1),
            "reference": column(fits["reference"].to_numpy(), 0),
            "status": [names[code] for code in np.repeat(status.ravel(), NODES.size)],
            "heading_deg": column([f"{node:g}" for node in NODES], 2),
            "table_correction_deg": correction.ravel(),
            "standard_error_deg": error.ravel(),
            "sign": str(fits.attrs.get("table_sign", "subtract_error")),
        }
    )
    with atomic(Path(path)) as temporary:
        table.to_csv(temporary, index=False, float_format="%.3f", lineterminator="\r\n")
    return Path(path)
