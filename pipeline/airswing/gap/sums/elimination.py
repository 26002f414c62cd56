"""Linear algebra on the sums: day fields out, climatology and found effects conditioned on.

Assumptions: whitened residuals are X theta plus unit noise plus, every day, a random combination of
the day-field columns, of the variances of :mod:`airswing.gap.sums.variance_components`. Eliminating
the day fields couples the aircraft that flew on the same day; the coupling is kept between
everything that is conditioned on, and between aircraft in fleet-wide columns.

Validity: conditional sums of an aircraft's own columns are exact; sums of candidates of *different*
aircraft are treated as independent once the included columns are conditioned on. Dictionary columns
against columns in force for a part of a week use the week's average.

Source: Frisch-Waugh-Lovell elimination; mixed-model equations of Henderson (1975).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.variance_components import Variances, lasting_prior, shared_variances
from airswing.gap.sums.weighted_columns import own_row, weekly_sums

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Key = tuple[int, bytes]
"""A column and a digest of its weights."""


@dataclass(frozen=True)
class Included:
    """One column that is conditioned on."""

    column: int  # a column of the layout; one outside the core is in force by whole weeks
    weights: Floats  # (A, D): factor on the column per aircraft and day: 1 where it acts
    precision: float  # 1 over its prior variance
    digest: bytes | None = None  # of the weights, where it is known already

    @cached_property
    def key(self) -> Key:
        """What tells it from others, whatever its precision."""
        return self.column, self.digest or digest_of(self.weights)


@dataclass(frozen=True)
class Base:
    """Sums with the day fields eliminated."""

    stats: Statistics
    variances: Variances  # of the day fields' coefficients and of the climatology's
    root: Floats  # (D, q, q): inverse Cholesky factor of the day fields' normal matrix, per day
    cross: Floats  # (A, D, q, p): ``root`` times Z'X
    score: Floats  # (A, D, p): X'r with the day fields eliminated
    # (2, T): log probability of the sizes of an aircraft's background
    # (:mod:`airswing.gap.evidence.between_aircraft_variance`), in effects of the heading (second
    # row) and in the others
    background: Floats | None = None
    # (p,): what the scatter of headings looks like in each column, m/s
    # (:mod:`airswing.gap.evidence.scattered_headings`)
    scattered: Floats | None = None
    # rows, fleet_rows, daily, blocks: what was computed already of weighted columns, by column and
    # digest of the weights: X'Y with every column, of each aircraft and of all together, coupling
    # and X'r by day, X'X of an aircraft's own by fold
    rows: dict[Key, Floats] = field(default_factory=dict, repr=False)
    fleet_rows: dict[Key, Floats] = field(default_factory=dict, repr=False)
    daily: dict[Key, tuple[Floats, Floats]] = field(default_factory=dict, repr=False)
    blocks: dict[tuple[object, ...], Floats] = field(default_factory=dict, repr=False)

    @cached_property
    def _flat(self) -> Floats:
        return self.cross.reshape(self.cross.shape[0], -1, self.cross.shape[-1])

    @cached_property
    def fleet_cross(self) -> Floats:
        """``root`` times Z'X of all aircraft together, (D, q, p)."""
        return np.asarray(self.cross.sum(axis=0))

    @cached_property
    def gram(self) -> Floats:
        """Own X'X per aircraft with the day fields eliminated, (A, p, p)."""
        whole = self.stats.whole_gram
        return np.asarray(whole - np.matmul(self._flat.transpose(0, 2, 1), self._flat))

    @cached_property
    def fleet_gram(self) -> Floats:
        """X'X of the fleet-wide columns, coupling of the aircraft included, (p, p)."""
        total = self.fleet_cross.reshape(-1, self.cross.shape[-1])
        whole = self.stats.whole_gram.sum(axis=0)
        return np.asarray(whole - total.T @ total)

    @cached_property
    def whole_score(self) -> Floats:
        """X'r of each aircraft's columns over all days, (A, p)."""
        return np.asarray(self.score.sum(axis=1))

    @cached_property
    def lasting_share(self) -> Floats:
        """Share of each fleet-wide column's X'X that the climatology and the slope take, (p,)."""
        lasting = climatology(self)
        cross = _cross_rows(self, lasting)[1]
        taken = ((fit_included(self, lasting).half @ cross) ** 2).sum(axis=0)
        own = np.diagonal(self.fleet_gram)
        # a column that never acts has nothing to be taken up
        share = np.divide(taken, own, out=np.zeros_like(taken), where=own > 1e-9)
        return np.asarray(np.clip(share, 0.0, 1.0))


