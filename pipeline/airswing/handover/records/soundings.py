"""Ascents and descents joined: single reports to one report of many levels.

Assumes reports of an aircraft in the order of time, flights numbered, phases told. A sounding is a
run of reports of one flight in one phase, ascent or descent, without a gap of more than
`LARGEST_GAP`; reports that were left out between do not end it. It stands at the place and time of
its middle report: the readers know one place and one time for all levels. Levels go by descending
pressure, which WRF's nudging needs to interpolate between the first and the last of them. A second
report at the same pressure (a level-off; OBSPROC merges what is less than 1 Pa apart) cannot be a
level of its own and stays a single report, so that nothing is lost; so does a run of one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.flags import PHASE

LARGEST_GAP = 600  # s. Ascending, reports are seconds to a few minutes apart.
LEAST_STEP = 2.0  # Pa between the levels of a sounding
MOST_LEVELS = 1000  # WRFDA cuts reports of more than 1001 levels


def joined_soundings(rows: NDArray[np.void], flight: NDArray[np.int64]) -> NDArray[np.void]:
    """Give the levels of a sounding one number, one place and one time.

    Rows are of whole aircraft, in the order of aircraft and time, ``report`` counting them.
    """
    if not rows.size:
        return rows
    run = _runs(rows, flight)
    # By descending pressure within a run; of equal ones the earlier.
    order = np.lexsort((np.arange(rows.size), -rows["pressure"], run))
    level = rows["pressure"][order]
    repeated = np.zeros(rows.size, dtype=bool)
    repeated[order[1:]] = (np.diff(run[order]) == 0) & (level[:-1] - level[1:] < LEAST_STEP)
    members = np.flatnonzero(~repeated)
    begins = np.flatnonzero(np.diff(run[members], prepend=-1))
    counts = np.diff(begins, append=members.size)
    middle = members[begins + (counts - 1) // 2]
    whole = rows.copy()
    for name in ("report", "time", "latitude", "longitude"):
        whole[name][members] = np.repeat(rows[name][middle], counts)
    return whole


def _runs(rows: NDArray[np.void], flight: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the run each report belongs to, from 0 in order."""
    phase, time = rows["phase"], rows["time"]
    moving = (phase == PHASE["ascent"]) | (phase == PHASE["descent"])
    new = np.ones(rows.size, dtype=bool)
    new[1:] = (
        ~moving[1:]
        | (phase[1:] != phase[:-1])
        | (flight[1:] != flight[:-1])
        | (rows["aircraft"][1:] != rows["aircraft"][:-1])
        | (time[1:] - time[:-1] > LARGEST_GAP)
    )
    run = np.cumsum(new) - 1
    start = np.flatnonzero(new)[run]
    too_many = (np.arange(rows.size) - start) // MOST_LEVELS
    return np.asarray(np.cumsum(new | (np.diff(too_many, prepend=0) > 0)) - 1, dtype=np.int64)
