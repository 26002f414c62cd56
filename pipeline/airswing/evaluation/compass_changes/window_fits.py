"""Fits by calendar window: whether a compass stayed as it was.

Assumes screened headings; every window is fitted from its own reports alone. Angles in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.deviation import FITTED_FROM, FleetSums, fit_sums, sum_aircraft
from airswing.errors import InputError
from airswing.flags import STATUS, published
from airswing.products.ragged import blocks, some_reports


def fit_by_window(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    window: Literal["month", "quarter"] = "month",
    **fit_options: object,
) -> list[dict[str, object]]:
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
    list of dict
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
    options: dict[str, Any] = {
        "pools": {reference: members} if len(members) > 1 else {},
        **fit_options,
    }
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
            parts.append(sum_aircraft(some_reports(block, own == one), **options))
    words = {code: name for name, code in STATUS.items()}
    found = []
    for one in list(sums):
        fits = fit_sums(sums.pop(one)).sel(reference=reference)
        first = str(np.datetime64(one * step, "M").astype("datetime64[D]"))
        for k in range(fits.sizes["aircraft"]):
            found.append(_window_entry(fits.isel(aircraft=k), first, words))
    return sorted(found, key=lambda entry: (entry["aircraft"], entry["window"]))


def _window_entry(fit: xr.Dataset, first: str, words: dict[int, str]) -> dict[str, object]:
    entry: dict[str, object] = {
        "aircraft": str(fit["aircraft"].item()),
        "window": first,
        "reports": int(fit["report_count"]),
        "status": words[int(fit["status"])],
    }
    if not published(fit["status"]):
        return entry
    for name in ("offset", "amplitude", "phase"):
        entry[name] = float(fit[name])
        entry[f"{name}_standard_error"] = float(fit[f"{name}_standard_error"])
    wide = np.sqrt(np.diag(fit["deviation_covariance"].to_numpy()))
    for name, value, error in zip("ABCDE", fit["deviation"].to_numpy(), wide, strict=True):
        entry[name], entry[f"{name}_standard_error"] = float(value), float(error)
    return entry
