"""What the noise fit starts from: gross errors, a residual without smooth effects, its lags.

Assumptions and validity: those of :mod:`airswing.gap.noise.model`. Gross errors are single reports
that stand out from *both* neighbours: a screening on the size of the residual itself would remove
the very effects that are looked for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from airswing.gap.noise.whitening import FlightOrder
from airswing.physics.robust_spread import robust_sd

Floats = NDArray[np.float64]

MOST_LAGS = 30  # largest difference of position on a flight
LEVELS = 5  # at equal counts of reports
#: Factor from which errors along and across the heading differ: weather's are alike, a scattering
#: compass errs across it only.
UNLIKE = 1.1
#: Distances (m) at which the autocovariance along the flight is tabulated.
DISTANCE_EDGES = np.array([0, 10, 25, 50, 75, 100, 150, 200, 300, 400, 600, 900]) * 1e3


def gross_errors(residual: Floats, order: FlightOrder) -> NDArray[np.bool_]:
    """Mark single reports that stand out from both neighbours of their flight; shape (n,).

    A report is gross when it differs by more than five robust standard deviations from the
    median of itself and its two neighbours (at the ends: the two nearest).

    Parameters
    ----------
    residual : (n, 2) float
        Residual (u, v), m s-1.
    """
    n = residual.shape[0]
    before, after = previous_and_next(order, n)
    first = np.where(before >= 0, before, after[np.maximum(after, 0)])
    second = np.where(after >= 0, after, before[np.maximum(before, 0)])
    known = (first >= 0) & (second >= 0) & (first != second)
    departure = np.zeros((n, 2))
    stack = np.stack([residual, residual[first], residual[second]])
    departure[known] = (residual - np.median(stack, axis=0))[known]
    used = np.abs(departure[known])
    if used.size == 0:
        return np.zeros(n, bool)
    # where the report itself is the median it departs by nothing, and that is no error of zero
    middle = used[used > 0]
    # half of a normal's values lie within 0.6745 standard deviations
    spread = np.median(middle) / 0.6745 if middle.size else 1.0
    return np.asarray((np.abs(departure) > 5.0 * spread).any(axis=1) & known)


def previous_and_next(order: FlightOrder, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index of the previous and next report of the same flight, -1 where there is none.

    Returns
    -------
    before, after : (n,) int
    """
    before, after = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for j in range(1, order.starts.size - 1):
        now = order.index[order.starts[j] : order.starts[j + 1]]
        last = order.index[order.starts[j - 1] : order.starts[j - 1] + now.size]
        before[now], after[last] = last, now
    return before, after


def remove_smooth_effects(
    residual: Floats, aircraft: NDArray[np.integer], heading: Floats, airspeed: Floats
) -> Floats:
    """Residual less a per-aircraft regression on heading harmonics and airspeed terms.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    aircraft : (n,) int
    heading : (n,) float
        rad.
    airspeed : (n,) float
        m s-1.

    Returns
    -------
    (n, 2) float
        m s-1. Used to estimate the noise only.
    """
    out = residual.copy()
    for a in np.unique(aircraft):
        own = np.flatnonzero(aircraft == a)
        design = _smooth_columns(heading[own], airspeed[own])
        values = residual[own].ravel()
        # wide: before the noise is known what turns with the heading still stands in the scatter
        bound = 8 * robust_sd(values) + 1e-12
        good = np.abs(values - np.median(values)) < bound
        used = design * good
        # an aircraft on one heading cannot tell its columns apart: the smallest solution is taken
        # off
        coefficients = np.linalg.lstsq(used @ design.T, used @ values, rcond=1e-13)[0]
        out[own] -= (coefficients @ design).reshape(-1, 2)
    return out


def _smooth_columns(heading: Floats, airspeed: Floats) -> Floats:
    """Columns, (8, 2 n), of a heading error of two cycles, an airspeed factor and a wind."""
    sine, cosine = np.sin(heading), np.cos(heading)
    across, along = np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)
    out = np.empty((8, heading.size, 2))
    out[0] = across
    out[1], out[2] = sine[:, None] * across, cosine[:, None] * across
    out[3] = (2.0 * sine * cosine)[:, None] * across
    out[4] = (cosine**2 - sine**2)[:, None] * across
    out[5] = along
    out[:6] *= airspeed[:, None] / 100.0  # of a size with the two below: the square is well posed
    out[6], out[7] = (1.0, 0.0), (0.0, 1.0)
    return out.reshape(8, -1)


