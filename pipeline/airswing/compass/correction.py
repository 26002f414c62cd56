"""The 8-point correction table of a unit, and the correction of the reported winds.

The error of the unit is the direction of its air vector: psi_corr = psi_ind - psi_err(m), m the
indicated magnetic heading. With V_A = V_G - W_reported the ground vector cancels: W_corrected =
W_reported + V_A - R V_A, R the turn by -psi_err. So only airspeed and indicated heading are needed,
and every report that has them is corrected. On request the airspeed scale s is removed too:
V_A / (1 + s). The one-cycle part of the curve (B, C) is proportional to the inverse of the
horizontal field and is scaled to that of every report where it is known; a table is not.

*Table.* The projection of docs/method.md ("The correction table"), weighted by the headings that
the aircraft flies and a small even weight. ``subtract_error``: degrees to ADD to the indicated
heading, as on a navigator's deviation card (east positive = magnetic - compass); ``add_error``: the
heading error itself, which the unit subtracts.

*Standard error* of the corrected wind vector relative to the report of an aircraft without compass
error. The correction adds V (e^(-i delta) - 1) along the heading, of length V delta. Its errors are
independent and add in quadrature:

* the curve: V times its standard error at the heading, and V times the difference of the unit's
  table from the curve at this heading and field, which is known;
* the heading: with an error eps the curve is read at the wrong heading and the correction turned
  with it, ``V (delta, delta') eps``; a large eps saturates like the chord of a circle,
  ``2 (1 - exp(-sd^2 / 2))`` in place of ``sd^2``;
* the airspeed: ``delta`` times its error, and its scale where that is removed;
* coding: both reports are rounded to steps of speed and direction, twice the variance of one.

Gusts and noise of the sensors are in both reports and not included. Valid for deviations under 30
degrees. Degrees in the Datasets, radians and m/s inside. Source: Jacobs et al. 2010, steps e and f.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.compass.whole_aircraft import map_aircraft
from airswing.errors import InputError
from airswing.flags import CORRECTION, SCREENING, STATUS, is_corrected, published
from airswing.physics.compass_deviation import deviation_basis, deviation_slope
from airswing.products.ragged import aircraft_of_report
from airswing.products.whole_files import atomic
from airswing.vocabulary import describe

Array = NDArray[np.float64]

NODES = np.arange(0.0, 360.0, 45.0)
FINE = np.arange(0.5, 360.0, 1.0)
"""Headings at which curve and table are compared: the middles of 1-degree bins."""
EVEN_SHARE = 0.05  # share of the weight that is spread evenly over all headings
Sign = Literal["subtract_error", "add_error"]
SIGNS: dict[str, float] = {"subtract_error": -1.0, "add_error": 1.0}


def deviation_curve(coefficients: ArrayLike, heading: ArrayLike) -> Array:
    """Heading error A + B sin m + C cos m + D sin 2m + E cos 2m, (..., m), degrees.

    ``coefficients`` (..., 5) in degrees; ``heading`` (m,) indicated magnetic, degrees.
    """
    basis = deviation_basis(np.radians(np.asarray(heading, dtype=np.float64)))
    return np.asarray(np.asarray(coefficients, dtype=np.float64) @ basis)


def curve_standard_error(covariance: ArrayLike, heading: ArrayLike, gain: ArrayLike = 1.0) -> Array:
    """Standard error of a deviation curve, (...), degrees.

    ``covariance`` (..., 5, 5) in degree2; ``heading`` (...) indicated magnetic, degrees; ``gain``
    (...) the factor of the one-cycle part (B, C). Leading dimensions broadcast.
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


