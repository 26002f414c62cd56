"""What is found of an effect that shows in no mean: whose it is, since when, how surely.

Assumptions: the clearest of many aircraft and steps was looked for, which has its price.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from airswing.gap.effects.base import Told
from airswing.gap.result.schema.entries import Parameter as Value

LOOKED_AT = float(np.log(100.0))
"""Price of looking at a hundred aircraft and steps for the clearest one, nats."""


@dataclass(frozen=True)
class MomentVerdict:
    """One second-moment effect found."""

    name: str
    tails: tuple[str, ...]
    parameters: Told
    standard_errors: dict[str, float]
    per_tail: Mapping[str, Mapping[str, Value]]  # tail -> parameters
    period: list[str | None] | None
    # log likelihood ratio of the clearest aircraft against chance, nats, less what looking at all
    # of them costs
    evidence: float


def against_chance(count: int, share: float, chance: float) -> float:
    """Log likelihood ratio of a share of ``count`` draws against the share that chance gives, nats.

    Parameters
    ----------
    share, chance : float
        Between 0 and 1.

    Returns
    -------
    float
        ``count`` times the Kullback-Leibler divergence of the two Bernoulli laws; 0 for a share
        not above chance.
    """
    # all or none have no logarithm, though the divergence of them is finite
    p, q = (float(np.clip(x, 1e-9, 1 - 1e-9)) for x in (share, chance))
    return count * (p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))) if p > q else 0.0


def verdict_of(
    name: str,
    per_tail: Mapping[str, Mapping[str, Value]],
    period: list[str | None] | None,
    evidence: list[float],
) -> MomentVerdict:
    """Put together what was found on each aircraft, with the middle of their parameters."""
    first = next(iter(per_tail.values()))
    middle = {name: _middle([values[name] for values in per_tail.values()]) for name in first}
    clearest = float(max(evidence) - LOOKED_AT)
    return MomentVerdict(name, tuple(per_tail), middle, {}, per_tail, period, clearest)


def _middle(values: list[Value]) -> Value:
    """Median of numbers; of what is none, the one that most aircraft have."""
    numbers = [value for value in values if isinstance(value, float)]
    if len(numbers) == len(values):
        return float(np.median(numbers))
    return max(values, key=values.count)
