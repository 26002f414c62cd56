"""Reports that a diagnosis keeps in memory: all of them, or whole flights drawn evenly.

The model holds its whitened columns in memory, 2.7 kB a report each; an archive with more than
`MOST` reports is represented by whole flights, drawn by a hash of the flight's number (the same
whatever the order of reading), so that errors along a flight keep their neighbours.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.products.ragged import blocks, joined, some_reports

#: Reports held in memory, about: 0.5 GB of columns.
MOST = 150_000
_FACTOR, _WHOLE = 2654435761, 2**32
"""Multiplicative hash (Knuth, The Art of Computer Programming, 6.4)."""


def sampled(headings: xr.Dataset, most: int = MOST) -> xr.Dataset:
    """Whole flights of a headings Dataset, about ``most`` reports; all where it holds no more.

    Parameters
    ----------
    headings : Dataset
        Ragged headings, in memory or opened lazily.
    most : int
        Reports to keep, about.

    Returns
    -------
    Dataset
        In memory where it was sampled.
    """
    total = headings.sizes["report"]
    if total <= most or "flight" not in headings:
        return headings
    share = most / total
    parts = []
    for block in blocks(headings):
        number = np.asarray(block["flight"].to_numpy(), np.int64)
        parts.append(some_reports(block, _drawn(number, share)))
    return joined(parts)


def _drawn(flight: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    return np.asarray((flight * _FACTOR) % _WHOLE < share * _WHOLE)
