"""Error of the reference wind that a fleet shows: a field, its basis and its precision by segment.

Assumes that the error of the reference wind is a smooth field common to all aircraft in it: a part
that lasts over the archive (hat functions in latitude, longitude and ln p) and a part that changes
every six hours (hat functions about 400 km apart). Both are Gaussian random effects with variances
estimated from the data, so that a reference without error leaves the fits unchanged. A flight has
in addition an error common to a *piece* of it, an error of each block of some 200 km, and white
noise. The deviation of an aircraft varies with its heading and is the same at all places; the field
is neither, which separates the two.

Places are given by latitude, longitude (degrees) and ln p. The seam of longitude is where the
fewest blocks are, so that the date line and a hemisphere need no special case.

A passing part of more than `MOST_NODES` nodes is divided into regions: within a segment, blocks of
different regions are taken as independent, although nodes reach over the border (a node is in each
region with blocks near it). The borders move from one segment to the next, so that the regions of
five segments overlap and no place is always at a border. The lasting part is never divided.

Valid for any number of aircraft; the more of them fly in the same air, the more it helps. Works on
blocks (`airswing.compass.fleet.blocks`). SI units and radians; latitude and longitude in degrees.

References
----------
Henderson 1975, Biometrics 31, 423-447 (mixed model equations); Laird & Ware 1982, Biometrics 38,
963-974 (variances by expectation-maximization).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from airswing.compass.fleet.blocks import Blocks
from airswing.physics.splines import hats_not_zero
from airswing.physics.triangle import wrap_degrees
from airswing.units import METRES_PER_DEGREE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Short = NDArray[np.int32]
Single = NDArray[np.float32]
Flags = NDArray[np.bool_]

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
"""Positions that the borders of regions take in turn; no divisor of the four segments of a day."""


@dataclass(frozen=True)
class FieldBasis:
    """Nodes of the lasting and the passing part of the field."""

    lasting: tuple[Floats, ...]  # nodes in latitude, eastward degrees and ln p
    passing: tuple[Floats, ...]  # nodes in latitude and eastward degrees
    origin: tuple[float, float]  # longitude of the middle, cosine of the middle latitude

    @classmethod
    def of(cls, latitude: Floats, longitude: Floats, log_pressure: Floats) -> FieldBasis:
        """Place the nodes for some blocks.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        log_pressure : array of float, shape (n,)
        """
        origin = (_middle(longitude), float(np.cos(np.radians(np.median(latitude)))))
        east = _eastward(longitude, origin)
        places = (latitude, east, log_pressure)
        apart = (STATIC_SPACING, STATIC_SPACING, np.inf)
        lasting = tuple(
            np.unique(
                np.quantile(values, np.linspace(0, 1, max(nodes, 1 + int(np.ptp(values) // step))))
            )
            for values, nodes, step in zip(places, STATIC_NODES, apart, strict=True)
        )
        return cls(lasting, tuple(_even(v) for v in (latitude, east)), origin)

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
        found = 1
        for nodes, parts in zip(self.passing, self.cuts, strict=True):
            # with the nodes beyond both borders
            found *= min(nodes.size, -(-(nodes.size - 1) // parts) + 2)
        return found

    def lasting_at(
        self, latitude: Floats, longitude: Floats, log_pressure: Floats
    ) -> tuple[Short, Floats]:
        """Return the functions of the lasting part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 8)
            The values at a place add up to one.
        """
        return _product((latitude, _eastward(longitude, self.origin), log_pressure), self.lasting)

    def passing_at(self, latitude: Floats, longitude: Floats) -> tuple[Short, Floats]:
        """Return the functions of the passing part that are not zero at some places.

        Returns
        -------
        index, value : arrays, shape (n, up to 4)
            The values at a place add up to one.
        """
        return _product((latitude, _eastward(longitude, self.origin)), self.passing)

    def cells(self, latitude: Floats, longitude: Floats, segment: Ints) -> Ints:
        """Return the region of some places in their segments.

        Parameters
        ----------
        latitude, longitude : arrays of float, shape (n,), degrees
        segment : array of int, shape (n,)

        Returns
        -------
        array of int, shape (n,)
            Segment times number of regions, plus the region.
        """
        if self.regions == 1:
            return segment
        found = np.zeros(segment.size, dtype=np.int64)
        shift = (segment % SHIFTS) / SHIFTS
        places = (latitude, _eastward(longitude, self.origin))
        for values, nodes, parts in zip(places, self.passing, self.cuts, strict=True):
            if parts > 1:
                width = float(nodes[-1] - nodes[0]) / parts
                part = np.floor((values - nodes[0]) / width + shift).astype(np.int64)
                found = found * (parts + 1) + np.clip(part, 0, parts)
        return np.asarray(segment * np.int64(self.regions) + found)


def _middle(longitude: Floats) -> float:
    """Longitude opposite the widest gap; where there is none, opposite the fewest blocks."""
    degree = np.floor(longitude % 360.0).astype(np.int64) % 360
    count = np.bincount(degree, minlength=360)
    least = np.tile(count == count.min(), 2)
    # twice around, for a gap across the meridian where counting begins
    run = np.zeros(720, dtype=np.int64)
    for k in range(1, 720):
        run[k] = (run[k - 1] + 1) * least[k]
    last = int(np.argmax(np.minimum(run, 360)))
    return (last + 1 - float(run[last]) / 2.0 + 180.0) % 360.0


def _eastward(longitude: Floats, origin: tuple[float, float]) -> Floats:
    """Degrees of great circle east of the middle, without a jump at the antimeridian."""
    return np.asarray(wrap_degrees(longitude - origin[0]) * origin[1])


def _even(values: Floats) -> Floats:
    low, high = float(values.min()), float(values.max())
    count = max(2, round((high - low) / SPACING) + 1)
    return np.linspace(low, high, count) if high > low else np.array([low])


def _product(values: tuple[Floats, ...], nodes: tuple[Floats, ...]) -> tuple[Short, Floats]:
    """Products of the hat functions of every coordinate."""
    index = np.zeros((values[0].size, 1), dtype=np.int32)
    value = np.ones((values[0].size, 1))
    for coordinate, knots in zip(values, nodes, strict=True):
        left, share = hats_not_zero(coordinate, knots)
        index = (index * np.int32(knots.size))[:, :, np.newaxis] + left[:, np.newaxis]
        value = value[:, :, np.newaxis] * share[:, np.newaxis]
        index, value = index.reshape(len(index), -1), value.reshape(len(value), -1)
    return index, value


LARGEST_VARIANCE = 9.0
"""(m/s)2: bound of every variance; a larger one is no error of the reference."""
ROUNDS = 6
"""Rounds of the variances, each with the field removed that the round before found."""


@dataclass(frozen=True)
class Variances:
    """Variances of the parts of a block's mean residual, (m/s)2 for each component."""

    white: Floats  # (aircraft,): of a report of weight one
    block: float
    piece: float
    passing: float


