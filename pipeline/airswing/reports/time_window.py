"""The reports of some stretch of time out of those that were set down by aircraft.

Assumes a filled :class:`airswing.reports.staging_store.Spool`. Which of its segments meet the time
is told by the hours each notes; their reports are picked out some aircraft at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.reports.derive import Columns
from airswing.reports.staging_store import Segment, Spool


class Between(Spool):
    """The reports of a spool from one time to before another.

    Its counts are of all reports in the segments that meet the time; it has no audit.

    Attributes
    ----------
    marks : list of str
        Checksums of these segments: the reports are the same where these are.
    """

    def __init__(self, whole: Spool, start: np.datetime64, stop: np.datetime64) -> None:
        super().__init__(key=whole.key)
        self.segments = [one for one in whole.segments if _meets(one, start, stop)]
        self.marks = sorted(one.checksum for one in self.segments)
        self._window = start, stop

    def columns(self, first: str, last: str) -> tuple[Columns, NDArray[np.object_]]:
        """Canonical columns as of a whole spool; some tails may have none."""
        columns, tails = super().columns(first, last)
        start, stop = self._window
        kept = np.flatnonzero((columns["time"] >= start) & (columns["time"] < stop))
        return {name: values[kept] for name, values in columns.items()}, tails


def _meets(one: Segment, start: np.datetime64, stop: np.datetime64) -> bool:
    first, last = (int(when.astype("M8[h]").astype(np.int64)) for when in (start, stop))
    return any(first <= hour <= last for hour, _ in one.hours)
