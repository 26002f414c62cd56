"""Tables weighed and fitted: what a table's values are, on whom, and what they explain.

Assumptions: evidence and confirmation are whitened, values are means over whole cells
(:mod:`airswing.gap.witness.cell_means`). Each fold of weeks has values fitted without it.

Validity: sizes from 0.25 m/s where a table acts most; evidence from 6 nats, more than the largest
of sixty tables on archives that hold nothing.

Units: nats, m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.value_tables import Grid
from airswing.gap.held_out.share_held import BLOCK, BOUND
from airswing.gap.sums.elimination import inverse_root
from airswing.gap.witness.bench import Bench, stands_on_report
from airswing.gap.witness.cell_means import CellSums
from airswing.gap.witness.ground import Sums
from airswing.gap.witness.scan import SIZES, Weighed, evidence

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Standard errors by which weeks left out must confirm an unknown, as they must a name.
CONFIRMED = 2.0
#: Evidence that an unknown needs, nats.
LEAST_EVIDENCE = 6.0
#: Size that an unknown needs, m/s rms over the reports of its aircraft, and where it acts most.
LEAST_SIZE = (0.08, 0.25)
#: One of these of a table of half the aircraft or fewer: each has a little of every effect.
OWN_SIZE = (0.2, 0.4)
#: Prior variance of a table's mean when it is fitted, in those of its values.
MEAN = 4.0
#: Days left out together of a table by date; folds at least, for a standard error between them.
DATE_BLOCK, LEAST_FOLDS = 2, 5
#: What another table must explain more than the one before it, as a share.
GAIN = 0.03


@dataclass(frozen=True)
class Unknown:
    """A table that explains what no name does."""

    component: str
    grid: Grid
    tails: tuple[int, ...]  # aircraft; all of them where the whole fleet has it
    shared: bool  # one table for all its aircraft
    evidence: float  # nats
    # (A, k): table of each aircraft, in the unit of the component; 0 where it has none
    values: Floats
    by_fold: Floats  # (F, A, k): the same, fitted without each fold
    # (k, k) each: root of the covariance of the values: of all its aircraft's where
    # shared, else of each's
    roots: tuple[Floats, ...]
    size: float  # m/s rms over the reports of its aircraft
    peak: float  # m/s, where it acts most: mean over the tenth of its reports it changes most
    held_out: float  # energy explained on weeks left out, nats (half of squared standard errors)
    held_out_error: float
    # tuple of (float, str, tuple of str): other tables that came near: evidence, component,
    # variables
    rivals: tuple[tuple[float, str, tuple[str, ...]], ...] = ()
    run: float = 0.0  # size within the run that its edges are of, m/s

    @property
    def groups(self) -> list[list[int]]:
        """Aircraft that have a table together."""
        return [list(self.tails)] if self.shared else [[a] for a in self.tails]


@dataclass(frozen=True)
class Candidate:
    """A table weighed."""

    nats: float  # evidence
    component: str
    grid: Grid
    weighed: Weighed
    sums: Sums
    # whether it is the evidence of its cells' means, which must then confirm it
    by_means: bool = False
    jumps: float = -np.inf  # evidence of the jumps at its edges, where it was made for them
    tails: tuple[int, ...] = ()  # aircraft of the run at its edges, where it was made for one
    run: float = 0.0  # size of that run, m/s

    @property
    def strength(self) -> float:
        """Evidence of the table or of its edges, whichever is more, nats."""
        return max(self.nats, self.jumps)


def struck(candidate: Candidate) -> tuple[int, ...]:
    """Aircraft that have a table; all where the fleet has it."""
    if candidate.tails:
        return candidate.tails
    found = candidate.weighed
    own = found.by_aircraft[0]
    aircraft = own.size
    if candidate.by_means or found.single[0] < LEAST_EVIDENCE:
        return tuple(range(aircraft))
    if candidate.sums.apart is not None and found.fleet[0] >= found.single[0]:
        return tuple(range(aircraft))
    share = 0.5
    # expectation maximisation of the share of aircraft that have it
    for _ in range(20):
        odds = own + np.log(share / (1 - share))
        posterior = 1 / (1 + np.exp(-np.clip(odds, -50, 50)))
        # at none or all the odds could not move again
        share = float(np.clip(posterior.mean(), 0.05, 0.95))
    likely = np.flatnonzero((posterior > 0.5) & (own > 0.02 * own.max()))
    # the rest of so many is rather too quiet to show it than free of it
    if likely.size >= 0.75 * aircraft:
        return tuple(range(aircraft))
    return tuple(int(a) for a in likely)


def fitted(bench: Bench, candidate: Candidate, fold: Integers) -> Unknown | None:
    """Fit a table on the whole archive and without each fold."""
    tails = struck(candidate)
    if not tails:
        return None
    halves = bench.beside_others(candidate.grid, candidate.component, tails)
    fold = left_out(candidate.grid, fold, halves=halves)
    sums, found = candidate.sums, candidate.weighed
    # the mean of a table is the table's, not a steady error beside it
    prior = (candidate.grid.prior() + MEAN) / bench.scale(candidate.component) ** 2
    own = list(tails)
    whole = len(own) == sums.gram.shape[0]
    gram, score = _shared_sums(candidate, own)
    factor = np.array([found.fleet_factor if whole else found.factor])
    together, _ = evidence(gram, score.sum(axis=0)[None], prior, error=0.0, factor=factor)
    shared = bool(together[0] >= found.by_aircraft[0][own].sum() or whole)
    groups = [own] if shared else [[a] for a in own]
    values, by_fold, roots, energy = _values(
        bench, candidate.grid, candidate.component, groups, fold
    )
    # days left out hold other cells of a table by date, not the same share of all of them
    by_means = candidate.by_means or "date" in candidate.grid.variables
    if not by_means and not stands_on_report(candidate.grid):
        energy = _confirmed(candidate, prior, groups, fold)
    size, peak = sizes(bench, candidate.grid, candidate.component, values, own)
    return Unknown(
        candidate.component,
        candidate.grid,
        tails,
        shared,
        candidate.strength,
        values,
        by_fold,
        tuple(roots),
        size,
        peak,
        0.5 * float(energy.sum()),
        0.5 * float(energy.std(ddof=1) * np.sqrt(energy.size)),
        run=candidate.run,
    )


def _values(
    bench: Bench, grid: Grid, component: str, groups: Sequence[list[int]], fold: Integers
) -> tuple[Floats, Floats, list[Floats], Floats]:
    """Values of a table, without each fold, roots of their covariance, what they explain of each.

    (A, k) and (F, A, k), (k, k) of each group, and (F,).
    """
    # the mean of a table is the table's, not a steady error beside it
    prior = (grid.prior() + MEAN) / bench.scale(component) ** 2
    aircraft, folds = len(bench.setting.frame.tails), int(fold.max()) + 1
    values, by_fold = np.zeros((aircraft, grid.size)), np.zeros((folds, aircraft, grid.size))
    roots, energy = [], np.zeros(folds)
    for group in groups:
        means = bench.cell_sums(grid, component, group, fold)
        values[group], root = cell_values(means, prior)
        roots.append(root)
        for f in range(folds):
            by_fold[f, group], _ = cell_values(means, prior, without=f)
            energy[f] += means.explained(by_fold[f, group[0]], f)
    return values, by_fold, roots, energy


def left_out(grid: Grid, fold: Integers, *, halves: bool = False) -> Integers:
    """Folds in which a table is judged: weeks; of a short archive some days each.

    Of a table by date days are dealt in turn: a week that is left out would leave nothing to tell
    what its own cells hold. Of some aircraft beside others, half of the flights of these days.
    """
    days, number = fold.size, int(fold.max()) + 1
    if "date" in grid.variables:
        dealt = np.arange(days) // DATE_BLOCK % max(number, LEAST_FOLDS)
        return np.asarray((2 * dealt[:, None] + np.arange(2)).ravel() if halves else dealt)
    if number < LEAST_FOLDS <= days:
        return np.asarray(np.arange(days) * LEAST_FOLDS // days)
    return fold


def confined(bench: Bench, unknown: Unknown, fold: Integers) -> Unknown:
    """The same table without aircraft whose weeks left out show its opposite, reports alike.

    Day fields take a share of what most aircraft have, and leave the opposite to the others: these
    would have the table as well, and names against it once it was taken off. In the frame of the
    wind what errs by aircraft is their weather. Of tables of its own an aircraft has none that
    explains nothing of its weeks left out: large ones of others must not draw it in.
    """
    if "wind" in unknown.component and unknown.shared:
        return unknown
    frame, day = bench.setting.frame, bench.setting.day
    energy = _energy(bench, field_of(bench, unknown, fold))
    blocks, aircraft = int(day.max()) // BLOCK + 1, len(frame.tails)
    place = frame.aircraft * blocks + day // BLOCK
    each = np.bincount(place, energy, aircraft * blocks).reshape(aircraft, blocks)
    against = each.sum(axis=1) < -CONFIRMED * each.std(axis=1) * np.sqrt(blocks)
    if not unknown.shared:
        against = each.sum(axis=1) <= 0.0
    own = [a for a in unknown.tails if not against[a]]
    if not own or len(own) == len(unknown.tails):
        return unknown
    groups = [own] if unknown.shared else [[a] for a in own]
    halves = bench.beside_others(unknown.grid, unknown.component, own)
    fold = left_out(unknown.grid, fold, halves=halves)
    values, by_fold, roots, _ = _values(bench, unknown.grid, unknown.component, groups, fold)
    size, peak = sizes(bench, unknown.grid, unknown.component, values, own)
    return replace(
        unknown,
        tails=tuple(own),
        values=values,
        by_fold=by_fold,
        roots=tuple(roots),
        size=size,
        peak=peak,
    )


def _shared_sums(candidate: Candidate, own: Sequence[int]) -> tuple[Floats, Floats]:
    """X'V^-1 X of one table for some aircraft, and X'V^-1 r by day."""
    sums = candidate.sums
    whole = len(own) == sums.gram.shape[0]
    scores = sums.score if whole or sums.apart is None else sums.apart
    gram = sums.fleet_gram if whole else sums.gram[own].sum(axis=0)
    return gram, scores[0, own].sum(axis=0)


def _confirmed(
    candidate: Candidate, prior: Floats, groups: Sequence[list[int]], fold: Integers
) -> Floats:
    """Energy that a table explains of each fold, fitted without it, (F,)."""
    sums, found = candidate.sums, candidate.weighed
    energy = np.zeros(int(fold.max()) + 1)
    for group in groups:
        whole = len(group) == sums.gram.shape[0]
        factor = np.array([found.fleet_factor if whole else found.factor])
        gram, score = _shared_sums(candidate, group)
        daily = sums.day_weight[group].sum(axis=0)
        for f in range(energy.size):
            keep = fold != f
            # of the information the part that the days of the other folds have
            ratio = float(daily[keep].sum() / max(daily.sum(), 1e-12))
            _, value = evidence(
                gram * ratio, score[keep].sum(axis=0)[None], prior, error=0.0, factor=factor
            )
            left = value[0] @ gram @ value[0] * (1 - ratio)
            energy[f] += 2 * value[0] @ score[~keep].sum(axis=0) - left
    return energy


def cell_values(
    means: CellSums, prior: Floats, *, without: int | None = None
) -> tuple[Floats, Floats]:
    """Values of a table and a root of their covariance, (k,) and (k, k).

    Parameters
    ----------
    prior : (k, k) float
        Correlation of the values before they are seen, in squares of the component's unit.
    without : int, optional
        A fold left out.

    Returns
    -------
    values : (k,) float
    root : (k, k) float
    """
    keep = np.arange(means.score.shape[0]) != (-1 if without is None else without)
    gram, score = means.of_table(keep)
    _, mean = evidence(gram, score[None], prior, error=0.0, factor=np.array([means.factor]))
    # a smooth prior has next to nothing in its roughest direction
    inverse = np.linalg.inv(prior + 1e-9 * np.eye(prior.shape[0]))
    square = np.clip(mean[0] @ inverse @ mean[0] / mean[0].size, SIZES[0] ** 2, SIZES[-1] ** 2)
    return mean[0], inverse_root(gram / means.factor + inverse / square).T


def sizes(
    bench: Bench, grid: Grid, component: str, values: Floats, own: Sequence[int]
) -> tuple[float, float]:
    """Size over the reports of some aircraft and over the tenth changed most, m/s rms."""
    cells = bench.cells(grid)
    aircraft = bench.setting.frame.aircraft
    there = np.isin(aircraft, own) & (cells >= 0)
    change = values[aircraft[there], cells[there]]
    square = (change[:, None] * bench.direction_for(grid, component)[there]) ** 2
    speed = np.sqrt(square.sum(axis=1))
    if speed.size == 0:
        return 0.0, 0.0
    # a tenth of the reports: the largest alone would be one cell's noise
    top = np.sort(speed)[-max(1, speed.size // 10) :]
    return float(np.sqrt((speed**2).mean())), float(np.sqrt((top**2).mean()))


def merged(bench: Bench, unknown: Unknown, over: int) -> Unknown:
    """The same table with all cells of one variable made one, the mean of its reports.

    Parameters
    ----------
    over : int
        Place of the variable.

    Returns
    -------
    Unknown
        In its own cells still.
    """
    cells, wide = bench.cells(unknown.grid), np.zeros(1, np.int64)
    for place, axis in enumerate(unknown.grid.axes):
        own = np.arange(axis.size) * (place != over)
        wide = (wide[:, None] * (own.max() + 1) + own).ravel()
    count = np.bincount(cells[cells >= 0], minlength=unknown.grid.size)
    belongs = np.equal.outer(wide, np.arange(wide.max() + 1)) * 1.0
    mean = belongs * count[:, None] / np.maximum(count @ belongs, 1.0) @ belongs.T
    return replace(unknown, values=unknown.values @ mean, by_fold=unknown.by_fold @ mean)


def halved(bench: Bench, unknown: Unknown, fold: Integers) -> list[Unknown]:
    """The same table with the cells of one variable cut in two, of each that is no category."""
    halves = bench.beside_others(unknown.grid, unknown.component, unknown.tails)
    fold = left_out(unknown.grid, fold, halves=halves)
    out = []
    for place, axis in enumerate(unknown.grid.axes):
        if axis.kind == "category":
            continue
        told = bench.variables[axis.variable]
        cells = told.cells(axis.edges)
        middle = [float(np.median(told.values[cells == k])) for k in np.unique(cells[cells >= 0])]
        axes = list(unknown.grid.axes)
        axes[place] = replace(axis, edges=np.union1d(axis.edges, middle))
        grid = replace(unknown.grid, axes=tuple(axes))
        values, by_fold, _, _ = _values(bench, grid, unknown.component, unknown.groups, fold)
        out.append(replace(unknown, grid=grid, values=values, by_fold=by_fold))
    return out


def field_of(bench: Bench, unknown: Unknown, fold: Integers | None = None) -> Floats:
    """Error an unknown makes at every report, (n, 2), m/s; held out where days have folds, (D,)."""
    cells = bench.cells(unknown.grid)
    aircraft = bench.setting.frame.aircraft
    safe = np.maximum(cells, 0)
    if fold is None:
        value = unknown.values[aircraft, safe]
    else:
        halves = bench.beside_others(unknown.grid, unknown.component, unknown.tails)
        unit = bench.setting.half_day if halves else bench.setting.day
        own = left_out(unknown.grid, fold, halves=halves)[unit]
        value = unknown.by_fold[own, aircraft, safe]
    value = np.where(cells >= 0, value, 0.0)
    return np.asarray(value[:, None] * bench.direction_for(unknown.grid, unknown.component))


def explained(bench: Bench, error: Floats) -> float:
    """Energy that an error takes off the real residual, mean over the reports, m2 s-2.

    Single reports count to a bound.
    """
    return float(_energy(bench, error).mean())


def _energy(bench: Bench, error: Floats) -> Floats:
    """Energy that an error takes off every report, (n,), m2 s-2; 0 of gross ones."""
    residual = bench.residuals[0]
    near = np.abs(residual).max(axis=1) < BOUND
    return np.asarray(np.where(near, ((2 * residual - error) * error).sum(axis=1), 0.0))


def clearly_more(bench: Bench, one: Unknown, other: Unknown, fold: Integers) -> bool:
    """Whether another table explains more of weeks left out: by its share, and by its error."""
    told = [_energy(bench, field_of(bench, table, fold)) for table in (one, other)]
    day = bench.setting.day
    # errors of the reference last over days, and both tables meet the same
    block = np.bincount(day // BLOCK, told[1] - told[0])
    more = float(block.sum())
    error = float(block.std() * np.sqrt(block.size))
    return more > max(CONFIRMED * error, GAIN * abs(float(told[0].sum())))


def stands(unknown: Unknown) -> bool:
    """Whether an unknown is of practical size and explains weeks left out."""
    large = unknown.size >= LEAST_SIZE[0] and max(unknown.peak, unknown.run) >= LEAST_SIZE[1]
    if not unknown.run and 2 * len(unknown.tails) <= len(unknown.values):
        large &= unknown.size >= OWN_SIZE[0] or unknown.peak >= OWN_SIZE[1]
    return large and unknown.held_out > CONFIRMED * unknown.held_out_error
