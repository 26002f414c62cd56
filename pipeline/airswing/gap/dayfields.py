"""How large the errors are that the aircraft of a day share: variances of the day fields.

Assumptions: every day the reference's error holds a random combination of the day-field columns,
coefficients independent with one variance per column. What lasts (the climatology, the slope on the
wind) and what a fleet-wide effect would do are fitted beside them, with their priors. Left out of
that fit they would pass for weather: an effect that turns or stretches the winds would raise the
very variances by which it is then told from weather (four times, for winds left along the grid).

Validity: as many days as make a variance, ten or so; an effect of single aircraft is not taken out
first and enters the variances with its mean over the fleet.

Source: expectation maximisation for variance components (Laird & Ware 1982, Biometrics 38:963); the
mixed-model equations are those of Henderson (1975).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.layout import Layout
from airswing.gap.statistics import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Prior = tuple[Integers, Floats]
"""Columns (m,) and 1 over the prior variances of their coefficients (m,)."""

#: 1 over the prior variance of each coefficient of the climatology, s2 m-2.
CLIMATOLOGY_PRECISION = 0.25
#: Prior standard deviations of the slope of residuals on the wind, and on the wind turned by 90
#: degrees, that are no one's fault.
SLOPE_SD = (0.006, 0.004)
#: Change of a variance in one round under which the rounds end, as a share.
CONVERGED = 1e-3


def lasting_prior(layout: Layout) -> Prior:
    """Columns of the climatology and of the slope on the wind, with their precisions.

    Parameters
    ----------
    layout : Layout

    Returns
    -------
    columns : (m,) int
    precision : (m,) float
    """
    climatology, slope = layout.columns("climatology"), layout.columns("slope")
    precision = np.full(climatology.size, CLIMATOLOGY_PRECISION)
    return np.r_[climatology, slope], np.r_[precision, 1 / np.square(SLOPE_SD)]


def shared_prior(layout: Layout, effects: Mapping[str, Any]) -> Prior:
    """Columns of the effects that could be taken for weather, with their precisions.

    Parameters
    ----------
    layout : Layout
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
    return np.concatenate(columns), 1 / np.concatenate(scales) ** 2


def day_variances(
    stats: Statistics,
    beside: Prior | None = None,
    *,
    rounds: int = 60,
    floor: float = 1e-4,
) -> Floats:
    """Variances of the day fields by expectation maximisation.

    Parameters
    ----------
    stats : Statistics
    beside : (columns, precision), optional
        What else is fitted beside them, for the whole fleet, on top of what lasts.
    rounds : int
        At most.
    floor : float
        Smallest variance, m2 s-2.

    Returns
    -------
    (q,) float
    """
    columns, precision = lasting_prior(stats.layout)
    if beside is not None:
        columns, precision = np.r_[columns, beside[0]], np.r_[precision, beside[1]]
    fields = stats.layout.blocks["day_fields"]
    normal = stats.day_cross.sum(axis=0, dtype=float)
    own, other = normal[:, :, fields], normal[:, :, columns]
    score = stats.day_score.sum(axis=0)
    own_score, other_score = score[:, fields], score[:, columns].sum(axis=0)
    gram = stats.whole_gram.sum(axis=0)[np.ix_(columns, columns)]
    gram = gram + np.diag(precision)
    variance = np.full(fields.stop, 0.5)
    for _ in range(rounds):
        spread = np.linalg.inv(own + np.diag(1 / variance))
        share = spread @ other
        left = gram - np.einsum("dqi,dqj->ij", other, share, optimize=True)
        doubt = np.linalg.inv(left)
        lasting = doubt @ (other_score - np.einsum("dqi,dq->i", share, own_score))
        mean = np.einsum("dij,dj->di", spread, own_score - other @ lasting)
        second = mean**2 + np.diagonal(spread, axis1=1, axis2=2)
        second += ((share @ doubt) * share).sum(axis=2)
        new = np.maximum(second.mean(axis=0), floor)
        change = float(np.max(np.abs(new / variance - 1)))
        variance = new
        if change < CONVERGED:
            break
    return variance