@dataclass(frozen=True)
class Stretch:
    """Blocks of a fleet against one reference, end to end; n blocks.

    Where the field is divided into regions each region of a segment counts as a segment.
    """

    weight: Floats  # (n,): in reports
    residual: Floats  # (2, n): mean of each block, m/s
    slopes: Single  # (2, 6, n): mean of each block
    aircraft: Ints  # (n,): not decreasing
    opens: Ints  # (pieces,): first block of each piece
    piece: Ints  # (n,)
    node: Short  # (n, up to 4): nodes of the passing part, numbered over all segments
    share: Floats  # (n, up to 4): values of their functions
    lasting: Short  # (n, up to 9): functions of the lasting part and, last, its mean
    lasting_share: Floats  # (n, up to 9): their values
    segment: Ints  # (n,): place among the segments
    segments: Ints  # numbers of the segments, not decreasing
    nodes: int  # largest number of nodes with blocks in one segment; others are filled up to it
    every: int  # number of nodes of a segment, with or without blocks

    @classmethod
    def of(cls, parts: list[Blocks], basis: FieldBasis) -> Stretch:
        """Concatenate the blocks of a fleet.

        Parameters
        ----------
        parts : list of Blocks
            One an aircraft.
        basis : FieldBasis
        """
        count = np.array([part.size for part in parts])
        means = np.concatenate([part.sums for part in parts], axis=1)
        weight = means[0].astype(np.float64)
        means[1:] *= (1.0 / weight).astype(np.float32)
        latitude, longitude, log_pressure, number = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("latitude", "longitude", "log_pressure", "segment")
        )
        aircraft = np.repeat(np.arange(count.size), count)
        piece = np.concatenate([part.piece for part in parts])
        cell = basis.cells(latitude, longitude, number)
        change = np.zeros(piece.size, dtype=np.bool_)
        change[:1] = True
        # a piece ends at the border of its region: only the lasting part extends over it
        for value in (piece, aircraft, cell):
            change[1:] |= value[1:] != value[:-1]
        segments, segment = np.unique(cell, return_inverse=True)
        node, share = basis.passing_at(latitude, longitude)
        lasting, lasting_share = basis.lasting_at(latitude, longitude, log_pressure)
        mean = np.full((piece.size, 1), basis.lasting_size, dtype=np.int32)
        node, nodes = _nodes_with_blocks(node, segment, segments.size, basis.passing_size)
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
        """Functions of the lasting part at every block, shape (n, functions)."""
        return as_sparse(self.lasting, self.lasting_share, int(self.lasting[0, -1]) + 1)

    @cached_property
    def piece_sums(self) -> sparse.csr_matrix:
        """Sums over the blocks of each piece, shape (pieces, n)."""
        ends = np.append(self.opens, self.weight.size)
        each = np.ones(self.weight.size), np.arange(self.weight.size), ends
        return sparse.csr_matrix(each, shape=(self.opens.size, self.weight.size))

    @cached_property
    def passing_design(self) -> sparse.csr_matrix:
        """Functions of the passing part at every block, shape (n, segment * nodes)."""
        return as_sparse(self.node, self.share, self.segments.size * self.nodes)


