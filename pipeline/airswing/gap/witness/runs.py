"""Runs: neighbouring cells of a variable in which some aircraft are off by one and the same amount.

Assumptions: a table has a value for every cell and aircraft, and what a small effect shows is lost
among them: of four aircraft off by 0.4 m/s in three cells of sixteen, five standard errors each,
tables that leave all else open see nothing. One amount t in one run of cells, of a share pi of the
aircraft, is two numbers and a place. With X'V^-1 X = g_a and X'V^-1 r = b_a of the run and
aircraft a,

    log B_a = (t b_a - t^2 g_a / 2) / (f + e^2 g_a),      B = mean prod_a ((1 - pi) + pi B_a),

the mean over runs, amounts and shares: what looking at many costs is in it. f is the cluster
factor, that of the whole fleet as far as aircraft share it; e what lasts, of the whole fleet by
place as much as models are off in one region for a season.

Validity: variables that hold nothing of the residual. An effect that is no run is seen by the run
most like it.

Units: nats; m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from airswing.gap.archive.reported_variables import OF_THE_REPORT, Variable
from airswing.gap.archive.value_tables import COMPONENTS, SCALED, Axis, Grid, axis_of
from airswing.gap.witness.bench import PERSISTENT, Bench, lasting_of_fleet
from airswing.gap.witness.ground import Sums
from airswing.gap.witness.scan import SHARES, own_factor

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Variables that hold the wind's error.
HOLDS_ERROR = ("drift", *OF_THE_REPORT)
#: Cells of a variable.
CELLS = {"circular": 24, "linear": 16, "category": 3}
#: Amounts that are averaged over, of either sign, m/s rms.
AMOUNTS = 0.15 * 2 ** (np.arange(9) / 2)
#: Share of the aircraft from which all have it.
ALL = 0.75


@dataclass(frozen=True)
class Run:
    """Cells of a variable in which some aircraft are off."""

    component: str  # m/s, also where it shows more as an angle or factor of the wind
    # cells beside the run and of it; of a direction it may go through 0
    grid: Grid
    tails: tuple[int, ...]
    size: float  # m/s rms within it
    nats: float  # evidence, averaged over runs, amounts and shares


def runs(bench: Bench) -> list[Run]:
    """The likeliest run of every variable and component, most evidence first."""
    found = []
    for name, variable in bench.variables.items():
        if name in HOLDS_ERROR:
            continue
        fine = Grid((axis_of(variable, CELLS[variable.kind]),))
        ends = spans(variable.kind, fine.size)
        for component in COMPONENTS:
            ways = (component, SCALED[component][0]) if "wind" in component else (component,)
            each = [_strongest(bench, fine, ends, way) for way in ways]
            nats, place, tails, size = max(each, key=lambda one: one[0])
            if tails:
                grid = Grid((_axis(variable, fine.axes[0], ends[place]),))
                found.append(Run(component, grid, tails, size, nats))
    return sorted(found, key=lambda run: -run.nats)


def _strongest(
    bench: Bench, fine: Grid, ends: Integers, component: str
) -> tuple[float, int, tuple[int, ...], float]:
    """Evidence of a variable's runs, the likeliest, its aircraft and its size."""
    sums, _ = bench.sums(fine, component)
    scale = bench.scale(component)
    inside = _inside(ends, fine.size)
    score = sums.score[0] @ inside.T
    gram = np.einsum("mk,akl,ml->am", inside, sums.gram, inside, optimize=True)
    flown = (sums.count @ inside.T) > 0
    gram = np.where(flown, np.maximum(gram, 0.0), 0.0)
    lasting = lasting_of_fleet(fine, sums.lasting_share)
    return evidence(
        np.where(flown, score.sum(axis=1), 0.0) * scale**-1,
        gram / scale**2,
        (own_factor(sums, sums.score[0]), _of_fleet(sums, score)),
        lasting,
    )


def _of_fleet(sums: Sums, score: Floats) -> Floats:
    """Scatter of all aircraft's daily scores (A, D, m) together over that of their own, (m,)."""
    together = score.sum(axis=0)
    # a column that no report moves scatters by nothing
    whole = np.maximum((score**2).sum(axis=(0, 1)), 1e-12)
    days = max(together.shape[0] - 1, 1)
    apart = together - together.mean(axis=0)
    return np.asarray((apart**2).sum(axis=0) * (together.shape[0] / days) / whole)


def spans(kind: str, size: int) -> Integers:
    """First cell of every run and that after its last, (m, 2); of a turn at most half of it."""
    if kind == "category":
        return np.stack([np.arange(size), np.arange(size) + 1], -1)
    turns = kind == "circular"
    longest = size // 2 if turns else size - 1
    return np.array(
        [(k, k + n) for n in range(1, longest + 1) for k in range(size if turns else size - n + 1)]
    )


def _inside(ends: Integers, size: int) -> Floats:
    """Whether a cell is of a run, (m, k)."""
    apart = np.mod(np.arange(size) - ends[:, :1], size)
    return np.asarray(apart < ends[:, 1:] - ends[:, :1], np.float64)


def _axis(variable: Variable, fine: Axis, ends: Integers) -> Axis:
    """Cells of a run and beside it."""
    if variable.kind == "category":
        return fine
    turn = fine.size if variable.kind == "circular" else fine.size + 1
    inner = fine.edges[np.unique(np.r_[0, ends % turn, fine.size])]
    return Axis(fine.variable, fine.kind, inner)


def evidence(
    score: Floats, gram: Floats, factors: tuple[float, Floats], lasting: float
) -> tuple[float, int, tuple[int, ...], float]:
    """Log Bayes factor of one amount in one run of some aircraft against none.

    Parameters
    ----------
    score, gram : (A, m) float
        Of every aircraft and run, in s/m and (s/m)^2.
    factors : (float, (m,) float)
        Cluster factor of an aircraft's scores, and what days of the whole fleet scatter more.
    lasting : float
        What lasts of the fleet, m/s.

    Returns
    -------
    nats : float
    run : int
        The likeliest.
    tails : tuple of int
        Aircraft that have it, in the likeliest run.
    size : float
        m/s, by least squares.
    """
    totals: list[Floats] = []
    best: tuple[float, int, tuple[int, ...]] = (-np.inf, 0, ())
    own_scatter, together = factors
    for share, amount in product(SHARES, np.concatenate([AMOUNTS, -AMOUNTS])):
        wide = own_scatter * (1 + share * np.maximum(together - 1, 0.0))
        wide = wide + gram * (PERSISTENT**2 + (share * lasting) ** 2)
        own = (amount * score - 0.5 * amount**2 * gram) / wide
        total = np.logaddexp(np.log1p(-share), np.log(share) + own).sum(axis=0)
        totals.append(total)
        place = int(np.argmax(total))
        if total[place] > best[0]:
            has = np.flatnonzero(own[:, place] > np.log(1 / share - 1))
            best = float(total[place]), place, tuple(int(a) for a in has)
    _, place, tails = best
    if len(tails) >= ALL * score.shape[0]:
        tails = tuple(range(score.shape[0]))
    nats = float(logsumexp(totals) - np.log(len(totals) * score.shape[1]))
    own = list(tails)
    # where the best stands there is information; a chance of none would be a size without end
    size = abs(score[own, place].sum()) / max(gram[own, place].sum(), 1e-9)
    return nats, place, tails, float(size)