def _nodes_around(table: ArrayLike, heading: ArrayLike) -> tuple[Array, Array, Array]:
    """Values at the nodes below and above each heading; its distance from the lower, in steps."""
    values = np.asarray(table, dtype=np.float64)
    nodes = values.shape[-1]
    place = np.mod(np.asarray(heading, dtype=np.float64), 360.0) * (nodes / 360.0)
    lower = np.where(np.isfinite(place), np.floor(place), 0).astype(np.int64) % nodes
    row = () if values.ndim == 1 else (np.arange(values.shape[0]),)
    return values[*row, lower], values[*row, (lower + 1) % nodes], place - np.floor(place)


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
        Fits with ``deviation`` and ``status``.
    headings : Dataset, or array of int, shape (aircraft, 360)
        The reports of the fit, whose headings weight the projection; or their counts, of
        :func:`heading_histogram`.
    resolution : float
        Degrees that the unit can hold; 0 for no rounding.
    sign : {"subtract_error", "add_error"}
        Sign convention of the table; see the module docstring.

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
        remedy = f"One of: {', '.join(SIGNS)}"
        raise InputError("unknown sign of the table", field="table.sign", found=sign, remedy=remedy)
    histogram = headings
    if isinstance(headings, xr.Dataset):
        histogram = heading_histogram(headings, abscissa=fits.attrs.get("abscissa", "magnetic"))
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
    tables = fits.assign(
        table_correction=correction.drop_attrs(),
        table_residual_rms=residual.drop_attrs(),
        table_heading=("node", NODES),
    )
    tables.attrs.update(table_sign=sign, table_resolution=float(resolution))
    return describe(tables)


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
            nodes = np.linalg.solve(basis.T @ weighted, weighted.T @ error)
            if resolution > 0:
                # three times 0.1 is 0.30000000000000004
                nodes = np.round(np.rint(nodes / resolution) * resolution, 12)
        tables[place] = sign * nodes + 0.0
        residual[place] = np.sqrt(weight @ (unit_interpolation(nodes, FINE) - error) ** 2)
    return tables, residual


def error_from_table(fits: xr.Dataset) -> xr.DataArray:
    """Return the heading error (..., aircraft, node) of the tables, degrees, indicated - true."""
    return SIGNS[fits.attrs.get("table_sign", "subtract_error")] * fits["table_correction"]


