"""Unknowns: tables that explain what no name does, one after the other.

Assumptions: an unknown is a table over one or two variables, of one component, of all aircraft or
of some. The best table of one variable is looked for over all variables and components; then a
second variable, finer cells, an angle or a factor in place of metres per second are tried. What a
table explains is judged on weeks left out.

Validity: that of :mod:`airswing.gap.witness.fitted_tables`. What two variables carry and neither of
them alone is seen by the learned witness, which names the pair
(:mod:`airswing.gap.witness.learned`), and of the whole fleet in products of their shapes
(:mod:`airswing.gap.witness.products`).

Units: nats, m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.reported_variables import KINDS, OF_THE_REPORT
from airswing.gap.archive.value_tables import COMPONENTS, SCALED, Axis, Grid, axis_of
from airswing.gap.witness.bench import Bench, stands_on_report
from airswing.gap.witness.fitted_tables import (
    GAIN,
    LEAST_EVIDENCE,
    Candidate,
    Unknown,
    explained,
    field_of,
    fitted,
    merged,
)
from airswing.gap.witness.jumps import Jumps, jumps
from airswing.gap.witness.learned import Heard
from airswing.gap.witness.periods import Period, periods
from airswing.gap.witness.products import products
from airswing.gap.witness.runs import Run, runs

Integers = NDArray[np.int64]

#: What a second variable must add, nats and as a share of the evidence.
SECOND = (6.0, 0.03)
#: What a finer table, or an angle in place of metres per second, must add, nats.
FINER = 3.0
#: Second variables that are fitted at most.
MOST_PAIRS = 3
#: Variables that tell each other in part: in a pair each is tried in the place of the other.
LIKES = (
    ("magnetic_heading", "track"),
    ("altitude", "temperature", "airspeed", "ground_speed"),
    ("wind_speed", "drift"),
)
#: Variables that hold the reference's wind. With the reported one both are in a table, and so is
#: their difference, the residual itself.
OF_THE_REFERENCE = ("drift", "ground_speed")
#: Variables at whose jumps tables are cut.
MOST_JUMPING = 3
#: Size of a run, m/s, of most aircraft and of at most half: each has a little of every effect, in
#: the hard world 0.20 to 0.30 by phase.
RUN_SIZE = (0.25, 0.33)
#: Cells of the two variables of a table.
PAIR_CELLS = {"circular": 8, "linear": 5, "category": 3}
#: The same where there is enough to tell.
FINE_CELLS = {"circular": 16, "linear": 10, "category": 3}


def weighed(bench: Bench, grid: Grid, component: str) -> Candidate:
    """Weigh one table: of the fleet or of some aircraft, whichever tells more."""
    found, sums = bench.weigh(grid, component)
    changes = float(max(found.fleet[0], found.single[0]))
    # along or across itself the reported wind goes with its own error; an aircraft turns about it
    itself = stands_on_report(grid) and "wind" in component
    means = -np.inf if itself else bench.weigh_means(grid, component)
    return Candidate(max(changes, means), component, grid, found, sums, means > changes)


def curves(bench: Bench) -> list[Candidate]:
    """All tables of one variable, most evidence first."""
    out = []
    for name, variable in bench.variables.items():
        grid = Grid((axis_of(variable, KINDS[name][1]),))
        out += [weighed(bench, grid, component) for component in COMPONENTS]
    return sorted(out, key=lambda c: -c.nats)


def edged(bench: Bench) -> list[Candidate]:
    """Tables cut where the residual jumps or a period begins and ends, most evidence first."""
    told: list[Jumps | Period] = [*jumps(bench)[:MOST_JUMPING], *periods(bench)[:1]]
    made = [
        _by_jumps(weighed(bench, found.grid(bench), found.component), found.nats)
        for found in told
        if found.nats >= LEAST_EVIDENCE
    ]
    return sorted(made, key=lambda c: -c.strength)


def of_runs(bench: Bench) -> list[Candidate]:
    """Tables cut at the ends of runs, of their aircraft, most evidence first."""
    few = len(bench.setting.frame.tails) // 2
    told = [
        run
        for run in runs(bench)
        if run.nats >= LEAST_EVIDENCE and run.size >= RUN_SIZE[len(run.tails) <= few]
    ]
    return [_of_run(weighed(bench, run.grid, run.component), run) for run in told[:MOST_JUMPING]]


def _of_run(candidate: Candidate, run: Run | Candidate) -> Candidate:
    """A table for which a run speaks: it is confirmed by what it was found by."""
    nats, size = (run.nats, run.size) if isinstance(run, Run) else (run.jumps, run.run)
    return replace(candidate, jumps=nats, tails=run.tails, run=size, by_means=False)


def _by_jumps(candidate: Candidate, nats: float) -> Candidate:
    """A table for which its jumps speak; whose it is only where single aircraft's tables tell."""
    whole = candidate.weighed.single[0] < LEAST_EVIDENCE
    return replace(candidate, jumps=nats, by_means=bool(candidate.by_means or whole))


