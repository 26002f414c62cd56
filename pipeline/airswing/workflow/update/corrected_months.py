"""Corrected winds by month: which months the table of today would change.

Every report added moves every curve a little. A month is corrected anew where the curve of one of
its aircraft has moved by more than `MOVED` of its standard error at a heading of the table, or its
status changed; else its winds stay those of the curve they were made with, within that.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from airswing.compass.table import NODES, deviation_curve
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.netcdf import read_product
from airswing.workflow.fits import make_corrected
from airswing.workflow.job import CORRECTED, HEADINGS, Job, earlier, main_reference
from airswing.workflow.update.months import keep_note, kept_note

MOVED = 0.5
"""Standard errors."""


def correct_month(job: Job, fits: xr.Dataset) -> bool:
    """Correct the winds of a month, where those that stand are not within `MOVED` of today's.

    Returns
    -------
    bool
        Whether anything was written.
    """
    path = job.output / ".update" / f"{job.month}.corrected.json"
    with read_product(job.place(HEADINGS), lazy=True) as headings:
        before, now = kept_note(path), _applied(job, headings, fits)
        stands = None if _moved(before, now) else earlier(job, job.place(CORRECTED))
        if stands is not None:
            stands.close()
            return False
        make_corrected(job, headings, fits).close()
    keep_note(path, now)
    return True


def _applied(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> dict[str, object]:
    """What the winds of a month's aircraft are corrected by."""
    names = headings["aircraft"].to_numpy().astype(str)
    known = fits["aircraft"].to_numpy().astype(str)
    reference = main_reference(job.config)
    own = fits.sel(reference=reference).isel(aircraft=np.flatnonzero(np.isin(known, names)))
    angle = np.radians(NODES)
    slope = np.stack(
        [np.ones(NODES.size), np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)]
    )
    square = own["deviation_covariance"].transpose("aircraft", "coefficient", "coefficient_2")
    variance = np.einsum("in,kij,jn->kn", slope, square.to_numpy(), slope)
    curve = deviation_curve(own["deviation"].transpose("aircraft", ...).to_numpy(), NODES)
    told = {key: str(fits.attrs.get(key)) for key in ("abscissa", "table_sign", "table_resolution")}
    told["method"] = job.config.correction.method
    return {
        "made": fingerprint(
            headings.attrs["uuid"], reference, told, code_digest("airswing.compass.correction")
        ),
        "status": own["status"].to_numpy().tolist(),
        "aircraft": own["aircraft"].to_numpy().astype(str).tolist(),
        "curve": np.nan_to_num(curve).tolist(),
        "error": np.sqrt(np.nan_to_num(np.maximum(variance, 0.0))).tolist(),
    }


def _moved(before: dict[str, object], now: dict[str, object]) -> bool:
    """Whether curves that were applied are not those of now, within their errors."""
    if any(before.get(key) != now[key] for key in ("made", "status", "aircraft")):
        return True
    apart = np.abs(np.array(now["curve"]) - np.array(before["curve"]))
    return bool(np.any(apart > MOVED * np.array(now["error"])))
