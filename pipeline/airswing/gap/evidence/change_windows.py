"""Periods in which something may act: pairs of days that are tried, and sums over them.

Assumptions: a change happens between two days; most last to the archive's end. What sets in on a
date lasts to the end, and is multiplied by the days since; sums of that over all periods follow
from running sums of the daily ones times powers of the day.

Validity: about 60 dates are tried (every day of two months, every third of half a year).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import day_factors
from airswing.gap.sums.accumulate import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Shortest period tried, days with reports.
SHORTEST = 3
MOST_EDGES = 60  # of periods, over the archive: their pairs are tried
#: Days by which the dates of one change may differ.
NEAR = 3
#: Prior probability that a change ends again before the archive does.
ENDING = 0.2


@cache
def windows(days: int) -> Integers:
    """Pairs (first day, one past the last day) tried, (w, 2)."""
    stride = max(1, int(np.ceil(days / MOST_EDGES)))
    edges = np.arange(0, days + 1, stride)
    if edges[-1] != days:
        edges = np.r_[edges, days]
    pairs = [(a, b) for a in edges for b in edges if b - a >= SHORTEST]
    pairs = [(a, b) for a, b in pairs if (a > 0 or b < days) and (a < SHORTEST) <= (a == 0)]
    kept = [(a, b) for a, b in pairs if days - b >= SHORTEST or b == days]
    return np.array(kept, np.int64).reshape(-1, 2)  # a short archive has none


@dataclass(frozen=True)
class Windows:
    """Windows that are tried, the last one the columns at work unchanged all the time."""

    windows: Integers  # (w, 2)
    # (w,): day from which the days count that the columns are multiplied by; None: by one
    since: Floats | None
    days: Integers  # (D,)
    size: Floats  # (w,): root mean square of what the columns are multiplied by

    def scales(self, candidate: Candidate) -> Floats:
        """Prior scales (w, k): of coefficients that make as much as those of what lasts."""
        return np.asarray(candidate.scales / self.size[:, None])

    def sums(self, by_day: Floats, power: int) -> Floats:
        """Sums (w, ...) over windows of what is by day (D, ...) times a power of the factors."""
        moments = []
        for p in range(power + 1 if self.since is not None else 1):
            weighted = by_day * (self.days**p).reshape(-1, *[1] * (by_day.ndim - 1))
            running = np.concatenate([np.zeros((1, *by_day.shape[1:])), np.cumsum(weighted, 0)])
            moments.append(running[self.windows[:, 1]] - running[self.windows[:, 0]])
        if self.since is None:
            return np.asarray(moments[0])
        since = self.since.reshape(-1, *[1] * (by_day.ndim - 1))
        terms = [comb(power, p) * (-since) ** (power - p) * m for p, m in enumerate(moments)]
        ramps = np.sum(terms, axis=0)
        ramps[-1] = moments[0][-1]
        return np.asarray(ramps)


def windows_tried(
    stats: Statistics, candidate: Candidate, period: tuple[int, int] | None
) -> tuple[Windows, Floats]:
    """Windows (near a period, where it is given), and the log prior of all but the last one."""
    days = stats.days.size
    tried = windows(days)
    if candidate.kind == "onset":
        tried = tried[(tried[:, 1] == days) & (tried[:, 0] > 0)]
    prior = _window_prior(tried, days)
    if period is not None:
        near = (np.abs(tried - np.array(period)) <= NEAR).all(axis=1)
        tried, prior = tried[near], prior[near]
    if len(prior):
        prior = prior - np.logaddexp.reduce(prior)
    whole = np.concatenate([tried, [[0, days]]])
    if candidate.kind != "onset":
        return Windows(whole, None, stats.days, np.ones(len(whole))), prior
    # counted from the archive's first day: the squares of large numbers would cancel
    count, numbers = stats.day_count.sum(axis=0), stats.days - stats.days[0]
    factors = [day_factors(candidate, (a, b), stats.days) for a, b in tried]
    since = [numbers[a] - f[a] for (a, _), f in zip(tried, factors, strict=True)]
    square = [f**2 @ count / max((f > 0) @ count, 1e-9) for f in factors]
    size = np.sqrt([*square, 1.0])
    return Windows(whole, np.array([*since, 0.0]), numbers, size), prior


def _window_prior(tried: Integers, days: int) -> Floats:
    """Log weight of windows: those that last to the end share 1 - ENDING, the others ENDING."""
    last = tried[:, 1] == days
    count = np.array([(~last).sum(), last.sum()])
    weight = np.where(last, (1 - ENDING) / max(count[1], 1), ENDING / max(count[0], 1))
    return np.asarray(np.log(weight))


__all__ = ["Windows", "windows", "windows_tried"]