def require_tables(fits: xr.Dataset, remedy: str = "Call add_tables first") -> None:
    """Raise InputError where the fits hold no correction tables."""
    if "table_correction" not in fits:
        raise InputError("the fits hold no tables", field="table_correction", remedy=remedy)


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write the table of every aircraft as CSV, one row a node; return the path.

    A refused fit has rows with its status and without numbers. InputError where the fits hold no
    tables or the file cannot be written.
    """
    require_tables(fits)
    dims = "reference", "aircraft"
    usable = xr.DataArray(published(fits["status"]), dims=fits["status"].dims)
    covariance = fits["deviation_covariance"].transpose(*dims, ...).to_numpy()
    by_node = curve_standard_error(covariance[:, :, np.newaxis], NODES[np.newaxis, np.newaxis])
    rows = xr.Dataset(
        {
            "status": fits["status"],
            "heading_deg": ("node", [f"{node:g}" for node in NODES]),
            "table_correction_deg": fits["table_correction"].where(usable) + 0.0,
            "standard_error_deg": xr.DataArray(by_node, dims=(*dims, "node")).where(usable),
            "sign": str(fits.attrs.get("table_sign", "subtract_error")),
        }
    )
    columns = ["aircraft", "reference", *rows.data_vars]
    table = rows.to_dataframe(dim_order=[*dims, "node"]).reset_index()[columns]
    table["status"] = table["status"].map({code: name for name, code in STATUS.items()})
    with atomic(Path(path)) as temporary:
        table.to_csv(temporary, index=False, float_format="%.3f", lineterminator="\r\n")
    return Path(path)


COPIED = (
    *("time", "latitude", "longitude", "pressure", "pressure_altitude"),
    *("eastward_wind", "northward_wind", "air_temperature"),
    *("reference_eastward_wind", "reference_northward_wind", "lead_time"),
    *("heading", "magnetic_heading", "airspeed", "phase", "flight", "screening", "row_size"),
    *("platform", "roll_flag", "temperature_qc"),
)
"""Variables of the reports that the corrected product also holds, where they are present."""
NEEDED = (
    *("eastward_wind", "northward_wind", "heading", "magnetic_heading", "airspeed"),
    *("screening", "row_size", "platform", "horizontal_field", "heading_standard_error"),
    *("ground_velocity_error", "wind_speed_resolution", "wind_direction_resolution"),
)
"""Variables that the correction reads. Without the last five it applies to the mean field, and its
standard error includes only the fit and the table."""


def corrected_wind(
    u: ArrayLike,
    v: ArrayLike,
    airspeed: ArrayLike,
    heading: ArrayLike,
    error: ArrayLike,
    scale: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """Wind (n,) that the unit would have computed along the corrected heading, m/s.

    ``u, v`` and ``airspeed`` as reported, m/s; ``heading`` and heading ``error`` in radians;
    ``scale``: relative error of the airspeed, to be removed.
    """
    east, north, speed, psi, turn = (
        np.asarray(values, dtype=np.float64) for values in (u, v, airspeed, heading, error)
    )
    true_speed = speed / (1.0 + np.asarray(scale, dtype=np.float64))
    return (
        np.asarray(east + speed * np.sin(psi) - true_speed * np.sin(psi - turn)),
        np.asarray(north + speed * np.cos(psi) - true_speed * np.cos(psi - turn)),
    )


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
    """Standard error of the corrected wind as a vector, (n,), m/s; see the module.

    ``deviation`` is that removed (radians) and ``slope`` its derivative by the heading;
    ``curve_error`` the standard error of the deviation, with that of the airspeed scale where it is
    removed (radians); ``heading_error`` (radians) and ``airspeed_error`` (m/s) those at the report;
    ``coding`` the variance from rounding (m2/s2) of :func:`coding_variance`.
    """
    chord = 2.0 * (1.0 - np.exp(-0.5 * np.square(heading_error)))
    angle = np.square(curve_error) + (np.square(deviation) + np.square(slope)) * chord
    along = np.square(np.multiply(deviation, airspeed_error))
    variance = np.square(airspeed) * angle + along + np.asarray(coding, dtype=np.float64)
    return np.asarray(np.sqrt(variance))


def coding_variance(speed: ArrayLike, speed_step: ArrayLike, direction_step: ArrayLike) -> Array:
    """Variance (n,) of the vector difference of two reports of the same wind from their rounding.

    m2/s2: a uniform error has a twelfth of its step squared; twice, for two reports. ``speed`` and
    ``speed_step`` in m/s, ``direction_step`` in radians; steps are 0 where unknown.
    """
    arc = np.multiply(speed, direction_step)
    return np.asarray((np.square(speed_step) + np.square(arc)) / 6.0)


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
        Reference or pool of the fits; by default the first pool, without pools the first reference.
    method : {"table", "curve"}
        Apply the table as the unit would, or the fitted curve.
    apply_airspeed_scale : bool
        Remove the airspeed scale as well.

    Returns
    -------
    Dataset
        The reports with ``corrected_eastward_wind, corrected_northward_wind, corrected_heading,
        corrected_wind_standard_error`` and ``correction_applied``; dask-backed where the headings
        or the fits are. Other reports keep their wind, and the flag states the reason.

    Raises
    ------
    InputError
        If the reference has no fits, the tables are missing or the method is unknown.

    References
    ----------
    Jacobs et al. 2010, step f.

    Examples
    --------
    >>> corrected = airswing.correct(headings, fits, reference="ruc")
    >>> corrected["corrected_eastward_wind"].attrs["units"]
    'm s-1'
    """
    names = [str(name) for name in fits["reference"].to_numpy()]
    reference = main_reference(fits) if reference is None else reference
    if reference not in names:
        raise InputError(
            "no fit against this reference",
            field="reference",
            found=reference,
            remedy=f"Fitted: {', '.join(names)}",
        )
    if method not in ("table", "curve"):
        raise InputError("unknown method", field="method", found=method, remedy="table or curve")
    if method == "table":
        require_tables(fits, "Call add_tables first, or use method='curve'")
    fit = fits.isel(reference=names.index(reference))
    read = headings[[name for name in NEEDED if name in headings]]
    corrected = map_aircraft(_correct, read, fit, method=method, scaled=apply_airspeed_scale)
    reports = headings[[name for name in COPIED if name in headings]]
    ds = reports.assign({str(name): corrected[name] for name in corrected.data_vars})
    ds.attrs.update(correction_reference=reference, correction_method=method)
    return describe(ds)


def main_reference(fits: xr.Dataset) -> str:
    """First pool of the fits of a run; without pools the first reference."""
    names = fits["reference"].to_numpy().astype(str)
    single = int(fits.attrs.get("reference_count", names.size))
    return str(names[single if single < names.size else 0])


