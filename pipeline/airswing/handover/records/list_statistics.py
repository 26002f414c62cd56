"""The statistics a reject list is kept by, of reported and of corrected winds, by aircraft.

Assumes screened reports with model winds (``headings.nc``) and their correction, in the same order.
Differences are report minus reference: of speed (``S``, m/s), of direction (``DIR``, degrees,
wrapped, where the reference blows 5 m/s or more), and the length of the vector difference (``W``,
m/s). ``bias`` is a mean, ``std`` a standard deviation about it, ``rms`` a root mean square. The
same reports count for both states: those that could be corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.error_profiles import MIN_DIRECTION_WIND, STATES, profile_cells
from airswing.flags import CORRECTION
from airswing.products.ragged import aircraft_of_report, blocks

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
_WINDS = ("eastward_wind", "northward_wind")
_NEEDED = (
    *_WINDS,
    "reference_eastward_wind",
    "reference_northward_wind",
    "pressure",
    "phase",
    "screening",
)
_APPLIED = (CORRECTION["corrected"], CORRECTION["already_corrected"])


def list_statistics(
    headings: xr.Dataset, corrected: xr.Dataset, members: Sequence[str]
) -> dict[str, Floats]:
    """Statistics of every aircraft; reports are held against the mean of the ``members``.

    Returns
    -------
    dict of str to array
        ``number`` (aircraft,): reports that count, ``usable`` (aircraft,): reports whose wind could
        be used were it right; by name of the criterion (state, aircraft).
    """
    parts: list[dict[str, Floats]] = []
    mended = blocks(corrected, [*(f"corrected_{name}" for name in _WINDS), "correction_applied"])
    for block, better in zip(blocks(headings, list(_NEEDED)), mended, strict=True):
        parts.append(_of_block(block, better, list(members)))
    return {name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]}


def _of_block(block: xr.Dataset, better: xr.Dataset, members: list[str]) -> dict[str, Floats]:
    """Statistics of the aircraft of a block."""
    cell, _ = profile_cells(block)
    model = reference_mean(block, members)
    u_ref, v_ref = (model[f"reference_{name}"].to_numpy() for name in _WINDS)
    winds = {
        "reported": [block[name].to_numpy() for name in _WINDS],
        "corrected": [better[f"corrected_{name}"].to_numpy() for name in _WINDS],
    }
    applied = np.isin(better["correction_applied"].to_numpy(), _APPLIED)
    usable = (cell >= 0) & np.isfinite(u_ref) & np.isfinite(winds["reported"][0])
    good = usable & applied & np.isfinite(winds["corrected"][0])
    row, size = aircraft_of_report(block), block.sizes["aircraft"]
    found: dict[str, list[Floats]] = {}
    for state in STATES:
        u, v = (part[good] for part in winds[state])
        one = _criteria(u, v, u_ref[good], v_ref[good], row[good], size)
        for name, values in one.items():
            found.setdefault(name, []).append(values)
    table = {name: np.array(values) for name, values in found.items()}
    number = np.bincount(row[good], minlength=size).astype(np.float64)
    return table | {
        "number": number,
        "usable": np.bincount(row[usable], minlength=size).astype(np.float64),
    }


def _criteria(
    u: Floats, v: Floats, u_ref: Floats, v_ref: Floats, row: NDArray[np.int64], size: int
) -> dict[str, Floats]:
    """Criteria of one state of the wind by aircraft; NaN without reports."""
    speed = np.hypot(u, v) - np.hypot(u_ref, v_ref)
    # Directions turn clockwise: from where the reference blows to where the report does.
    turned = np.degrees(np.arctan2(u * v_ref - v * u_ref, u * u_ref + v * v_ref))
    turned = np.where(np.hypot(u_ref, v_ref) >= MIN_DIRECTION_WIND, turned, np.nan)
    length = np.hypot(u - u_ref, v - v_ref)
    found: dict[str, Floats] = {}
    for name, values in (("S", speed), ("DIR", turned), ("W", length)):
        told = np.isfinite(values)
        number = np.bincount(row[told], minlength=size)
        kept = np.where(told, values, 0.0).astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.bincount(row, weights=kept, minlength=size) / number
            square = np.bincount(row, weights=kept**2, minlength=size) / number
        found[f"bias_{name}"] = mean
        found[f"std_{name}"] = np.sqrt(np.maximum(square - mean**2, 0.0))
        found[f"rms_{name}"] = np.sqrt(square)
    return found
