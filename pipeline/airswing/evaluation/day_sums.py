"""Disagreement summed by aircraft and day: what a field test rests on, and its bootstrap over days.

Assumes days are the units that are independent: every flight of a day shares the model's error.
Two groups of aircraft (controls, corrected) and two windows (before, during). Knots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.products.ragged import aircraft_of_report

GROUPS = ("controls", "corrected")
WINDOWS = ("before", "during")
Floats = NDArray[np.float64]


class DayPart(NamedTuple):
    """Reports and summed disagreement of the aircraft of a block by day and window."""

    days: NDArray[np.int64]  # (day, 2): day since 1970 and window (0 before, 1 during)
    counts: Floats  # (aircraft, day)
    total: Floats  # (aircraft, day)

    @classmethod
    def of(
        cls,
        headings: xr.Dataset,
        difference: Floats,
        chosen: NDArray[np.bool_],
        window: NDArray[np.int64],
    ) -> DayPart:
        """Accumulate by aircraft and day; a flight counts for the day of each of its reports.

        Parameters
        ----------
        headings : Dataset
            A block of whole aircraft.
        difference : array, shape (report,)
            Kt.
        chosen : array of bool, shape (report,)
        window : array of int, shape (report,)
            0 before, 1 during.
        """
        aircraft = aircraft_of_report(headings)[chosen]
        day = headings["time"].to_numpy()[chosen].astype("datetime64[D]").astype(np.int64)
        # A day split by the start of the test counts once in each window.
        # One number a day and window: sorting rows of two takes most of a field test.
        known, index = np.unique(2 * day + window[chosen], return_inverse=True)
        days = np.column_stack([known // 2, known % 2])
        shape = (headings.sizes["aircraft"], known.size)
        cell = aircraft * shape[1] + index
        count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
        total = np.bincount(cell, weights=difference[chosen], minlength=count.size).reshape(shape)
        return cls(days, count.astype(np.float64), total.astype(np.float64))


@dataclass(frozen=True)
class DaySums:
    """Reports and summed disagreement by aircraft and day, the field test's statistics."""

    # count, total: (aircraft, day): reports, and their summed disagreement in kt
    count: Floats
    total: Floats
    corrected: NDArray[np.bool_]  # (aircraft,)
    during: NDArray[np.bool_]  # (day,): whether a day is of the test, not of the window before it

    @classmethod
    def of(
        cls, parts: list[DayPart], member: NDArray[np.bool_], corrected: NDArray[np.bool_]
    ) -> DaySums:
        """Put blocks of aircraft side by side on the days of all.

        Parameters
        ----------
        parts : list of DayPart
            In order of aircraft.
        member : array of bool, shape (aircraft,)
            Of either group; the others are left out.
        corrected : array of bool, shape (member,)
        """
        days = np.unique(np.concatenate([part.days for part in parts]), axis=0)
        key, first = days[:, 0] * 2 + days[:, 1], 0
        count, total = np.zeros((2, member.size, days.shape[0]))
        for part in parts:
            rows = slice(first, first + part.counts.shape[0])
            place = np.searchsorted(key, part.days[:, 0] * 2 + part.days[:, 1])
            count[rows, place], total[rows, place] = part.counts, part.total
            first = rows.stop
        return cls(count[member], total[member], corrected, days[:, 1] == 1)

    def means(self) -> dict[tuple[str, str], float]:
        """Mean disagreement of each group in each window, kt."""
        count, total = self.count, self.total
        found = {}
        for group, chosen in zip(GROUPS, (~self.corrected, self.corrected), strict=True):
            for window, days in zip(WINDOWS, (~self.during, self.during), strict=True):
                number = count[chosen][:, days].sum()
                found[group, window] = total[chosen][:, days].sum() / number if number else np.nan
        return found

    def levels(self) -> tuple[Floats, Floats]:
        """Mean disagreement of each aircraft before and during, kt."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (
                self.total[:, ~self.during].sum(1) / self.count[:, ~self.during].sum(1),
                self.total[:, self.during].sum(1) / self.count[:, self.during].sum(1),
            )


def bootstrap(sums: DaySums, *, draws: int, seed: int) -> NDArray[np.float64]:
    """Draw the means of groups and windows again, whole days within each window.

    Returns
    -------
    array, shape (draw, group, window)
        Kt; groups and windows in order of `GROUPS` and `WINDOWS`.
    """
    rng = np.random.default_rng(seed)
    drawn = np.empty((draws, 2, 2))
    for column, days in enumerate((np.flatnonzero(~sums.during), np.flatnonzero(sums.during))):
        weights = day_weights(rng, draws, days.size)
        for row, chosen in enumerate((~sums.corrected, sums.corrected)):
            count = weights @ sums.count[chosen][:, days].sum(0)
            total = weights @ sums.total[chosen][:, days].sum(0)
            drawn[:, row, column] = total / np.maximum(count, 1.0)
    return drawn


def day_weights(rng: np.random.Generator, draws: int, days: int) -> NDArray[np.float64]:
    """How often each day is drawn, spread out a little for the few days there are.

    Drawing n of n days again has a variance (n - 1)/n of the true one; the weights' distance
    from one is stretched by sqrt(n/(n - 1)) to mend that.

    Returns
    -------
    array, shape (draws, days)
    """
    weights = rng.multinomial(days, np.full(days, 1.0 / days), size=draws).astype(float)
    return np.asarray(1.0 + (weights - 1.0) * np.sqrt(days / max(days - 1.0, 1.0)))


def interval_95(values: NDArray[np.float64]) -> list[float]:
    """Low and high end of the interval that holds 95 % of the draws."""
    low, high = np.percentile(values, [2.5, 97.5])
    return [float(low), float(high)]
