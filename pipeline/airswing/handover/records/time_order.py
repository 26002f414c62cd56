"""Rows sorted by time through files, so that memory does not grow with the archive.

Assumes rows that come by aircraft and are wanted by time. A first look at the times decides bins of
about `ROWS_AT_ONCE`; rows are set down in their bin as they come and sorted when it is their turn.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airswing.handover.records.eligible import ROW

# Few enough that their lines stay in the processor's cache while they are written.
ROWS_AT_ONCE = 10_000  # about as many are sorted together


class TimeOrder:
    """Rows in, by any order; rows out, by time.

    Parameters
    ----------
    folder : Path
        For the bins; made, and left to the caller to remove.
    times : iterable of array of datetime64
        All times of the archive, in parts.
    """

    def __init__(self, folder: Path, times: Iterable[NDArray[np.datetime64]]) -> None:
        self._folder = folder
        folder.mkdir()
        minutes: Counter[int] = Counter()
        for part in times:
            known = part[~np.isnat(part)].astype("datetime64[m]").astype(np.int64)
            found, counts = np.unique(known, return_counts=True)
            minutes.update(dict(zip(found.tolist(), counts.tolist(), strict=True)))
        edges, held = [], 0
        for minute in sorted(minutes):
            if held and held + minutes[minute] > ROWS_AT_ONCE:
                edges.append(60 * minute)
                held = 0
            held += minutes[minute]
        self._edges = np.array(edges, dtype=np.int64)

    def add(self, rows: NDArray[np.void]) -> None:
        """Take rows."""
        number = np.searchsorted(self._edges, rows["time"], side="right")
        order = np.argsort(number, kind="stable")
        bins, begins = np.unique(number[order], return_index=True)
        for one, part in zip(bins, np.split(rows[order], begins[1:]), strict=True):
            with self._path(int(one)).open("ab") as file:
                part.tofile(file)

    def __iter__(self) -> Iterator[NDArray[np.void]]:
        """All rows, some at a time, never parts of one report: by time, report and pressure."""
        for number in range(self._edges.size + 1):
            path = self._path(number)
            if path.exists():
                rows = np.fromfile(path, dtype=ROW)
                yield rows[np.lexsort((-rows["pressure"], rows["report"], rows["time"]))]
                path.unlink()

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:06d}"
