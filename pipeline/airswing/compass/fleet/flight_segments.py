"""Reports summed over short stretches of flight: all the fleet's part of the fit needs to know.

Assumes that the reference's error hardly changes over a block (half an hour of a turboprop's
flight, a quarter of a jet's: about 200 km, half the distance of the field's nodes), so that the
reports of a block can stand at the place of the middle one. The sums themselves are exact: of the
weights, of the residual of the vector equation (:mod:`airswing.compass.fit.normal_equations`) and
of its derivatives by A to E and the airspeed scale, each with the report's robust weight. Blocks
end with their flight and with their six-hour segment; what a flight flew in one segment is a
*piece*.

What differs inside a block is used for the size of the noise only: the headings of one leg differ
by little more than the noise of the reported wind, which turns the indicated heading and its error
alike, so a curve through them would follow the noise (errors in variables).

Made aircraft by aircraft, so any split of a fleet gives the same blocks, bit for bit. Radians,
m/s; an array of some 15 numbers a block.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airswing.units import Picked

Array = NDArray[np.float64]
Index = NDArray[np.int64]
LENGTH = 240e3
"""Metres a block may be long at the aircraft's airspeed."""
DURATIONS = (1800, 1200, 900, 600)
"""Seconds a block may last: parts of a segment, so that no block crosses its end."""
FASTEST = tuple(LENGTH / seconds for seconds in DURATIONS[:-1])
"""Airspeed up to which each but the last will do, m/s."""
SEGMENT_SECONDS = 6 * 3600
"""Time for which a passing error of the reference is taken as standing still."""
SLOPES = 6
"""A to E and the airspeed scale."""
ROWS = 1 + 2 + 2 * SLOPES
"""Weight; residual eastward, northward; slopes eastward, slopes northward."""
LEAST_WEIGHT = 0.3
"""Reports' worth of weight below which a block is left out: gross errors."""


@dataclass(frozen=True)
class Places:
    """Where and when the reports of one aircraft are."""

    latitude: NDArray[np.floating]  # (n,), degrees
    longitude: NDArray[np.floating]  # (n,), degrees
    pressure: NDArray[np.floating]  # (n,), Pa
    time: NDArray[np.datetime64]  # (n,)

    def at(self, index: Picked) -> Places:
        """Those of some reports."""
        return Places(
            self.latitude[index], self.longitude[index], self.pressure[index], self.time[index]
        )


@dataclass(frozen=True)
class Edges:
    """Where the blocks of one aircraft's reports begin."""

    start: Index  # (blocks,): first report of each
    segment: Index  # (blocks,): six-hour segments since 1970
    opens: NDArray[np.bool_]  # (blocks,): whether the block is the first of its piece


@dataclass(frozen=True)
class Cut:
    """What blocks need of their reports beside their sums."""

    count: Index  # (blocks,): reports of each
    middle: Places  # of the middle one of each
    # segment, opens: (blocks,): as of :class:`Edges`
    segment: Index
    opens: NDArray[np.bool_]


@dataclass(frozen=True)
class Blocks:
    """Sums of one aircraft's reports against one reference, at its own fit without bias."""

    # (15, blocks): weight (a report's is one on average), weighted residual and slopes, see
    # :data:`ROWS`. The residual is the reference's wind minus the corrected one; minus the slopes
    # are its derivatives.
    sums: NDArray[np.float32]
    # sum of the squared residual (times its weight, which is what the means are made of) less what
    # the blocks' means hold, (m/s)2
    within: float
    freedom: float  # degrees of freedom of ``within``, both components
    latitude: Array  # (blocks,)
    longitude: Array  # (blocks,)
    log_pressure: Array  # (blocks,)
    segment: NDArray[np.int32]  # (blocks,)
    piece: NDArray[np.int32]  # (blocks,): 0, 1, 2 ... never falling.

    @property
    def size(self) -> int:
        """Number of blocks."""
        return int(self.segment.size)

    def of(self, segments: Index) -> Blocks:
        """Those of some segments; ``within`` and ``freedom`` stay those of all.

        Parameters
        ----------
        segments : array of int
            Rising.

        Returns
        -------
        Blocks
            Views where all the blocks between the first and the last of the segments are asked for
            and their segments never fall.
        """
        low, high = np.searchsorted(self.segment, (segments[0], segments[-1] + 1))
        keep: Picked = slice(int(low), int(high))
        if segments[-1] - segments[0] >= segments.size or self.falls:
            keep = np.isin(self.segment, segments)
        return replace(
            self,
            sums=self.sums[:, keep],
            latitude=self.latitude[keep],
            longitude=self.longitude[keep],
            log_pressure=self.log_pressure[keep],
            segment=self.segment[keep],
            piece=self.piece[keep],
        )

    @cached_property
    def falls(self) -> bool:
        """Whether the number of the segment falls anywhere: flights numbered out of time."""
        return bool(np.any(self.segment[1:] < self.segment[:-1]))


