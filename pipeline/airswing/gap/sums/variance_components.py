"""How large the errors are that aircraft share: of a day, and those that last over the archive.

Assumptions: every day the reference's error holds a random combination of the day-field columns,
coefficients independent with one variance per column. The reference's climatology is one more draw:
its coefficients are alike in size, a few larger, and the archive tells how large. A fixed wide
prior would let it take up most of what a fleet-wide effect does; where a reference has little
climatology, as its columns show together, an effect that looks like much of it is none. The slope
on the wind and what a fleet-wide effect would do are fitted beside them, with their priors. Left
out of that fit they would pass for weather: an effect that turns or stretches the winds would raise
the very variances by which it is then told from weather (four times, for winds left along the
grid).

Validity: as many days as make a variance, ten or so; an effect of single aircraft is not taken out
first and enters the variances with its mean over the fleet.

Source: expectation maximisation for variance components (Laird & Ware 1982, Biometrics 38:963); the
mixed-model equations are those of Henderson (1975); coefficients of a t distribution as normal ones
of inverse-gamma variances (Gelman et al., Bayesian Data Analysis, 3rd ed., section 17.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.candidates import GROUP_SCALE
from airswing.gap.design.layout import Layout
from airswing.gap.effects.base import Effect
from airswing.gap.sums.accumulate import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Prior = tuple[Integers, Floats]
"""Columns (m,) and 1 over the prior variances of their coefficients (m,)."""

#: Smallest standard deviation of the climatology's coefficients, m/s: no reference is without.
LEAST_CLIMATOLOGY = 0.05
#: Degrees of freedom of their t distribution.
FREEDOM = 4.0
#: Prior standard deviations of the slope of residuals on the wind, and on the wind turned by 90
#: degrees, that are no one's fault.
SLOPE_SD = (0.006, 0.004)
#: Change of a variance in one round under which the rounds end, as a share.
CONVERGED = 1e-3
MOST_ROUNDS = 60
SMALLEST = 1e-4  # variance of a day field, m2 s-2


@dataclass(frozen=True)
class Variances:
    """Of what is no aircraft's fault."""

    day: Floats  # (q,): of each day field's coefficients from day to day, m2 s-2
    climatology: Floats  # (m,): of the coefficients of the climatology, m2 s-2


def lasting_prior(layout: Layout, variance: Floats) -> Prior:
    """Columns of the climatology and of the slope on the wind, with their precisions.

    Parameters
    ----------
    variance : (m,) float
        Of the climatology's coefficients, m2 s-2.

    Returns
    -------
    columns : (m + 2,) int
    precision : (m + 2,) float
    """
    columns = np.r_[layout.columns("climatology"), layout.columns("slope")]
    return columns, 1 / np.r_[variance, np.square(SLOPE_SD)]


def shared_prior(layout: Layout, effects: Mapping[str, Effect]) -> Prior:
    """Columns of what could be taken for weather, with their precisions.

    Parameters
    ----------
    effects : mapping
        Name -> effect: those of the fleet or the reference, and those of the wind an aircraft
        meets, which all aircraft may have.

    Returns
    -------
    columns : (m,) int
    precision : (m,) float
        1 over the squares of the effects' own scales.
    """
    columns, scales = [np.zeros(0, np.int64)], [np.zeros(0)]
    for name in layout.effects:
        effect = effects[name]
        stage = getattr(effect, "stage", "sensor")
        if effect.scope in ("fleet", "reference") or stage == "atmosphere":
            columns.append(layout.columns(name))
            scales.append(np.asarray(effect.column_scales, float))
    for name in layout.groups:
        if name.startswith("wind:"):
            columns.append(layout.columns(name))
            scales.append(np.full(columns[-1].size, GROUP_SCALE))
    return np.concatenate(columns), 1 / np.concatenate(scales) ** 2


def shared_variances(stats: Statistics, beside: Prior | None = None) -> Variances:
    """Variances of the day fields and of the climatology by expectation maximisation.

    Parameters
    ----------
    beside : (columns, precision), optional
        What else is fitted beside them, for the whole fleet, on top of what lasts.
    """
    layout = stats.layout
    steady = layout.columns("climatology").size
    # Rounds of expectation, where `compass.fit.pooled_bias` lays a grid: here are as many variances
    # as columns, and days are tied to each other by what lasts.
    now = Variances(np.full(layout.blocks["day_fields"].stop, 0.5), np.full(steady, 0.5))
    columns, _ = lasting_prior(layout, now.climatology)
    more = (np.zeros(0, np.int64), np.zeros(0)) if beside is None else beside
    sums = _Sums.of(stats, np.r_[columns, more[0]])
    for _ in range(MOST_ROUNDS):
        precision = np.r_[lasting_prior(layout, now.climatology)[1], more[1]]
        by_day, lasting = sums.second_moments(now.day, precision)
        new = Variances(
            np.maximum(by_day.mean(axis=0), SMALLEST),
            _drawn_together(lasting[:steady], now.climatology),
        )
        change = np.r_[new.day / now.day, new.climatology / now.climatology] - 1
        now = new
        if np.max(np.abs(change)) < CONVERGED:
            break
    return now


def _drawn_together(square: Floats, variance: Floats) -> Floats:
    """Variances of coefficients with these expected squares (m,), from those of the last round."""
    common = 1 / float(np.mean(1 / variance))
    drawn = (FREEDOM * common + square) / (FREEDOM + 1)
    return np.asarray(np.maximum(drawn, LEAST_CLIMATOLOGY**2))


@dataclass(frozen=True)
class _Sums:
    """X'X and X'r of the day fields (by day) and of the lasting columns (of the archive)."""

    own: Floats
    other: Floats
    own_score: Floats
    other_score: Floats
    gram: Floats

    @classmethod
    def of(cls, stats: Statistics, columns: Integers) -> _Sums:
        fields = stats.layout.blocks["day_fields"]
        normal = stats.day_cross.sum(axis=0, dtype=float)
        score = stats.day_score.sum(axis=0)
        gram = stats.whole_gram.sum(axis=0)[np.ix_(columns, columns)]
        return cls(
            normal[:, :, fields],
            normal[:, :, columns],
            score[:, fields],
            score[:, columns].sum(axis=0),
            gram,
        )

    def second_moments(self, day: Floats, precision: Floats) -> tuple[Floats, Floats]:
        """Expected squares of the coefficients, (D, q) and (m,), at variances and precisions."""
        spread = np.linalg.inv(self.own + np.diag(1 / day))
        share = spread @ self.other
        left = self.gram + np.diag(precision)
        left -= np.einsum("dqi,dqj->ij", self.other, share, optimize=True)
        doubt = np.linalg.inv(left)
        lasting = doubt @ (self.other_score - np.einsum("dqi,dq->i", share, self.own_score))
        mean = np.einsum("dij,dj->di", spread, self.own_score - self.other @ lasting)
        second = mean**2 + np.diagonal(spread, axis1=1, axis2=2)
        second += ((share @ doubt) * share).sum(axis=2)
        return second, lasting**2 + np.diagonal(doubt)
