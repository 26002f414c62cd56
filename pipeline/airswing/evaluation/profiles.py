"""Error profiles: wind and direction error by phase of flight and level, before and after.

Assumes the reference is the truth to within its own error, so the profiles hold both errors
together. Levels are layers of pressure altitude. Standard errors are clustered by flight: the
reports of one flight share the model's error.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import reference_mean
from airswing.vocabulary import PHASE, SCREENING

STATES = ("reported", "corrected")
LEVEL_EDGES_HPA = (1100.0, 900.0, 800.0, 700.0, 600.0, 500.0, 400.0, 300.0, 200.0)
"""Edges of the layers, hPa, from the ground up (those of the WRFDA error table, merged)."""
_UNUSABLE = ("no_reference", "missing_wind", "wind_qc", "gross_error", "no_ground_vector")
MIN_DIRECTION_WIND = 5.0
"""Reference wind, m/s, below which a direction says little."""


def clustered_rms(
    squares: NDArray[np.float64], cell: NDArray[np.int64], flight: NDArray[np.int64], cells: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Root mean square by cell, with a standard error clustered by flight.

    Parameters
    ----------
    squares : array of float, shape (report,)
        Squared errors.
    cell : array of int, shape (report,)
        Cell of each report, below ``cells``.
    flight : array of int, shape (report,)
    cells : int

    Returns
    -------
    rms, standard_error : arrays of float, shape (cells,)
        The standard error is NaN with fewer than two flights. Delta method on the ratio of sums
        over flights (Cameron & Miller 2015, J. Hum. Resour. 50, 317-372).
    reports, flights : arrays of int, shape (cells,)
    """
    good = np.isfinite(squares) & (cell >= 0)
    squares, cell, flight = squares[good], cell[good], flight[good]
    number = np.bincount(cell, minlength=cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell, weights=squares, minlength=cells) / number
    pairs, index = np.unique(np.column_stack([cell, flight]), axis=0, return_inverse=True)
    score = np.bincount(index.ravel(), weights=squares - mean[cell], minlength=len(pairs))
    of_cell = pairs[:, 0].astype(np.int64)
    flights = np.bincount(of_cell, minlength=cells)
    spread = np.bincount(of_cell, weights=score**2, minlength=cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = spread / number**2 * flights / (flights - 1.0)
        rms = np.sqrt(mean)
        error = np.where(flights >= 2, np.sqrt(variance) / (2.0 * rms), np.nan)
    return rms, error, number, flights


def error_profiles(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> xr.Dataset:
    """Profile the wind error by phase of flight and layer, as reported and as corrected.

    Parameters
    ----------
    headings : Dataset
        Screened headings (``report``).
    corrected : Dataset
        Corrected winds of the same reports.
    pools : mapping of str to list of str
        Members of each reference and pool.

    Returns
    -------
    Dataset
        ``eastward_rms``, ``northward_rms``, ``direction_rms`` with ``*_standard_error``
        (reference, state, flight_phase, layer), ``profile_count`` and ``profile_flights``.
    """
    bits = sum(SCREENING[name] for name in _UNUSABLE)
    usable = (headings["screening"].to_numpy() & bits) == 0
    layers = len(LEVEL_EDGES_HPA) - 1
    # Level falls as pressure rises: digitize on the negated edges.
    layer = np.digitize(-headings["pressure"].to_numpy() / 100.0, -np.array(LEVEL_EDGES_HPA)) - 1
    phase = headings["phase"].to_numpy().astype(np.int64)
    cell = np.where(usable & (layer >= 0) & (layer < layers), phase * layers + layer, -1)
    flight = headings["flight"].to_numpy().astype(np.int64)
    winds = {
        "reported": ("eastward_wind", "northward_wind"),
        "corrected": ("corrected_eastward_wind", "corrected_northward_wind"),
    }
    shape = (len(pools), len(STATES), len(PHASE), layers)
    found = _empty(shape)
    for i, members in enumerate(pools.values()):
        model = reference_mean(headings, members)
        reference = (
            model["reference_eastward_wind"].to_numpy(),
            model["reference_northward_wind"].to_numpy(),
        )
        for j, state in enumerate(STATES):
            source = headings if state == "reported" else corrected
            wind = tuple(source[name].to_numpy() for name in winds[state])
            for name, squares in _squares(wind, reference).items():
                rms, error, number, flights = clustered_rms(
                    squares, cell, flight, len(PHASE) * layers
                )
                found[f"{name}_rms"][i, j] = rms.reshape(shape[2:])
                found[f"{name}_rms_standard_error"][i, j] = error.reshape(shape[2:])
                if name == "eastward":
                    found["profile_count"][i, j] = number.reshape(shape[2:])
                    found["profile_flights"][i, j] = flights.reshape(shape[2:])
    dims = ("reference", "state", "flight_phase", "layer")
    edges = np.array(LEVEL_EDGES_HPA) * 100.0
    return xr.Dataset(
        {name: (dims, values) for name, values in found.items()}
        | {
            "layer_bottom_pressure": ("layer", edges[:-1]),
            "layer_top_pressure": ("layer", edges[1:]),
        },
        coords={"reference": list(pools), "state": list(STATES), "flight_phase": list(PHASE)},
    )


def _squares(wind: tuple[Any, ...], reference: tuple[Any, ...]) -> dict[str, Any]:
    """Squared errors of the components and, in degrees, of the direction."""
    (u, v), (u_ref, v_ref) = wind, reference
    turned = np.arctan2(u * v_ref - v * u_ref, u * u_ref + v * v_ref)
    weak = np.hypot(u_ref, v_ref) < MIN_DIRECTION_WIND
    return {
        "eastward": np.asarray((u - u_ref) ** 2, dtype=np.float64),
        "northward": np.asarray((v - v_ref) ** 2, dtype=np.float64),
        "direction": np.where(weak, np.nan, np.degrees(turned) ** 2).astype(np.float64),
    }


def _empty(shape: tuple[int, ...]) -> dict[str, NDArray[Any]]:
    names = [f"{name}_rms" for name in ("eastward", "northward", "direction")]
    found: dict[str, NDArray[Any]] = {}
    for name in names:
        found[name] = np.full(shape, np.nan)
        found[f"{name}_standard_error"] = np.full(shape, np.nan)
    found["profile_count"] = np.zeros(shape, dtype=np.int32)
    found["profile_flights"] = np.zeros(shape, dtype=np.int32)
    return found