def _nodes_with_blocks(node: Short, segment: Ints, segments: int, every: int) -> tuple[Short, int]:
    """Number the nodes that have blocks, segment by segment; and the largest number of them."""
    present = np.zeros((segments, every), dtype=np.bool_)
    present[segment[:, np.newaxis], node] = True
    number = np.cumsum(present, axis=1, dtype=np.int32) - np.int32(1)
    nodes = int(number[:, -1].max()) + 1
    found = number[segment[:, np.newaxis], node]
    found += (segment * nodes).astype(np.int32)[:, np.newaxis]
    return found, nodes


def bounds_of(group: Ints, groups: int) -> list[tuple[int, int]]:
    """Return the first and one past the last element of each group of a sorted array.

    Parameters
    ----------
    group : array of int, shape (n,)
        0 .. groups - 1, not decreasing.
    groups : int
    """
    return list(pairwise(np.searchsorted(group, np.arange(groups + 1)).tolist()))


def as_sparse(index: NDArray[np.integer], value: Floats, columns: int) -> sparse.csr_matrix:
    """Return a sparse matrix of ``columns`` columns from the places and values of every row."""
    rows, each = index.shape
    start = np.arange(0, (rows + 1) * each, each, dtype=index.dtype)
    return sparse.csr_matrix((value.ravel(), index.ravel(), start), shape=(rows, columns))


