"""Parts of an archive: some reports only, and whole flights dealt into folds.

Assumes flights are numbered uniquely over the archive.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.ragged import aircraft_of_report
from airswing.vocabulary import SCREENING


def flight_folds(headings: xr.Dataset, *, folds: int, seed: int = 0) -> NDArray[np.int64]:
    """Deal whole flights into folds, evenly over each aircraft's days.

    Parameters
    ----------
    headings : Dataset
    folds : int
    seed : int, default 0

    Returns
    -------
    array of int, shape (report,)
        Fold of every report's flight.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds.
    """
    flight = headings["flight"].to_numpy()
    _, first, index = np.unique(flight, return_index=True, return_inverse=True)
    if folds < 2 or first.size < folds:
        raise InputError(
            "the flights cannot be dealt into that many folds",
            field="folds",
            found=f"{folds} folds, {first.size} flights",
            remedy="Two folds or more, and no more than there are flights",
        )
    rng = np.random.default_rng(seed)
    day = headings["time"].to_numpy()[first].astype("datetime64[D]").astype(np.int64)
    aircraft = aircraft_of_report(headings)[first]
    order = np.lexsort((rng.random(first.size), day, aircraft))
    number = np.empty(first.size, dtype=np.int64)
    # Each run of `folds` flights in the order of days gets every fold once, in a random order.
    runs = -(-first.size // folds)
    dealt = np.argsort(rng.random((runs, folds)), axis=1).ravel()[: first.size]
    number[order] = dealt
    return np.asarray(number[index])


def only(headings: xr.Dataset, chosen: NDArray[np.bool_]) -> xr.Dataset:
    """The same headings with all other reports marked so that no fit uses them.

    Parameters
    ----------
    headings : Dataset
    chosen : array of bool, shape (report,)

    Returns
    -------
    Dataset
        With the bit ``no_reference`` set elsewhere; for use inside an evaluation only.
    """
    screening = headings["screening"].to_numpy().copy()
    screening[~chosen] |= SCREENING["no_reference"]
    return headings.assign(screening=("report", screening))
