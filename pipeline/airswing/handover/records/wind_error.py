"""Standard error of a wind component, report by report, for formats that carry one.

Where ``observation_errors.nc`` stands beside the reports, the error is that of the report's leg and
layer (`VARIABLE` by ``state``, ``flight_phase`` and ``layer``): of corrected winds it holds what
the corrections leave uncertain on the average, so half the square of a report's own
``corrected_wind_standard_error`` (that of the vector) replaces the cell's mean of it. An aircraft
whose compass is hardly known so weighs less than one that is well known.

Where there is none, or the cell is empty, the error is that of WRFDA's own table for the type of
report (var/obsproc/obserr.txt of WRF 4.7, wind components, interpolated in pressure), and half the
square of the report's own is added. The table is meant for winds as reported: it is generous for
corrected ones.

Assumes errors of the two components alike, and independent of the correction's.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.records.platforms import PLATFORMS
from airswing.handover.records.registry import Winds

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

PRODUCT, VARIABLE = "observation_errors.nc", "wind_component_error"
LEAST_SHARE = 0.5
"""Of its cell's error, that a report's own is at least."""
TAMDARS = (
    (150, 200, 350, 400, 450, 500, 600, 650, 750, 800, 850, 900),
    (3.6, 3.2, 3.2, 3.0, 3.0, 2.9, 2.9, 2.7, 2.7, 2.5, 2.5, 2.3),
)
"""hPa, m/s: where the table's steps begin and end; constant beyond."""
AIREPS = 3.6
"""m/s, at all levels."""


def table_error(pressure: Array, platform: NDArray[np.int8]) -> Array:
    """Error of a wind component by WRFDA's table.

    Parameters
    ----------
    pressure : array, shape (n,)
        Pa.
    platform : array of int8, shape (n,)
        Numbers of `PLATFORMS`; AMDAR and ACARS count as AIREPS, as WRFDA takes them.

    Returns
    -------
    array, shape (n,)
        m/s.
    """
    tamdar = np.interp(pressure / 100.0, *TAMDARS)
    return np.where(platform == PLATFORMS.index("TAMDAR"), tamdar, AIREPS)


class WindErrors:
    """Errors of reports of one state of the wind.

    Parameters
    ----------
    known : Dataset, optional
        Of :func:`known_errors`.
    winds : {"corrected", "reported"}
    """

    def __init__(self, known: xr.Dataset | None, winds: Winds) -> None:
        self._corrected = winds == "corrected"
        self._cells = np.full((len(PHASE), 1), np.nan)
        self._bottom = self._top = np.array([np.nan])
        if known is not None:
            phases = [str(name) for name in known["flight_phase"].to_numpy()]
            table = known[VARIABLE].sel(state=winds).transpose("flight_phase", "layer").to_numpy()
            self._bottom = known["layer_bottom_pressure"].to_numpy().astype(np.float64)
            self._top = known["layer_top_pressure"].to_numpy().astype(np.float64)
            self._cells = np.full((len(PHASE), table.shape[1]), np.nan)
            for name, code in PHASE.items():
                if name in phases:
                    self._cells[code] = table[phases.index(name)]
        self._sum = np.zeros((2, *self._cells.shape))

    def look(self, rows: NDArray[np.void]) -> None:
        """Take note of what the corrections leave uncertain on the average.

        Parameters
        ----------
        rows : array of :data:`airswing.handover.records.eligible.ROW`
            All reports have to come by before errors are asked for.
        """
        own = _own(rows)
        phase, layer, inside = self._cell(rows)
        told = inside & np.isfinite(rows["error"])
        np.add.at(self._sum[0], (phase[told], layer[told]), own[told])
        np.add.at(self._sum[1], (phase[told], layer[told]), 1.0)

    def of(self, rows: NDArray[np.void], platform: NDArray[np.int8]) -> Array:
        """Error of a wind component of every report.

        Parameters
        ----------
        rows : array of :data:`airswing.handover.records.eligible.ROW`
        platform : array of int8, shape (n,)
            Numbers of `PLATFORMS`.

        Returns
        -------
        array, shape (n,)
            m/s.
        """
        table = table_error(rows["pressure"], platform)
        phase, layer, inside = self._cell(rows)
        cell = np.where(inside, self._cells[phase, layer], np.nan)
        mean = (self._sum[0] / np.maximum(self._sum[1], 1.0))[phase, layer]
        own = np.where(np.isfinite(rows["error"]), _own(rows), np.where(np.isnan(cell), 0.0, mean))
        if not self._corrected:
            return np.where(np.isnan(cell), table, cell)
        told = np.maximum(cell**2 - mean + own, (LEAST_SHARE * cell) ** 2)
        return np.asarray(np.sqrt(np.where(np.isnan(cell), table**2 + own, told)))

    def _cell(self, rows: NDArray[np.void]) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
        """Phase and layer of every report, and whether it is in a layer."""
        pressure = rows["pressure"][:, np.newaxis]
        within = (pressure <= self._bottom) & (pressure > self._top)
        inside: NDArray[np.bool_] = np.any(within, axis=1)
        return rows["phase"], np.argmax(within, axis=1), inside


def _own(rows: NDArray[np.void]) -> Array:
    """Half the square of what the correction left uncertain, (m/s)2; NaN where that is not told."""
    return np.asarray(rows["error"].astype(np.float64) ** 2 / 2.0)


def known_errors(folder: Path | None) -> xr.Dataset | None:
    """Errors by leg and layer that an earlier stage wrote.

    Parameters
    ----------
    folder : Path or None
        Of the run's products.

    Returns
    -------
    Dataset or None
        ``observation_errors.nc``; None where there is none.

    Raises
    ------
    InputError
        If the product is another's.
    """
    path = None if folder is None else folder / PRODUCT
    if path is None or not path.exists():
        return None
    from airswing.products.netcdf import read_product

    ds = read_product(path)
    for name in (VARIABLE, "state", "flight_phase", "layer_bottom_pressure", "layer_top_pressure"):
        if name not in ds.variables:
            raise InputError(
                "does not tell the errors of reports by leg and layer", file=path, field=name,
                remedy="Make it again, or move it away to use WRFDA's own table",
            )  # fmt: skip
    return ds
