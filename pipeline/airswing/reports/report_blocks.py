"""An archive of reports as blocks of whole aircraft on disk, one block in memory at a time.

Assumes that no aircraft has more reports than a process can hold (a year of one report a minute
are half a million); any number of aircraft. The blocks, one after the other, are the reports
Dataset that :func:`airswing.reports.read.read_reports` gives, bit for bit, however the aircraft
are divided into blocks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.products.checked import digest
from airswing.products.ragged import BLOCK_REPORTS
from airswing.reports.assembly import Shared, assembled
from airswing.reports.canonical.audit import Audit, similar
from airswing.reports.staging_store import Spool
from airswing.vocabulary import describe


class Archive:
    """Ordered reports of a fleet, block by block; ``interval`` and ``begins`` as for `assembled`.

    Parameters
    ----------
    spool : Spool
        Filled.
    folder : Path
        For the blocks, which are this archive's own and not kept between runs.
    limit : int, optional
        Reports of a block; `BLOCK_REPORTS` by default.

    Attributes
    ----------
    audit : Audit
        Of the reading, duplicates and derived values included.
    reports, aircraft, flights : int
        Of the whole archive.
    largest : int
        Reports of the largest block.
    hours : dict of int to int
        Reports in each hour since 1970, duplicates included.
    content : str
        Checksum of all reports as they are ordered, where ``begins`` is given.
    """

    def __init__(
        self,
        spool: Spool,
        folder: Path,
        *,
        limit: int | None = None,
        interval: float = 0.0,
        begins: tuple[np.datetime64, np.datetime64] | None = None,
    ) -> None:
        self.folder, self.hours = folder, spool.hours()
        self.audit = Audit()
        self.audit.add(spool.audit)
        self.audit.similar_tails = similar(spool.counts())
        self.reports = self.aircraft = self.largest = 0
        folder.mkdir(parents=True, exist_ok=True)
        counts, flights, marks = [], [], []
        hours: Counter[int] = Counter()
        for first, last in spool.groups(limit or BLOCK_REPORTS):
            columns, tails = spool.columns(first, last)
            if begins is not None:
                self.audit.read += columns["time"].size
            if not columns["time"].size:
                continue
            block = assembled(columns, tails, self.audit, interval=interval, begins=begins)
            if not block.reports.sizes["report"]:
                continue
            self.reports += block.reports.sizes["report"]
            self.aircraft += block.reports.sizes["aircraft"]
            self.largest = max(self.largest, block.reports.sizes["report"])
            counts.append(block.counts)
            flights.append(block.flights)
            plain = _columns(block.reports)
            if begins is not None:
                hours.update(block.reports["time"].to_numpy().astype("M8[h]").astype(int).tolist())
                marks.append(digest(*(plain[name].tobytes() for name in sorted(plain))))
            # set down at once: no more than one block of an archive is in memory
            with self._path(len(counts) - 1).open("wb") as file:
                np.savez(file, allow_pickle=False, **plain)
        if begins is not None:
            self.hours = dict(sorted(hours.items()))
        self._shared = Shared(counts, flights) if counts else None
        self.flights = sum(flights)
        self._blocks, self.content = len(counts), digest(*marks).hex()

    def __len__(self) -> int:
        return self._blocks

    def __iter__(self) -> Iterator[xr.Dataset]:
        return (self.block(number) for number in range(len(self)))

    def block(self, number: int) -> xr.Dataset:
        """One block as :func:`airswing.reports.read.read_reports` gives, without its audit."""
        with np.load(self._path(number), allow_pickle=False) as stored:
            columns = {name: stored[name] for name in stored.files}
        per_aircraft = {"aircraft", "row_size", "platform"}
        ds = xr.Dataset(
            {
                name: ("aircraft" if name in per_aircraft else "report", values)
                for name, values in columns.items()
                if name != "aircraft"
            },
            coords={"aircraft": ("aircraft", columns["aircraft"].astype(object))},
        )
        if self._shared is None:
            raise IndexError(number)
        return self._shared.complete(number, describe(ds))

    def _path(self, number: int) -> Path:
        return self.folder / f"block{number:06d}.npz"


def _columns(reports: xr.Dataset) -> dict[str, NDArray[np.generic]]:
    """Plain arrays of a block; names as fixed-width text, which needs no pickling."""
    found = {str(name): reports[name].to_numpy() for name in reports.variables}
    return found | {"aircraft": found["aircraft"].astype(str)}
