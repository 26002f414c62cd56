"""Standard error of a wind component, report by report, for formats that carry one.

Where ``observation_errors.nc`` stands beside the reports, the variance of a report's error is that
of its leg and layer, plus what its aircraft's differs from that of the legs and layers it flew,
plus what its correction is less certain of than the aircraft's others: half the square of
``corrected_wind_standard_error``, which is that of the vector. Where the aircraft's own error is
not known, the correction is held against those of its leg and layer. An aircraft whose compass is
hardly known so weighs less than one that is well known. No error falls below `LEAST`, nor below
half of its leg's and layer's; layers beyond those that are known have the nearest one's.

Where there is none, the error is that of WRFDA's own table for the type of report
(var/obsproc/obserr.txt of WRF 4.7, wind components, interpolated in pressure), and half the square
of the correction's own is added. The table is meant for winds as reported: it is generous for
corrected ones.

Assumes errors of the two components alike, and independent of the correction's.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PHASE
from airswing.handover.records.platforms import PLATFORMS
from airswing.handover.records.registry import Winds

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

PRODUCT = "observation_errors.nc"
BY_CELL, BY_AIRCRAFT = "observation_error_filled", "aircraft_observation_error"
LEAST = 0.5
"""m/s: what coding in whole knots and degrees alone leaves of a wind of 30 m/s is 0.4 m/s."""
LEAST_SHARE = 0.5  # Of its cell's error, that a report's own is at least
TAMDARS = (
    (150, 200, 350, 400, 450, 500, 600, 650, 750, 800, 850, 900),
    (3.6, 3.2, 3.2, 3.0, 3.0, 2.9, 2.9, 2.7, 2.7, 2.5, 2.5, 2.3),
)
"""hPa, m/s: where the table's steps begin and end; constant beyond."""
AIREPS = 3.6  # m/s, at all levels


def table_error(pressure: Array, platform: NDArray[np.int8]) -> Array:
    """Error of a wind component (m/s) by WRFDA's table, at pressures (Pa), by platform number.

    AMDAR and ACARS count as AIREPS, as WRFDA takes them.
    """
    tamdar = np.interp(pressure / 100.0, *TAMDARS)
    return np.where(platform == PLATFORMS.index("TAMDAR"), tamdar, AIREPS)


class WindErrors:
    """Errors of reports of one state of the wind.

    Parameters
    ----------
    known : Dataset, optional
        Of :func:`known_errors`.
    aircraft : sequence of str
        Names of all aircraft, as ``aircraft`` of the rows numbers them.
    """

    def __init__(self, known: xr.Dataset | None, winds: Winds, aircraft: Sequence[str]) -> None:
        self._corrected = winds == "corrected"
        self._cells: Array = np.full((len(PHASE), 1), np.nan)
        self._tops: Array = np.array([-np.inf])
        self._aircraft: Array = np.full(len(aircraft), np.nan)
        if known is not None:
            self._take(known.sel(state=winds), list(aircraft))
        self._own_of_cell = _Means(self._cells.size)
        self._own_of_aircraft = _Means(len(aircraft))
        self._cells_of_aircraft = _Means(len(aircraft))

    def _take(self, known: xr.Dataset, aircraft: list[str]) -> None:
        known = known.isel(layer=np.argsort(-known["layer_bottom_pressure"].to_numpy()))
        table = known[BY_CELL].transpose("flight_phase", "layer").to_pandas()
        # A phase without a profile of its own has that of all.
        rows = [name if name in table.index else "all" for name in PHASE]
        self._cells = np.square(table.loc[rows].to_numpy(dtype=np.float64))
        self._tops = known["layer_top_pressure"].to_numpy().astype(np.float64)
        own = known[BY_AIRCRAFT].to_series().reindex(aircraft).to_numpy(dtype=np.float64)
        self._aircraft = np.where(own > 0.0, own**2, np.nan)

    @property
    def source(self) -> str:
        """Where the errors come from: a product that knows none leaves WRFDA's own table."""
        return "WRFDA's own table" if np.isnan(self._cells).all() else PRODUCT

    def look(self, rows: NDArray[np.void]) -> None:
        """Take note of what each aircraft flew and of how certain corrections are.

        All rows have to come by before errors are asked for.
        """
        own, cell = _own(rows), self._cell(rows)
        self._own_of_cell.add(cell, own)
        self._own_of_aircraft.add(rows["aircraft"], own)
        self._cells_of_aircraft.add(rows["aircraft"], self._cells.ravel()[cell])

    def of(self, rows: NDArray[np.void], platform: NDArray[np.int8]) -> Array:
        """Error of a wind component of every report (m/s); platforms as numbers of `PLATFORMS`."""
        own, cell = _own(rows), self._cell(rows)
        base, aircraft = self._cells.ravel()[cell], self._aircraft[rows["aircraft"]]
        flown = self._cells_of_aircraft.of(rows["aircraft"])
        differs = np.nan_to_num(aircraft - flown)
        usual = np.where(
            np.isnan(aircraft),
            self._own_of_cell.of(cell),
            self._own_of_aircraft.of(rows["aircraft"]),
        )
        less_certain = np.nan_to_num(own - usual) if self._corrected else 0.0
        least = np.maximum(LEAST_SHARE**2 * base, LEAST**2)
        known = np.maximum(base + differs + less_certain, least)
        added = np.nan_to_num(own) if self._corrected else 0.0
        table = table_error(rows["pressure"], platform) ** 2 + added
        return np.asarray(np.sqrt(np.where(np.isnan(base), table, known)))

    def _cell(self, rows: NDArray[np.void]) -> NDArray[np.int64]:
        """Number of every report's leg and layer."""
        # Tops stand from the ground up: as many as are above the report's pressure lie
        # below it.
        layer = np.sum(rows["pressure"][:, np.newaxis] <= self._tops, axis=1)
        layer = np.minimum(layer, self._tops.size - 1)
        return np.asarray(rows["phase"] * np.int64(self._tops.size) + layer, dtype=np.int64)


class _Means:
    """Means by group of values that come in parts; those that are NaN do not count."""

    def __init__(self, groups: int) -> None:
        self._total, self._number = np.zeros(groups), np.zeros(groups)

    def add(self, group: NDArray[np.integer], values: Array) -> None:
        told, size = np.isfinite(values), self._total.size
        self._total += np.bincount(group[told], weights=values[told], minlength=size)
        self._number += np.bincount(group[told], minlength=size)

    def of(self, group: NDArray[np.integer]) -> Array:
        with np.errstate(invalid="ignore"):
            return np.asarray((self._total / self._number)[group])


def _own(rows: NDArray[np.void]) -> Array:
    """Half the square of what the correction left uncertain, (m/s)2; NaN where that is not told."""
    return np.asarray(rows["error"].astype(np.float64) ** 2 / 2.0)


def known_errors(folder: Path | None) -> xr.Dataset | None:
    """``observation_errors.nc`` of a run's folder, by leg and layer; None where there is none.

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
    for name in (BY_CELL, BY_AIRCRAFT, "layer_bottom_pressure", "layer_top_pressure"):
        if name not in ds.variables:
            raise InputError(
                "does not tell the errors of reports by leg and layer",
                file=path,
                field=name,
                remedy="Make it again, or move it away to use WRFDA's own table",
            )
    return ds