def speed_counts(airspeed: NDArray[np.floating]) -> Index:
    """Reports by the duration of blocks that will do for their airspeed.

    Counts of several periods add up: an aircraft's blocks are cut alike in all of them, and as
    they are when it is fitted to all of its reports.

    Parameters
    ----------
    airspeed : array, shape (n,), m/s

    Returns
    -------
    array of int, shape (4,)
        As `DURATIONS`.
    """
    below = [np.count_nonzero(airspeed <= fastest) for fastest in FASTEST]
    return np.diff([0, *below, airspeed.size])


def duration_of(counts: Index) -> int:
    """Seconds a block lasts at the median airspeed.

    Parameters
    ----------
    counts : array of int, shape (4,)
        Of :func:`speed_counts`.
    """
    total = np.cumsum(counts)
    return DURATIONS[int(np.searchsorted(2 * total, total[-1]))]


def find_edges(flight: NDArray[np.integer], time: NDArray[np.datetime64], seconds: int) -> Edges:
    """Cut one aircraft's reports into blocks.

    Parameters
    ----------
    flight : array of int, shape (n,)
        Never falling.
    time : array of datetime64, shape (n,)
    seconds : int
        That a block lasts.
    """
    ticks = np.array(seconds, dtype="timedelta64[s]").astype(time.dtype.str.replace("M8", "m8"))
    number = time.view(np.int64) // int(ticks.astype(np.int64))
    change = np.ones(number.size, dtype=np.bool_)
    np.not_equal(number[1:], number[:-1], out=change[1:])
    change[1:] |= flight[1:] != flight[:-1]
    start = np.flatnonzero(change)
    segment = number[start] // (SEGMENT_SECONDS // seconds)
    opens = np.ones(start.size, dtype=np.bool_)
    first = flight[start]
    opens[1:] = (segment[1:] != segment[:-1]) | (first[1:] != first[:-1])
    return Edges(start, segment, opens)


class _Placed(Protocol):
    """Reports of one aircraft, sorted by flight, with their places; see `Reports`."""

    flight: Index
    airspeed: Array
    latitude: Array
    longitude: Array
    pressure: Array
    time: NDArray[np.datetime64]


