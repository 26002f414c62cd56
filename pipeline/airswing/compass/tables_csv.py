"""The 8-point tables of all aircraft as CSV.

Assumes fits with tables (:func:`airswing.compass.table.add_tables`). Degrees.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import xarray as xr

from airswing.compass.correction import curve_standard_error
from airswing.compass.fit.sandwich import Array
from airswing.compass.table import NODES
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.products.whole_files import atomic

COLUMNS = (
    "aircraft",
    "reference",
    "status",
    "heading_deg",
    "table_correction_deg",
    "standard_error_deg",
    "sign",
)
_STATUS_TEXT = {code: name for name, code in STATUS.items()}


def write_tables_csv(fits: xr.Dataset, path: str | Path) -> Path:
    """Write every aircraft's table, one row a node; a refused fit keeps its row and reason."""
    _need_tables(fits)
    target = Path(path)
    with (
        atomic(target) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        sign = str(fits.attrs.get("table_sign", "subtract_error"))
        for reference in range(fits.sizes["reference"]):
            for aircraft in range(fits.sizes["aircraft"]):
                one = fits.isel(reference=reference, aircraft=aircraft)
                writer.writerows(_table_rows(one, sign))
    return target


def _table_rows(one: xr.Dataset, sign: str) -> list[tuple[str, ...]]:
    names = (
        str(one["aircraft"].item()),
        str(one["reference"].item()),
        _STATUS_TEXT[int(one["status"])],
    )
    correction = one["table_correction"].to_numpy()
    error = _node_errors(one)
    return [
        (*names, f"{node:g}", _number(correction[k], 3), _number(error[k], 3), sign)
        for k, node in enumerate(NODES)
    ]


def _node_errors(one: xr.Dataset) -> Array:
    return np.asarray(curve_standard_error(one["deviation_covariance"].to_numpy(), NODES))


def _number(value: float, places: int) -> str:
    return "" if not np.isfinite(value) else f"{value + 0.0:.{places}f}"


def _need_tables(fits: xr.Dataset) -> None:
    if "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables", field="table_correction", remedy="Call add_tables first"
        )