def _correct(headings: xr.Dataset, fit: xr.Dataset, *, method: str, scaled: bool) -> xr.Dataset:
    """Corrected winds of the reports of some aircraft, in memory."""
    place = {str(name): k for k, name in enumerate(fit["aircraft"].to_numpy())}
    fitted = [place.get(str(name), -1) for name in headings["aircraft"].to_numpy()]
    aircraft = aircraft_of_report(headings)
    row = np.array(fitted, dtype=np.int64)[aircraft]
    magnetic = fit.attrs.get("abscissa", "magnetic") == "magnetic"
    argument_name = "magnetic_heading" if magnetic else "heading"
    names = ("eastward_wind", "northward_wind", "airspeed", "heading", argument_name)
    columns = [headings[name].to_numpy().astype(np.float64) for name in names]
    flag = _flags(headings, columns, fit, row)
    applied = is_corrected(flag)
    # only corrected reports from here on
    u, v, speed, heading, argument = (values[applied] for values in columns)
    row, aircraft = row[applied], aircraft[applied]

    def filled(name: str, by_aircraft: bool = False) -> Array:
        """Values of a variable, zero where they are unknown."""
        if name not in headings:
            return np.zeros(row.size)
        values = np.nan_to_num(headings[name].to_numpy().astype(np.float64))
        return values[aircraft] if by_aircraft else values[applied]

    gain = np.ones(row.size)
    if "mean_horizontal_field" in fit:
        field, mean = filled("horizontal_field"), fit["mean_horizontal_field"].to_numpy()[row]
        np.divide(mean, field, out=gain, where=np.isfinite(mean) & (field > 0))
    coefficients = fit["deviation"].to_numpy()[row]
    coefficients[:, 1:3] *= gain[:, np.newaxis]
    angle = np.radians(argument)
    error = (coefficients.T * deviation_basis(angle)).sum(axis=0)
    slope = deviation_slope(np.radians(coefficients), angle)
    curve_error = np.empty(row.size)
    # one covariance matrix for each aircraft, not for each report
    for begin, end in pairwise([*np.flatnonzero(np.diff(aircraft, prepend=-1)), row.size]):
        covariance, block = fit["deviation_covariance"].to_numpy()[row[begin]], slice(begin, end)
        curve_error[block] = curve_standard_error(covariance, argument[block], gain[block])
    if method == "table":
        table = error_from_table(fit).to_numpy()[row]
        lower, upper, share = _nodes_around(table, argument)
        from_table = lower * (1 - share) + upper * share
        # the known difference of table and curve counts as an error: the unit does not remove it
        curve_error, error = np.hypot(curve_error, from_table - error), from_table
        slope = (upper - lower) * table.shape[-1] / 360.0  # degrees per degree
    scale, scale_error = np.zeros(row.size), np.zeros(row.size)
    if scaled:  # fits of an offset have no airspeed scale
        scale = np.nan_to_num(fit["airspeed_scale"].to_numpy()[row])
        scale_error = np.nan_to_num(fit["airspeed_scale_standard_error"].to_numpy()[row])
    heading_error = np.radians(filled("heading_standard_error"))
    # the mean of both components is known: the part not across the heading is along it
    along = 2.0 * filled("ground_velocity_error") ** 2 - (speed * heading_error) ** 2
    standard_error = correction_error(
        speed,
        np.radians(error),
        slope,
        curve_error=np.hypot(np.radians(curve_error), scale_error),
        heading_error=heading_error,
        airspeed_error=np.sqrt(np.maximum(along, 0.0)),
        coding=coding_variance(
            np.hypot(u, v),
            filled("wind_speed_resolution", by_aircraft=True),
            np.radians(filled("wind_direction_resolution", by_aircraft=True)),
        ),
    )
    u, v = corrected_wind(u, v, speed, np.radians(heading), np.radians(error), scale)
    ds = xr.Dataset()
    for name, before, corrected in (
        ("eastward_wind", columns[0], u),
        ("northward_wind", columns[1], v),
        ("heading", columns[3], np.mod(heading - error, 360.0)),
        ("wind_standard_error", np.full(applied.size, np.nan), standard_error),
    ):
        values = before.copy()
        values[applied] = corrected
        ds[f"corrected_{name}"] = "report", values
    return ds.assign(correction_applied=("report", flag))


def _flags(
    headings: xr.Dataset, columns: list[Array], fit: xr.Dataset, row: NDArray[np.int64]
) -> NDArray[np.int8]:
    """Codes of `CORRECTION`; if several reasons apply, the one that is hardest to remove."""
    status = np.append(fit["status"].to_numpy(), STATUS["too_few_reports"])[row]
    u, v, speed, heading, argument = columns
    by_unit = np.zeros(row.size, dtype=bool)
    if "screening" in headings:
        by_unit = (headings["screening"].to_numpy() & SCREENING["field_test"]) > 0
    reasons = {
        "missing_wind": ~np.isfinite(u + v),
        "already_corrected": by_unit,
        "no_fit": ~published(status),
        "no_correction_needed": status == STATUS["no_correction_needed"],
        "no_heading": ~np.isfinite(argument + speed + heading),
        "offset_only": status == STATUS["offset_only"],
    }
    codes = [CORRECTION[name] for name in reasons]
    return np.select(list(reasons.values()), codes, CORRECTION["corrected"]).astype(np.int8)
