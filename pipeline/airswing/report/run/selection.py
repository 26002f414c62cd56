"""Which reports and which fit a figure shows.

Assumes the Datasets of the stages: reports sorted by aircraft with ``row_size``, one
``screening`` word a report (0: used in the fit), and fits by reference and by pool, where a
pool's heading error is the mean over its members.  Angles are degrees.
"""

from __future__ import annotations

import json
from typing import SupportsInt

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.disagreement import member_mean
from airswing.flags import STATUS

Floats = NDArray[np.float64]


def tails(ds: xr.Dataset) -> list[str]:
    """Return the aircraft identifiers as strings."""
    return [str(name) for name in ds["aircraft"].to_numpy()]


def _aircraft_index(ds: xr.Dataset, aircraft: str | int) -> int:
    """Return the position of an aircraft given by name or position."""
    known = tails(ds)
    if isinstance(aircraft, int | np.integer):
        return range(len(known))[int(aircraft)]
    if aircraft not in known:
        raise InputError(
            "no such aircraft",
            field="aircraft",
            found=aircraft,
            remedy=f"Choose from {', '.join(known[:8])}{' ...' if len(known) > 8 else ''}",
        )
    return known.index(aircraft)


def rows_of(ds: xr.Dataset, aircraft: str | int) -> slice:
    """Return the slice of reports of one aircraft."""
    stop = np.cumsum(ds["row_size"].to_numpy())
    index = _aircraft_index(ds, aircraft)
    return slice(int(stop[index] - ds["row_size"].to_numpy()[index]), int(stop[index]))


def members(headings: xr.Dataset, fits: xr.Dataset, reference: str) -> list[str]:
    """Return the references behind a fit: itself, or the members of a pool.

    A pool's members are taken from the JSON attribute ``pools`` of the fits where it stands,
    else from its name (``ruc+rtfdaa``), else all references of the headings.
    """
    known = [str(name) for name in headings["reference"].to_numpy()]
    if reference in known:
        return [reference]
    stored: dict[str, list[str]] = json.loads(str(fits.attrs.get("pools", "{}")) or "{}")
    named = stored.get(reference, reference.split("+"))
    found = [name for name in named if name in known]
    return found or known


def headline_reference(fits: xr.Dataset, headings: xr.Dataset) -> str:
    """Return the fit the page leads with: the first pool, else the first reference."""
    known = {str(name) for name in headings["reference"].to_numpy()}
    names = [str(name) for name in fits["reference"].to_numpy()]
    return next((name for name in names if name not in known), names[0])


def pooled(
    headings: xr.Dataset, fits: xr.Dataset, reference: str, name: str, rows: slice = slice(None)
) -> Floats:
    """Mean over a fit's members of a (reference, report) variable, (report,)."""
    chosen = headings[name].sel(reference=members(headings, fits, reference))
    return np.asarray(member_mean(chosen.isel(report=rows).astype(float)).to_numpy())


def used(headings: xr.Dataset, rows: slice = slice(None)) -> NDArray[np.bool_]:
    """Return which reports passed every screening rule."""
    return np.asarray(headings["screening"].isel(report=rows).to_numpy() == 0)


def fitted_bias(fits: xr.Dataset, reference: str) -> tuple[float, float]:
    """Return the eastward and northward bias of a reference (m/s) of the joint fit, else zero."""
    if "reference_bias" not in fits:
        return 0.0, 0.0
    bias = np.nan_to_num(fits["reference_bias"].sel(reference=reference).to_numpy().astype(float))
    return float(bias[0]), float(bias[1])


def compass_points(
    headings: xr.Dataset, fits: xr.Dataset, aircraft: str | int, reference: str
) -> tuple[Floats, Floats]:
    """Magnetic heading and heading error (degrees) of the reports behind one fit.

    The reference's fitted bias b is taken out, as the joint fit does, so that the reports lie
    about the fitted curve: psi_err - (b_u cos psi - b_v sin psi) / V (docs/method.md).
    """
    rows = rows_of(headings, aircraft)
    abscissa = "heading" if fits.attrs.get("abscissa") == "true" else "magnetic_heading"
    heading = np.asarray(headings[abscissa].isel(report=rows).to_numpy(), float) % 360.0
    error = pooled(headings, fits, reference, "heading_error", rows)
    eastward, northward = fitted_bias(fits, reference)
    if eastward or northward:
        true = np.radians(np.asarray(headings["heading"].isel(report=rows).to_numpy(), float))
        airspeed = np.asarray(headings["airspeed"].isel(report=rows).to_numpy(), float)
        across = eastward * np.cos(true) - northward * np.sin(true)
        error = error - np.degrees(across / np.where(airspeed > 0, airspeed, np.nan))
    keep = used(headings, rows) & np.isfinite(heading) & np.isfinite(error)
    return heading[keep], error[keep]


def one_fit(fits: xr.Dataset, aircraft: str | int, reference: str) -> xr.Dataset:
    """Return the fit of one aircraft against one reference or pool.

    Raises
    ------
    InputError
        If the reference was not fitted.
    """
    names = [str(name) for name in fits["reference"].to_numpy()]
    if reference not in names:
        raise InputError(
            "no fit against this reference",
            field="reference",
            found=reference,
            remedy=f"Choose from {', '.join(names)}",
        )
    return fits.isel(reference=names.index(reference), aircraft=_aircraft_index(fits, aircraft))


def status_words(code: SupportsInt) -> str:
    """Return a fit's status in words."""
    names = {value: name.replace("_", " ") for name, value in STATUS.items()}
    return names.get(int(code), f"status {int(code)}")


def basis(heading: Floats) -> Floats:
    """Return columns 1, sin m, cos m, sin 2m, cos 2m at headings m (degrees); (..., 5)."""
    m = np.radians(heading)
    return np.stack([np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)], -1)


def curve_with_error(fit: xr.Dataset, heading: Floats) -> tuple[Floats, Floats]:
    """Fitted heading error and its standard error (degrees) at headings (degrees)."""
    columns = basis(heading)
    value = columns @ np.nan_to_num(fit["deviation"].to_numpy().astype(float))
    covariance = np.nan_to_num(fit["deviation_covariance"].to_numpy().astype(float))
    variance = np.einsum("ni,ij,nj->n", columns, covariance, columns)
    return value, np.sqrt(np.clip(variance, 0.0, None))


def table_error(fit: xr.Dataset) -> tuple[Floats, Floats]:
    """Node headings and the heading error the 8-point table stands for (degrees).

    The stored correction is what a unit adds to the indicated heading (minus the error), or
    the error itself where the table's ``sign`` attribute says ``add_error``.
    """
    nodes = fit["table_heading"].to_numpy().astype(float)
    correction = fit["table_correction"].to_numpy().astype(float)
    return nodes, correction if adds_error(fit) else -correction


def adds_error(fits: xr.Dataset) -> bool:
    """Return whether the stored table is the heading error itself, not what a unit adds."""
    sign = fits["table_correction"].attrs.get("sign", fits.attrs.get("table_sign", ""))
    return "add_error" in str(sign)
