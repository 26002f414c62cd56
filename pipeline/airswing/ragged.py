"""Ragged reports: many aircraft end to end on one axis, and how to move to one row an aircraft.

Assumes the CF contiguous ragged form: reports of one aircraft stand together, in the order of
the ``aircraft`` dimension, and ``row_size`` counts them. Plain numpy; no I/O.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray


def row_bounds(row_size: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First report and one past the last report of every aircraft.

    Parameters
    ----------
    row_size : array of int, shape (aircraft,)
        Number of reports of each aircraft.

    Returns
    -------
    start, stop : arrays of int64, shape (aircraft,)
    """
    stop = np.cumsum(row_size, dtype=np.int64)
    return stop - np.asarray(row_size, dtype=np.int64), stop


def aircraft_of_report(ds: xr.Dataset) -> NDArray[np.int64]:
    """Index of the aircraft each report belongs to.

    Parameters
    ----------
    ds : Dataset
        With ``row_size`` (aircraft).

    Returns
    -------
    array of int64, shape (report,)
    """
    row_size = ds["row_size"].to_numpy()
    return np.repeat(np.arange(row_size.size, dtype=np.int64), row_size)


def padded(values: NDArray[Any], row_size: NDArray[Any], fill: float = np.nan) -> NDArray[Any]:
    """Lay ragged values out as one row an aircraft, padded at the end.

    Parameters
    ----------
    values : array, shape (report, ...)
    row_size : array of int, shape (aircraft,)
    fill : float, default NaN
        What stands past an aircraft's last report.

    Returns
    -------
    array, shape (aircraft, observation, ...)
        ``observation`` is as long as the longest row.
    """
    row_size = np.asarray(row_size)
    width = int(row_size.max(initial=0))
    dtype = np.result_type(values.dtype, np.asarray(fill).dtype if fill == fill else np.float32)
    rows = np.full((row_size.size, width, *values.shape[1:]), fill, dtype=dtype)
    rows[_filled(row_size, width)] = values
    return rows


def unpadded(rows: NDArray[Any], row_size: NDArray[Any]) -> NDArray[Any]:
    """Undo :func:`padded`.

    Parameters
    ----------
    rows : array, shape (aircraft, observation, ...)
    row_size : array of int, shape (aircraft,)

    Returns
    -------
    array, shape (report, ...)
    """
    return np.asarray(rows[_filled(np.asarray(row_size), rows.shape[1])])


def _filled(row_size: NDArray[Any], width: int) -> NDArray[np.bool_]:
    return np.asarray(np.arange(width)[np.newaxis, :] < row_size[:, np.newaxis])
