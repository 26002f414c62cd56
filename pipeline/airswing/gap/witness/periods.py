"""Periods: days between which a component of the whole fleet's winds is off.

Assumptions: an effect that all aircraft have from one day to another is one number of these days
beside another of all the rest. Cells of a week each straddle its ends and hold a part of it; every
pair of ends is tried instead, on sums of single days, and what each would explain is averaged over
them all (Smith 1975, Biometrika 62, 407-416), so that looking at many costs what it should. The
error that the aircraft of a day share scatters these sums (:mod:`airswing.gap.witness.cell_means`);
from day to day it is taken for independent but for the cluster factor.

Validity: at least :data:`SHORTEST` days inside and outside; what single aircraft have shows in
their own tables, beside the others of the same days.

Units: nats; m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.value_tables import SCALED, Axis, Grid
from airswing.gap.held_out.share_held import BLOCK
from airswing.gap.witness.bench import PERSISTENT, Bench
from airswing.gap.witness.scan import SIZES

Floats = NDArray[np.float64]

#: Days inside and outside of a period at least: weather lasts two.
SHORTEST = 3


@dataclass(frozen=True)
class Period:
    """Days on which a component is off."""

    component: str
    # first, last: days, the second one not of it
    first: int
    last: int
    nats: float  # evidence, averaged over where it begins and ends

    def grid(self, bench: Bench) -> Grid:
        """Cells before, within and after it."""
        starts = _starts(bench)
        inner = [starts[day] for day in (self.first, self.last) if 0 < day < starts.size - 1]
        return Grid((Axis("date", "linear", np.array([starts[0], *inner, starts[-1]])),))


def periods(bench: Bench) -> list[Period]:
    """The likeliest period of each component, most evidence first; none of a short archive.

    As metres per second or as an angle or factor, whichever tells more.
    """
    starts = _starts(bench)
    days = starts.size - 1
    if "date" not in bench.variables or days < 4 * SHORTEST:
        return []
    grid = Grid((Axis("date", "linear", starts),))
    fleet, blocks = range(len(bench.setting.frame.tails)), np.arange(days) // BLOCK
    found = []
    for component, (scaled, _) in SCALED.items():
        each = []
        for name in (component, scaled):
            sums, unit = bench.cell_sums(grid, name, fleet, blocks), bench.scale(name)
            gram, score = sums.of_table(np.ones(sums.score.shape[0], bool))
            factor = max(sums.factor, 1.0)
            each.append(_likeliest(component, gram / unit**2, score / unit, factor))
        found.append(max(each, key=lambda one: one.nats))
    return sorted(found, key=lambda one: -one.nats)


def _starts(bench: Bench) -> Floats:
    """Date at which each day begins, and the end of the last, (D + 1,)."""
    date, day = bench.variables["date"].values, bench.setting.day
    days = int(day.max()) + 1
    first, last = np.full(days, np.inf), np.full(days, -np.inf)
    np.minimum.at(first, day, date)
    np.maximum.at(last, day, date)
    return np.asarray(np.r_[first[0], 0.5 * (first[1:] + last[:-1]), last[-1]], np.float64)


def _likeliest(component: str, gram: Floats, score: Floats, factor: float) -> Period:
    """Weigh every period on sums of single days, (D, D) and (D,)."""
    days = score.size
    first, last = np.triu_indices(days + 1, SHORTEST)
    inside = last - first <= days - SHORTEST
    first, last = first[inside], last[inside]
    summed = np.zeros((days + 1, days + 1))
    summed[1:, 1:] = gram.cumsum(axis=0).cumsum(axis=1)
    told = np.r_[0.0, score.cumsum()]
    here = told[last] - told[first]
    square = summed[last, last] - summed[first, last] - summed[last, first] + summed[first, first]
    # beside what is there on all days: that is no period's
    share = (summed[last, -1] - summed[first, -1]) / summed[-1, -1]
    here = (here - share * told[-1]) / factor
    # a period that is the whole archive has nothing beside it
    square = np.maximum(square - share**2 * summed[-1, -1], 1e-9) / factor
    narrow = square * (1 + square * PERSISTENT**2)
    each = np.empty((SIZES.size, first.size))
    for s, size in enumerate(SIZES):
        wide = square * (1 + square * (PERSISTENT**2 + size**2))
        each[s] = 0.5 * (here**2 / narrow - here**2 / wide - np.log(wide / narrow))
    nats = np.logaddexp.reduce(each, axis=0) - np.log(SIZES.size)
    best = int(np.argmax(nats))
    whole = float(np.logaddexp.reduce(nats) - np.log(nats.size))
    return Period(component, int(first[best]), int(last[best]), whole)
