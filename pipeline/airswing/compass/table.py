"""The 8-point correction table of a unit's firmware, its interpolation, and its CSV file.

The firmware holds one number a node at indicated magnetic headings 0, 45, ... 315 degrees and
interpolates linearly between them, periodically. The best table is then not the curve at its nodes
(which multiplies harmonic k by sinc^2(k/8): 0.950, 0.811) but the least-squares projection of the
curve on that piecewise-linear basis, weighted by the headings that the aircraft flies. A small even
weight makes the table follow the curve at headings that are not flown.

``subtract_error``: the table holds the degrees to ADD to the indicated heading, minus the heading
error, as a navigator's deviation card does (east positive = magnetic - compass).
``add_error``: the table holds the heading error itself, which the unit subtracts.
The argument is the indicated magnetic heading: psi_corr = psi_ind - psi_err(psi_ind). Degrees.

References
----------
Jacobs et al. 2010 (seed paper), steps e and f.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
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
    """Heading error A + B sin m + C cos m + D sin 2m + E cos 2m, (..., m), degrees.

    ``coefficients`` (..., 5) in degrees; ``heading`` (m,) indicated magnetic, degrees.
    """
    basis = deviation_basis(np.radians(np.asarray(heading, dtype=np.float64)))
    return np.asarray(np.asarray(coefficients, dtype=np.float64) @ basis)


def curve_standard_error(covariance: ArrayLike, heading: ArrayLike, gain: ArrayLike = 1.0) -> Array:
    """Standard error of a deviation curve, (n,), degrees.

    ``covariance`` (n, 5, 5) or (5, 5) in degree2; ``heading`` (n,) indicated magnetic, degrees;
    ``gain`` (n,) the factor of the one-cycle part (B, C).
    """
    basis = deviation_basis(np.radians(heading), gain)
    product = np.einsum("...ij,j...->i...", np.asarray(covariance, dtype=np.float64), basis)
    return np.asarray(np.sqrt(np.maximum((product * basis).sum(axis=0), 0.0)))


def unit_interpolation(table: ArrayLike, heading: ArrayLike) -> Array:
    """Interpolate in a table as the unit does, (n,), degrees; NaN where a value is NaN.

    ``table`` is one (node,) or one for each heading (n, node), nodes evenly spaced from 0 degrees;
    ``heading`` (n,) indicated magnetic, degrees, of any turn.
    """
    lower, upper, share = _nodes_around(table, heading)
    return np.asarray(lower * (1 - share) + upper * share)


def table_slope(table: ArrayLike, heading: ArrayLike) -> Array:
    """Slope of tables, (n,), degrees per degree; arguments as of `unit_interpolation`."""
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
    """Number of reports used of each aircraft by 1-degree bin of heading, (aircraft, heading_bin).

    ``headings`` are screened; the abscissa is ``magnetic`` or ``true``. Dask-backed where the
    headings are.
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
    basis = np.stack([unit_interpolation(row, FINE) for row in np.eye(NODES.size)], axis=1)
    for place in zip(*np.nonzero(np.isfinite(deviation).all(axis=-1)), strict=True):
        weight, error = weights[place[-1]], deviation_curve(deviation[place], FINE)
        nodes = np.zeros(NODES.size)
        if status[place] != STATUS["no_correction_needed"]:
            weighted = basis * weight[:, np.newaxis]
            projected = np.linalg.solve(basis.T @ weighted, weighted.T @ error)
            nodes = _round_to(projected, resolution)
        tables[place] = sign * nodes + 0.0
        residual[place] = np.sqrt(weight @ (unit_interpolation(nodes, FINE) - error) ** 2)
    return tables, residual


def error_from_table(fits: xr.Dataset) -> xr.DataArray:
    """Return the heading error (..., aircraft, node) of the tables, degrees, indicated - true."""
    sign = SIGNS[fits.attrs.get("table_sign", "subtract_error")]
    return sign * fits["table_correction"]


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write the table of every aircraft as CSV, one row a node; return the path.

    A refused fit has rows with its status and without numbers. InputError where the fits hold no
    tables or the file cannot be written.
    """
    if "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables", field="table_correction", remedy="Call add_tables first"
        )
    dims = "reference", "aircraft"
    usable = xr.DataArray(published(fits["status"]), dims=fits["status"].dims)
    basis = deviation_basis(np.radians(NODES))
    covariance = fits["deviation_covariance"].transpose(*dims, ...).to_numpy()
    variance = np.einsum("in,raij,jn->ran", basis, covariance, basis)
    error = xr.DataArray(np.sqrt(np.maximum(variance, 0.0)), dims=(*dims, "node"))
    rows = xr.Dataset(
        {
            "status": fits["status"],
            "heading_deg": ("node", [f"{node:g}" for node in NODES]),
            "table_correction_deg": fits["table_correction"].where(usable) + 0.0,
            "standard_error_deg": error.where(usable),
            "sign": str(fits.attrs.get("table_sign", "subtract_error")),
        }
    )
    columns = ["aircraft", "reference", *rows.data_vars]
    table = rows.to_dataframe(dim_order=[*dims, "node"]).reset_index()[columns]
    table["status"] = table["status"].map({code: name for name, code in STATUS.items()})
    with atomic(Path(path)) as temporary:
        table.to_csv(temporary, index=False, float_format="%.3f", lineterminator="\r\n")
    return Path(path)