def _tells_itself(names: Sequence[str]) -> bool:
    """Whether variables hold both the reported wind and the reference's."""
    return bool(set(names) & set(OF_THE_REPORT)) and bool(set(names) & set(OF_THE_REFERENCE))


def pairs_of(bench: Bench, heard: Heard) -> list[Candidate]:
    """Tables of pairs of variables, most evidence first.

    Those that the learned witness names, and whose products tell.
    """
    named = [(component, pair) for component in heard.components[:1] for pair in heard.pairs]
    named += [(component, pair) for _, component, pair in products(bench, LIKES)]
    out = [
        weighed(bench, Grid(tuple(_pair_axis(bench, name) for name in pair)), component)
        for component, pair in dict.fromkeys(named)
        if not _tells_itself(pair)
    ]
    return sorted(out, key=lambda c: -c.nats)


def refined(bench: Bench, best: Candidate, fold: Integers) -> Unknown | None:
    """The best table that holds a variable and component, fitted.

    A second variable, finer cells, an angle or a factor: each is tried where the evidence is for
    it, and what explains most on weeks left out is taken.

    Parameters
    ----------
    best : Candidate
        A table of one variable.
    fold : (D,) int
        Fold of every day.
    """
    scaled = weighed(bench, best.grid, SCALED[best.component][0])
    also = []
    if np.isfinite(best.jumps):  # a jump tells nothing of which of the two it is of
        scaled = _of_run(scaled, best) if best.run else _by_jumps(scaled, best.jumps)
        also = [best, scaled]
    best = _better(best, [scaled], FINER)
    options = _of_one(bench, best) + also + _of_two(bench, best)
    found = _most_explaining(bench, options, fold)
    if found is None or len(found.grid.axes) == 1:
        return found
    return _finest(bench, _of_likes(bench, found, fold), fold)


def exchanged(bench: Bench, table: Unknown, fold: Integers) -> Unknown:
    """A pair with others in its variables' places that have more evidence and explain more.

    A pair is found by one of its variables alone; where winds blow from one side a track tells the
    drift as well.
    """
    if len(table.grid.axes) == 1:
        return table
    pair = table
    for place in range(2):
        for candidate in _in_place(bench, pair, place):
            pair = _more_explaining(bench, pair, _fitted(bench, candidate, fold), fold) or pair
    return table if pair is table else _finest(bench, pair, fold)


def _in_place(bench: Bench, pair: Unknown, place: int) -> list[Candidate]:
    """Tables with another variable in one's place that have more evidence, most first."""
    kept = pair.grid.axes[1 - place]
    made = []
    for other in bench.variables:
        if other in pair.grid.variables or _tells_itself((other, kept.variable)):
            continue
        axes = [_pair_axis(bench, other), kept] if place == 0 else [kept, _pair_axis(bench, other)]
        made.append(weighed(bench, Grid((axes[0], axes[1])), pair.component))
    more = [one for one in made if one.nats > pair.evidence]
    return sorted(more, key=lambda one: -one.nats)[:MOST_PAIRS]


def _finest(bench: Bench, pair: Unknown, fold: Integers) -> Unknown:
    """A pair in finer cells where these explain more, its more telling variable first."""
    finest = tuple(
        axis_of(bench.variables[axis.variable], FINE_CELLS[axis.kind]) for axis in pair.grid.axes
    )
    finer = _fitted(bench, weighed(bench, Grid(finest), pair.component), fold)
    return _most_telling_first(bench, _more_explaining(bench, pair, finer, fold) or pair, fold)


def _of_likes(bench: Bench, pair: Unknown, fold: Integers) -> Unknown:
    """A pair, each of its variables the one of its like that explains most of weeks left out."""
    for place in range(2):
        name = pair.grid.variables[place]
        likes = next((group for group in LIKES if name in group), ())
        for other in set(likes) & set(bench.variables) - set(pair.grid.variables):
            axes = list(pair.grid.axes)
            axes[place] = _pair_axis(bench, other)
            if _tells_itself([axis.variable for axis in axes]):
                continue
            table = _fitted(bench, weighed(bench, Grid((axes[0], axes[1])), pair.component), fold)
            if table is None:
                continue
            told, now = (explained(bench, field_of(bench, one, fold)) for one in (table, pair))
            pair = table if told > now else pair
    return pair


