"""Sums of tables against what is not explained, with the reference's own error taken out exactly.

Assumptions: the error of the reference is the noise along flights, day fields, a climatology and a
slope on the wind, all with the sizes the diagnosis estimated; beside them every aircraft has a
little of every steady error of heading and airspeed. With ``V`` the covariance of all of it, a
table's columns X enter as ``X'V^-1 X`` and ``X'V^-1 r``: generalised least squares, so that what
weather or a little deviation explains is no one's unknown.

Validity: whole flights; columns in m/s. The ground is prepared once: residuals, the real one and
those of simulated archives, share its columns.

Source: Frisch-Waugh-Lovell; mixed-model equations of Henderson (1975).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan, unit_vectors
from airswing.gap.design.weather import climatology_columns, day_field_columns, slope_columns
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import FlightOrder, Gains, take_gains, whiten_blocks
from airswing.gap.sums.cluster_inflation import BLOCKS, cluster_factor
from airswing.gap.sums.elimination import inverse_root
from airswing.gap.sums.variance_components import SLOPE_SD, Variances

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

#: Size of the little of every steady error that every aircraft has, m/s rms.
BACKGROUND = 0.1
#: Bound on whitened residuals.
CLIP = 5.0


@dataclass(frozen=True)
class Sums:
    """Sums of one table's columns, everything the reference does taken out."""

    gram: Floats  # (A, k, k): X'V^-1 X of each aircraft
    score: Floats  # (R, A, D, k): X'V^-1 r by aircraft and day, of each residual
    fleet_gram: Floats  # (k, k): of all aircraft together
    # (D, k, k): the same by day, of all aircraft, before what lasts is taken out
    fleet_days: Floats
    day_weight: Floats  # (A, D): its trace by aircraft and day
    count: Floats  # (A, k): reports in each cell
    lasting_share: float  # part of the fleet's X'X that what lasts takes up
    # (A, B): scatter of each aircraft's scores between blocks of days (:func:`cluster_factor`). A
    # matrix an aircraft and day would be gigabytes in a year of sixty aircraft, so it is made here.
    scatter: Floats | None = None
    # (A, D, k): instead of it, where cells share no report: X'V^-1 X by aircraft and day has
    # nothing beside its diagonal
    day_diagonal: Floats | None = None
    # (R, A, D, k): scores of each aircraft about the fleet's own table, where weather is common to
    # all
    apart: Floats | None = None

    def scatter_of(self, score: Floats) -> Floats:
        """Scatter of each aircraft's scores between blocks of days, of one residual's, (A, B)."""
        if self.day_diagonal is None:
            assert self.scatter is not None
            return self.scatter
        eye = np.eye(score.shape[-1])
        each = zip(self.day_diagonal, score, self.gram, strict=True)
        return np.stack([cluster_factor(own[..., None] * eye, of, g) for own, of, g in each])


@dataclass(frozen=True)
class Left:
    """Residuals with everything the reference does taken out."""

    # (2 m, R) each: V^-1 r of the reports of each part of the ground
    parts: tuple[Singles, ...]
    daily: Floats  # (D, q, R): best values of the day fields given each residual
    lasting: Floats  # (L, R): the same of what lasts


