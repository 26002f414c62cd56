"""One reference's part of the fleet's equations, worked through some days at a time.

Assumes what :mod:`airswing.compass.fleet.reference_error` assumes of the reference's error. Of the
blocks' sums only some days are laid out at once (:data:`MOST_BLOCKS` blocks, whole days: the
passing part and a piece never reach over the end of a segment), so that beside the sums themselves
nothing grows with the archive but a score of every unknown a day. Where the days are cut depends on
the blocks alone.

With more blocks than that the variances and the Newton matrix are those of an even choice of
segments, scaled to all; the scores are of every block.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from airswing.compass.fleet.field_basis import FieldBasis
from airswing.compass.fleet.field_coupling import OWN, Coupling, direct_information, own_design
from airswing.compass.fleet.flight_segments import SLOPES, Blocks
from airswing.compass.fleet.reference_error import (
    Flags,
    Floats,
    Ints,
    Precision,
    Stretch,
    as_sparse,
    bounds_of,
    counted,
    estimate_variances,
)

MOST_BLOCKS = 50_000
"""Blocks laid out at once, about; and those the variances and the Newton matrix are made from."""
AIRCRAFT = 125
"""With more aircraft than that so many blocks more: an aircraft must be seen on a few days."""
LEAST_FREEDOM = 30
"""Degrees of freedom within blocks that tell an aircraft's white noise."""
MOST_NODES = 100_000_000
"""Numbers of the passing part's covariances laid out at once."""
MOST_KEPT = 4_000_000
"""Numbers of the passing part's covariances that are kept between two rounds over the blocks."""


