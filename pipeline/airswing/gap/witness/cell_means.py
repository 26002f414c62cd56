"""Values of a table as its cells hold them on average, beside the days and the climatology.

Assumptions: cells are coarse, and their variables known roughly. Whitened along flights a table is
fitted to what changes between neighbouring reports, and of a table that changes at the edges of
cells alone: an effect that is smooth, or whose variable is a little off, comes out at 0.35 to 0.7
of what it is (its evidence holds all the same). Its mean over a cell is whole. So every report
counts alike here, and table, day fields and climatology are one mixed model,

    r = X theta + C c + Z_d z_d + e,   e ~ N(0, f g(p)^2 (sigma_c^2 + sigma_w^2)),

f being the number of reports that tell as much as one alone would: along a flight they err alike.
Where errors across the heading are larger than along it, r and all columns are evened before.
Day fields are eliminated day by day, so that weeks are left out exactly.

Validity: that of the noise model; columns that steady errors of an aircraft's heading and airspeed
have are not in it: named effects were taken off before.

Source: Henderson (1975); Kish (1965), Survey Sampling, section 5.4 (f, the design effect).

Units: m/s; values in the component's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.design.weather import day_field_columns
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import Evened
from airswing.gap.sums.variance_components import SLOPE_SD, Variances
from airswing.gap.witness.ground import lasting_columns

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Bound on residuals, in standard deviations.
CLIP = 5.0
#: Bounds of the factor by which a table's scores scatter more than the reports to one suggest.
FACTORS = (0.1, 3.0)


@dataclass(frozen=True)
class CellSums:
    """Sums of a table's cells beside what lasts, day fields eliminated, by fold of days."""

    gram: Floats  # (F, s + k, s + k): what lasts first (s columns), then the cells
    score: Floats  # (F, s + k)
    prior: Floats  # (s,): 1 over the prior variances of what lasts
    simulated: tuple[CellSums, ...] = ()  # of simulated archives, in cells of their own
    share: float = 0.0  # part of what these show by themselves that is taken off
    # (F, s + k, s + k): covariance of the scores, where the days' fields are not eliminated but
    # scatter them
    scatter: Floats | None = None

    @property
    def factor(self) -> float:
        """Scatter of the scores between folds over what ``f`` reports to one would give."""
        s, number = self.prior.size, self.score.shape[0]
        gram = self.gram.sum(axis=0)
        # cells without a report stay at nil
        ridge = np.diag(np.r_[self.prior, np.full(gram.shape[0] - s, 1e-6 * np.trace(gram))])
        best = np.linalg.solve(gram + ridge, self.score.sum(axis=0))
        apart = self.score - self.gram @ best
        spread = self.gram if self.scatter is None else self.scatter
        expected = np.diagonal(spread, axis1=1, axis2=2)[:, s:].sum() * (1 - 1 / number)
        return float(np.clip((apart[:, s:] ** 2).sum() / max(expected, 1e-9), *FACTORS))

    @property
    def lasting_share(self) -> float:
        """Part of the cells' X'X that what lasts takes up."""
        whole = float(np.trace(self.gram.sum(axis=0)[self.prior.size :, self.prior.size :]))
        left = self._beside_lasting(np.ones(self.score.shape[0], bool))[0]
        return float(np.clip(1 - np.trace(left) / max(whole, 1e-12), 0.0, 1.0))

    def explained(self, values: Floats, fold: int) -> float:
        """Energy that values fitted without a fold explain of it, in units of the noise."""
        gram, score = self.of_table(np.arange(self.score.shape[0]) == fold)
        return float(2 * values @ score - values @ gram @ values) / self.factor

    def of_table(self, keep: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Sums of the cells alone over some folds, (k, k) and (k,), what lasts eliminated."""
        left, own, part = self._beside_lasting(keep)
        if self.simulated:
            alike = [one._beside_lasting(keep)[1] for one in self.simulated]
            own = own - self.share * np.mean(alike, axis=0)
        if self.scatter is None:
            return left, own
        # least squares, and the covariance it has: information A M^-1 A about its estimate
        s, noise = self.prior.size, self.scatter[keep].sum(axis=0)
        noise[:s, :s] += np.diag(self.prior)
        turn = np.concatenate([-part, np.eye(left.shape[0])], axis=1)
        noise = turn @ noise @ turn.T
        # a cell that what lasts takes up whole has no noise left, and its equation no solution
        noise += np.eye(left.shape[0]) * max(1e-9 * np.trace(noise), 1e-12)
        told = np.linalg.solve(noise, np.column_stack([left, own]))
        return left @ told[:, :-1], left @ told[:, -1]

    def _beside_lasting(self, keep: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
        """X'X and X'r of the cells, what lasts eliminated, and the part of it in each cell."""
        s = self.prior.size
        gram, score = self.gram[keep].sum(axis=0), self.score[keep].sum(axis=0)
        gram[:s, :s] += np.diag(self.prior)
        part = np.linalg.solve(gram[:s, :s], gram[:s, s:]).T
        return gram[s:, s:] - part @ gram[:s, s:], score[s:] - part @ score[:s], part


@dataclass(frozen=True)
class Weights:
    """A residual as the reports count."""

    values: Floats  # (n, 2): residual times weight, clipped
    beside: Floats  # (D, q + s): its sums with the columns of the days and of what lasts


@dataclass(frozen=True)
class CellModel:
    """Columns of the days and of what lasts, and their sums."""

    weight: Floats  # (n,): 1 over the variance a report counts with; 0 where it is gross
    columns: NDArray[np.float32]  # (n, 2, q + s): of the day fields, then of what lasts
    day: Integers  # (n,)
    root: Floats  # (D, q, q): inverse Cholesky factor of the day fields' normal matrix
    gram: Floats  # (D, q + s, q + s)
    prior: Floats  # (s,)
    of_days: Floats  # (q,): variances of the day fields, m2 s-2
    evened: Evened | None = None  # how errors along and across the heading are made alike

    @classmethod
    def of(
        cls,
        quiet: Frame,
        plan: DictionaryPlan,
        *,
        noise: NoiseFit,
        variances: Variances,
        day: Integers,
    ) -> CellModel:
        """Sum the columns of an archive, whose frame is free of the residual's noise."""
        fields = day_field_columns(quiet, plan)
        columns = np.concatenate([fields, lasting_columns(quiet, plan)], -1)
        evened = noise.gains.evened
        columns = columns if evened is None else evened.by_report(columns)
        model = noise.model
        variance = reports_to_one(noise) * (model.correlated_sd**2 + model.white_sd**2)
        weight = np.where(noise.gains.weight > 0, noise.gains.scale**2 / variance, 0.0)
        q, width = fields.shape[-1], columns.shape[-1]
        gram = np.zeros((int(day.max()) + 1, width, width))
        order = np.argsort(day, kind="stable")
        for own in np.split(order, np.flatnonzero(np.diff(day[order])) + 1):
            part = columns[own] * np.sqrt(weight[own])[:, None, None]
            flat = part.reshape(-1, width)
            gram[day[own[0]]] = flat.T @ flat
        normal = gram[:, :q, :q] + np.diag(1 / variances.day)
        root = np.linalg.inv(np.linalg.cholesky(normal))
        prior = np.r_[1 / variances.climatology, 1 / np.square(SLOPE_SD)]
        single = columns.astype(np.float32)
        return cls(weight, single, day, root, gram, prior, variances.day, evened)

    def _even(self, values: Floats) -> Floats:
        """Vectors (n, 2) with errors alike in all directions."""
        return values if self.evened is None else np.asarray(self.evened.by_report(values))

    def weigh(self, residual: Floats) -> Weights:
        """Weigh a residual, (n, 2) m/s."""
        # one bound for all of them, that of a usual report
        spread = np.where(self.weight > 0, CLIP / np.sqrt(np.maximum(self.weight, 1e-12)), 0.0)
        bound = np.median(spread[spread > 0], keepdims=True)[:, None]
        values = self.weight[:, None] * np.clip(self._even(residual), -bound, bound)
        sums = np.einsum("nc,ncj->nj", values.astype(np.float32), self.columns)
        return Weights(values, self._by_day(sums, self.day, self.root.shape[0]))

    def score(self, weights: Weights) -> Floats:
        """Residual times weight, days and what lasts taken out: V^-1 r of every report, (n, 2)."""
        q = self.root.shape[1]
        whole = np.diag(self.prior)
        told = np.zeros(self.prior.size)
        for root, gram, own in zip(self.root, self.gram, weights.beside, strict=True):
            shared = root @ gram[:q, q:]
            whole += gram[q:, q:] - shared.T @ shared
            told += own[q:] - shared.T @ (root @ own[:q])
        lasting = np.linalg.solve(whole, told)
        fields = [
            root.T @ (root @ (own[:q] - gram[:q, q:] @ lasting))
            for root, gram, own in zip(self.root, self.gram, weights.beside, strict=True)
        ]
        out = weights.values - self.weight[:, None] * (self.columns[..., q:] @ lasting)
        daily = np.stack(fields)[self.day]
        out -= self.weight[:, None] * np.einsum("ncj,nj->nc", self.columns[..., :q], daily)
        return self._even(out)

    def sums(
        self,
        cells: Integers,
        size: int,
        direction: Floats,
        *,
        weights: Weights,
        fold: Integers,
        whole_days: bool = False,
    ) -> CellSums:
        """Sums of a table.

        Parameters
        ----------
        cells : (n,) int
            Cell of every report, -1 for none.
        size : int
            Number of cells k.
        direction : (n, 2) float
            Change of the wind by one unit of a value, m/s.
        fold : (D,) int
            Fold of every day.
        whole_days : bool
            Whether the table changes from day to day, not within one. Beside fields of each day
            it would then rest on the little of its direction's change that these do not follow,
            which the reference knows least: the fields are left in, as scatter of its scores.
        """
        days, q, _ = self.root.shape
        s, k = self.prior.size, size
        weighed = weights.values
        known = np.flatnonzero((cells >= 0) & (self.weight > 0))
        direction = self._even(direction)
        unit = direction[known] * self.weight[known, None]
        told = np.column_stack(
            [
                np.einsum("nc,ncj->nj", unit.astype(np.float32), self.columns[known]),
                (direction[known] * weighed[known]).sum(axis=1),
                (direction[known] * unit).sum(axis=1),
            ]
        )
        by_cell = self._by_day(told, self.day[known] * k + cells[known], days * k)
        by_cell = by_cell.reshape(days, k, -1)
        gram = np.zeros((int(fold.max()) + 1, s + k, s + k))
        score, scatter = np.zeros((gram.shape[0], s + k)), np.zeros_like(gram)
        for d in range(days):
            own = by_cell[d]
            beside = np.concatenate([self.gram[d, :q, q:], own[:, :q].T], axis=1)
            whole = gram[fold[d]]
            whole[:s, :s] += self.gram[d, q:, q:]
            whole[s:, :s] += own[:, q : q + s]
            whole[:s, s:] += own[:, q : q + s].T
            whole[s:, s:] += np.diag(own[:, -1])
            score[fold[d]] += np.r_[weights.beside[d, q:], own[:, -2]]
            if whole_days:
                scatter[fold[d]] += (beside.T * self.of_days) @ beside
            else:
                shared = self.root[d] @ beside
                whole -= shared.T @ shared
                score[fold[d]] -= shared.T @ (self.root[d] @ weights.beside[d, :q])
        return CellSums(gram, score, self.prior, scatter=scatter + gram if whole_days else None)

    @staticmethod
    def _by_day(values: Floats, key: Integers, length: int) -> Floats:
        """Sums of rows by key, (length, m)."""
        n = key.size
        group = csr_array((np.ones(n), (key, np.arange(n))), shape=(length, n))
        return np.asarray(group @ values)


def reports_to_one(noise: NoiseFit) -> float:
    """Reports of an archive's flights that tell a mean as well as one independent one.

    Returns
    -------
    float
        Sum of the correlations with all reports of the same flight, averaged over reports.
    """
    order, decay = noise.order, noise.gains.decay
    run = np.ones(decay.size)
    starts = order.starts
    for j in range(1, starts.size - 1):
        now = order.index[starts[j] : starts[j + 1]]
        before = order.index[starts[j - 1] : starts[j - 1] + now.size]
        run[now] += decay[now] * run[before]
    common, white = noise.model.correlated_sd**2, noise.model.white_sd**2
    return float((common * (2 * run - 1).mean() + white) / (common + white))