@dataclass(frozen=True)
class Conditional:
    """Sums given the included columns; by day: :mod:`airswing.gap.sums.day_scores`."""

    base: Base
    included: tuple[Included, ...]
    fit: Fit
    # rows, fleet_rows: X'Y between each included column and each aircraft's every column, m of
    # (A, p), and of the fleet's columns, (m, p)
    rows: list[Floats]
    fleet_rows: Floats
    gram: Floats  # (A, p, p)
    score: Floats  # (A, p)
    fleet_gram: Floats  # (p, p)
    fleet_score: Floats  # (p,)
    # columns projected out of all others (:mod:`airswing.gap.sums.beyond`)
    beside: Beside | None = None
    # what has been computed from these sums already
    derived: dict[str, Floats] = field(default_factory=dict, repr=False)

    @property
    def coefficients(self) -> Floats:
        """Posterior means of the included columns' coefficients, (m,)."""
        return self.fit.coefficients

    @property
    def covariance(self) -> Floats:
        """Their posterior covariance at unit noise, (m, m)."""
        return self.fit.covariance

    @property
    def lasting_share(self) -> Floats:
        """See :attr:`Base.lasting_share`, (p,)."""
        return self.base.lasting_share

    @property
    def background(self) -> Floats | None:
        """See :class:`Base`, (2, T)."""
        return self.base.background

    @property
    def scattered(self) -> Floats | None:
        """See :class:`Base`, (p,)."""
        return self.base.scattered


@dataclass(frozen=True)
class Beside:
    """Columns of each unit's own that are projected out, and their share of all others."""

    columns: Integers  # (k,)
    own: Floats  # (A, k, p)
    fleet: Floats  # (k, p)


def eliminate_days(stats: Statistics, variances: Variances | None = None) -> Base:
    """Eliminate the day fields from all sums.

    Parameters
    ----------
    variances : Variances, optional
        Estimated when not given.
    """
    variances = shared_variances(stats) if variances is None else variances
    fields = stats.layout.blocks["day_fields"]
    normal = stats.day_cross[..., fields].sum(axis=0, dtype=float) + np.diag(1 / variances.day)
    root = np.linalg.inv(np.linalg.cholesky(normal))
    shared = np.einsum("dij,dj->di", root, stats.day_score[:, :, fields].sum(axis=0))
    cross, score = np.empty(stats.day_cross.shape), stats.day_score.copy()
    for own, out, left in zip(stats.day_cross, cross, score, strict=True):
        np.matmul(root, own, out=out)  # an aircraft at a time, for memory
        left -= (shared[:, None] @ out)[:, 0]
    return Base(stats, variances, root, cross, score)


def climatology(base: Base) -> list[Included]:
    """Included columns of the reference's climatology: fleet-wide, with the archive's prior."""
    ones = np.ones(base.stats.day_count.shape)
    same = digest_of(ones)
    prior = lasting_prior(base.stats.layout, base.variances.climatology)
    pairs = zip(*prior, strict=True)
    return [Included(int(column), ones, float(precision), same) for column, precision in pairs]


def condition(
    base: Base,
    included: list[Included],
    *,
    columns: Integers | None = None,
    aircraft: int | None = None,
) -> Conditional:
    """Condition sums on a set of columns.

    Parameters
    ----------
    columns : (k,) int, optional
        Where sums are asked for of these only: those of others stay 0.
    aircraft : int, optional
        One whose own sums are then asked for of all columns.
    """
    fit = fit_included(base, included)
    rows, fleet = _cross_rows(base, included)
    everything = slice(None)
    if columns is None:
        gram, score = _own_sums(base, fit, rows, everything, everything)
    else:
        gram, score = np.zeros(base.gram.shape), np.zeros(base.whole_score.shape)
        square = everything, columns[:, None], columns
        gram[square], score[:, columns] = _own_sums(base, fit, rows, everything, columns)
    if aircraft is not None:
        one = slice(aircraft, aircraft + 1)
        gram[one], score[one] = _own_sums(base, fit, rows, one, everything)
    sums = _fleet_sums(base, fit, fleet, columns)
    return Conditional(base, tuple(included), fit, rows, fleet, gram, score, *sums)


