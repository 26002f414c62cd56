"""Error of the reference wind that a fleet shows: a field, its basis and its precision by segment.

The random effects are those of docs/method.md ("Errors of the reference"): the lasting part of the
field consists of hat functions in latitude, longitude and ln p, the passing part of hat functions
about 400 km apart. The deviation of an aircraft depends on its heading and not on the place, the
field on the place and not on the heading, which separates the two.

A passing part of more than `MOST_NODES` nodes is divided into regions: within a segment, blocks of
different regions are taken as independent. The borders move from one segment to the next, so that
no place is always at a border. SI units and radians; latitude and longitude in degrees.

*Blocks.* The error of the reference hardly changes over a block (half the distance between the
nodes of the field), so that its reports can be placed at the middle one. The sums are exact: of the
robust weights, of the residual of the vector equation (`airswing.compass.fit.kernel`) and of its
derivatives by A to E and the airspeed scale. A block ends with its flight and with its six-hour
segment; the blocks of a flight in one segment are a piece. Differences within a block give the size
of the noise and nothing else: the headings of one leg differ by little more than the noise of the
reported wind, which turns indicated heading and heading error alike, so that a curve through them
would follow the noise (errors in variables).

References
----------
Henderson 1975, Biometrics 31, 423-447 (mixed model equations); Laird & Ware 1982, Biometrics 38,
963-974 (variances by expectation-maximization).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from airswing.physics.great_circle import middle_longitude
from airswing.physics.splines import hat_products
from airswing.physics.triangle import wrap_degrees
from airswing.units import METRES_PER_DEGREE

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Short = NDArray[np.int32]

LENGTH = 240e3  # metres: longest block at the aircraft's median airspeed
DURATIONS = (1800, 1200, 900, 600)  # durations of a block in seconds; each divides a segment
SEGMENT_SECONDS = 6 * 3600  # time over which a passing error of the reference is taken as constant
SLOPES = 6  # A to E and the airspeed scale
LEAST_WEIGHT = 0.3  # weight, in reports, below which a block is omitted (gross errors)


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
        """Return a subset of the reports."""
        return Reports(*(getattr(self, entry.name)[..., index] for entry in fields(self)))


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
        columns = {name: getattr(self, name)[keep] for name in names}
        return replace(self, sums=self.sums[:, keep], **columns)


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


SPACING = 400e3 / METRES_PER_DEGREE
"""Degrees between the nodes of the passing part (400 km): the scale of a model's synoptic error."""
STATIC_NODES = (4, 5, 3)
"""Least numbers of nodes of the lasting part in latitude, longitude and ln p, at quantiles of the
blocks."""
STATIC_SPACING = 2000e3 / METRES_PER_DEGREE
"""Degrees (2000 km) for which there is one node more in latitude and longitude."""
MOST_NODES = 400
"""Nodes of the passing part in one region: a square of 8,000 km. Their covariance takes the square
of their number in each segment, its inverse the cube."""
SHIFTS = 5
"""Number of successive positions of regions' borders; not a divisor of four segments a day."""
LARGEST_VARIANCE = 9.0  # (m/s)2: bound of every variance; a larger one is no error of the reference
ROUNDS = 6  # iterations of the variances, each with the field of the previous one removed


