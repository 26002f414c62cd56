"""Error profiles: wind and direction error by phase of flight and level, before and after.

Assumes the reference is the truth to within its own error, so the profiles hold both errors
together. Levels are layers of pressure altitude. Standard errors are clustered by flight: the
reports of one flight share the model's error.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.resampling import SUMS, cluster_sums, clustered_mean
from airswing.flags import PHASE, SCREENING
from airswing.products.ragged import aircraft_of_report, blocks

STATES = ("reported", "corrected")
# Edges of the layers, hPa, from the ground up (those of the WRFDA error table, merged).
LEVEL_EDGES_HPA = (1100.0, 900.0, 800.0, 700.0, 600.0, 500.0, 400.0, 300.0, 200.0)
CELLS = len(PHASE) * (len(LEVEL_EDGES_HPA) - 1)  # Phases of flight times layers
_UNUSABLE = ("no_reference", "missing_wind", "wind_qc", "gross_error", "no_ground_vector")
_COLUMNS = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "pressure",
    "phase",
    "flight",
    "screening",
)
MIN_DIRECTION_WIND = 5.0  # Reference wind, m/s, below which a direction says little


def _cell_sums(
    squares: NDArray[np.float64], cell: NDArray[np.int64], flight: NDArray[np.int64], cells: int
) -> NDArray[np.float64]:
    good = np.isfinite(squares) & (cell >= 0)
    return cluster_sums(squares[good], cell[good], flight[good], cells)


def _rms(
    sums: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Root mean square and its standard error (delta method), reports and flights."""
    mean, error = clustered_mean(sums)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(mean)
        wide = error / (2.0 * rms)
    return rms, wide, sums[0].astype(np.int64), sums[2].astype(np.int64)


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
    layers = len(LEVEL_EDGES_HPA) - 1
    found = _empty((len(pools), len(STATES), len(PHASE), layers))
    parts: dict[tuple[int, int, str], list[NDArray[np.float64]]] = {}
    mended = blocks(corrected, ["corrected_eastward_wind", "corrected_northward_wind"])
    for block, better in zip(blocks(headings, _COLUMNS), mended, strict=True):
        for key, sums in _block_sums(block, better, pools).items():
            parts.setdefault(key, []).append(sums)
    for (i, j, name), part in parts.items():
        rms, error, number, flights = _rms(np.concatenate(part, axis=1).sum(axis=1))
        shape = (len(PHASE), layers)
        found[f"{name}_rms"][i, j] = rms.reshape(shape)
        found[f"{name}_rms_standard_error"][i, j] = error.reshape(shape)
        if name == "eastward":
            found["profile_count"][i, j] = number.reshape(shape)
            found["profile_flights"][i, j] = flights.reshape(shape)
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


def _block_sums(
    headings: xr.Dataset, corrected: xr.Dataset, pools: Mapping[str, list[str]]
) -> dict[tuple[int, int, str], NDArray[np.float64]]:
    """Sums of each aircraft of a block, by pool, state and error: (6, aircraft, cell)."""
    cell, cells = profile_cells(headings)
    flight = headings["flight"].to_numpy().astype(np.int64)
    row, size = aircraft_of_report(headings), headings.sizes["aircraft"]
    inside = np.where(cell >= 0, row * cells + cell, -1)
    winds = {
        "reported": (headings, "eastward_wind", "northward_wind"),
        "corrected": (corrected, "corrected_eastward_wind", "corrected_northward_wind"),
    }
    found = {}
    for i, members in enumerate(pools.values()):
        model = reference_mean(headings, members)
        reference = (
            model["reference_eastward_wind"].to_numpy(),
            model["reference_northward_wind"].to_numpy(),
        )
        for j, state in enumerate(STATES):
            source, *names = winds[state]
            wind = tuple(source[name].to_numpy() for name in names)
            for name, squares in _squares(wind, reference).items():
                sums = _cell_sums(squares, inside, flight, size * cells)
                found[i, j, name] = sums.reshape(SUMS, size, cells)
    return found


def profile_cells(headings: xr.Dataset) -> tuple[NDArray[np.int64], int]:
    """Phase and layer of every report as one number, -1 where it does not count.

    Returns
    -------
    array of int, shape (report,)
        Phase times the number of layers, plus the layer from the ground up.
    int
        Number of cells.
    """
    bits = sum(SCREENING[name] for name in _UNUSABLE)
    usable = (headings["screening"].to_numpy() & bits) == 0
    layers = len(LEVEL_EDGES_HPA) - 1
    # Level falls as pressure rises: digitize on the negated edges.
    layer = np.digitize(-headings["pressure"].to_numpy() / 100.0, -np.array(LEVEL_EDGES_HPA)) - 1
    phase = headings["phase"].to_numpy().astype(np.int64)
    cell = np.where(usable & (layer >= 0) & (layer < layers), phase * layers + layer, -1)
    return np.asarray(cell, dtype=np.int64), CELLS


def _squares(
    wind: tuple[NDArray[np.float64], ...], reference: tuple[NDArray[np.float64], ...]
) -> dict[str, NDArray[np.float64]]:
    """Squared errors of the components and, in degrees, of the direction."""
    (u, v), (u_ref, v_ref) = wind, reference
    turned = np.arctan2(u * v_ref - v * u_ref, u * u_ref + v * v_ref)
    weak = np.hypot(u_ref, v_ref) < MIN_DIRECTION_WIND
    return {
        "eastward": np.asarray((u - u_ref) ** 2, dtype=np.float64),
        "northward": np.asarray((v - v_ref) ** 2, dtype=np.float64),
        "direction": np.where(weak, np.nan, np.degrees(turned) ** 2).astype(np.float64),
    }


def _empty(shape: tuple[int, ...]) -> dict[str, NDArray[np.generic]]:
    names = [f"{name}_rms" for name in ("eastward", "northward", "direction")]
    found: dict[str, NDArray[np.generic]] = {}
    for name in names:
        found[name] = np.full(shape, np.nan)
        found[f"{name}_standard_error"] = np.full(shape, np.nan)
    found["profile_count"] = np.zeros(shape, dtype=np.int32)
    found["profile_flights"] = np.zeros(shape, dtype=np.int32)
    return found