def _own_sums(
    base: Base, fit: Fit, rows: list[Floats], own: slice, some: slice | Integers
) -> tuple[Floats, Floats]:
    """X'X (n, k, k) and X'r (n, k) of some columns of some aircraft given what is fitted."""
    cross = np.stack([row[own, some] for row in rows], axis=1)
    reduced = fit.half @ cross
    gram = base.gram[own][:, some][:, :, some] - reduced.transpose(0, 2, 1) @ reduced
    return gram, base.whole_score[own][:, some] - fit.coefficients @ cross


def _fleet_sums(
    base: Base, fit: Fit, fleet: Floats, columns: Integers | None
) -> tuple[Floats, Floats]:
    """X'X (p, p) and X'r (p,) of fleet-wide columns given what is fitted; of some alone."""
    some = np.arange(fleet.shape[1]) if columns is None else columns
    reduced = fit.half @ fleet[:, some]
    square = np.ix_(some, some)
    gram, score = np.zeros(base.fleet_gram.shape), np.zeros(fleet.shape[1])
    gram[square] = base.fleet_gram[square] - reduced.T @ reduced
    score[some] = base.whole_score[:, some].sum(axis=0) - fit.coefficients @ fleet[:, some]
    return gram, score


@dataclass(frozen=True)
class Fit:
    """Ridge fit of included columns alone."""

    coefficients: Floats  # (m,)
    # covariance, half: (m, m): posterior covariance at unit noise and its lower factor's transpose
    covariance: Floats
    half: Floats
    gram: Floats  # (m, m)
    score: Floats  # (D, m)


def fit_included(base: Base, included: list[Included]) -> Fit:
    """Fit the included columns, without a look at any other."""
    return _fit(included, *included_sums(base, *_stacked(included), keys=[x.key for x in included]))


def fits_by_fold(base: Base, included: list[Included], fold: Integers) -> Iterator[tuple[Fit, Fit]]:
    """Fit the included columns without each fold of days in turn, and on its days alone.

    Parameters
    ----------
    fold : (D,) int
        Fold of every day.

    Yields
    ------
    without, within : Fit
        By day, of the days they are made of.
    """
    columns, weights = _stacked(included)
    gram, by_day = _daily_sums(base, columns, weights, fold)
    for f in range(gram.shape[0]):
        # summed anew, not the whole less the fold: of what acts in the fold alone nothing is left
        parts = (fold != f, np.delete(gram, f, axis=0).sum(axis=0)), (fold == f, gram[f])
        without, within = (
            _fit(included, own + weekly_sums(base.stats, columns, weights, days), by_day[days])
            for days, own in parts
        )
        yield without, within


def _fit(included: list[Included], gram: Floats, by_day: Floats) -> Fit:
    half = inverse_root(gram + np.diag([x.precision for x in included]))
    covariance = half.T @ half
    return Fit(covariance @ by_day.sum(axis=0), covariance, half, gram, by_day)


def inverse_root(matrix: Floats) -> Floats:
    """Root H of the inverse of a positive matrix, H'H = matrix^-1, collinear directions damped.

    Parameters
    ----------
    matrix : (m, m) float

    Returns
    -------
    (m, m) float
    """
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-30))
    # at unit diagonal: radians and m/s stand side by side, and the floor is the same for all
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-6))).T / scale)


def _stacked(included: list[Included]) -> tuple[Integers, Floats]:
    columns = np.array([x.column for x in included], np.int64)
    return columns, np.stack([x.weights for x in included])


def included_sums(
    base: Base, columns: Integers, weights: Floats, *, keys: Sequence[Key] | None = None
) -> tuple[Floats, Floats]:
    """X'X among weighted core columns, and X'r by day.

    Parameters
    ----------
    columns : (m,) int
    weights : (m, A, D) float
    keys : sequence of (m,) Key, optional
        Of the weighted columns, where they are known already.

    Returns
    -------
    gram : (m, m) float
    score : (D, m) float
    """
    whole = np.zeros(base.stats.days.size, np.int64)
    gram, by_day = _daily_sums(base, columns, weights, whole, keys)
    return gram[0] + weekly_sums(base.stats, columns, weights, whole == 0), by_day


