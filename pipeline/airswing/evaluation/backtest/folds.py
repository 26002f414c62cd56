"""Parts of an archive: some reports only, and whole flights dealt into folds.

Assumes flights are numbered uniquely over the archive. Neither reads more than a block of aircraft
at a time: what is left out is marked when it is looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from airswing.errors import InputError
from airswing.flags import SCREENING
from airswing.products.ragged import blocks, row_bounds

# From some reports (their columns and ``aircraft_number``) to whether each is chosen.
Choice = Callable[[xr.Dataset], NDArray[np.bool_]]


@dataclass(frozen=True)
class Folds:
    """The fold of every flight."""

    flight: NDArray[np.int64]  # (flight,): increasing
    number: NDArray[np.int64]  # (flight,): its fold

    def of(self, reports: xr.Dataset) -> NDArray[np.int64]:
        """Fold of every report's flight."""
        return np.asarray(self.number[np.searchsorted(self.flight, reports["flight"].to_numpy())])


def flight_folds(headings: xr.Dataset, *, folds: int, seed: int = 0) -> Folds:
    """Deal whole flights into folds, evenly over each aircraft's days.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds.
    """
    flight, day, aircraft = _flights(headings)
    if folds < 2 or flight.size < folds:
        raise InputError(
            "the flights cannot be dealt into that many folds",
            field="folds",
            found=f"{folds} folds, {flight.size} flights",
            remedy="Two folds or more, and no more than there are flights",
        )
    rng = np.random.default_rng(seed)
    order = np.lexsort((rng.random(flight.size), day, aircraft))
    number = np.empty(flight.size, dtype=np.int64)
    # Each run of `folds` flights in the order of days gets every fold once, in a random order.
    runs = -(-flight.size // folds)
    dealt = np.argsort(rng.random((runs, folds)), axis=1).ravel()[: flight.size]
    number[order] = dealt
    return Folds(flight, number)


def _flights(
    headings: xr.Dataset,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Every flight, the day of its first report and its aircraft, flights increasing."""
    parts, aircraft = [], 0
    for block in blocks(headings, ["flight", "time"]):
        flight, first = np.unique(block["flight"].to_numpy(), return_index=True)
        day = block["time"].to_numpy()[first].astype("datetime64[D]").astype(np.int64)
        stop = row_bounds(block["row_size"].to_numpy())[1]
        parts.append([flight, day, aircraft + np.searchsorted(stop, first, side="right")])
        aircraft += block.sizes["aircraft"]
    columns = [np.concatenate(column).astype(np.int64) for column in zip(*parts, strict=True)]
    # stable: rows of one group keep their order, so that their sums are the same bit for bit
    order = np.argsort(columns[0], kind="stable")
    return columns[0][order], columns[1][order], columns[2][order]


def only(
    headings: xr.Dataset, chosen: Choice, *, columns: tuple[str, ...] = ("time", "flight")
) -> xr.Dataset:
    """The same headings with all other reports marked so that no fit uses them.

    Parameters
    ----------
    headings : Dataset
        In memory or opened lazily.
    chosen : callable
        Says of some reports which are chosen, see `Choice`.
    columns : tuple of str
        Variables it looks at.

    Returns
    -------
    Dataset
        With the bit ``no_reference`` set elsewhere, found whenever ``screening`` is looked at; for
        use inside an evaluation only.
    """
    marked = indexing.LazilyIndexedArray(_Marked(headings, chosen, columns))
    return headings.assign(screening=xr.Variable("report", marked))


class _Marked(BackendArray):
    """The column ``screening`` with the reports that are not chosen marked, slice by slice."""

    def __init__(self, headings: xr.Dataset, chosen: Choice, columns: tuple[str, ...]) -> None:
        self.columns = headings[["screening", *columns]]
        self.stop = row_bounds(headings["row_size"].to_numpy())[1]
        self.chosen = chosen
        self.shape = (headings.sizes["report"],)
        self.dtype = headings["screening"].dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> object:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._read
        )

    def _read(self, key: tuple[slice | int, ...]) -> NDArray[np.generic]:
        part = self.columns.isel(report=key[0]).load()
        number = np.arange(self.shape[0])[key[0]] if isinstance(key[0], slice) else key[0]
        part["aircraft_number"] = ("report", np.searchsorted(self.stop, number, side="right"))
        # what was loaded may be a view of columns that others hold
        screening = part["screening"].to_numpy().copy()
        screening[~self.chosen(part)] |= SCREENING["no_reference"]
        return screening