class Precision:
    """Inverse covariance of the blocks' means, with the field unknown.

    Attributes
    ----------
    weight : array, shape (n,)
        Inverse variance of each block.
    tied : array, shape (pieces,)
        Variance of a piece's error that is left by its blocks.
    inverse : array, shape (segment, nodes, nodes)
        Posterior covariance of the nodes.
    """

    def __init__(self, stretch: Stretch, variances: Variances) -> None:
        self.stretch = stretch
        white = variances.white[stretch.aircraft] / stretch.weight
        self.weight = 1.0 / (white + variances.block)
        total = np.add.reduceat(self.weight, stretch.opens)
        self.tied = variances.piece / (1.0 + variances.piece * total)
        self.inverse = self._node_inverse(variances.passing)

    def within_pieces(self, values: Floats) -> Floats:
        """Apply the inverse covariance with the field known; shape (..., n)."""
        found = values * self.weight
        mean = np.add.reduceat(found, self.stretch.opens, axis=-1) * self.tied
        return np.asarray(found - self.weight * mean[..., self.stretch.piece])

    def passing(self, weighted: Floats) -> Floats:
        """Return the posterior mean of the passing part, shape (segment * nodes, k).

        ``weighted`` (k, n) is the result of :meth:`within_pieces`.
        """
        right = self.stretch.passing_design.T @ weighted.T
        shape = (self.stretch.segments.size, self.stretch.nodes, right.shape[1])
        return np.asarray((self.inverse @ right.reshape(shape)).reshape(right.shape))

    def apply(self, values: Floats) -> Floats:
        """Apply the inverse covariance with the field unknown; shape (k, n)."""
        field = (self.stretch.passing_design @ self.passing(self.within_pieces(values))).T
        return self.within_pieces(values - field)

    def _node_inverse(self, variance: float) -> Floats:
        """Posterior covariance of every segment's nodes, shape (segment, nodes, nodes)."""
        one, nodes = self.stretch, self.stretch.nodes
        weighted = one.share * self.weight[:, np.newaxis]
        design = as_sparse(one.node, weighted, one.segments.size * nodes)
        of_piece = one.piece_sums @ design
        tied = of_piece.copy()
        tied.data *= np.repeat(self.tied, np.diff(tied.indptr))
        seen = (one.passing_design.T @ design - of_piece.T @ tied).tocoo()
        found = np.zeros((one.segments.size, nodes, nodes))
        found[seen.row // nodes, seen.row % nodes, seen.col % nodes] = seen.data
        found[:, np.arange(nodes), np.arange(nodes)] += 1.0 / variance
        for matrix in found:  # in place: over a hemisphere these take most of the memory
            matrix[:] = np.linalg.inv(matrix)
        return found


def estimate_variances(stretch: Stretch, white: Floats) -> Variances:
    """Estimate the variances from the residuals of the fits of single aircraft.

    By expectation-maximization for the field; by moments for blocks and pieces, whose expected
    squares would need the whole inverse.

    Parameters
    ----------
    stretch : Stretch
    white : array of float, shape (aircraft,)
        Variance of a report of weight one.
    """
    found = Variances(white, 0.3, 0.5, 0.5)
    count = np.bincount(stretch.piece)
    noise = white[stretch.aircraft] / stretch.weight
    for _ in range(ROUNDS):
        precision = Precision(stretch, found)
        coefficients = precision.passing(precision.within_pieces(stretch.residual))
        left = stretch.residual - (stretch.passing_design @ coefficients).T
        mean = np.add.reduceat(left, stretch.opens, axis=1) / count
        apart = float(((left - mean[:, stretch.piece]) ** 2).sum()) / 2.0
        share = 1.0 - 1.0 / count[stretch.piece]
        block = (apart - float((share * noise).sum())) / max(float((count - 1).sum()), 1.0)
        # above zero: the precision of a part divides by its variance
        block = min(max(block, 1e-3), LARGEST_VARIANCE)
        expected = np.add.reduceat(noise + block, stretch.opens) / count**2
        unknown = _piece_uncertainty(precision, count)
        piece = float((mean**2).mean() - expected.mean() + unknown)
        energy = coefficients.reshape(stretch.segments.size, stretch.nodes, 2) ** 2
        unseen = stretch.every - stretch.nodes  # nodes without blocks keep their prior variance
        passing = (
            float(
                (energy.mean() + np.einsum("sii->si", precision.inverse).mean()) * stretch.nodes
                + unseen * found.passing
            )
            / stretch.every
        )
        found = Variances(
            white,
            block,
            min(max(piece, 1e-3), LARGEST_VARIANCE),
            min(max(passing, 1e-4), LARGEST_VARIANCE),
        )
    return found


def _piece_uncertainty(precision: Precision, count: Ints) -> float:
    """Mean posterior variance of the passing part at the middle of a piece."""
    one = precision.stretch
    middle = one.opens + count // 2
    node, share = one.node[middle] % one.nodes, one.share[middle]
    segment = one.segment[middle][:, np.newaxis, np.newaxis]
    posterior = precision.inverse[segment, node[:, :, np.newaxis], node[:, np.newaxis]]
    return float(np.einsum("pi,pij,pj->p", share, posterior, share).mean())