def included_by_fold(base: Base, included: list[Included], fold: Integers) -> tuple[Floats, Floats]:
    """X'X of included core columns by fold of days (F, m, m), and their X'r by day (D, m)."""
    return _daily_sums(base, *_stacked(included), fold, [x.key for x in included])


def _daily_sums(
    base: Base,
    columns: Integers,
    weights: Floats,
    fold: Integers,
    known: Sequence[Key] | None = None,
) -> tuple[Floats, Floats]:
    """X'X by fold of days, (F, m, m), as far as daily sums tell it; X'r by day, (D, m).

    Of columns outside the core that is the coupling alone.
    """
    stats = base.stats
    belongs = (fold == np.arange(int(fold.max()) + 1)[:, None]).astype(float)
    even = (weights == 1.0).all(axis=(1, 2))  # the same for all: of these the fleet's sums will do
    coupled = np.empty((columns.size, *base.fleet_cross.shape[:2]))
    by_day = np.empty((stats.days.size, columns.size))
    coupled[even] = np.moveaxis(base.fleet_cross[:, :, columns[even]], -1, 0)
    by_day[:, even] = base.score[:, :, columns[even]].sum(axis=0)
    partly = np.flatnonzero(~even).tolist()
    if known is None:
        keys = {k: (int(columns[k]), digest_of(weights[k])) for k in partly}
    else:
        keys = {k: known[k] for k in partly}
    for k, key in keys.items():
        if key not in base.daily:
            active = np.flatnonzero(weights[k].any(axis=1))
            own, column = weights[k][active], columns[k]
            base.daily[key] = (
                np.einsum("ad,adi->di", own, base.cross[active, :, :, column]),
                (own * base.score[active, :, column]).sum(axis=0),
            )
        coupled[k], by_day[:, k] = base.daily[key]
    core = columns < stats.layout.core
    always, others = np.flatnonzero(core & even), np.flatnonzero(core & ~even)
    gram = np.zeros((belongs.shape[0], columns.size, columns.size))
    sums = stats.fleet_day_gram[:, columns[always][:, None], columns[always]]
    gram[:, always[:, None], always] = np.tensordot(belongs, sums, 1)
    acting = np.asarray(weights[others].any(axis=2))
    for a in np.flatnonzero(acting.any(axis=0)).tolist():
        own = others[acting[:, a]]
        beside = np.r_[always, own]
        # from one set of terms to the next most aircraft keep theirs
        block = a, fold.tobytes(), columns[always].tobytes(), *(keys[k] for k in own.tolist())
        if block not in base.blocks:
            sums = stats.day_gram[a][:, columns[own][:, None], columns[beside]]
            factor = weights[own, a].T[:, :, None] * weights[beside, a].T[:, None, :]
            base.blocks[block] = np.tensordot(belongs, factor * sums, 1)
        gram[:, own[:, None], beside] += base.blocks[block]
    gram[:, always[:, None], others] = gram[:, others[:, None], always].swapaxes(1, 2)
    for f in range(belongs.shape[0]):
        flat = coupled[:, fold == f].reshape(columns.size, -1)
        gram[f] -= flat @ flat.T
    return gram, by_day


def digest_of(weights: Floats) -> bytes:
    """What tells weights from others; most are 0, and are not gone through."""
    # places as well as values: the same numbers on other days are other weights
    where = np.flatnonzero(weights)
    told = where.tobytes() + weights.ravel()[where].tobytes()
    return blake2b(told, digest_size=16).digest()


def _cross_rows(base: Base, included: list[Included]) -> tuple[list[Floats], Floats]:
    """X'Y between each included column and each aircraft's every column, (A, p); the fleet's, (p,).

    The latter stacked, (m, p).
    """
    keys = [x.key for x in included]
    new = [k for k, key in enumerate(keys) if key not in base.rows]
    if new:
        shared = [
            np.einsum(
                "bd,bdi->di", included[k].weights, base.cross[:, :, :, included[k].column]
            ).ravel()
            for k in new
        ]
        coupled = np.stack(shared) @ base._flat  # all at once: the whole cross is gone through
        for i, k in enumerate(new):
            own = own_row(base.stats, included[k].column, included[k].weights)
            base.rows[keys[k]] = own - coupled[:, i]
            base.fleet_rows[keys[k]] = base.rows[keys[k]].sum(axis=0)
    return [base.rows[key] for key in keys], np.stack([base.fleet_rows[key] for key in keys])
