"""Reports of an aircraft, and their sums over short parts of a flight for the fit of the fleet.

The error of the reference hardly changes over a block (about 200 km, half the distance between the
nodes of the field), so that its reports can be placed at the middle one. The sums are exact: of the
robust weights, of the residual of the vector equation (`airswing.compass.fit.kernel`) and of its
derivatives by A to E and the airspeed scale. A block ends with its flight and with its six-hour
segment; the blocks of a flight in one segment are a *piece*. Differences within a block give the
size of the noise and nothing else: the headings of one leg differ by little more than the noise of
the reported wind, which turns indicated heading and heading error alike, so that a curve through
them would follow the noise (errors in variables). Radians, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Short = NDArray[np.int32]

LENGTH = 240e3
"""Metres: longest block at the aircraft's median airspeed."""
DURATIONS = (1800, 1200, 900, 600)
"""Seconds that a block may last, all of them parts of a segment."""
SEGMENT_SECONDS = 6 * 3600
"""Time over which a passing error of the reference is taken as constant."""
SLOPES = 6
"""A to E and the airspeed scale."""
LEAST_WEIGHT = 0.3
"""Weight, in reports, below which a block is left out: gross errors."""


@dataclass(frozen=True)
class Reports:
    """Reports of one aircraft against one reference, sorted by flight; arrays of shape (n,).

    Angles in radians, speeds in m s-1; all values finite.
    """

    basis: Array  # (5, n): of the deviation, see `deviation_basis`
    heading: Array  # indicated true heading
    heading_error: Array  # against the reference
    airspeed: Array
    implied: Array  # airspeed that the reference implies
    variance: Array  # known variance of a component of the residual, m2 s-2
    flight: Index  # number of the flight within the aircraft, not decreasing
    latitude: Array  # degrees
    longitude: Array
    pressure: Array  # Pa
    time: NDArray[np.datetime64]

    def take(self, index: Index) -> Reports:
        """Some of the reports."""
        return Reports(*(getattr(self, one.name)[..., index] for one in fields(self)))


@dataclass(frozen=True)
class Blocks:
    """Sums of one aircraft's reports against one reference, at its fit without bias.

    The rows of ``sums`` are the weight (a report has one on average); the weighted residual,
    reference minus corrected wind, eastward and northward; its derivatives by A to E and the
    airspeed scale with the sign reversed, eastward and then northward.
    """

    sums: NDArray[np.float32]  # (15, blocks)
    within: float  # weighted sum of squares of the residual within blocks, (m/s)2
    freedom: float  # degrees of freedom of ``within``, both components
    latitude: Array  # (blocks,)
    longitude: Array
    log_pressure: Array
    segment: Short  # six-hour segments since 1970
    piece: Short  # 0, 1, 2 ..., not decreasing

    def of(self, segments: Index) -> Blocks:
        """Blocks of some increasing segments; ``within`` and ``freedom`` stay those of all."""
        low, high = np.searchsorted(self.segment, (segments[0], segments[-1] + 1))
        keep: slice | NDArray[np.bool_] = slice(int(low), int(high))
        # segments decrease where flights are not numbered by time
        if segments[-1] - segments[0] >= segments.size or (np.diff(self.segment) < 0).any():
            keep = np.isin(self.segment, segments)
        names = ("latitude", "longitude", "log_pressure", "segment", "piece")
        kept = {name: getattr(self, name)[keep] for name in names}
        return replace(self, sums=self.sums[:, keep], **kept)


def sum_blocks(
    rows: Array, square: float, reports: Reports, bias: Array, step: Array, kappa: float
) -> Blocks:
    """Sum one aircraft's reports against one reference by block.

    ``rows`` (15, n) are weight, weighted residual and weighted derivatives of each report, as in
    :class:`Blocks`; ``square`` the sum of the squares of weight times residual; ``bias`` (2,), m/s,
    that of the reference that was removed from the residual and is added again; ``step`` (6,) that
    of A to E and the scale after the residual; ``kappa`` the mean derivative of the robust score
    over the mean weight: robust residuals are smaller than the shift that causes them by this
    factor.
    """
    fastest = np.divide(LENGTH, DURATIONS[:-1])
    seconds = DURATIONS[int(np.searchsorted(fastest, np.median(reports.airspeed)))]
    # a block begins where the number of its interval or the flight changes, a piece where the
    # segment or the flight does
    flight, time = reports.flight, reports.time.astype("datetime64[s]").astype(np.int64)
    number = time // seconds
    start = _changes(number, flight)
    segment = number[start] // (SEGMENT_SECONDS // seconds)
    opens = np.zeros(start.size, dtype=np.int32)
    opens[_changes(segment, flight[start])] = 1
    stop = np.append(start[1:], reports.flight.size)
    count, at = stop - start, (start + stop) // 2
    sums = np.add.reduceat(rows, start, axis=1)
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
        segment[keep].astype(np.int32),
        np.cumsum(opens, dtype=np.int32)[keep],
    )


def _changes(first: Index, second: Index) -> Index:
    change = np.ones(first.size, dtype=np.bool_)
    change[1:] = (first[1:] != first[:-1]) | (second[1:] != second[:-1])
    return np.flatnonzero(change)
