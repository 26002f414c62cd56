"""Information of one reference's blocks about the unknowns of the fleet.

The unknowns are the coefficients of each aircraft (A to E and the airspeed scale), a bias of each
aircraft in two components, and the lasting part of the field (`airswing.compass.fleet.field`) in
two components; passing part, pieces and blocks are in the weights (generalized least squares).

Aircraft are connected only by the field: if it were known, the information of each would be a
separate block. The passing part reduces it by H' G H, with G the posterior covariance of a
segment's nodes and H the weighted sums of an aircraft's design at the nodes it flew near, a sparse
matrix. The whole matrix is multiplied without being formed.

The equations of whole days are formed together, about `MOST_BLOCKS` blocks, so that memory grows
with the archive only by the blocks' sums and by a score of each unknown a day. With more blocks,
variances and information are computed from evenly chosen segments and scaled to all blocks; the
scores are always of every block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from airswing.compass.fleet.field import (
    SLOPES,
    Array,
    Blocks,
    FieldBasis,
    Index,
    Precision,
    Stretch,
    as_sparse,
    estimate_variances,
)
from airswing.products.ragged import aircraft_groups

UNKNOWNS = SLOPES + 2
"""Unknowns of an aircraft: A to E, airspeed scale, bias eastward and northward."""
OF_COMPONENT = tuple([*range(SLOPES), SLOPES + c] for c in range(2))
"""Unknowns that enter each component of the residual."""
MOST_BLOCKS = 50_000  # approximate number of blocks whose equations are formed together
AIRCRAFT = 125
"""Number of aircraft above which `MOST_BLOCKS` grows in proportion: an aircraft must occur on some
of the days."""
MOST_NUMBERS = 100_000_000
"""Most elements of the passing part's covariances that are formed together."""
LEAST_FREEDOM = 30
"""Fewest degrees of freedom within blocks for an estimate of an aircraft's white noise."""


