"""Reports that a simulation made elsewhere, held against those of the archive.

Assumptions: where the simulation flew the archive's paths, a report of it is the same aircraft's
at the same time (to `SAME_TIME` seconds) and place (to `SAME_PLACE` degrees, which coarse coding
stays within); its wind then stands in place of the reference wind. A report of the archive without
a match is left out and counted. Where fewer than `LEAST_SHARE` of the archive's reports, or fewer
than `LEAST_MATCHED`, have a match, the simulation flew other paths and only distributions can be
compared (`airswing.workflow.gap_start`).

Validity: winds in m/s, degrees; the reference's derivatives stay those of the collocation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.physics.triangle import wrap_degrees

__all__ = ["LEAST_SHARE", "Matched", "match_reports", "same_paths", "with_simulated_wind"]

FloatArray = NDArray[np.float64]
SAME_TIME = 60.0
"""Seconds: times cut to the minute still match."""
SAME_PLACE = 0.05
"""Degrees of a great circle: three arc minutes."""
# Of the archive's reports that must be matched, and how many: a simulation of other flights tells
# nothing of these.
LEAST_SHARE = 0.5
LEAST_MATCHED = 200


@dataclass(frozen=True)
class Matched:
    """Simulated winds at the reports of an archive."""

    # u, v: (n,): simulated wind, m s-1; NaN without a match
    u: FloatArray
    v: FloatArray
    simulated: int  # reports of the simulation

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which reports (n,) have a match."""
        return np.isfinite(self.u) & np.isfinite(self.v)


def match_reports(frame: Frame, simulated: xr.Dataset) -> Matched:
    """Find the simulated report of every report of an archive.

    Parameters
    ----------
    simulated : xarray.Dataset
        Reports of the simulation, as `airswing.reports.read_reports` gives them.
    """
    names = [str(name) for name in simulated["aircraft"].values]
    ends = np.cumsum(simulated["row_size"].values)
    seconds = simulated["time"].values.astype("datetime64[ms]").astype(np.int64) / 1e3
    u, v = (np.full(frame.size, np.nan) for _ in range(2))
    for index, tail in enumerate(frame.tails):
        rows = np.flatnonzero(frame.aircraft == index)
        if tail not in names or not rows.size:
            continue
        place = names.index(tail)
        start = int(ends[place - 1]) if place else 0
        own = slice(start, int(ends[place]))
        nearest = start + _nearest(seconds[own], frame.time[rows])
        same = np.abs(seconds[nearest] - frame.time[rows]) <= SAME_TIME
        same &= _same_place(frame.take(rows), simulated, nearest)
        u[rows[same]] = simulated["eastward_wind"].values[nearest[same]]
        v[rows[same]] = simulated["northward_wind"].values[nearest[same]]
    return Matched(u, v, int(seconds.size))


def _nearest(times: FloatArray, wanted: FloatArray) -> NDArray[np.int64]:
    """Return the index of the nearest of ascending times for each wanted time."""
    # at the ends both neighbours are the one that is there
    after = np.clip(np.searchsorted(times, wanted), 1, max(times.size - 1, 1))
    after = np.minimum(after, times.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(times[before] - wanted) <= np.abs(times[after] - wanted)
    return np.asarray(np.where(nearer, before, after), np.int64)


def _same_place(frame: Frame, simulated: xr.Dataset, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    north = simulated["latitude"].values[rows] - frame.latitude
    east = simulated["longitude"].values[rows] - frame.longitude
    east = wrap_degrees(east) * np.cos(np.radians(frame.latitude))
    return np.asarray(np.hypot(north, east) <= SAME_PLACE)


def same_paths(matched: Matched) -> bool:
    """Return whether the simulation flew the archive's paths."""
    number = int(matched.found.sum())
    return number >= LEAST_MATCHED and number >= LEAST_SHARE * matched.found.size


def with_simulated_wind(frame: Frame, matched: Matched) -> Frame:
    """Return the reports that have a match, the simulated wind in place of the reference's.

    Parameters
    ----------
    matched : Matched
        From `match_reports`.

    Raises
    ------
    InputError
        Nothing matches.
    """
    found = matched.found
    if not found.any():
        raise InputError("no simulated report is of an aircraft and time of the archive")
    kept = frame.take(np.flatnonzero(found))
    return replace(kept, u_ref=matched.u[found], v_ref=matched.v[found])