@dataclass(frozen=True)
class FieldBasis:
    """Nodes of the lasting and the passing part of the field."""

    lasting: tuple[Array, ...]  # nodes in latitude, eastward degrees and ln p
    passing: tuple[Array, ...]  # nodes in latitude and eastward degrees
    origin: tuple[float, float]  # longitude of the middle, cosine of the middle latitude

    @classmethod
    def of(cls, latitude: Array, longitude: Array, log_pressure: Array) -> FieldBasis:
        """Place the nodes for some blocks."""
        origin = (middle_longitude(longitude), float(np.cos(np.radians(np.median(latitude)))))
        places = (latitude, _eastward(longitude, origin), log_pressure)
        spacing = (STATIC_SPACING, STATIC_SPACING, np.inf)
        lasting = tuple(
            np.unique(
                np.quantile(values, np.linspace(0, 1, max(nodes, 1 + int(np.ptp(values) // step))))
            )
            for values, nodes, step in zip(places, STATIC_NODES, spacing, strict=True)
        )
        spans = [(float(values.min()), float(values.max())) for values in places[:2]]
        passing = tuple(
            np.linspace(*span, max(2, round(np.ptp(span) / SPACING) + 1) if np.ptp(span) else 1)
            for span in spans
        )
        return cls(lasting, passing, origin)

    @property
    def lasting_size(self) -> int:
        """Number of functions of the lasting part."""
        return int(np.prod([nodes.size for nodes in self.lasting]))

    @property
    def passing_size(self) -> int:
        """Number of functions of the passing part in one segment."""
        return int(np.prod([nodes.size for nodes in self.passing]))

    @cached_property
    def cuts(self) -> tuple[int, int]:
        """Numbers of parts into which the passing part is divided in latitude and eastward."""
        rows, columns = (nodes.size for nodes in self.passing)
        down, across = 1, 1
        while rows * columns > MOST_NODES * down * across:
            if rows * across >= columns * down:  # the longer side of a region
                down += 1
            else:
                across += 1
        return down, across

    @property
    def regions(self) -> int:
        """Number of regions of a segment; shifted borders add one on each axis."""
        return int(np.prod([parts + (parts > 1) for parts in self.cuts]))

    @property
    def region_size(self) -> int:
        """Largest number of functions of the passing part in one region."""
        # with the nodes beyond both borders
        sides = [
            min(nodes.size, -(-(nodes.size - 1) // parts) + 2)
            for nodes, parts in zip(self.passing, self.cuts, strict=True)
        ]
        return int(np.prod(sides))

    def cells(self, latitude: Array, east: Array, segment: Index) -> Index:
        """Segment times number of regions, plus the region, of some places in their segments."""
        if self.regions == 1:
            return segment
        region = np.zeros(segment.size, dtype=np.int64)
        shift = (segment % SHIFTS) / SHIFTS
        for values, nodes, parts in zip((latitude, east), self.passing, self.cuts, strict=True):
            if parts > 1:
                width = float(nodes[-1] - nodes[0]) / parts
                interval = np.floor((values - nodes[0]) / width + shift).astype(np.int64)
                region = region * (parts + 1) + np.clip(interval, 0, parts)
        return np.asarray(segment * np.int64(self.regions) + region)


def _eastward(longitude: Array, origin: tuple[float, float]) -> Array:
    """Degrees of great circle east of the middle, without a jump at the antimeridian."""
    return np.asarray(wrap_degrees(longitude - origin[0]) * origin[1])


@dataclass(frozen=True)
class Variances:
    """Variances of the parts of a block's mean residual, (m/s)2 for each component."""

    white: Array  # (aircraft,): of a report of weight one
    block: float
    piece: float
    passing: float


@dataclass(frozen=True)
class Stretch:
    """Blocks of a fleet against one reference, concatenated; n blocks.

    Where the field is divided into regions each region of a segment counts as a segment.
    """

    weight: Array  # (n,): in reports
    residual: Array  # (2, n): mean of each block, m/s
    slopes: NDArray[np.float32]  # (2, 6, n): mean of each block
    aircraft: Index  # (n,): not decreasing
    opens: Index  # (pieces,): first block of each piece
    piece: Index  # (n,)
    node: Short  # (n, up to 4): nodes of the passing part, numbered over all segments
    share: Array  # (n, up to 4): values of their functions
    lasting: Short  # (n, up to 9): functions of the lasting part and, last, its mean
    lasting_share: Array  # (n, up to 9): their values
    segment: Index  # (n,): index of the segment
    segments: Index  # numbers of the segments, not decreasing
    nodes: int  # largest number of nodes with blocks in one segment; others are filled up to it
    every: int  # number of nodes of a segment, with or without blocks

    @classmethod
    def of(cls, fleet: list[Blocks], basis: FieldBasis) -> Stretch:
        """Concatenate the blocks of a fleet, one element an aircraft."""
        means = np.concatenate([blocks.sums for blocks in fleet], axis=1)
        weight = means[0].astype(np.float64)
        means[1:] *= (1.0 / weight).astype(np.float32)
        latitude, longitude, log_pressure, number, piece = (
            np.concatenate([getattr(blocks, name) for blocks in fleet])
            for name in ("latitude", "longitude", "log_pressure", "segment", "piece")
        )
        aircraft = np.repeat(np.arange(len(fleet)), [blocks.segment.size for blocks in fleet])
        east = _eastward(longitude, basis.origin)
        cell = basis.cells(latitude, east, number)
        change = np.zeros(piece.size, dtype=np.bool_)
        change[:1] = True
        # a piece ends at the border of its region: only the lasting part extends over it
        for value in (piece, aircraft, cell):
            change[1:] |= value[1:] != value[:-1]
        segments, segment = np.unique(cell, return_inverse=True)
        node, share = hat_products((latitude, east), basis.passing)
        # number the nodes that have blocks, segment by segment
        present = np.zeros((segments.size, basis.passing_size), dtype=np.bool_)
        present[segment[:, np.newaxis], node] = True
        place = np.cumsum(present, axis=1, dtype=np.int32) - np.int32(1)
        nodes = int(place[:, -1].max()) + 1
        node = place[segment[:, np.newaxis], node]
        node += (segment * nodes).astype(np.int32)[:, np.newaxis]
        lasting, lasting_share = hat_products((latitude, east, log_pressure), basis.lasting)
        mean = np.full((piece.size, 1), basis.lasting_size, dtype=np.int32)
        return cls(
            weight,
            means[1:3].astype(np.float64),
            means[3:].reshape(2, -1, piece.size),
            aircraft,
            np.flatnonzero(change),
            np.cumsum(change) - 1,
            node,
            share,
            np.hstack([lasting, mean]),
            np.hstack([lasting_share, np.ones(mean.shape)]),
            segment,
            segments // basis.regions,
            nodes,
            basis.region_size,
        )

    @cached_property
    def lasting_design(self) -> sparse.csr_matrix:
        """Functions of the lasting part at every block, (n, functions)."""
        return as_sparse(self.lasting, self.lasting_share, int(self.lasting[0, -1]) + 1)

    @cached_property
    def piece_sums(self) -> sparse.csr_matrix:
        """Sums over the blocks of each piece, (pieces, n)."""
        size = self.weight.size
        entries = np.ones(size), np.arange(size), np.append(self.opens, size)
        return sparse.csr_matrix(entries, shape=(self.opens.size, size))

    @cached_property
    def passing_design(self) -> sparse.csr_matrix:
        """Functions of the passing part at every block, (n, segment * nodes)."""
        return as_sparse(self.node, self.share, self.segments.size * self.nodes)


def as_sparse(index: NDArray[np.integer], value: Array, columns: int) -> sparse.csr_matrix:
    """Sparse matrix of ``columns`` columns from the places and values of every row."""
    rows, width = index.shape
    start = np.arange(0, (rows + 1) * width, width, dtype=index.dtype)
    return sparse.csr_matrix((value.ravel(), index.ravel(), start), shape=(rows, columns))


class Precision:
    """Inverse covariance of the blocks' means, with the field unknown.

    From the inverse variance of each block (n,), ``weight``; the posterior variance of a piece's
    error given its blocks (pieces,), ``tied``; and the posterior covariance of the nodes (segment,
    nodes, nodes), ``inverse``.
    """

    def __init__(self, stretch: Stretch, variances: Variances) -> None:
        self.stretch = stretch
        self.weight = 1.0 / (variances.white[stretch.aircraft] / stretch.weight + variances.block)
        total = np.add.reduceat(self.weight, stretch.opens)
        self.tied = variances.piece / (1.0 + variances.piece * total)
        nodes = stretch.nodes
        weighted = stretch.share * self.weight[:, np.newaxis]
        design = as_sparse(stretch.node, weighted, stretch.segments.size * nodes)
        of_piece = stretch.piece_sums @ design
        tied = of_piece.copy()
        tied.data *= np.repeat(self.tied, np.diff(tied.indptr))
        seen = (stretch.passing_design.T @ design - of_piece.T @ tied).tocoo()
        self.inverse = np.zeros((stretch.segments.size, nodes, nodes))
        self.inverse[seen.row // nodes, seen.row % nodes, seen.col % nodes] = seen.data
        self.inverse[:, np.arange(nodes), np.arange(nodes)] += 1.0 / variances.passing
        for matrix in self.inverse:  # in place: over a hemisphere these take most of the memory
            matrix[:] = np.linalg.inv(matrix)

    def within_pieces(self, values: Array) -> Array:
        """Apply the inverse covariance with the field known; shape (..., n)."""
        weighted = values * self.weight
        mean = np.add.reduceat(weighted, self.stretch.opens, axis=-1) * self.tied
        return np.asarray(weighted - self.weight * mean[..., self.stretch.piece])

    def passing(self, weighted: Array) -> Array:
        """Posterior mean of the passing part (segment * nodes, k).

        ``weighted`` (k, n) is the result of :meth:`within_pieces`.
        """
        right = self.stretch.passing_design.T @ weighted.T
        shape = (self.stretch.segments.size, self.stretch.nodes, right.shape[1])
        return np.asarray((self.inverse @ right.reshape(shape)).reshape(right.shape))

    def apply(self, values: Array) -> Array:
        """Apply the inverse covariance with the field unknown; shape (k, n)."""
        field = (self.stretch.passing_design @ self.passing(self.within_pieces(values))).T
        return self.within_pieces(values - field)


def estimate_variances(stretch: Stretch, white: Array) -> Variances:
    """Estimate the variances from the residuals of the fits of single aircraft.

    By expectation-maximization for the field; by moments for blocks and pieces, whose expected
    squares would need the whole inverse. ``white`` (aircraft,) is that of a report of weight one.
    """
    variances = Variances(white, 0.3, 0.5, 0.5)
    count = np.bincount(stretch.piece)
    noise = white[stretch.aircraft] / stretch.weight
    middle = stretch.opens + count // 2
    node, node_share = stretch.node[middle] % stretch.nodes, stretch.share[middle]
    segment = stretch.segment[middle][:, np.newaxis, np.newaxis]
    for _ in range(ROUNDS):
        precision = Precision(stretch, variances)
        coefficients = precision.passing(precision.within_pieces(stretch.residual))
        residual = stretch.residual - (stretch.passing_design @ coefficients).T
        mean = np.add.reduceat(residual, stretch.opens, axis=1) / count
        scatter = float(((residual - mean[:, stretch.piece]) ** 2).sum()) / 2.0
        share = 1.0 - 1.0 / count[stretch.piece]
        block = (scatter - float((share * noise).sum())) / max(float((count - 1).sum()), 1.0)
        # positive, because the precision of a part divides by its variance
        block = min(max(block, 1e-3), LARGEST_VARIANCE)
        expected = np.add.reduceat(noise + block, stretch.opens) / count**2
        # mean posterior variance of the passing part at the middle of a piece
        posterior = precision.inverse[segment, node[:, :, np.newaxis], node[:, np.newaxis]]
        unknown = float(np.einsum("pi,pij,pj->p", node_share, posterior, node_share).mean())
        piece = float((mean**2).mean() - expected.mean() + unknown)
        energy = float((coefficients**2).mean() + np.einsum("sii->si", precision.inverse).mean())
        empty = stretch.every - stretch.nodes  # nodes without blocks keep their prior variance
        passing = (energy * stretch.nodes + empty * variances.passing) / stretch.every
        variances = Variances(
            white,
            block,
            min(max(piece, 1e-3), LARGEST_VARIANCE),
            min(max(passing, 1e-4), LARGEST_VARIANCE),
        )
    return variances
