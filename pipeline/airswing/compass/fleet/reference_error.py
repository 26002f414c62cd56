"""The reference's error as the whole fleet sees it: a field, and what is known of it per segment.

Assumes the error of the reference wind is a smooth field shared by every aircraft that flies
through it: a part that lasts over the archive (hat functions in latitude, longitude and ln p)
and a part that changes every six hours (hat functions about 400 km apart). Both are Gaussian
random effects whose variances are estimated from the data, so that a reference without error
leaves the fits as they were. What a flight meets beside it is an error of its own (a *piece* of a
flight shares one), an error of each block of some 200 km and white noise. An aircraft's deviation
turns with its heading and is its own; the field does neither, and that is how the two are told
apart.

Valid for any number of aircraft; the more of them share the air, the more it helps. Works on
blocks (:mod:`airswing.compass.fleet.flight_segments`), not reports. SI units and radians inside;
latitude and longitude in degrees.

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

from airswing.compass.fleet.field_basis import FieldBasis
from airswing.compass.fleet.flight_segments import Blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Short = NDArray[np.int32]
Single = NDArray[np.float32]
Flags = NDArray[np.bool_]

LARGEST_VARIANCE = 9.0
"""(m/s)2: more than this is not the reference's error."""
# Rounds in which the variances settle: each takes off the parts that the one before found.
ROUNDS = 6


@dataclass(frozen=True)
class Variances:
    """Variances of what a block's mean residual is made of, (m/s)2 a component."""

    white: Floats  # (aircraft,): of one report's weight
    block: float
    piece: float
    passing: float


@dataclass(frozen=True)
class Stretch:
    """Blocks of a fleet against one reference, end to end."""

    weight: Floats  # (n,): reports' worth
    residual: Floats  # (2, n): mean of each block, m/s
    slopes: Single  # (2, 6, n): mean of each block
    aircraft: Ints  # (n,): never falling
    opens: Ints  # (pieces,): first block of each piece
    piece: Ints  # (n,)
    # node, share: (n, up to 4): nodes of the passing part among all segments', and their values
    node: Short
    share: Floats
    # lasting, lasting_share: (n, up to 9): functions of the lasting part and, last, its mean
    lasting: Short
    lasting_share: Floats
    # (n,): place among the segments; where the field is worked in regions each region of a segment
    # stands as one
    segment: Ints
    segments: Ints  # their numbers, never falling
    # nodes of a segment that blocks meet, of the segment that has most of them; others have less
    nodes: int
    every: int  # nodes of a segment, met or not

    @classmethod
    def of(cls, parts: list[Blocks], basis: FieldBasis) -> Stretch:
        """Put the blocks of a fleet end to end.

        Parameters
        ----------
        parts : list of Blocks
            One an aircraft.
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
        change = np.ones(piece.size, dtype=np.bool_)
        change[1:] = (piece[1:] != piece[:-1]) | (aircraft[1:] != aircraft[:-1])
        cell = basis.cells(latitude, longitude, number)
        # a piece ends at the border of its region: nothing but the lasting part reaches over it
        change[1:] |= cell[1:] != cell[:-1]
        segments, _, segment = counted(cell)
        segments //= basis.regions
        node, share = basis.passing_at(latitude, longitude)
        lasting, lasting_share = basis.lasting_at(latitude, longitude, log_pressure)
        every = np.ones((piece.size, 1))
        lasting = np.hstack([lasting, every.astype(np.int32) * np.int32(basis.lasting_size)])
        lasting_share = np.hstack([lasting_share, every])
        node, nodes = _met(node, segment, segments.size, basis.passing_size)
        return cls(
            weight,
            means[1:3].astype(np.float64),
            means[3:].reshape(2, -1, piece.size),
            aircraft,
            np.flatnonzero(change),
            np.cumsum(change) - 1,
            node,
            share,
            lasting,
            lasting_share,
            segment,
            segments,
            nodes,
            basis.region_size,
        )

    @cached_property
    def lasting_design(self) -> sparse.csr_matrix:
        """Lasting part's functions at every block, shape (n, functions)."""
        return as_sparse(self.lasting, self.lasting_share, int(self.lasting[0, -1]) + 1)

    @cached_property
    def piece_sums(self) -> sparse.csr_matrix:
        """Sums over the blocks of each piece, shape (pieces, n)."""
        ends = np.append(self.opens, self.weight.size)
        each = np.ones(self.weight.size), np.arange(self.weight.size), ends
        return sparse.csr_matrix(each, shape=(self.opens.size, self.weight.size))

    @cached_property
    def passing_design(self) -> sparse.csr_matrix:
        """Passing part's functions at every block, shape (n, segment * nodes)."""
        return as_sparse(self.node, self.share, self.segments.size * self.nodes)


def _met(node: Short, segment: Ints, segments: int, every: int) -> tuple[Short, int]:
    """Number the nodes that blocks meet, segment by segment; and how many a segment has at most."""
    there = np.zeros((segments, every), dtype=np.bool_)
    there[segment[:, np.newaxis], node] = True
    number = np.cumsum(there, axis=1, dtype=np.int32) - np.int32(1)
    nodes = int(number[:, -1].max()) + 1
    found = number[segment[:, np.newaxis], node]
    found += (segment * nodes).astype(np.int32)[:, np.newaxis]
    return found, nodes