@dataclass(frozen=True)
class Ground:
    """Reports ready for tables: whitened nuisance columns by aircraft and day."""

    order: FlightOrder
    gains: Gains  # in the order's own sequence
    # tuple of (int, int, (m,) int, (2 m, w) float32): aircraft, day, positions in the order, and
    # ``[Z, C, B]`` of these reports
    parts: tuple[tuple[int, int, Integers, Singles], ...]
    root: Floats  # (D, q, q): inverse Cholesky factor of the day fields' normal matrix
    fields: Floats  # (D, q, L): ``root`` Z' [C, B of every aircraft] by day
    half: Floats  # (L, L): root of the inverse of what lasts given the day fields
    # aircraft, days, columns of the climatology, of one aircraft's steady errors
    sizes: tuple[int, int, int, int]
    owner: Integers  # (n,): aircraft of every report, in the order's sequence

    def _places(self, aircraft: int) -> Integers:
        """Places of an aircraft's own columns among all that last."""
        steady, own = self.sizes[2:]
        return np.concatenate([np.arange(steady), steady + aircraft * own + np.arange(own)])

    def solved(self, residuals: Floats) -> Left:
        """Take everything the reference does out of residuals, (R, n, 2) m/s."""
        days, q = self.root.shape[:2]
        white = _whitened(np.moveaxis(residuals, 0, -1), self.order, self.gains)
        white = np.clip(white, -CLIP, CLIP)
        width = white.shape[0]
        told = [white[:, :, rows].reshape(width, -1).T for _, _, rows, _ in self.parts]
        shared = np.zeros((days, q, width))
        score = np.zeros((self.half.shape[0], width))
        for (a, d, _, part), own in zip(self.parts, told, strict=True):
            both = part.T @ own
            shared[d] += both[:q]
            score[self._places(a)] += both[q:]
        shared = self.root @ shared
        score -= np.einsum("dql,dqr->lr", self.fields, shared, optimize=True)
        found = self.half.T @ (self.half @ score)
        by_day = self.root.swapaxes(1, 2) @ (shared - self.fields @ found)
        left = []
        for (a, d, _, part), own in zip(self.parts, told, strict=True):
            values = np.concatenate([by_day[d], found[self._places(a)]]).astype(np.float32)
            left.append(own - part @ values)
        return Left(tuple(left), by_day, found)

    def cleared(
        self,
        quiet: Frame,
        residuals: Floats,
        *,
        plan: DictionaryPlan,
        day: Integers,
        rows: Integers,
    ) -> Floats:
        """Residuals without day fields, climatology and everyone's little of steady errors.

        Parameters
        ----------
        residuals : (R, n, 2) float
            m/s.
        day : (n,) int
        rows : (m,) int
            Reports asked for.

        Returns
        -------
        (R, m, 2) float
        """
        count, own = self.sizes[2:]
        made, part = self.solved(residuals), quiet.take(rows)
        fields, mine = day_field_columns(part, plan), steady_columns(part)
        steady = lasting_columns(part, plan)
        out = residuals[:, rows]
        for r, left in enumerate(out):
            each = made.lasting[count:, r].reshape(-1, own)[part.aircraft]
            left -= np.einsum("nck,nk->nc", fields, made.daily[day[rows], :, r])
            left -= np.einsum("nck,nk->nc", mine, each) + steady @ made.lasting[:count, r]
        return out

    def sums(self, cells: Integers, size: int, direction: Floats, left: Left) -> Sums:
        """Sums of a table.

        Parameters
        ----------
        cells : (n,) int
            Cell of every report, -1 for none.
        size : int
            Number of cells k.
        direction : (n, 2) float
            Unit vector of the component.
        left : Left
            Of the residuals.
        """
        index = self.order.index
        cell, unit = cells[index], direction[index].astype(np.float32)
        columns = np.zeros((size, 2, index.size), np.float32)
        known = np.flatnonzero((cell >= 0) & (self.gains.weight > 0))
        for k in range(2):
            columns[cell[known], k, known] = unit[known, k]
        whiten_blocks(columns, self.order.starts, self.gains)
        return self._summed(columns, cell, known, left)

    def _summed(self, columns: Singles, cell: Integers, known: Integers, left: Left) -> Sums:
        aircraft, days, steady, own = self.sizes
        k, q = columns.shape[0], self.root.shape[1]
        fleet_days, whole = np.zeros((days, k, k)), np.zeros((days, k, q))
        gram, fleet = np.zeros((aircraft, k, k)), np.zeros((k, k))
        together = np.zeros((k, self.half.shape[0]))
        score = np.zeros((left.lasting.shape[1], aircraft, days, k))
        weight = np.zeros((aircraft, days))
        scatter = np.full((aircraft, len(BLOCKS)), np.nan)
        told = zip(self.parts, left.parts, strict=True)
        for a, parts in groupby(told, key=lambda part: part[0][0]):
            day_gram, both = np.zeros((days, k, k)), np.zeros((days, k, q + steady + own))
            for (_, d, rows, beside), rest in parts:
                x = columns[:, :, rows].reshape(k, -1)
                day_gram[d] = x @ x.T
                both[d] = x @ beside
                score[:, a, d] = (x @ rest).T
            cross = both[:, :, :q] @ self.root.swapaxes(1, 2)
            lasting = np.zeros((k, steady + own * aircraft))
            lasting[:, self._places(a)] = both[:, :, q:].sum(axis=0)
            lasting -= np.tensordot(cross, self.fields, axes=((0, 2), (0, 1)))
            fleet += day_gram.sum(axis=0)
            whole += cross
            day_gram -= cross @ cross.swapaxes(1, 2)
            fleet_days += day_gram
            taken = lasting @ self.half.T
            together += taken
            gram[a] = day_gram.sum(axis=0) - taken @ taken.T
            weight[a] = np.trace(day_gram, axis1=1, axis2=2)
            scatter[a] = cluster_factor(day_gram, score[0, a], gram[a])
        key = self.owner[known] * k + cell[known]
        count = np.bincount(key, minlength=aircraft * k).reshape(aircraft, k)
        fleet -= np.einsum("dkq,dlq->kl", whole, whole, optimize=True)
        share = float(np.trace(together @ together.T) / max(np.trace(fleet), 1e-9))
        fleet -= together @ together.T
        return Sums(gram, score, fleet, fleet_days, weight, count.astype(float), share, scatter)


