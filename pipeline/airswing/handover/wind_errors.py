"""Standard error of a wind component, report by report: one rule for every export.

Where the run has ``observation_errors.nc``, the error variance of a report is

    base(phase, layer) + [variance of its aircraft - mean base of the reports of that aircraft]
    + [q - mean q],   q = half the square of ``corrected_wind_standard_error``

where the mean of q is over the reports of the aircraft; over the phase and layer where the variance
of the aircraft is unknown. No variance falls below a quarter of its base, nor an error below
`LEAST`. Without the product the error is that of WRFDA's table for the type of report, with q added
for corrected winds. Assumes equal errors of both components.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.observation_errors import USED
from airswing.flags import PHASE
from airswing.handover.selection import ERRORS, PLATFORMS, Request, Rows, platforms, product_of_run

Array = NDArray[np.float64]

BASE, BY_AIRCRAFT = "observation_error_filled", "aircraft_observation_error"
LEAST = 0.5  # m/s: coding in whole knots and degrees causes 0.4 m/s at a wind of 30 m/s
LEAST_SHARE = 0.25  # least variance of a report as a share of the base variance


def known_errors(request: Request, *, required: bool = True) -> xr.Dataset:
    """``observation_errors.nc`` of the run, for the winds to export.

    InputError if it is absent or another product, or ``required`` and without any known error.
    """
    why = "it holds the errors to write"
    with product_of_run(request, "observation_errors", why=why) as product:
        errors = product.load()
    for name in (BASE, BY_AIRCRAFT, "layer_bottom_pressure", "layer_top_pressure"):
        if name not in errors.variables:
            raise InputError(
                "does not hold the errors of reports by phase and layer",
                file=(request.products or request.path) / ERRORS,
                field=name,
                remedy="Make it again, or move it away to use WRFDA's table",
            )
    selected = errors.sel(state=request.winds).sortby("layer_bottom_pressure", ascending=False)
    if required and not np.isfinite(selected[BASE]).any():
        raise InputError(
            "no error of the reports is known",
            field="observation_error",
            found=errors.attrs.get("method_reason"),
            remedy="Two references or neighbouring aircraft are needed on several days",
        )
    return selected


def base_variance(errors: xr.Dataset, phase: str) -> Array:
    """Base variance (layer,) of a phase, (m/s)2, layers from the ground upwards."""
    names = [str(name) for name in errors["flight_phase"].to_numpy()]
    base = errors[BASE].sel(flight_phase=phase if phase in names else "all").to_numpy()
    return np.square(base.astype(np.float64))


def table_error(pressure: Array, platform: NDArray[np.int8]) -> Array:
    """Error of a component in WRFDA's table (m/s), at pressures (Pa), by index of `PLATFORMS`."""
    tamdar, airep = (
        np.interp(pressure / 100.0, *USED[name]) for name in ("wrfda_tamdar", "wrfda_airep")
    )
    # WRFDA takes AMDAR and ACARS for AIREP
    return np.where(platform == PLATFORMS.index("TAMDAR"), tamdar, airep)


class WindErrors:
    """Error of every report of an archive, from all rows exported and :func:`known_errors`."""

    def __init__(self, request: Request, rows: Rows, errors: xr.Dataset | None) -> None:
        names = request.aircraft
        self._corrected = request.winds == "corrected"
        self._platform = platforms(request)
        self._base: Array = np.full((len(PHASE), 1), np.nan)
        self._tops: Array = np.array([-np.inf])
        self._aircraft: Array = np.full(len(names), np.nan)  # variance of each
        if errors is not None:
            self._base = np.stack([base_variance(errors, phase) for phase in PHASE])
            self._tops = errors["layer_top_pressure"].to_numpy().astype(np.float64)
            by_name = errors[BY_AIRCRAFT].to_series().reindex(names)
            self._aircraft = np.square(by_name.to_numpy(dtype=np.float64))
        self.source = "WRFDA's table" if np.isnan(self._base).all() else ERRORS
        cell = self._cell(rows)
        table = pd.DataFrame({"q": rows["error"] ** 2 / 2.0, "base": self._base.ravel()[cell]})
        by_aircraft = table.groupby(rows["aircraft"]).mean().reindex(range(len(names)))
        by_cell = table.groupby(cell)["q"].mean().reindex(range(self._base.size))
        self._q_of_aircraft, self._q_of_cell = by_aircraft["q"].to_numpy(), by_cell.to_numpy()
        # Variance of each aircraft beyond the base of its reports, (m/s)2; NaN where unknown.
        self.aircraft_excess: Array = self._aircraft - by_aircraft["base"].to_numpy()

    def of(self, rows: Rows) -> Array:
        """Error of a wind component of every report, m/s."""
        cell, aircraft = self._cell(rows), rows["aircraft"]
        base, q = self._base.ravel()[cell], rows["error"] ** 2 / 2.0
        excess = self.aircraft_excess[aircraft]
        table = table_error(rows["pressure"], self._platform[aircraft]) ** 2
        if self._corrected:
            table = table + np.nan_to_num(q)
            unknown = np.isnan(self._aircraft[aircraft])
            mean = np.where(unknown, self._q_of_cell[cell], self._q_of_aircraft[aircraft])
            excess = np.nan_to_num(excess) + np.nan_to_num(q - mean)
        return np.asarray(np.sqrt(np.where(np.isnan(base), table, bounded(base, excess))))

    def _cell(self, rows: Rows) -> NDArray[np.int64]:
        # The index of the layer is the number of layer tops at or below the report.
        layer = np.sum(rows["pressure"][:, np.newaxis] <= self._tops, axis=1)
        layer = np.minimum(layer, self._tops.size - 1)
        return np.asarray(rows["phase"] * np.int64(self._tops.size) + layer, dtype=np.int64)


def bounded(base: Array, excess: Array | float) -> Array:
    """Variance from its base and an excess (0 where NaN), not below the least, (m/s)2."""
    least = np.maximum(LEAST_SHARE * base, LEAST**2)
    return np.maximum(base + np.nan_to_num(excess), least)
