"""A cause that cannot be at work, forced in: it must close nothing on held-out flights.

Assumptions: the placebo is a compass deviation of one cycle in the magnetic heading of *another*
flight, drawn anew for each flight, report by report in order. It has the size, the spread and the
correlation along the flight of a real deviation's columns, and none of its cause. It is fitted to
each aircraft on some weeks, without any gate of evidence, and taken off the others.

Validity: whatever the placebo closes on the weeks it was fitted to is luck; what it closes on the
others measures the luck left in the closure of this archive. Each draw has two coefficients an
aircraft, so a small loss is expected, not a gain.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.weather import unit_vectors
from airswing.gap.model.closure import day_interval
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.whitening import whiten
from airswing.gap.result.schema import DecoyEntry
from airswing.units import KNOT

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Prior standard deviation of the placebo's coefficients, rad: that of a deviation.
PRIOR = np.radians(2.0)
DRAWS = 4  # placebos; what they close is averaged


@dataclass(frozen=True)
class Placebo:
    """Reduction of the mean vector disagreement by a placebo, kt."""

    fitted: float  # on the flights it was fitted to
    held_out: float  # on the others
    held_out_ci: tuple[float, float]  # 95 % interval over days
    draws: int

    @property
    def closes_nothing(self) -> bool:
        """Whether the interval reaches zero, or what is closed is under 0.01 kt."""
        # kt: less is printed as nothing
        return self.held_out_ci[0] <= 0.0 or self.held_out < 0.01

    def entry(self) -> DecoyEntry:
        """As ``gap.json`` holds it."""
        return DecoyEntry(
            reduction_kt=self.held_out,
            reduction_ci_kt=list(self.held_out_ci),
            reduction_where_fitted_kt=self.fitted,
            draws=self.draws,
            closes_nothing=self.closes_nothing,
        )


def fitted_placebo(
    frame: Frame,
    residual: Floats,
    *,
    noise: NoiseFit,
    day: Integers,
    fold: Integers,
    seed: int = 0,
) -> Placebo:
    """Fit placebos to a residual on all folds but one, and measure on that one.

    Parameters
    ----------
    residual : (n, 2) float
        What the placebo is to explain, m s-1.
    day : (n,) int
        Index of each report's day.
    fold : (n,) int
        Fold of each report.
    """
    rng = np.random.default_rng(seed)
    target = np.asarray(whiten(residual, noise.order, noise.gains))
    before = np.hypot(*residual.T)
    inside, outside = np.zeros((2, frame.size))
    for _ in range(DRAWS):
        columns = placebo_columns(frame, rng)
        white = np.asarray(whiten(columns, noise.order, noise.gains))
        own, other = placebo_errors(columns, white, target, frame.aircraft, fold)
        inside += (before - np.hypot(*(residual - own).T)) / DRAWS
        outside += (before - np.hypot(*(residual - other).T)) / DRAWS
    interval = day_interval(outside / KNOT, day, seed)
    return Placebo(float(inside.mean()) / KNOT, float(outside.mean()) / KNOT, interval, DRAWS)


def placebo_columns(frame: Frame, rng: np.random.Generator) -> Floats:
    """Columns (n, 2, 2) of one cycle in the magnetic heading of other flights, m s-1 per rad."""
    order = np.lexsort((frame.time, frame.flight))
    _, start, number, count = np.unique(
        frame.flight[order], return_index=True, return_inverse=True, return_counts=True
    )
    other = rng.permutation(start.size)[number]
    place = np.arange(order.size) - start[number]
    borrowed = np.empty(order.size)
    borrowed[order] = np.nan_to_num(frame.magnetic_heading)[
        order[start[other] + np.mod(place, count[other])]
    ]
    cross, _ = unit_vectors(frame.heading)
    cycle = np.stack([np.sin(borrowed), np.cos(borrowed)], -1)
    return np.asarray(-(frame.airspeed[:, None] * cross)[:, :, None] * cycle[:, None, :])


def placebo_errors(
    columns: Floats, white: Floats, target: Floats, aircraft: Integers, fold: Integers
) -> tuple[Floats, Floats]:
    """Wind errors (n, 2) of columns fitted to each aircraft on all folds, and on all but its own.

    Parameters
    ----------
    columns, white : (n, 2, k) float
        As they are, and whitened.
    target : (n, 2) float
        Whitened residual.
    aircraft, fold : (n,) int

    Returns
    -------
    fitted, held_out : (n, 2) float
        m s-1.
    """
    folds = int(fold.max()) + 1
    code = aircraft * folds + fold
    shape = (int(aircraft.max()) + 1, folds)
    k = columns.shape[-1]
    score, gram = np.zeros((*shape, k)), np.zeros((*shape, k, k))
    for i in range(k):
        weights = (white[:, :, i] * target).sum(axis=1)
        score[..., i] = np.bincount(code, weights, minlength=shape[0] * folds).reshape(shape)
        for j in range(k):
            weights = (white[:, :, i] * white[:, :, j]).sum(axis=1)
            sums = np.bincount(code, weights, minlength=shape[0] * folds)
            gram[..., i, j] = sums.reshape(shape)
    ridge = np.eye(k) / PRIOR**2
    everything = np.linalg.solve(gram.sum(axis=1) + ridge, score.sum(axis=1)[..., None])[..., 0]
    others = np.linalg.solve(
        gram.sum(axis=1, keepdims=True) - gram + ridge,
        (score.sum(axis=1, keepdims=True) - score)[..., None],
    )[..., 0]
    fitted = np.einsum("nck,nk->nc", columns, everything[aircraft])
    return np.asarray(fitted), np.asarray(np.einsum("nck,nk->nc", columns, others[aircraft, fold]))
