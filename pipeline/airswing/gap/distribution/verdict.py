"""An effect that shows in no mean: on whom, since when, how surely, and what it closes.

The evidence is a log likelihood ratio of the clearest aircraft against chance, less the logarithm
of the number of aircraft and steps that were tried.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.effects.base import Stated
from airswing.gap.result.schema.entries import Parameter as Value
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

TRIED = float(np.log(100.0))
"""Log number of aircraft and steps among which the clearest is sought."""


@dataclass(frozen=True)
class Verdict:
    """One effect found."""

    name: str
    tails: tuple[str, ...]
    parameters: Stated
    standard_errors: dict[str, float]
    per_tail: Mapping[str, Mapping[str, Value]]  # tail -> parameters
    period: list[str | None] | None
    evidence: float  # log likelihood ratio


def against_chance(count: int, share: float, chance: float) -> float:
    """Log likelihood ratio of a share of ``count`` draws against the share by chance.

    ``count`` times the Kullback-Leibler divergence of the two Bernoulli laws; 0 for a share not
    above chance.
    """
    p, q = (float(np.clip(x, 1e-9, 1 - 1e-9)) for x in (share, chance))
    return count * (p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))) if p > q else 0.0


def verdict_of(
    name: str,
    per_tail: Mapping[str, Mapping[str, Value]],
    period: list[str | None] | None,
    evidence: list[float],
) -> Verdict:
    """Combine what was found on each aircraft, with the median of their parameters."""
    first = next(iter(per_tail.values()))
    middle = {name: _middle([values[name] for values in per_tail.values()]) for name in first}
    clearest = float(max(evidence) - TRIED)
    return Verdict(name, tuple(per_tail), middle, {}, per_tail, period, clearest)


def _middle(values: list[Value]) -> Value:
    numbers = [value for value in values if isinstance(value, float)]
    if len(numbers) == len(values):
        return float(np.median(numbers))
    return max(values, key=values.count)


@dataclass(frozen=True)
class Reduction:
    """How far the mean disagreement shrinks without an effect, with its standard error, kt."""

    kt: float
    error: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, not below zero."""
        low, high = self.kt - NORMAL_95 * self.error, self.kt + NORMAL_95 * self.error
        return max(low, 0.0), max(high, 0.0)


def mean_reduction(longer: Floats, affected: Mask, shape_error: float = 0.16) -> Reduction:
    """Mean over all reports of the length (m/s) that an effect adds to the affected ones.

    ``shape_error`` is the relative error of the assumed distribution.
    """
    if longer.size == 0:
        return Reduction(0.0, 0.0)
    kt = float(longer.sum()) / affected.size / KNOT
    drawn = float(longer.std()) * np.sqrt(longer.size) / affected.size / KNOT
    return Reduction(max(kt, 0.0), float(np.hypot(drawn, shape_error * kt)))