def level_factors(residual: Floats, log_pressure: Floats) -> tuple[Floats, Floats]:
    """Robust standard deviation by level, relative to that of all.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    log_pressure : (n,) float

    Returns
    -------
    level_nodes, level_factors : (m,) float
    """
    edges = np.unique(np.quantile(log_pressure, np.linspace(0, 1, LEVELS + 1)))
    if edges.size < 3:
        return np.array([float(np.median(log_pressure))]), np.ones(1)
    which = np.clip(np.searchsorted(edges, log_pressure, "right") - 1, 0, edges.size - 2)
    centre = np.array([np.median(log_pressure[which == k]) for k in range(edges.size - 1)])
    sd = np.array([robust_sd(residual[which == k].ravel()) for k in range(edges.size - 1)])
    # a level whose few reports agree by chance must not weigh twenty-five times as much
    sd = np.maximum(sd, 0.2 * sd.max() + 1e-9)
    counts = np.bincount(which, minlength=edges.size - 1)
    return centre, sd / np.sqrt(np.average(sd**2, weights=counts))


def directional_sd(residual: Floats, heading: Floats) -> tuple[float, float]:
    """Robust standard deviations along and across the heading, m/s; as below."""
    nose = np.stack([np.sin(heading), np.cos(heading)], -1)
    parts = (residual * nose).sum(axis=1), residual[:, 0] * nose[:, 1] - residual[:, 1] * nose[:, 0]
    along, across = (max(robust_sd(part), 1e-9) for part in parts)
    return along, across


def direction_factors(residual: Floats, heading: Floats) -> tuple[float, float]:
    """Robust standard deviations along and across the heading, their mean square 1.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    heading : (n,) float
        rad.

    Returns
    -------
    along, across : float
        1 where they differ by less than :data:`UNLIKE`.
    """
    along, across = directional_sd(residual, heading)
    if max(along, across) < UNLIKE * min(along, across):
        return 1.0, 1.0
    both = float(np.hypot(along, across) / np.sqrt(2.0))
    return along / both, across / both


def autocovariance(
    residual: Floats,
    distance: Floats,
    step: Floats,
    order: FlightOrder,
    *,
    decay: Callable[[Floats, Floats], Floats],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Autocovariance along flights against the distance flown, and the correlation of a model.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    distance : (n,) float
        Distance since the previous report, m; infinite at the first of a flight.
    step : (n,) float
        Absolute change of ln p since then.
    decay : callable
        Correlation over a distance and a change of ln p. Pairs some way apart have mostly
        climbed or descended too: a model's mean over the pairs is what the measured one meets.

    Returns
    -------
    centre, covariance, correlation, count : (m,) float
        Mean distance of the pairs (m), mean product of the two components (m2 s-2), the model's
        mean correlation, pairs. The first entry is distance zero.
    """
    along, climbed = np.zeros((2, residual.shape[0]))
    blocks = [
        order.index[order.starts[j] : order.starts[j + 1]] for j in range(order.starts.size - 1)
    ]
    for j in range(1, len(blocks)):
        now, last = blocks[j], blocks[j - 1][: blocks[j].size]
        along[now] = along[last] + distance[now]
        climbed[now] = climbed[last] + step[now]
    bins = DISTANCE_EDGES.size - 1
    total, reach, alike, count = np.zeros((4, bins + 1))
    alike[0] = count[0] = float(residual.shape[0])
    total[0] = 0.5 * float((residual**2).sum())
    for j in range(1, len(blocks)):
        for lag in range(1, min(j, MOST_LAGS) + 1):
            now, last = blocks[j], blocks[j - lag][: blocks[j].size]
            gap = along[now] - along[last]
            where = np.searchsorted(DISTANCE_EDGES, gap, "right") - 1
            ok = (where >= 0) & (where < bins)
            product = 0.5 * (residual[now] * residual[last]).sum(axis=1)
            total[1:] += np.bincount(where[ok], product[ok], minlength=bins)
            correlation = decay(gap[ok], (climbed[now] - climbed[last])[ok])
            alike[1:] += np.bincount(where[ok], correlation, minlength=bins)
            reach[1:] += np.bincount(where[ok], gap[ok], minlength=bins)
            count[1:] += np.bincount(where[ok], minlength=bins)
    with np.errstate(invalid="ignore"):
        return reach / count, total / count, alike / count, count