def counted(numbers: Ints) -> tuple[Ints, Ints, Ints]:
    """Numbers that occur, how often each does, and the place of every one among them.

    As :func:`numpy.unique` gives them, without sorting: for numbers that lie close together.
    """
    first = int(numbers.min())
    shifted = numbers - first
    count = np.bincount(shifted)
    found = np.flatnonzero(count)
    place = np.zeros(count.size, dtype=np.int64)
    place[found] = np.arange(found.size)
    return found + first, count[found], place[shifted]


def bounds_of(group: Ints, groups: int) -> list[tuple[int, int]]:
    """Where each group of a never falling array begins and ends.

    Parameters
    ----------
    group : array of int, shape (n,)
        0 .. groups - 1.

    Returns
    -------
    list of pair of int
    """
    edges = np.searchsorted(group, np.arange(groups + 1))
    return [(int(i), int(j)) for i, j in pairwise(edges)]


def as_sparse(index: NDArray[np.integer], value: Floats, columns: int) -> sparse.csr_matrix:
    """Sparse matrix of ``columns`` columns from the values and places of every row."""
    rows, each = index.shape
    start = np.arange(0, (rows + 1) * each, each, dtype=index.dtype)
    return sparse.csr_matrix((value.ravel(), index.ravel(), start), shape=(rows, columns))


class Precision:
    """Inverse covariance of the blocks' means: the field unknown, a piece's error shared by it.

    Parameters
    ----------
    stretch : Stretch
    variances : Variances
    inverse : array of float, shape (segment, nodes, nodes), optional
        Posterior covariance of the nodes, where it is known already.
    """

    def __init__(self, stretch: Stretch, variances: Variances, inverse: Floats | None = None):
        self.stretch = stretch
        white = variances.white[stretch.aircraft] / stretch.weight
        self.weight = 1.0 / (white + variances.block)
        total = np.add.reduceat(self.weight, stretch.opens)
        self.tied = variances.piece / (1.0 + variances.piece * total)
        self.inverse = self._node_inverse(variances.passing) if inverse is None else inverse

    def within_pieces(self, values: Floats) -> Floats:
        """Apply the inverse covariance where the field is known; shape (..., n).

        Parameters
        ----------
        values : array of float, shape (..., n)
        """
        found = values * self.weight
        mean = np.add.reduceat(found, self.stretch.opens, axis=-1) * self.tied
        found -= self.weight * mean[..., self.stretch.piece]
        return np.asarray(found)

    def passing(self, weighted: Floats) -> Floats:
        """Most likely passing part; shape (segment * nodes, k).

        Parameters
        ----------
        weighted : array of float, shape (k, n)
            Of :meth:`within_pieces`.
        """
        right = self.stretch.passing_design.T @ weighted.T
        shape = (self.stretch.segments.size, self.stretch.nodes, right.shape[1])
        return np.asarray((self.inverse @ right.reshape(shape)).reshape(right.shape))

    def apply(self, values: Floats) -> Floats:
        """Apply the inverse covariance, the field unknown; shape (k, n).

        Parameters
        ----------
        values : array of float, shape (k, n)
        """
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
        seen = one.passing_design.T @ design - of_piece.T @ tied
        seen = seen.tocoo()
        found = np.zeros((one.segments.size, nodes, nodes))
        found[seen.row // nodes, seen.row % nodes, seen.col % nodes] = seen.data
        found[:, np.arange(nodes), np.arange(nodes)] += 1.0 / variance
        for one_segment in found:  # in place: over a hemisphere these are most of the memory
            one_segment[:] = np.linalg.inv(one_segment)
        return found


def estimate_variances(stretch: Stretch, white: Floats) -> Variances:
    """Find the variances from what the aircraft's own fits leave unexplained.

    Parameters
    ----------
    white : array of float, shape (aircraft,)
    """
    # Beside expectation for the field, moments for blocks and pieces: there are as many of those as
    # reports, and of each the expected square would be an entry of the whole inverse.
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
        # never nothing: the precision of a part divides by its variance
        block = min(max(block, 1e-3), LARGEST_VARIANCE)
        own = np.add.reduceat(noise + block, stretch.opens) / count**2
        unknown = _piece_uncertainty(precision, count)
        piece = float((mean**2).mean() - own.mean() + unknown)
        energy = coefficients.reshape(stretch.segments.size, stretch.nodes, 2) ** 2
        apart = stretch.every - stretch.nodes  # nobody's: as uncertain as before
        passing = (
            float(
                (energy.mean() + np.einsum("sii->si", precision.inverse).mean()) * stretch.nodes
                + apart * found.passing
            )
            / stretch.every
        )
        found = Variances(
            white,
            block,
            # as of the block: never nothing
            min(max(piece, 1e-3), LARGEST_VARIANCE),
            min(max(passing, 1e-4), LARGEST_VARIANCE),
        )
    return found


def _piece_uncertainty(precision: Precision, count: Ints) -> float:
    """Mean posterior variance of the passing part at the middle of a piece."""
    one = precision.stretch
    middle = one.opens + count // 2
    segment, total = one.segment[middle], 0.0
    column, value = one.node[middle].T % one.nodes, one.share[middle].T
    for row, share in zip(column, value, strict=True):
        for other, part in zip(column, value, strict=True):
            total += float((share * part * precision.inverse[segment, row, other]).mean())
    return total