class Reference:
    """One reference's part of the equations.

    The unknowns are, in this order, the coefficients (aircraft, 6), the biases (aircraft, 2) and
    the lasting part (2, functions).

    Parameters
    ----------
    blocks : list of Blocks
        One an aircraft.
    free : array of bool, shape (aircraft, 6)
    days : array of int
        First segment of every day.
    """

    def __init__(self, blocks: list[Blocks], free: Flags, days: Ints) -> None:
        self.blocks, self.free, self.days = blocks, free, days
        self.basis = FieldBasis.of(
            *(
                np.concatenate([getattr(part, name) for part in blocks])
                for name in ("latitude", "longitude", "log_pressure")
            )
        )
        self.aircraft, self.lasting = free.shape[0], self.basis.lasting_size + 1
        segments, count, _ = counted(np.concatenate([part.segment for part in blocks]))
        most = int(MOST_BLOCKS * max(1.0, self.aircraft / AIRCRAFT))
        # a segment of many nodes takes the room of so many blocks
        nodes = min(self.basis.passing_size, 4 * int(count.max()))
        numbers = min(nodes**2, min(nodes, self.basis.region_size) ** 2 * self.basis.regions)
        count = np.maximum(count, numbers * most // MOST_NODES)
        every = -(-int(count.sum()) // most)
        self.thinned = every > 1
        some = self._stretch(segments[every // 2 :: every])
        white = _white(np.array([(part.within, part.freedom) for part in blocks]))
        self.variances = estimate_variances(some, white)
        self.some = Precision(some, self.variances)
        self.runs = _runs(segments, count, self._day_of(segments), most)
        self.inverses: dict[tuple[int, int], Floats] = {}
        self.keeps = self.thinned and segments.size * numbers <= MOST_KEPT
        self.worth, self.lasting_worth = np.zeros(self.aircraft), np.zeros(self.lasting)
        self.precise, self.direct = 0.0, np.zeros((self.aircraft, 8, 8))
        self.start = self._survey()

    def _stretch(self, segments: Ints) -> Stretch:
        """Blocks of some segments, end to end; what is not fitted has no slope."""
        found = Stretch.of([part.of(segments) for part in self.blocks], self.basis)
        for k, (i, j) in enumerate(bounds_of(found.aircraft, self.aircraft)):
            found.slopes[:, ~self.free[k], i:j] = 0.0
        return found

    def _parts(self) -> Iterator[Precision]:
        """Every block once, some days at a time."""
        if not self.thinned:
            yield self.some
            return
        for segments in self.runs:
            run = int(segments[0]), segments.size
            part = Precision(self._stretch(segments), self.variances, self.inverses.get(run))
            if self.keeps:
                self.inverses[run] = part.inverse
            yield part

    def _day_of(self, segments: Ints) -> Ints:
        """Place of the day of each of some segments."""
        return np.searchsorted(self.days, segments, side="right") - 1

    def _survey(self) -> Floats:
        """Scores where every unknown is zero, by day; and what needs every block but no unknown."""
        found = np.zeros((self.days.size, self.aircraft * SLOPES + self.size))
        for part in self._parts():
            one = part.stretch
            self.worth += np.bincount(one.aircraft, weights=one.weight, minlength=self.aircraft)
            self.lasting_worth += one.lasting_design.T @ one.weight
            if self.thinned:
                self.precise += float(part.weight.sum())
                self.direct += direct_information(part, self.aircraft)
            self._add_scores(part, one.residual, found)
        return found

    @property
    def size(self) -> int:
        """Number of unknowns of its own."""
        return int(2 * (self.aircraft + self.lasting))

    def coupling(self) -> Coupling:
        """Information about every unknown, from the blocks."""
        some = direct_information(self.some, self.aircraft)
        if not self.thinned:
            every = np.broadcast_to(np.eye(OWN), some.shape)
            return Coupling.of(self.some, some, every, 1.0)
        gain = self.precise / float(self.some.weight.sum())
        return Coupling.of(self.some, self.direct, _factor(some, self.direct), gain)

    def leverage(self) -> Floats:
        """Share of each coefficient's scatter between days that fitting took away.

        Of the aircraft's own equations, the field known; shape (aircraft, 6).
        """
        days = self._day_information()
        total = days.sum(axis=1)
        trace = np.trace(total, axis1=1, axis2=2)[:, np.newaxis, np.newaxis]
        # one: none of this aircraft's days is among them, and nothing is said of it
        ridge = np.where(trace > 0, 1e-9 * trace, 1.0) * np.eye(OWN)
        inverse = np.linalg.inv(total + ridge)
        twice = (days @ inverse[:, np.newaxis] @ days).sum(axis=1)
        taken = inverse @ twice @ inverse
        share = np.diagonal(taken, axis1=1, axis2=2) / np.diagonal(inverse, axis1=1, axis2=2)
        return np.asarray(np.minimum(share[:, :SLOPES] * days.shape[1] / self.days.size, 0.5))

    def _day_information(self) -> Floats:
        """Information on each aircraft's unknowns by day were the field known.

        Returns
        -------
        array, shape (aircraft, day, 8, 8)
            Of the days some segments are of.
        """
        one, a = self.some.stretch, self.aircraft
        _, day = np.unique(self._day_of(one.segments), return_inverse=True)
        days = int(day.max()) + 1
        group = (one.aircraft * days + day[one.segment])[one.opens]
        found = np.zeros((a * days, 8, 8))
        for component in range(2):
            design = own_design(one, component)
            weighted = self.some.within_pieces(design)
            kept = [*range(SLOPES), SLOPES + component]
            for i, left in enumerate(design):
                pieces = np.add.reduceat(weighted[: i + 1] * left, one.opens, axis=1)
                for j, values in enumerate(pieces):
                    sums = np.bincount(group, weights=values, minlength=a * days)
                    found[:, kept[i], kept[j]] += sums
        found = found + np.tril(found, -1).transpose(0, 2, 1)
        return np.asarray(found.reshape(a, days, 8, 8))

    def scores(self, unknowns: Floats) -> Floats:
        """Score of every unknown by day; shape (day, unknown).

        Parameters
        ----------
        unknowns : array, shape (unknown,)
        """
        a = self.aircraft
        theta = unknowns[: a * SLOPES].reshape(a, SLOPES)
        bias = unknowns[a * SLOPES : a * (SLOPES + 2)].reshape(a, 2)
        lasting = unknowns[a * (SLOPES + 2) :].reshape(2, -1)
        found = np.zeros((self.days.size, unknowns.size))
        for part in self._parts():
            one = part.stretch
            left = one.residual - (one.lasting_design @ lasting.T).T
            for k, (i, j) in enumerate(bounds_of(one.aircraft, a)):
                left[:, i:j] -= theta[k] @ one.slopes[:, :, i:j] + bias[k][:, np.newaxis]
            self._add_scores(part, left, found)
        return found

    def _add_scores(self, part: Precision, left: Floats, found: Floats) -> None:
        """Scores of some whole days' blocks by day, from what they leave unexplained."""
        one, a = part.stretch, self.aircraft
        weighted = part.apply(left)
        pieces = np.empty((SLOPES + 2, one.opens.size))
        for i, j in bounds_of(one.aircraft, a):
            if i == j:
                continue
            first, last = np.searchsorted(one.opens, (i, j))
            own = np.empty((SLOPES + 2, j - i))
            own[SLOPES:] = weighted[:, i:j]
            np.multiply(one.slopes[0, :, i:j], own[SLOPES], out=own[:SLOPES])
            own[:SLOPES] += one.slopes[1, :, i:j] * own[SLOPES + 1]
            pieces[:, first:last] = np.add.reduceat(own, one.opens[first:last] - i, axis=1)
        day = self._day_of(one.segments)
        rows, day = slice(int(day[0]), int(day[-1]) + 1), day - day[0]
        days = int(day[-1]) + 1
        group = one.aircraft[one.opens] * days + day[one.segment[one.opens]]
        columns = [slice(k, a * SLOPES, SLOPES) for k in range(SLOPES)]
        columns += [slice(a * SLOPES + c, a * (SLOPES + 2), 2) for c in range(2)]
        for column, values in zip(columns, pieces, strict=True):
            total = np.bincount(group, weights=values, minlength=a * days)
            found[rows, column] = total.reshape(a, days).T
        found[rows, a * (SLOPES + 2) :] = self._lasting_scores(one, weighted, day)

    def _lasting_scores(self, one: Stretch, weighted: Floats, day: Ints) -> Floats:
        """Scores of the lasting part by day, shape (day, 2 * functions)."""
        days = int(day[-1]) + 1
        shift = (day * self.lasting).astype(np.int32)[one.segment]
        daily = as_sparse(
            one.lasting + shift[:, np.newaxis], one.lasting_share, days * self.lasting
        )
        found = (daily.T @ weighted.T).reshape(days, self.lasting, 2)
        return np.asarray(found.transpose(0, 2, 1).reshape(days, -1))


def _runs(segments: Ints, count: Ints, day: Ints, most: int) -> list[Ints]:
    """Segments of whole days with at most so many blocks together, one day at least."""
    opens = np.flatnonzero(np.diff(day, prepend=-1))
    found, total = [0], 0
    for begin, blocks in zip(opens.tolist(), np.add.reduceat(count, opens).tolist(), strict=True):
        if total and total + blocks > most:
            found.append(begin)
            total = 0
        total += blocks
    return np.split(segments, found[1:])


def _white(within: Floats) -> Floats:
    """Variance of one report of each aircraft; the fleet's where it has too few to tell."""
    square, freedom = within.T
    known = freedom >= LEAST_FREEDOM
    if not known.any():
        return np.ones(square.size)
    found = square / np.maximum(freedom, 1.0)
    # never nothing: winds without any noise, as of a made archive, divide by it
    return np.asarray(np.maximum(np.where(known, found, np.median(found[known])), 1e-3))


def _factor(some: Floats, every: Floats) -> Floats:
    """What makes of the information from some blocks that from all, (aircraft, 8, 8)."""
    # some aircraft tell nothing of a parameter: their matrices have no factor without it
    ridge = 1e-9 * np.trace(every, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(OWN)
    thin, whole = (np.linalg.cholesky(one + ridge) for one in (some, every))
    return np.asarray(whole @ np.linalg.inv(thin))
