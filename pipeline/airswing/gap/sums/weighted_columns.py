"""Sums of columns in force on some days, from the archive's sums by day and by week.

Assumptions: what acts on a part of a week's reports has that part of the week's sums.

Validity: exact for columns of the core, which are summed by day; for others as far as the reports
of a week are alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.gap.sums.accumulate import Statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def week_means(stats: Statistics, weights: Floats) -> Floats:
    """Mean of day weights (m, A, D) over each week's reports, (m, A, W)."""
    own = (stats.week_of_day[:, None] == np.arange(stats.weeks.size)).astype(float)
    # a week an aircraft did not fly
    total = np.maximum(stats.day_count @ own, 1e-9)
    return np.asarray((weights * stats.day_count) @ own / total)


def weekly_sums(
    stats: Statistics, columns: Integers, weights: Floats, days: NDArray[np.bool_]
) -> Floats:
    """X'X of columns outside the core with all others on some days, (m, m); weeks shared out."""
    out = np.zeros((columns.size, columns.size))
    outside = np.flatnonzero(columns >= stats.layout.core)
    if not outside.size:
        return out
    means = week_means(stats, weights * days)
    kept = week_means(stats, np.broadcast_to(days.astype(float), (1, *weights.shape[1:])))[0]
    # both means are over the kept days, their product is shared out once
    once = np.divide(1.0, kept, out=np.zeros_like(kept), where=kept > 0)
    for k in outside:
        rows = stats.week_gram[:, :, columns[k], :][:, :, columns]
        out[k] = np.einsum("aw,maw,awm->m", means[k] * once, means, rows, optimize=True)
    out[:, outside] = out[outside].T
    return out


def own_row(stats: Statistics, column: int, weights: Floats) -> Floats:
    """X'Y between one weighted column and each aircraft's every column, uncoupled, (A, p)."""
    core = stats.layout.core
    out = np.zeros((len(stats.tails), stats.layout.size))
    active = np.flatnonzero(weights.any(axis=1))
    first = core if column < core else 0
    if column < core:
        rows = stats.day_gram[active, :, column, :].astype(float)
        out[active, :core] += np.einsum("ad,adc->ac", weights[active], rows)
    rows = stats.week_gram[active, :, column, first:].astype(float)
    out[active, first:] += np.einsum(
        "aw,awp->ap", week_means(stats, weights[None])[0][active], rows
    )
    return out
