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

UNKNOWNS = SLOPES + 2
"""Unknowns of an aircraft: A to E, airspeed scale, bias eastward and northward."""
KEPT = tuple([*range(SLOPES), SLOPES + c] for c in range(2))
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
            np.concatenate([getattr(part, name) for part in blocks])
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
        some = self._stretch(segments[every // 2 :: every])
        # variance of one report of each aircraft; the fleet's median where it has too few
        within, freedom = np.array([(part.within, part.freedom) for part in blocks]).T
        known, white = freedom >= LEAST_FREEDOM, within / np.maximum(freedom, 1.0)
        white = np.where(known, white, np.median(white[known]) if known.any() else 1.0)
        # positive also for synthetic winds without noise: the precision divides by it
        self.variances = estimate_variances(some, np.maximum(white, 1e-3))
        self.some = Precision(some, self.variances)
        self.runs = _runs(segments, count, self._day_of(segments), most)
        # sums over every block: report counts by aircraft and by function of the lasting part, the
        # information with the field known, and the scores where every unknown is zero, by day
        self.worth, self.lasting_worth = np.zeros(self.aircraft), np.zeros(self.functions)
        weight, self.direct = 0.0, np.zeros((self.aircraft, UNKNOWNS, UNKNOWNS))
        self.start = np.zeros((self.days.size, self.size + self.free.size))
        for part in self._parts():
            one = part.stretch
            self.worth += np.bincount(one.aircraft, weights=one.weight, minlength=self.aircraft)
            self.lasting_worth += one.lasting_design.T @ one.weight
            weight += float(part.weight.sum())
            self.direct += _direct_information(part, self.aircraft)
            self._add_scores(part, one.residual, self.start)
        # scaling from the chosen segments to all blocks, where the information depends on the
        # field: F N F' for the aircraft's unknowns, N times ``gain`` for the lasting part's
        self.factor, self.gain = np.broadcast_to(np.eye(UNKNOWNS), self.direct.shape), 1.0
        if self.thinned:
            # the ridge gives a factor where an aircraft has no information on a parameter
            trace = np.trace(self.direct, axis1=1, axis2=2)[:, np.newaxis, np.newaxis]
            ridge = 1e-9 * trace * np.eye(UNKNOWNS)
            few = _direct_information(self.some, self.aircraft)
            thin, whole = (np.linalg.cholesky(one + ridge) for one in (few, self.direct))
            self.factor = whole @ np.linalg.inv(thin)
            self.gain = weight / float(self.some.weight.sum())
        self._sum_information()

    @property
    def size(self) -> int:
        """Number of unknowns other than the coefficients."""
        return int(2 * (self.aircraft + self.functions))

    def _sum_information(self) -> None:
        """Information of the chosen segments, in the parts from which it is multiplied."""
        precision, one, functions = self.some, self.some.stretch, self.functions
        weighted = sparse.diags(precision.weight) @ one.lasting_design
        tied = sparse.diags(precision.tied) @ (one.piece_sums @ weighted)
        lasting = weighted - sparse.diags(precision.weight) @ (one.piece_sums.T @ tied)
        # information about one component's lasting part, and between it and the aircraft's unknowns
        self.lasting = (one.lasting_design.T @ lasting).toarray()
        self.border = np.zeros((self.aircraft, UNKNOWNS, 2, functions))
        # transposed H of each component, (7 * aircraft, segment * nodes), rows by coefficient (A to
        # E, scale, bias), then aircraft; and of the lasting part
        self.nodes: list[sparse.csr_matrix] = []
        self.lasting_nodes = (one.passing_design.T @ lasting).tocsr()
        rows = np.repeat(one.aircraft, one.node.shape[1])
        shape = (self.aircraft, one.segments.size * one.nodes)
        place = (one.aircraft[:, np.newaxis] * functions + one.lasting).ravel()
        for component, kept in enumerate(KEPT):
            values = precision.within_pieces(_design(one, component))
            at_nodes = [
                sparse.coo_matrix(
                    ((one.share * row[:, np.newaxis]).ravel(), (rows, one.node.ravel())), shape
                ).tocsr()
                for row in values
            ]
            self.nodes.append(sparse.vstack(at_nodes, format="csr"))
            for k, row in zip(kept, values, strict=True):
                each = (one.lasting_share * row[:, np.newaxis]).ravel()
                sums = np.bincount(place, weights=each, minlength=self.aircraft * functions)
                self.border[:, k, component] = sums.reshape(self.aircraft, functions)

    def times(self, craft: Array, lasting: Array) -> tuple[Array, Array]:
        """Multiply the information with some columns, (aircraft, 8, k) and (2, functions, k)."""
        many, root = craft.shape[-1], np.sqrt(self.gain)
        known = self.direct @ craft
        craft, lasting = self.factor.transpose(0, 2, 1) @ craft, root * lasting
        border = self.border.reshape(-1, 2 * self.functions)
        found = (border @ lasting.reshape(-1, many)).reshape(craft.shape)
        below = (border.T @ craft.reshape(-1, many)).reshape(lasting.shape) + self.lasting @ lasting
        inverse = self.some.inverse
        for component, (kept, nodes) in enumerate(zip(KEPT, self.nodes, strict=True)):
            at_nodes = nodes.T @ craft.transpose(1, 0, 2)[kept].reshape(-1, many)
            at_nodes += self.lasting_nodes @ lasting[component]
            shape = (*inverse.shape[:2], many)
            field = (inverse @ at_nodes.reshape(shape)).reshape(at_nodes.shape)
            found[:, kept] -= (nodes @ field).reshape(len(kept), -1, many).transpose(1, 0, 2)
            below[component] -= self.lasting_nodes.T @ field
        return known + self.factor @ found, root * below

    def aircraft_blocks(self) -> Array:
        """Information about the unknowns of each aircraft, (aircraft, 8, 8)."""
        found, size = np.zeros_like(self.direct), self.some.stretch.nodes
        for kept, nodes in zip(KEPT, self.nodes, strict=True):
            columns = nodes.tocsc()
            for k, inverse in enumerate(self.some.inverse):
                part = columns[:, k * size : (k + 1) * size].tocoo()
                coefficient, aircraft = np.divmod(part.row, self.aircraft)
                here, place = np.unique(aircraft, return_inverse=True)
                design = np.zeros((here.size, len(kept), size))
                design[place, coefficient, part.col] = part.data
                taken = design @ inverse @ design.transpose(0, 2, 1)
                found[np.ix_(here, kept, kept)] -= taken
        return np.asarray(self.direct + self.factor @ found @ self.factor.transpose(0, 2, 1))

    def lasting_block(self) -> Array:
        """Information about one component's lasting part, (functions, functions)."""
        found, size = self.lasting.copy(), self.some.stretch.nodes
        for k, inverse in enumerate(self.some.inverse):
            part = self.lasting_nodes[k * size : (k + 1) * size]
            functions = np.unique(part.indices)
            design = part[:, functions].toarray()
            found[np.ix_(functions, functions)] -= design.T @ (inverse @ design)
        return np.asarray(self.gain * found)

    def leverage(self) -> Array:
        """Share of each coefficient's scatter between days that fitting removes, (aircraft, 6).

        From the aircraft's equations with the field known.
        """
        one = self.some.stretch
        _, day = np.unique(self._day_of(one.segments), return_inverse=True)
        count = int(day.max()) + 1
        group = (one.aircraft * count + day[one.segment])[one.opens]
        days = np.zeros((self.aircraft * count, UNKNOWNS, UNKNOWNS))
        for component, kept in enumerate(KEPT):
            design = _design(one, component)
            weighted = self.some.within_pieces(design)
            for i, row in zip(kept, design, strict=True):
                pieces = np.add.reduceat(weighted * row, one.opens, axis=1)
                for j, values in zip(kept, pieces, strict=True):
                    days[:, i, j] += np.bincount(group, values, minlength=days.shape[0])
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
        found = np.zeros((self.days.size, unknowns.size))
        for part in self._parts():
            one = part.stretch
            left = one.residual - (one.lasting_design @ lasting.T).T
            for k, (i, j) in enumerate(one.of_aircraft(a)):
                left[:, i:j] -= theta[k] @ one.slopes[:, :, i:j] + bias[k][:, np.newaxis]
            self._add_scores(part, left, found)
        return found

    def _stretch(self, segments: Index) -> Stretch:
        """Blocks of some segments; coefficients that are not fitted have no slope."""
        found = Stretch.of([part.of(segments) for part in self.blocks], self.basis)
        for k, (i, j) in enumerate(found.of_aircraft(self.aircraft)):
            found.slopes[:, ~self.free[k], i:j] = 0.0
        return found

    def _parts(self) -> Iterator[Precision]:
        """Iterate over all blocks, some days at a time."""
        if not self.thinned:
            yield self.some
            return
        for segments in self.runs:
            yield Precision(self._stretch(segments), self.variances)

    def _day_of(self, segments: Index) -> Index:
        return np.searchsorted(self.days, segments, side="right") - 1

    def _add_scores(self, part: Precision, left: Array, found: Array) -> None:
        """Add the scores of some whole days' blocks, from their residual."""
        one, a, functions = part.stretch, self.aircraft, self.functions
        weighted = part.apply(left)
        day = self._day_of(one.segments)
        rows, day = slice(int(day[0]), int(day[-1]) + 1), day - day[0]
        days = int(day[-1]) + 1
        group = one.aircraft[one.opens] * days + day[one.segment[one.opens]]

        def by_day(values: Array) -> Array:
            pieces = np.add.reduceat(values, one.opens)
            total = np.bincount(group, weights=pieces, minlength=a * days)
            return np.asarray(total.reshape(a, days).T)

        for k in range(SLOPES):
            score = by_day(one.slopes[0, k] * weighted[0] + one.slopes[1, k] * weighted[1])
            found[rows, k : a * SLOPES : SLOPES] = score
        for c in range(2):
            found[rows, a * SLOPES + c : a * UNKNOWNS : 2] = by_day(weighted[c])
        shift = (day * functions).astype(np.int32)[one.segment]
        daily = as_sparse(one.lasting + shift[:, np.newaxis], one.lasting_share, days * functions)
        scores = (daily.T @ weighted.T).reshape(days, functions, 2)
        found[rows, a * UNKNOWNS :] = scores.transpose(0, 2, 1).reshape(days, -1)


def _design(one: Stretch, component: int) -> Array:
    """Design of an aircraft's coefficients and bias, (7, n)."""
    return np.vstack([one.slopes[component], np.ones(one.weight.size)])


def _direct_information(precision: Precision, aircraft: int) -> Array:
    """Information about each aircraft's unknowns with the field known, (aircraft, 8, 8)."""
    one = precision.stretch
    found = np.zeros((aircraft, UNKNOWNS, UNKNOWNS))
    for k, (i, j) in enumerate(one.of_aircraft(aircraft)):
        if i == j:
            continue
        first, last = np.searchsorted(one.opens, (i, j))
        for component, kept in enumerate(KEPT):
            design = np.vstack([one.slopes[component, :, i:j], np.ones(j - i)])
            weighted = design * precision.weight[i:j]
            sums = np.add.reduceat(weighted, one.opens[first:last] - i, axis=1)
            square = weighted @ design.T - (sums * precision.tied[first:last]) @ sums.T
            found[k][np.ix_(kept, kept)] += square
    return found


def _runs(segments: Index, count: Index, day: Index, most: int) -> list[Index]:
    """Segments of whole days with at most `most` blocks together, at least one day."""
    opens = np.flatnonzero(np.diff(day, prepend=-1))
    found, total = [0], 0
    for begin, blocks in zip(opens.tolist(), np.add.reduceat(count, opens).tolist(), strict=True):
        if total and total + blocks > most:
            found.append(begin)
            total = 0
        total += blocks
    return np.split(segments, found[1:])
