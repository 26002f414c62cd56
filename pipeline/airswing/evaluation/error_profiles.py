"""Error profiles: rms wind and direction error by phase of flight and level.

Assumes that the reference is the truth to within its own error, so that the profiles contain the
errors of both. Levels are layers of pressure. Standard errors are clustered by flight: the reports
of one flight have the model's error in common.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import innovations, reference_mean
from airswing.evaluation.resampling import SUMS, cluster_sums, clustered_mean
from airswing.flags import PHASE, SCREENING
from airswing.products.ragged import blocks

STATES = ("reported", "corrected")
LEVEL_EDGES_HPA = (1100.0, 900.0, 800.0, 700.0, 600.0, 500.0, 400.0, 300.0, 200.0)
"""Edges of the layers from the ground up (those of the error table of WRFDA, merged)."""
CELLS = len(PHASE) * (len(LEVEL_EDGES_HPA) - 1)
"""Phases of flight times layers."""
QUANTITIES = ("eastward", "northward", "direction")
_UNUSABLE = ("no_reference", "missing_wind", "wind_qc", "gross_error", "no_ground_vector")
_WINDS = ("eastward_wind", "northward_wind", "reference_eastward_wind", "reference_northward_wind")
_CORRECTED = ("corrected_eastward_wind", "corrected_northward_wind")


def error_profiles(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> xr.Dataset:
    """Profile the wind error by phase of flight and layer, as reported and as corrected.

    Parameters
    ----------
    headings : Dataset
        Screened headings (``report``), in memory or lazy.
    corrected : Dataset
        Corrected winds of the same reports.
    pools : mapping of str to list of str
        Members of each reference and pool.

    Returns
    -------
    Dataset
        ``eastward_rms``, ``northward_rms`` (m/s), ``direction_rms`` (degrees) with
        ``*_standard_error`` (reference, state, flight_phase, layer), ``profile_count`` and
        ``profile_flights``.
    """
    shape = (len(pools), len(STATES), len(QUANTITIES))
    sums = np.zeros((*shape, SUMS, CELLS))
    names = (*_WINDS, "pressure", "phase", "flight", "screening")
    for block, better in zip(blocks(headings, names), blocks(corrected, _CORRECTED), strict=True):
        cell, _ = profile_cells(block)
        flight = block["flight"].to_numpy().astype(np.int64)
        for i, members in enumerate(pools.values()):
            model = [reference_mean(block, members)[name].to_numpy() for name in _WINDS[2:]]
            for j, (source, pair) in enumerate(((block, _WINDS[:2]), (better, _CORRECTED))):
                found = innovations(*(source[name].to_numpy() for name in pair), *model)
                for k, name in enumerate(QUANTITIES):
                    good = np.isfinite(found[name]) & (cell >= 0)
                    sums[i, j, k] += cluster_sums(
                        found[name][good] ** 2, cell[good], flight[good], CELLS
                    )
    mean, error = clustered_mean(np.moveaxis(sums, 3, 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(mean)
        error = error / (2.0 * rms)  # the delta method
    dims = ("reference", "state", "flight_phase", "layer")
    cells = (len(PHASE), len(LEVEL_EDGES_HPA) - 1)
    edges = np.array(LEVEL_EDGES_HPA) * 100.0
    ds = xr.Dataset(
        {
            "layer_bottom_pressure": ("layer", edges[:-1]),
            "layer_top_pressure": ("layer", edges[1:]),
        },
        coords={"reference": list(pools), "state": list(STATES), "flight_phase": list(PHASE)},
    )
    for k, name in enumerate(QUANTITIES):
        ds[f"{name}_rms"] = dims, rms[:, :, k].reshape(*shape[:2], *cells)
        ds[f"{name}_rms_standard_error"] = dims, error[:, :, k].reshape(*shape[:2], *cells)
    for name, place in (("profile_count", 0), ("profile_flights", 2)):
        ds[name] = dims, sums[:, :, 0, place].reshape(*shape[:2], *cells).astype(np.int32)
    return ds


def profile_cells(headings: xr.Dataset) -> tuple[NDArray[np.int64], int]:
    """Phase and layer of every report as one number, -1 where it does not count.

    Parameters
    ----------
    headings : Dataset
        With ``pressure`` (Pa), ``phase`` and ``screening``.

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
    # the level falls as the pressure rises: digitize on the negated edges
    layer = np.digitize(-headings["pressure"].to_numpy() / 100.0, -np.array(LEVEL_EDGES_HPA)) - 1
    phase = headings["phase"].to_numpy().astype(np.int64)
    cell = np.where(usable & (layer >= 0) & (layer < layers), phase * layers + layer, -1)
    return np.asarray(cell, dtype=np.int64), CELLS
