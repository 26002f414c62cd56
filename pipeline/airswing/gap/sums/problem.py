"""What every step after the sums needs, as one object.

Assumes sums and noise of one pass over the reports. Steps that differ in what they look for
(closure, checks, interval, read-out) take the same problem and nothing of it apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.effects.base import Effect
from airswing.gap.noise.model import NoiseFit
from airswing.gap.sums.accumulate import Calendar, day_of_report
from airswing.gap.sums.elimination import Base


@dataclass(frozen=True)
class Problem:
    """An archive with its noise, its columns and the sums made of them."""

    # reports as they are, those held in memory (:mod:`airswing.gap.sums.whole_archive`)
    archive: Frame
    # the same with the heading and airspeed design columns are made of
    # (:mod:`airswing.gap.design.exogenous`)
    context: Frame
    effects: Mapping[str, Effect]  # name -> effect that has design columns
    plan: DictionaryPlan  # the nonparametric basis
    noise: NoiseFit
    base: Base  # sums with the day fields eliminated
    # reports, flights: how many the whole archive has
    reports: int
    flights: int
    seed: int = 0  # of everything drawn

    @cached_property
    def day(self) -> NDArray[np.int64]:
        """Index of each report's day in the sums, (n,)."""
        days, _ = day_of_report(self.archive, clock=self.base.stats.clock)
        return self.base.stats.day_index(days)

    @property
    def calendar(self) -> Calendar:
        """Aircraft and days of the sums."""
        return self.base.stats.calendar
