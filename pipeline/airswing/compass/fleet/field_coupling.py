"""What a reference's blocks say about the fleet's unknowns, kept in parts linear in the aircraft.

Assumes what :mod:`airswing.compass.fleet.reference_error` assumes. Aircraft meet in the field
alone: were it known, each aircraft's information would be a block of its own. What the passing
part takes away is H' G H, with G the posterior covariance of a segment's nodes and H the weighted
sums of an aircraft's design at the nodes it flew past, a sparse matrix. The whole is multiplied
without being written out; :meth:`Coupling.dense` writes it out for few aircraft.

References
----------
Henderson 1975, Biometrics 31, 423-447.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from airswing.compass.fleet.flight_segments import SLOPES
from airswing.compass.fleet.reference_error import (
    Floats,
    Ints,
    Precision,
    Short,
    Stretch,
    bounds_of,
)

OWN = SLOPES + 2
"""An aircraft's unknowns: A to E, airspeed scale, bias eastward and northward."""
KEPT = tuple([*range(SLOPES), SLOPES + c] for c in range(2))
"""Those that a component of the error knows of."""
ROWS_AT_ONCE = 512
"""Nodes whose share of the information is written out at once."""
GATHERED = 4_000_000
"""Numbers of the nodes' covariances that are looked up at once."""