class Reference:
    """One reference's part of the equations of the fleet.

    From the blocks of each aircraft, the coefficients that are fitted (aircraft, 6) and the first
    segment of every day. The unknowns are, in this order, the coefficients (aircraft, 6), the
    biases (aircraft, 2) and the lasting part (2, functions).
    """

    def __init__(self, blocks: list[Blocks], free: NDArray[np.bool_], days: Index) -> None:
        self.blocks, self.free, self.days = blocks, free, days
        latitude, longitude, log_pressure, segment = (
            np.concatenate([getattr(sums, name) for sums in blocks])
            for name in ("latitude", "longitude", "log_pressure", "segment")
        )
        self.basis = FieldBasis.of(latitude, longitude, log_pressure)
        self.aircraft, self.functions = free.shape[0], self.basis.lasting_size + 1
        segments, count = np.unique(segment, return_counts=True)
        most = int(MOST_BLOCKS * max(1.0, self.aircraft / AIRCRAFT))
        # a segment of many nodes counts as the blocks that take the same memory
        nodes = min(self.basis.passing_size, 4 * int(count.max()))
        numbers = min(nodes**2, min(nodes, self.basis.region_size) ** 2 * self.basis.regions)
        count = np.maximum(count, numbers * most // MOST_NUMBERS)
        every = -(-int(count.sum()) // most)
        self.thinned = every > 1
        sample = self._stretch(segments[every // 2 :: every])
        # variance of one report of each aircraft; the fleet's median where it has too few
        within, freedom = np.array([(sums.within, sums.freedom) for sums in blocks]).T
        measured, white = freedom >= LEAST_FREEDOM, within / np.maximum(freedom, 1.0)
        white = np.where(measured, white, np.median(white[measured]) if measured.any() else 1.0)
        # positive also for synthetic winds without noise: the precision divides by it
        self.variances = estimate_variances(sample, np.maximum(white, 1e-3))
        self.sample = Precision(sample, self.variances)
        self.runs = _runs(segments, count, self._day_of(segments), most)
        # sums over every block: report counts by aircraft and by function of the lasting part, the
        # information with the field known, and the scores where every unknown is zero, by day
        self.worth, self.lasting_worth = np.zeros(self.aircraft), np.zeros(self.functions)
        weight, self.direct = 0.0, np.zeros((self.aircraft, UNKNOWNS, UNKNOWNS))
        self.start = np.zeros((self.days.size, self.size + self.free.size))
        for precision in self._precisions():
            stretch = precision.stretch
            self.worth += np.bincount(stretch.aircraft, stretch.weight, self.aircraft)
            self.lasting_worth += stretch.lasting_design.T @ stretch.weight
            weight += float(precision.weight.sum())
            self.direct += _direct_information(precision, stretch.aircraft, self.aircraft)
            self._add_scores(precision, stretch.residual, self.start)
        # scaling from the chosen segments to all blocks, where the information depends on the
        # field: F N F' for the aircraft's unknowns, N times ``gain`` for the lasting part's
        self.factor, self.gain = np.broadcast_to(np.eye(UNKNOWNS), self.direct.shape), 1.0
        if self.thinned:
            # the ridge gives a factor where an aircraft has no information on a parameter
            trace = np.trace(self.direct, axis1=1, axis2=2)[:, np.newaxis, np.newaxis]
            ridge = 1e-9 * trace * np.eye(UNKNOWNS)
            few = _direct_information(self.sample, sample.aircraft, self.aircraft)
            thin, full = (np.linalg.cholesky(matrix + ridge) for matrix in (few, self.direct))
            self.factor = full @ np.linalg.inv(thin)
            self.gain = weight / float(self.sample.weight.sum())
        self._sum_information()

    @property
    def size(self) -> int:
        """Number of unknowns other than the coefficients."""
        return int(2 * (self.aircraft + self.functions))

    def _sum_information(self) -> None:
        precision, stretch, functions = self.sample, self.sample.stretch, self.functions
        weighted = sparse.diags(precision.weight) @ stretch.lasting_design
        tied = sparse.diags(precision.tied) @ (stretch.piece_sums @ weighted)
        lasting = weighted - sparse.diags(precision.weight) @ (stretch.piece_sums.T @ tied)
        # information about one component's lasting part, and between it and the aircraft's unknowns
        self.lasting = (stretch.lasting_design.T @ lasting).toarray()
        self.border = np.zeros((self.aircraft, UNKNOWNS, 2, functions))
        # transposed H of each component, (7 * aircraft, segment * nodes), rows by coefficient (A to
        # E, scale, bias), then aircraft; and of the lasting part
        self.nodes: list[sparse.csr_matrix] = []
        self.lasting_nodes = (stretch.passing_design.T @ lasting).tocsr()
        index = np.repeat(stretch.aircraft, stretch.node.shape[1]), stretch.node.ravel()
        shape = (self.aircraft, stretch.segments.size * stretch.nodes)
        place = (stretch.aircraft[:, np.newaxis] * functions + stretch.lasting).ravel()
        for component, unknowns in enumerate(OF_COMPONENT):
            values = precision.within_pieces(_design(stretch, component))
            at_nodes = [
                sparse.csr_matrix(((stretch.share * row[:, np.newaxis]).ravel(), index), shape)
                for row in values
            ]
            self.nodes.append(sparse.vstack(at_nodes, format="csr"))
            for k, row in zip(unknowns, values, strict=True):
                shares = (stretch.lasting_share * row[:, np.newaxis]).ravel()
                sums = np.bincount(place, weights=shares, minlength=self.aircraft * functions)
                self.border[:, k, component] = sums.reshape(self.aircraft, functions)

    def times(self, craft: Array, lasting: Array) -> tuple[Array, Array]:
        """Multiply the information with some columns, (aircraft, 8, k) and (2, functions, k)."""
        width, root = craft.shape[-1], np.sqrt(self.gain)
        direct = self.direct @ craft
        craft, lasting = self.factor.transpose(0, 2, 1) @ craft, root * lasting
        border = self.border.reshape(-1, 2 * self.functions)
        above = (border @ lasting.reshape(-1, width)).reshape(craft.shape)
        below = (border.T @ craft.reshape(-1, width)).reshape(lasting.shape)
        below += self.lasting @ lasting
        inverse = self.sample.inverse
        for component, (rows, nodes) in enumerate(zip(OF_COMPONENT, self.nodes, strict=True)):
            at_nodes = nodes.T @ craft.transpose(1, 0, 2)[rows].reshape(-1, width)
            at_nodes += self.lasting_nodes @ lasting[component]
            shape = (*inverse.shape[:2], width)
            field = (inverse @ at_nodes.reshape(shape)).reshape(at_nodes.shape)
            above[:, rows] -= (nodes @ field).reshape(len(rows), -1, width).transpose(1, 0, 2)
            below[component] -= self.lasting_nodes.T @ field
        return direct + self.factor @ above, root * below

    def aircraft_blocks(self) -> Array:
        """Information about the unknowns of each aircraft, (aircraft, 8, 8)."""
        information, size = np.zeros_like(self.direct), self.sample.stretch.nodes
        for unknowns, nodes in zip(OF_COMPONENT, self.nodes, strict=True):
            columns = nodes.tocsc()
            for k, inverse in enumerate(self.sample.inverse):
                block = columns[:, k * size : (k + 1) * size].tocoo()
                coefficient, aircraft = np.divmod(block.row, self.aircraft)
                present, place = np.unique(aircraft, return_inverse=True)
                design = np.zeros((present.size, len(unknowns), size))
                design[place, coefficient, block.col] = block.data
                reduction = design @ inverse @ design.transpose(0, 2, 1)
                information[np.ix_(present, unknowns, unknowns)] -= reduction
        return np.asarray(self.direct + self.factor @ information @ self.factor.transpose(0, 2, 1))

    def lasting_block(self) -> Array:
        """Information about one component's lasting part, (functions, functions)."""
        information, size = self.lasting.copy(), self.sample.stretch.nodes
        for k, inverse in enumerate(self.sample.inverse):
            block = self.lasting_nodes[k * size : (k + 1) * size]
            functions = np.unique(block.indices)
            design = block[:, functions].toarray()
            information[np.ix_(functions, functions)] -= design.T @ (inverse @ design)
        return np.asarray(self.gain * information)

    def leverage(self) -> Array:
        """Share of each coefficient's scatter between days that fitting removes, (aircraft, 6).

        From the aircraft's equations with the field known.
        """
        stretch = self.sample.stretch
        _, day = np.unique(self._day_of(stretch.segments), return_inverse=True)
        count = int(day.max()) + 1
        group = stretch.aircraft * count + day[stretch.segment]
        days = _direct_information(self.sample, group, self.aircraft * count)
        days = days.reshape(self.aircraft, count, UNKNOWNS, UNKNOWNS)
        total = days.sum(axis=1)
        trace = np.trace(total, axis1=1, axis2=2)[:, np.newaxis, np.newaxis]
        # an aircraft without blocks on these days: no leverage
        ridge = np.where(trace > 0, 1e-9 * trace, 1.0) * np.eye(UNKNOWNS)
        inverse = np.linalg.inv(total + ridge)
        removed = inverse @ (days @ inverse[:, np.newaxis] @ days).sum(axis=1) @ inverse
        share = np.diagonal(removed, axis1=1, axis2=2) / np.diagonal(inverse, axis1=1, axis2=2)
        return np.asarray(np.minimum(share[:, :SLOPES] * count / self.days.size, 0.5))

    def scores(self, unknowns: Array) -> Array:
        """Score of every unknown by day, (day, unknown)."""
        a = self.aircraft
        theta = unknowns[: a * SLOPES].reshape(a, SLOPES)
        bias = unknowns[a * SLOPES : a * UNKNOWNS].reshape(a, 2)
        lasting = unknowns[a * UNKNOWNS :].reshape(2, -1)
        scores = np.zeros((self.days.size, unknowns.size))
        for precision in self._precisions():
            stretch = precision.stretch
            residual = stretch.residual - (stretch.lasting_design @ lasting.T).T
            residual -= np.einsum("ckn,nk->cn", stretch.slopes, theta[stretch.aircraft])
            residual -= bias[stretch.aircraft].T
            self._add_scores(precision, residual, scores)
        return scores

    def _stretch(self, segments: Index) -> Stretch:
        """Blocks of some segments; coefficients that are not fitted have no slope."""
        stretch = Stretch.of([sums.of(segments) for sums in self.blocks], self.basis)
        np.multiply(stretch.slopes, self.free[stretch.aircraft].T, out=stretch.slopes)
        return stretch

    def _precisions(self) -> Iterator[Precision]:
        """Iterate over all blocks, some days at a time."""
        if not self.thinned:
            yield self.sample
            return
        for segments in self.runs:
            yield Precision(self._stretch(segments), self.variances)

    def _day_of(self, segments: Index) -> Index:
        return np.searchsorted(self.days, segments, side="right") - 1

    def _add_scores(self, precision: Precision, residual: Array, scores: Array) -> None:
        stretch, a, functions = precision.stretch, self.aircraft, self.functions
        weighted = precision.apply(residual)
        day = self._day_of(stretch.segments)
        rows, day = slice(int(day[0]), int(day[-1]) + 1), day - day[0]
        days = int(day[-1]) + 1
        group = stretch.aircraft[stretch.opens] * days + day[stretch.segment[stretch.opens]]

        def by_day(values: Array) -> Array:
            pieces = np.add.reduceat(values, stretch.opens)
            total = np.bincount(group, weights=pieces, minlength=a * days)
            return np.asarray(total.reshape(a, days).T)

        for k in range(SLOPES):
            score = by_day(stretch.slopes[0, k] * weighted[0] + stretch.slopes[1, k] * weighted[1])
            scores[rows, k : a * SLOPES : SLOPES] = score
        for c in range(2):
            scores[rows, a * SLOPES + c : a * UNKNOWNS : 2] = by_day(weighted[c])
        index = stretch.lasting + (day * functions).astype(np.int32)[stretch.segment][:, np.newaxis]
        daily = as_sparse(index, stretch.lasting_share, days * functions)
        lasting = (daily.T @ weighted.T).reshape(days, functions, 2)
        scores[rows, a * UNKNOWNS :] = lasting.transpose(0, 2, 1).reshape(days, -1)


def _design(stretch: Stretch, component: int) -> Array:
    """Design of an aircraft's coefficients and bias, (7, n)."""
    return np.vstack([stretch.slopes[component], np.ones(stretch.weight.size)])


def _direct_information(precision: Precision, group: Index, groups: int) -> Array:
    """Information about an aircraft's unknowns with the field known, (groups, 8, 8).

    ``group`` (n,) is that of each block, 0 to ``groups - 1``; all blocks of a piece have the same.
    """
    stretch = precision.stretch
    of_piece = group[stretch.opens]
    information = np.zeros((groups, UNKNOWNS, UNKNOWNS))
    for component, unknowns in enumerate(OF_COMPONENT):
        design = _design(stretch, component)
        weighted = precision.within_pieces(design)
        for i, row in zip(unknowns, design, strict=True):
            pieces = np.add.reduceat(weighted * row, stretch.opens, axis=1)
            for j, values in zip(unknowns, pieces, strict=True):
                information[:, i, j] += np.bincount(of_piece, values, groups)
    return information


def _runs(segments: Index, count: Index, day: Index, most: int) -> list[Index]:
    """Segments of whole days with at most `most` blocks together, at least one day."""
    opens = np.flatnonzero(np.diff(day, prepend=-1))
    runs = aircraft_groups(np.add.reduceat(count, opens), most)
    return np.split(segments, [opens[run.start] for run in runs[1:]])
