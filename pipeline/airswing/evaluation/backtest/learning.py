"""Corrections learned from some of the reports, to be judged on others.

Assumes screened headings; what must not be learned from was marked by
:func:`airswing.evaluation.backtest.folds.only`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Unpack

import xarray as xr

from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.products.ragged import blocks

# Columns a correction is made from and judged by.
_JUDGED = (
    "time",
    "flight",
    "eastward_wind",
    "northward_wind",
    "airspeed",
    "heading",
    "magnetic_heading",
    "screening",
    "reference_eastward_wind",
    "reference_northward_wind",
    "horizontal_field",
)


class TableOptions(FitOptions, total=False):
    """What :func:`fitted` takes."""

    resolution: float


def fitted(
    headings: xr.Dataset,
    pools: Mapping[str, list[str]],
    reference: str,
    *,
    resolution: float = 0.1,
    **options: Unpack[FitOptions],
) -> xr.Dataset:
    """Fit and tabulate against one reference or pool.

    Parameters
    ----------
    headings : Dataset
        Screened; what is marked is not learned from.
    reference : str
        Key of ``pools``.
    resolution : float, default 0.1
        Of the tables, degrees.
    **options
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.
    """
    members = list(pools[reference])
    part = headings.sel(reference=members)
    fits = fit_deviation(part, pools={reference: members}, alone=False, **options)
    attributes = fits.attrs
    fits = fits.sel(reference=[reference])
    fits.attrs = {**attributes, "reference_count": 1}
    return add_tables(fits, part, resolution=resolution)


def require_reference(pools: Mapping[str, list[str]], reference: str) -> None:
    """Refuse a reference or pool that is not known.

    Raises
    ------
    InputError
    """
    if reference not in pools:
        raise InputError(
            "no such reference or pool",
            field="reference",
            found=reference,
            remedy=f"Known: {', '.join(pools)}",
        )


def judged_blocks(headings: xr.Dataset) -> Iterator[tuple[xr.Dataset, slice]]:
    """Give blocks of aircraft with the columns a correction is judged by.

    Yields
    ------
    block : Dataset
    aircraft : slice
        Which aircraft it holds.
    """
    start = 0
    for block in blocks(headings, _JUDGED):
        stop = start + block.sizes["aircraft"]
        yield block, slice(start, stop)
        start = stop