def plain_sums(
    values: Floats,
    square: Floats,
    cells: Integers,
    size: int,
    *,
    aircraft: Integers,
    day: Integers,
) -> Sums:
    """Sums of a table without whitening: its cells' counts, and sums of the residual by cell.

    Parameters
    ----------
    values : (R, n) float
        Residual times the component's direction.
    square : (n,) float
        Square of that direction.
    cells : (n,) int
    aircraft, day : (n,) int

    Returns
    -------
    Sums
        In units of the residual's variance.
    """
    shape = int(aircraft.max()) + 1, int(day.max()) + 1, size
    used = np.flatnonzero(cells >= 0)
    key = (aircraft[used] * shape[1] + day[used]) * size + cells[used]
    total = int(np.prod(shape))
    # one over the variance of the residual along the direction: sums come in its units
    unit = float(np.mean(square)) / max(float(np.mean(values[0] ** 2)), 1e-6)
    count = np.bincount(key, minlength=total).reshape(shape)
    weight = unit * np.bincount(key, square[used], minlength=total).reshape(shape)
    score = np.stack(
        [unit * np.bincount(key, own[used], minlength=total).reshape(shape) for own in values]
    )
    gram = weight.sum(axis=1)[..., None] * np.eye(size)
    return Sums(
        gram,
        score,
        gram.sum(axis=0),
        fleet_days=weight.sum(axis=0)[..., None] * np.eye(size),
        day_weight=weight.sum(axis=2),
        count=count.sum(axis=1).astype(float),
        lasting_share=0.0,
        day_diagonal=np.asarray(weight, dtype=np.float64),
    )


def steady_columns(quiet: Frame) -> Floats:
    """Columns of steady errors of heading and airspeed, (n, 2, 7), about 1 m/s each."""
    cross, along = unit_vectors(quiet.heading)
    angle, speed = quiet.magnetic_heading, quiet.airspeed[:, None] / 100.0
    waves = [np.ones_like(angle), *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos))]
    columns = [wave[:, None] * speed * cross for wave in waves]
    return np.stack([*columns, along, speed * along], -1)


def lasting_columns(quiet: Frame, plan: DictionaryPlan) -> Floats:
    """Columns of the climatology and of the slope on the wind, (n, 2, s)."""
    return np.concatenate([climatology_columns(quiet, plan), slope_columns(quiet)], -1)


def prepare(
    quiet: Frame,
    *,
    noise: NoiseFit,
    plan: DictionaryPlan,
    variances: Variances,
    day: Integers,
) -> Ground:
    """Whiten the nuisance columns of an archive.

    Parameters
    ----------
    quiet : Frame
        Reports with heading, airspeed and wind free of the residual's noise.
    day : (n,) int
        Index of each report's day.
    """
    order = noise.order
    gains = take_gains(noise.gains, order.index)
    made = (day_field_columns(quiet, plan), lasting_columns(quiet, plan), steady_columns(quiet))
    widths = [columns.shape[-1] for columns in made]
    stacked = np.concatenate([_whitened(columns, order, gains) for columns in made])
    key = quiet.aircraft[order.index] * (int(day.max()) + 1) + day[order.index]
    turn = np.argsort(key, kind="stable")
    pieces = np.split(turn, np.flatnonzero(np.diff(key[turn])) + 1)
    rows = [
        (
            int(quiet.aircraft[order.index[p[0]]]),
            int(day[order.index[p[0]]]),
            p,
            np.ascontiguousarray(stacked[:, :, p].reshape(stacked.shape[0], -1).T),
        )
        for p in pieces
    ]
    sizes = len(quiet.tails), int(day.max()) + 1, widths[1], widths[2]
    prior = np.r_[1 / variances.climatology, 1 / np.square(SLOPE_SD)]
    prior = np.r_[prior, np.full(sizes[0] * sizes[3], 1 / BACKGROUND**2)]
    root, fields, half = _eliminated(rows, sizes, 1 / variances.day, prior)
    owner = quiet.aircraft[order.index]
    return Ground(order, gains, tuple(rows), root, fields, half, sizes, owner)


def _whitened(columns: Floats, order: FlightOrder, gains: Gains) -> Singles:
    """Columns (n, 2, w) whitened, (w, 2, n), in the order's sequence as their gains are."""
    block = np.moveaxis(columns, 0, -1).swapaxes(0, 1).astype(np.float32)
    out = np.ascontiguousarray(block[:, :, order.index])
    out[:, :, gains.weight == 0] = 0.0
    whiten_blocks(out, order.starts, gains)
    return out


def _eliminated(
    rows: list[tuple[int, int, Integers, Singles]],
    sizes: tuple[int, int, int, int],
    day_prior: Floats,
    prior: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Eliminate day fields from what lasts: ``root``, ``fields`` and ``half`` of the ground."""
    aircraft, days, steady, own = sizes
    q, lasting = day_prior.size, steady + own * aircraft
    normal = np.zeros((days, q, q)) + np.diag(day_prior)
    fields, gram = np.zeros((days, q, lasting)), np.diag(prior)
    places = [np.r_[np.arange(steady), steady + a * own + np.arange(own)] for a in range(aircraft)]
    for a, d, _, part in rows:
        both = (part.T @ part).astype(float)
        normal[d] += both[:q, :q]
        fields[d][:, places[a]] += both[:q, q:]
        gram[np.ix_(places[a], places[a])] += both[q:, q:]
    root = np.linalg.inv(np.linalg.cholesky(normal))
    fields = root @ fields
    gram -= np.einsum("dql,dqm->lm", fields, fields, optimize=True)
    return root, fields, inverse_root(gram)
