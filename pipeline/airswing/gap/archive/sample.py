"""Sampling of whole flights from archives that are too large for a diagnosis in memory.

The model keeps its whitened columns in memory, 2.7 kB for each report. An archive with more than
`MOST` reports is represented by whole flights, so that errors along a flight remain correlated.
They are drawn by a hash of the flight number, independent of the order of reading.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from airswing.products.ragged import blocks, joined, some_reports

MOST = 150_000
"""Approximate number of reports in memory: 0.5 GB of columns."""
_FACTOR, _RANGE = 2654435761, 2**32
"""Multiplicative hash (Knuth, The Art of Computer Programming, 6.4)."""


def sampled(headings: xr.Dataset, most: int = MOST) -> xr.Dataset:
    """Draw whole flights of a headings Dataset.

    Parameters
    ----------
    headings : Dataset
        Ragged headings, in memory or opened lazily.
    most : int
        Approximate number of reports to keep.

    Returns
    -------
    Dataset
        The same where it has no more than `most` reports, otherwise a sample in memory.
    """
    total = headings.sizes["report"]
    if total <= most or "flight" not in headings:
        return headings
    parts = []
    for block in blocks(headings):
        hashed = np.asarray(block["flight"].to_numpy(), np.int64) * _FACTOR % _RANGE
        parts.append(some_reports(block, hashed < most / total * _RANGE))
    return joined(parts)
