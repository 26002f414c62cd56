"""The turn from aircraft order to time order and back, out of core.

Model winds are sampled in order of time, headings are derived aircraft by aircraft. The places of
the reports are set down block by block of aircraft, each in the file of its stretch of time; a
stretch is collocated on its own, and its winds are set down beside its places; then each block
takes its winds from all stretches. Neither way holds more than one block or one stretch.

Assumptions
-----------
* A stretch is some whole hours of one calendar month (UTC) with at most `STRETCH_REPORTS` reports,
  or one hour that has more: what is added later leaves the stretches of earlier months as they are.
* The files are this run's own: they are not kept between runs, and not written atomically.
* A model time at the edge of two stretches is read for both of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.vocabulary import describe

STRETCH_REPORTS = 250_000  # Reports collocated at a time
PLACE = np.dtype([("time", "M8[ns]"), ("latitude", "f8"), ("longitude", "f8"), ("pressure", "f4")])
_HOUR = 3_600_000_000_000  # ns


def stretches(hours: Mapping[int, int], limit: int | None = None) -> NDArray[np.int64]:
    """Cut an archive into stretches of time: their starts, hours since 1970.

    ``hours`` are the reports in each hour since 1970, in order of time; a stretch ends where the
    next one starts.
    """
    numbers = np.array(list(hours), dtype=np.int64)
    months = numbers.astype("M8[h]").astype("M8[M]").astype(np.int64)
    starts: list[int] = []
    total, month = 0, None
    for hour, own, count in zip(numbers.tolist(), months.tolist(), hours.values(), strict=True):
        total += count
        if own != month or total > (limit or STRETCH_REPORTS):
            starts.append(hour)
            total, month = count, own
    return np.array(starts, dtype=np.int64)


class Places:
    """Where and when the reports are, by stretches of time, and the winds found there.

    ``folder`` is for the files of this run: made, and emptied of its own; ``starts`` of
    :func:`stretches`.
    """

    def __init__(self, folder: Path, starts: NDArray[np.int64]) -> None:
        self.folder, self.starts = folder, starts * _HOUR
        self._sizes: list[NDArray[np.int64]] = []
        self._names: list[str] = []
        self._references: NDArray[np.object_] = np.empty(0, dtype=object)
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.glob("stretch*"):
            path.unlink()

    def __len__(self) -> int:
        return int(self.starts.size)

    def add(self, reports: xr.Dataset) -> None:
        """Set down times and places of the next block of aircraft."""
        rows = np.empty(reports.sizes["report"], PLACE)
        for name in PLACE.names or ():
            rows[name] = reports[name].to_numpy()
        stretch = self._stretch(rows["time"])
        sizes = np.bincount(stretch, minlength=len(self))
        rows = rows[np.argsort(stretch, kind="stable")]
        for number, own in enumerate(np.split(rows, np.cumsum(sizes)[:-1])):
            if own.size:
                with self._file(number, "places").open("ab") as file:
                    file.write(own.tobytes())
        self._sizes.append(sizes)

    def reports(self, number: int) -> xr.Dataset:
        """Places of one stretch, in order of aircraft."""
        path = self._file(number, "places")
        rows = np.fromfile(path, PLACE) if path.exists() else np.empty(0, PLACE)
        return xr.Dataset(
            {name: ("report", np.ascontiguousarray(rows[name])) for name in PLACE.names or ()}
        )

    def put(self, number: int, winds: xr.Dataset) -> None:
        """Set down the winds (reference, report) of one stretch, ordered as :meth:`reports`."""
        self._names = [str(name) for name in winds.data_vars]
        self._references = winds["reference"].to_numpy()
        values = [winds[name].transpose("reference", "report").to_numpy() for name in self._names]
        with self._file(number, "winds").open("wb") as file:
            # Report by report: a block's winds in a stretch are then one piece of its
            # file.
            file.write(np.concatenate(values).T.astype(np.float64).tobytes())
        self._file(number, "places").unlink(missing_ok=True)

    def winds(self, block: int, reports: xr.Dataset) -> xr.Dataset:
        """Winds (reference, report) of one block of aircraft, from every stretch."""
        order = np.argsort(self._stretch(reports["time"].to_numpy()), kind="stable")
        width, start = len(self._names) * self._references.size, 0
        found = np.empty((order.size, width))
        before: NDArray[np.int64] = np.array(
            [np.zeros_like(self.starts), *self._sizes[:block]]
        ).sum(axis=0)
        for number, size in enumerate(self._sizes[block].tolist()):
            if not size:
                continue
            offset = 8 * int(before[number]) * width
            part = np.fromfile(self._file(number, "winds"), np.float64, size * width, offset=offset)
            found[order[start : start + size]] = part.reshape(size, width)
            start += size
        split = np.split(np.ascontiguousarray(found.T), len(self._names))
        return describe(
            xr.Dataset(
                {
                    name: (("reference", "report"), values)
                    for name, values in zip(self._names, split, strict=True)
                },
                coords={"reference": ("reference", self._references)},
            )
        )

    def _stretch(self, time: NDArray[np.datetime64]) -> NDArray[np.int64]:
        stamp = time.astype("M8[ns]").astype(np.int64)
        return np.searchsorted(self.starts, stamp, side="right") - 1

    def _file(self, number: int, what: str) -> Path:
        return self.folder / f"stretch{number:06d}.{what}"