def _most_telling_first(bench: Bench, pair: Unknown, fold: Integers) -> Unknown:
    """The same pair, that variable first without which it would explain less."""
    left = [explained(bench, field_of(bench, merged(bench, pair, k), fold)) for k in range(2)]
    if left[0] <= left[1]:
        return pair
    one, other = pair.grid.axes
    turned = np.arange(pair.grid.size).reshape(one.size, other.size).T.ravel()
    return replace(
        pair,
        grid=Grid((other, one)),
        values=pair.values[:, turned],
        by_fold=pair.by_fold[..., turned],
        roots=tuple(root[turned] for root in pair.roots),
    )


def _of_one(bench: Bench, best: Candidate) -> list[Candidate]:
    """Tables of one variable, coarse and fine; of a pair those of each of its variables.

    Between jumps as well: where an error falls back at each and grows again, between two of them it
    is nothing on average.
    """
    alone, jumping = len(best.grid.axes) == 1, np.isfinite(best.jumps)
    made = [best] if alone else []
    for name in best.grid.variables:
        kind = bench.variables[name].kind
        # what lasts for 10 degrees, or for a fortieth of the range, is seen; finer cells hold too
        # few reports, and a category has no finer ones
        for count in {"circular": (24, 36), "linear": (12, 20, 40), "category": ()}[kind]:
            axis = axis_of(bench.variables[name], count)
            if jumping and alone:
                axis = _cut_at(axis, best.grid.axes[0])
            finer = weighed(bench, Grid((axis,)), best.component)
            made += [finer] if not alone or jumping or finer.nats > 0.5 * best.nats else []
    return made


def _cut_at(axis: Axis, jumps: Axis) -> Axis:
    """An axis with the inner edges of another in the place of its own nearest to them."""
    own, at = axis.edges[1:-1], jumps.edges[1:-1]
    width = np.minimum(own - axis.edges[:-2], axis.edges[2:] - own)
    far = np.abs(own[:, None] - at).min(axis=1, initial=np.inf) > 0.4 * width
    return replace(axis, edges=np.r_[axis.edges[0], np.union1d(own[far], at), axis.edges[-1]])


def _of_two(bench: Bench, best: Candidate) -> list[Candidate]:
    """Tables with a second variable that the evidence is for, most first."""
    if len(best.grid.axes) == 2:
        return [best]
    name = best.grid.variables[0]
    pairs = []
    for other, variable in bench.variables.items():
        if other != name and not _tells_itself((name, other)):
            own = _pair_axis(bench, name)
            if np.isfinite(best.jumps):
                own = _cut_at(own, best.grid.axes[0])
            axes = (own, axis_of(variable, PAIR_CELLS[variable.kind]))
            pairs.append(weighed(bench, Grid(axes), best.component))
    least = best.nats + max(SECOND[0], SECOND[1] * best.nats)
    return sorted((c for c in pairs if c.nats > least), key=lambda c: -c.nats)[:MOST_PAIRS]


def _most_explaining(bench: Bench, options: Sequence[Candidate], fold: Integers) -> Unknown | None:
    """Fit tables and take the one that explains most on weeks left out; of equals the first."""
    best: Unknown | None = None
    for option in options:
        best = _more_explaining(bench, best, _fitted(bench, option, fold), fold)
    return best


def _fitted(bench: Bench, candidate: Candidate, fold: Integers) -> Unknown | None:
    """Fit a table that has evidence of its own: its probability is told by that."""
    return fitted(bench, candidate, fold) if candidate.strength >= LEAST_EVIDENCE else None


def _more_explaining(
    bench: Bench, first: Unknown | None, other: Unknown | None, fold: Integers
) -> Unknown | None:
    """The second of two tables where it explains clearly more on weeks left out, else the first."""
    if first is None or other is None:
        return first or other
    one, two = (explained(bench, field_of(bench, table, fold)) for table in (first, other))
    # a second table must earn its cells: of nothing explained a share is nothing
    return other if two > one + max(GAIN * abs(one), 1e-4) else first


def _pair_axis(bench: Bench, name: str) -> Axis:
    variable = bench.variables[name]
    # coarser than alone: a pair has the product of them, and each cell wants reports of its own
    return axis_of(variable, {"circular": 12, "linear": 6, "category": 3}[variable.kind])


def _better(best: Candidate, others: Sequence[Candidate], margin: float) -> Candidate:
    strongest = max(others, key=lambda c: c.nats, default=best)
    return strongest if strongest.nats > best.nats + margin else best
