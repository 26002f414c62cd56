"""Who reports, since when, and who fell silent.

Assumes that an aircraft flies on a day by its own habit: with the probability its past shows, and
in gaps as long as it has had before. Days on which hardly any aircraft reports are the archive's,
and count for nobody.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from airswing.evaluation.monitoring.sequential_test import Index

RARE = 1e-6
"""Probability of a silence by chance, at the aircraft's own habit."""
SHORTEST = 5
"""Days without a report that are never told."""
REPORTING = 0.2
"""Share of the fleet's usual number below which a day is the archive's own gap."""


class Spell(NamedTuple):
    """A silence: first day, night it was noticed, length so far, what was usual, still so."""

    number: int
    first: int
    noticed: int
    days: int
    usual_days: int
    lasts: bool


def first_and_silent_days(
    aircraft: Index, day: Index, number: int, last: int
) -> tuple[Index, list[Spell]]:
    """First day of every aircraft, and its silences.

    Parameters
    ----------
    aircraft, day : array of int, shape (rows,)
        Days with reports, by aircraft and day.
    last : int
        Last day.

    Returns
    -------
    first : array of int, shape (number,)
        Beyond ``last`` for those that never reported.
    spells : list of Spell
    """
    counts = np.bincount(day - day.min(), minlength=last + 1 - day.min())
    usual = np.median(counts[counts > 0])
    open_days = np.cumsum(counts >= REPORTING * usual)
    begin, spells = np.full(number, last + 1), []
    edges = np.searchsorted(aircraft, np.arange(number + 1))
    for k, (start, stop) in enumerate(pairwise(edges)):
        if start == stop:
            continue
        begin[k] = day[start]
        own = day[start:stop] - day.min()
        edge = np.append(open_days[own], open_days[-1])
        gaps = np.diff(edge) - 1  # open days between two days with reports
        gaps[-1] += 1
        usual_gaps = _usual_gaps(gaps)
        for j in np.flatnonzero(gaps > usual_gaps):
            noticed = np.searchsorted(open_days, edge[j] + usual_gaps[j] + 1)
            first = int(np.searchsorted(open_days, edge[j] + 1))
            base, still = int(day.min()), bool(j == gaps.size - 1)
            days = int(usual_gaps[j]) + 1
            spells.append(
                Spell(k, base + first, base + int(noticed), days, int(usual_gaps[j]), still)
            )
    return begin, spells


def _usual_gaps(gaps: Index) -> Index:
    """Longest gap that the days before each gap make usual."""
    flown = np.arange(1, gaps.size + 1)
    before = np.concatenate([[0], np.cumsum(gaps)[:-1]])
    idle = (before + 1.0) / (flown + before + 2.0)
    longest = np.concatenate([[0], np.maximum.accumulate(gaps)[:-1]])
    chance = np.ceil(np.log(RARE) / np.log(idle))
    shortest = np.full(gaps.size, SHORTEST)
    return np.asarray(np.maximum(np.maximum(shortest, 2 * longest), chance), np.int64)
