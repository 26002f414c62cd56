"""Fits by calendar window: whether a compass stayed as it was.

Assumes screened headings; every window is fitted from its own reports alone. Angles in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import FITTED_FROM, FleetSums, fit_sums, sum_aircraft
from airswing.errors import InputError
from airswing.evaluation.contents import WindowFit
from airswing.flags import STATUS, published
from airswing.products.ragged import blocks, some_reports


def fit_by_window(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    window: Literal["month", "quarter"] = "month",
    **fit_options: Unpack[FitOptions],
) -> list[WindowFit]:
    """Fit every aircraft in each calendar window on its own.

    Parameters
    ----------
    reference : str
        Key of ``pools``.
    window : {"month", "quarter"}
    **fit_options
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.

    Returns
    -------
    list of WindowFit
        One for each aircraft, window with reports: ``aircraft``, ``window`` (its first day),
        ``reports``, ``status`` and, where something is fitted, ``offset``, ``amplitude``, ``phase``
        and ``A`` to ``E`` with ``*_standard_error``, degrees.

    Raises
    ------
    InputError
        If the window or the reference is unknown.
    """
    if window not in ("month", "quarter") or reference not in pools:
        raise InputError(
            "cannot fit by window",
            field="window" if reference in pools else "reference",
            found=window if reference in pools else reference,
            remedy=f"month or quarter; known references: {', '.join(pools)}",
        )
    members = list(pools[reference])
    part = headings.sel(reference=members)
    mean = {reference: members} if len(members) > 1 else {}
    step = 1 if window == "month" else 3

    def number(reports: xr.Dataset) -> NDArray[np.int64]:
        month = reports["time"].to_numpy().astype("datetime64[M]").astype(np.int64)
        return np.asarray(month // step)

    windows: set[int] = set()
    for block in blocks(headings, ["time", "screening"]):
        windows.update(number(block)[block["screening"].to_numpy() == 0].tolist())
    sums: dict[int, list[FleetSums]] = {one: [] for one in sorted(windows)}
    for block in blocks(part, FITTED_FROM):
        own = number(block)
        for one, parts in sums.items():
            parts.append(sum_aircraft(some_reports(block, own == one), pools=mean, **fit_options))
    words = {code: name for name, code in STATUS.items()}
    found = []
    for one in list(sums):
        fits = fit_sums(sums.pop(one)).sel(reference=reference)
        first = str(np.datetime64(one * step, "M").astype("datetime64[D]"))
        for k in range(fits.sizes["aircraft"]):
            found.append(_window_entry(fits.isel(aircraft=k), first, words))
    return sorted(found, key=lambda entry: (entry["aircraft"], entry["window"]))


def _window_entry(fit: xr.Dataset, first: str, words: dict[int, str]) -> WindowFit:
    entry: WindowFit = {
        "aircraft": str(fit["aircraft"].item()),
        "window": first,
        "reports": int(fit["report_count"]),
        "status": words[int(fit["status"])],
    }
    if not published(fit["status"]):
        return entry
    entry["offset"] = float(fit["offset"])
    entry["offset_standard_error"] = float(fit["offset_standard_error"])
    entry["amplitude"] = float(fit["amplitude"])
    entry["amplitude_standard_error"] = float(fit["amplitude_standard_error"])
    entry["phase"] = float(fit["phase"])
    entry["phase_standard_error"] = float(fit["phase_standard_error"])
    a, b, c, d, e = fit["deviation"].to_numpy().tolist()
    wide = np.sqrt(np.diag(fit["deviation_covariance"].to_numpy())).tolist()
    entry["A"], entry["A_standard_error"] = a, wide[0]
    entry["B"], entry["B_standard_error"] = b, wide[1]
    entry["C"], entry["C_standard_error"] = c, wide[2]
    entry["D"], entry["D_standard_error"] = d, wide[3]
    entry["E"], entry["E_standard_error"] = e, wide[4]
    return entry