@dataclass(frozen=True)
class Coupling:
    """Information of one reference's blocks about its unknowns."""

    direct: Floats  # (aircraft, 8, 8): of each aircraft's own unknowns, the field known
    # (aircraft, 8, 2, functions): between them and the lasting part, the passing part known
    border: Floats
    # (functions, functions): of one component's lasting part, the passing part known
    lasting: Floats
    # sparse, (7 * aircraft, segment * nodes): of each component: H
    # transposed; rows by coefficient (A to E, scale, bias), then aircraft
    nodes: tuple[sparse.csr_matrix, sparse.csr_matrix]
    # sparse, (segment * nodes, functions): of the lasting part
    lasting_nodes: sparse.csr_matrix
    inverse: Floats  # (segment, nodes, nodes): G
    # (aircraft, 8, 8): what makes of some blocks' information that of all where the field has a
    # part in it: F N F' for the aircraft's unknowns,
    factor: Floats
    gain: float  # N for the lasting part's times this

    @classmethod
    def of(cls, precision: Precision, direct: Floats, factor: Floats, gain: float) -> Coupling:
        """Sum some blocks up.

        Parameters
        ----------
        precision : Precision
            Of some blocks.
        direct, factor, gain
            As the attributes, of all.
        """
        aircraft = factor.shape[0]
        one = precision.stretch
        weighted = sparse.diags(precision.weight) @ one.lasting_design
        tied = sparse.diags(precision.tied) @ (one.piece_sums @ weighted)
        lasting = weighted - sparse.diags(precision.weight) @ (one.piece_sums.T @ tied)
        met = _Met.of(one, aircraft)
        nodes, border = [], np.zeros((aircraft, OWN, 2, lasting.shape[1]))
        for component, kept in enumerate(KEPT):
            own = precision.within_pieces(own_design(one, component))
            nodes.append(met.sums(own))
            border[:, kept, component] = _at_functions(one, own, aircraft)
        return cls(
            direct,
            border,
            (one.lasting_design.T @ lasting).toarray(),
            (nodes[0], nodes[1]),
            (one.passing_design.T @ lasting).tocsr(),
            precision.inverse,
            factor,
            gain,
        )

    @property
    def aircraft(self) -> int:
        """How many there are."""
        return int(self.direct.shape[0])

    def times(self, own: Floats, lasting: Floats) -> tuple[Floats, Floats]:
        """Multiply.

        Parameters
        ----------
        own : array of float, shape (aircraft, 8, k)
        lasting : array of float, shape (2, functions, k)

        Returns
        -------
        own, lasting : arrays of the same shapes
        """
        size, many, root = self.lasting.shape[0], own.shape[-1], np.sqrt(self.gain)
        known = self.direct @ own
        own, lasting = self.factor.transpose(0, 2, 1) @ own, root * lasting
        border = self.border.reshape(-1, 2 * size)
        found = (border @ lasting.reshape(-1, many)).reshape(own.shape)
        below = (border.T @ own.reshape(-1, many)).reshape(lasting.shape) + self.lasting @ lasting
        for component, (kept, nodes) in enumerate(zip(KEPT, self.nodes, strict=True)):
            met = own.transpose(1, 0, 2)[kept].reshape(-1, many)
            seen = nodes.T @ met + self.lasting_nodes @ lasting[component]
            shape = (*self.inverse.shape[:2], many)
            taken = (self.inverse @ seen.reshape(shape)).reshape(seen.shape)
            found[:, kept] -= (nodes @ taken).reshape(len(kept), -1, many).transpose(1, 0, 2)
            below[component] -= self.lasting_nodes.T @ taken
        return known + self.factor @ found, root * below

    def own_blocks(self) -> Floats:
        """Information about each aircraft's own unknowns, shape (aircraft, 8, 8)."""
        found = np.zeros_like(self.direct)
        every = np.arange(self.aircraft)
        for kept, nodes in zip(KEPT, self.nodes, strict=True):
            found[np.ix_(every, kept, kept)] -= _taken_of_own(nodes, self.inverse)
        return np.asarray(self.direct + self.factor @ found @ self.factor.transpose(0, 2, 1))

    def lasting_block(self) -> Floats:
        """Information about one component's lasting part, shape (functions, functions)."""
        found, size = self.lasting.copy(), self.inverse.shape[1]
        for k, inverse in enumerate(self.inverse):
            seen = self.lasting_nodes[k * size : (k + 1) * size]
            met = np.unique(seen.indices)  # of a large field few have a part in one region
            own = seen[:, met].toarray()
            found[np.ix_(met, met)] -= own.T @ (inverse @ own)
        return np.asarray(self.gain * found)

    def dense(self) -> Floats:
        """All of it, the unknowns in the order of :class:`Reference`: for few aircraft."""
        a, n = self.aircraft, self.lasting.shape[0]
        own, lasting = unknowns(a, n)
        found = np.zeros((OWN * a + 2 * n, OWN * a + 2 * n))
        for component, (kept, nodes) in enumerate(zip(KEPT, self.nodes, strict=True)):
            low = lasting[component]
            found[np.ix_(low, low)] = self.lasting
            found[own[:, :, np.newaxis], low] = self.border[:, :, component]
            found[low, own[:, :, np.newaxis]] = self.border[:, :, component]
            place = np.concatenate([own.T[kept].ravel(), low])
            found[np.ix_(place, place)] -= self._taken(nodes.T.tocsr())
        for one in (found, found.T):
            one[own] = self.factor @ one[own]
            one[lasting] *= np.sqrt(self.gain)
        found[own[:, :, np.newaxis], own[:, np.newaxis]] += self.direct
        return found

    def _taken(self, nodes: sparse.csr_matrix) -> Floats:
        """What the passing part takes of one component's information."""
        segments, size = self.inverse.shape[:2]
        width = nodes.shape[1] + self.lasting.shape[0]
        step = max(ROWS_AT_ONCE // size, 1)
        found = np.zeros((width, width))
        for begin in range(0, segments, step):
            some = slice(begin * size, min(begin + step, segments) * size)
            # single precision takes half the time; what is added up over segments is added in
            # double
            seen = np.empty((some.stop - some.start, width), dtype=np.float32)
            seen[:, : nodes.shape[1]] = nodes[some].toarray()
            seen[:, nodes.shape[1] :] = self.lasting_nodes[some].toarray()
            inverse = self.inverse[begin : begin + step].astype(np.float32)
            solved = inverse @ seen.reshape(-1, size, width)
            found += seen.T @ solved.reshape(seen.shape)
        return found


def unknowns(aircraft: int, functions: int) -> tuple[Ints, Ints]:
    """Places of every aircraft's own unknowns, (aircraft, 8), and the lasting part's, (2, n)."""
    own = np.empty((aircraft, OWN), dtype=np.int64)
    own[:, :SLOPES] = np.arange(aircraft * SLOPES).reshape(aircraft, SLOPES)
    own[:, SLOPES:] = aircraft * SLOPES + np.arange(2 * aircraft).reshape(aircraft, 2)
    return own, aircraft * OWN + np.arange(2 * functions).reshape(2, functions)


def direct_information(precision: Precision, aircraft: int) -> Floats:
    """Information of each aircraft were the field known, shape (aircraft, 8, 8)."""
    one = precision.stretch
    found = np.zeros((aircraft, OWN, OWN))
    for k, (i, j) in enumerate(bounds_of(one.aircraft, aircraft)):
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


def own_design(one: Stretch, component: int) -> Floats:
    """Design of an aircraft's coefficients and bias, shape (7, n)."""
    return np.vstack([one.slopes[component], np.ones(one.weight.size)])


@dataclass(frozen=True)
class _Met:
    """Which nodes each aircraft met: pairs by aircraft, then node.

    ``where`` is the pair of each block's nodes, (n, 4); ``begin`` each aircraft's first pair.
    """

    node: Short
    begin: Ints
    where: Ints
    share: Floats
    every: int

    @classmethod
    def of(cls, one: Stretch, aircraft: int) -> _Met:
        every = one.segments.size * one.nodes
        key = one.aircraft[:, np.newaxis] * every + one.node
        met, where = np.unique(key, return_inverse=True)
        owner, node = np.divmod(met, every)
        begin = np.searchsorted(owner, np.arange(aircraft + 1))
        return cls(node.astype(np.int32), begin, where.ravel(), one.share, every)

    def sums(self, values: Floats) -> sparse.csr_matrix:
        """Sums of some rows of values at the nodes, a row for each and aircraft."""
        pairs, rows = self.node.size, values.shape[0]
        found = np.empty((rows, pairs))
        for row, one in zip(found, values, strict=True):
            shared = (self.share * one[:, np.newaxis]).ravel()
            row[:] = np.bincount(self.where, weights=shared, minlength=pairs)
        start = (np.arange(rows)[:, np.newaxis] * pairs + self.begin[:-1]).ravel()
        return sparse.csr_matrix(
            (found.ravel(), np.tile(self.node, rows), np.append(start, rows * pairs)),
            shape=(start.size, self.every),
        )


def _at_functions(one: Stretch, weighted: Floats, aircraft: int) -> Floats:
    """Sums of some rows of values at the lasting part's functions, (aircraft, rows, functions)."""
    functions = one.lasting_design.shape[1]
    place = (one.aircraft[:, np.newaxis] * functions + one.lasting).ravel()
    found = np.empty((aircraft, weighted.shape[0], functions))
    for row, values in enumerate(weighted):
        shared = (one.lasting_share * values[:, np.newaxis]).ravel()
        sums = np.bincount(place, weights=shared, minlength=aircraft * functions)
        found[:, row] = sums.reshape(aircraft, functions)
    return found


def _taken_of_own(nodes: sparse.csr_matrix, inverse: Floats) -> Floats:
    """H' G H of each aircraft and segment, summed by aircraft, shape (aircraft, 7, 7)."""
    rows, size = SLOPES + 1, inverse.shape[1]
    aircraft, pairs = nodes.shape[0] // rows, nodes.nnz // rows
    values = nodes.data.reshape(rows, pairs)
    segment, node = np.divmod(nodes.indices[:pairs].astype(np.int64), size)
    owner = np.repeat(np.arange(aircraft), np.diff(nodes.indptr[: aircraft + 1]))
    change = np.flatnonzero(np.diff(owner * inverse.shape[0] + segment, prepend=-1))
    count = np.diff(np.append(change, pairs))
    found = np.zeros((aircraft, rows, rows))
    # those of one length together: they are multiplied as one stack
    order = np.argsort(count, kind="stable")
    begin = 0
    while begin < order.size:
        most = int(count[order[begin]])
        # as many as have no more nodes than twice the least of them, and as fit
        stop = min(int(np.searchsorted(count[order], 2 * most, side="right")), order.size)
        stop = min(stop, begin + max(GATHERED // (2 * most) ** 2, 1))
        some = order[begin:stop]
        begin, wide = stop, int(count[some].max())
        there = np.arange(wide) < count[some, np.newaxis]
        at = np.where(there, change[some, np.newaxis] + np.arange(wide), 0)
        met = np.where(there, values[:, at], 0.0).transpose(1, 0, 2)
        own = inverse[
            segment[change[some], np.newaxis, np.newaxis],
            node[at][:, :, np.newaxis],
            node[at][:, np.newaxis],
        ]
        np.add.at(found, owner[change[some]], met @ own @ met.transpose(0, 2, 1))
    return found