def sum_blocks(
    rows: Array, square: float, reports: _Placed, bias: Array, step: Array, kappa: float
) -> Blocks:
    """Sum one aircraft's reports against one reference by block.

    Parameters
    ----------
    rows : array, shape (15, n)
        Weight, weighted residual and weighted derivatives of each report, see :class:`Blocks`.
    square : float
        Sum over all reports of the square of weight times residual.
    reports : Reports
        Sorted by flight.
    bias : array, shape (2,)
        Reference's bias that was removed from the residual, m/s: it is put back.
    step : array, shape (6,)
        Step of A to E and the scale that was made after the residual.
    kappa : float
        Mean derivative of the robust score over the mean weight: robust residuals are smaller than
        the shift that causes them by this factor.
    """
    middle = np.partition(reports.airspeed, (reports.flight.size - 1) // 2)
    seconds = DURATIONS[int(np.searchsorted(FASTEST, middle[(reports.flight.size - 1) // 2]))]
    edges = find_edges(reports.flight, reports.time, seconds)
    stop = np.append(edges.start[1:], reports.flight.size)
    count, at = stop - edges.start, (edges.start + stop) // 2
    sums = np.add.reduceat(rows, edges.start, axis=1)
    # weights of mean one: a block counts as its reports, and variances are those of a report
    unit = int(count.sum()) / max(float(sums[0].sum()), 1e-30)
    sums *= unit
    sums[1:3] /= kappa
    within = square * (unit / kappa) ** 2 - float(((sums[1] ** 2 + sums[2] ** 2) / count).sum())
    for row, slopes in ((1, sums[3 : 3 + SLOPES]), (2, sums[3 + SLOPES :])):
        sums[row] += bias[row - 1] * sums[0] - step @ slopes
    latitude, longitude, pressure = (
        values[at] for values in (reports.latitude, reports.longitude, reports.pressure)
    )
    keep = (sums[0] > LEAST_WEIGHT) & np.isfinite(latitude + longitude + pressure)
    return Blocks(
        sums[:, keep].astype(np.float32),
        within,
        2.0 * float(count.sum() - count.size),
        latitude[keep],
        longitude[keep],
        np.log(pressure[keep]),
        edges.segment[keep].astype(np.int32),
        np.cumsum(edges.opens, dtype=np.int32)[keep],
    )


def make_blocks(
    sums: Array,
    square: float,
    edges: Edges,
    places: Places,
    bias: Array,
    step: Array,
    kappa: float,
) -> Blocks:
    """Blocks of one aircraft and reference from what the last pass left.

    Parameters
    ----------
    sums : array, shape (15, blocks)
        Of the pass, at its own parameters.
    square : float
        Sum over all reports of the square of weight times residual.
    places : Places
        Of the reports, in the order of the pass.
    bias : array, shape (2,)
        Reference bias the pass took off, m/s: put back.
    step : array, shape (6,)
        Step of A to E and the scale after the pass.
    kappa : float
        Mean derivative of the robust score over the mean weight: robust residuals are that much
        smaller than what shifts them.
    """
    return blocks_of(sums, square, cut_of(edges, places), bias, step, kappa)


def cut_of(edges: Edges, places: Places) -> Cut:
    """What is kept of the reports a block is made of."""
    stop = np.append(edges.start[1:], places.time.size)
    middle = (edges.start + stop) // 2
    return Cut(stop - edges.start, places.at(middle), edges.segment, edges.opens)


def blocks_of(
    sums: Array, square: float, cut: Cut, bias: Array, step: Array, kappa: float
) -> Blocks:
    """As :func:`make_blocks`, from what was kept of the reports.

    Parameters
    ----------
    sums, square, bias, step, kappa
        As for :func:`make_blocks`.
    """
    count, at = cut.count, cut.middle
    # weights mean one: a block is then worth its reports, and variances are those of a report
    unit = int(count.sum()) / max(float(sums[0].sum()), 1e-30)
    sums = sums * unit
    sums[1:3] /= kappa
    within = square * (unit / kappa) ** 2 - float(((sums[1] ** 2 + sums[2] ** 2) / count).sum())
    for row, slopes in ((1, sums[3 : 3 + SLOPES]), (2, sums[3 + SLOPES :])):
        sums[row] += bias[row - 1] * sums[0] - step @ slopes
    heavy = (sums[0] > LEAST_WEIGHT) & np.isfinite(at.latitude + at.longitude + at.pressure)
    keep: Picked = slice(None) if heavy.all() else heavy  # mostly all: nothing to copy
    at = at.at(keep)
    return Blocks(
        sums[:, keep].astype(np.float32),
        within,
        2.0 * float(count.sum() - count.size),
        at.latitude.astype(np.float64),
        at.longitude.astype(np.float64),
        np.log(at.pressure.astype(np.float64)),
        cut.segment[keep].astype(np.int32),
        np.cumsum(cut.opens, dtype=np.int32)[keep],
    )
