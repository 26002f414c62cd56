"""Where a report lies between grid points and levels, and the values there.

Bilinear in the grid's index space, linear in the logarithm of pressure.

Assumptions and validity
------------------------
* A corner that is missing and has weight gives no value; a corner without weight is not
  looked at. Nothing is extrapolated, neither outside the grid nor above or below the levels.
* Every report's value depends on that report alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.geometry.placing import Placing

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Corners(NamedTuple):
    """Corner points (4, n) of each report's cell and its place in the cell, 0 to 1."""

    points: Ints
    x: Floats
    y: Floats


def corners(grid: Placing, fi: Floats, fj: Floats) -> Corners:
    """Corner points and place in the cell of fractional indices inside the grid (no NaN).

    Points (4, n) are places of (i, j), (i+1, j), (i, j+1), (i+1, j+1) in the message.
    """
    i = np.floor(fi).astype(np.int64)
    if not grid.periodic:
        i = np.clip(i, 0, max(grid.ni - 2, 0))
    j = np.clip(np.floor(fj).astype(np.int64), 0, max(grid.nj - 2, 0))
    x, y = fi - i, fj - j
    i0, i1 = i % grid.ni, (i + 1) % grid.ni if grid.periodic else np.minimum(i + 1, grid.ni - 1)
    j1 = np.minimum(j + 1, grid.nj - 1)
    position = grid.position
    points = np.stack([position(i0, j), position(i1, j), position(i0, j1), position(i1, j1)])
    return Corners(points, x, y)


def bilinear(values: Floats, x: Floats, y: Floats) -> Floats:
    """Interpolate corner values (4, ..., n); those without weight are not looked at."""
    return weighted(values, ((1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y))


def bilinear_slopes(values: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the bilinear interpolant by x and by y (per grid length)."""
    return (
        weighted(values, (y - 1, 1 - y, -y, y)),
        weighted(values, (x - 1, -x, 1 - x, x)),
    )


def weighted(values: Floats, weights: Sequence[Floats]) -> Floats:
    """Sum of values times weights along the first axis; what has no weight is not looked at."""
    total = np.zeros(values.shape[1:])
    for value, weight in zip(values, weights, strict=True):
        total += np.where(weight == 0.0, 0.0, weight * value)
    return total


class Brackets(NamedTuple):
    """Level above (k) and weight of the level below (k + 1) of each report.

    `inside`: the report lies between levels; `upper`, `lower`: ln p of both levels.
    """

    k: Ints
    weight: Floats
    inside: NDArray[np.bool_]
    upper: Floats
    lower: Floats


def level_brackets(levels: Floats, pressure: Floats, *, both: bool = False) -> Brackets:
    """Levels around each report and the weight of the lower one, linear in ln p.

    Parameters
    ----------
    levels : (level,) or (level, n) float array, Pa
        Increasing along the first axis.
    pressure : (n,) float array, Pa
    both : bool
        Always name two levels (derivatives need them), even on a level; else `weight` is 0 on
        level `k` itself, and `k + 1` is not needed.
    """
    count = levels.shape[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        if levels.ndim == 1:
            # right: a level met exactly is the upper of the two, and the lower one is not needed
            k = np.searchsorted(levels, pressure, side="right") - 1
        else:
            k = (levels <= pressure).sum(axis=0) - 1
        inside = (pressure >= levels[0]) & (pressure <= levels[-1])
        highest = count - 2 if both and count > 1 else count - 1
        k = np.clip(k, 0, highest)
        below = np.minimum(k + 1, count - 1)
        columns = np.arange(pressure.size)
        first = levels[k] if levels.ndim == 1 else levels[k, columns]
        second = levels[below] if levels.ndim == 1 else levels[below, columns]
        upper, lower, lnp = np.log(first), np.log(second), np.log(pressure)
        weight = np.where(pressure == first, 0.0, (lnp - upper) / (lower - upper))
        weight = np.where(pressure == second, np.where(below > k, 1.0, 0.0), weight)
    return Brackets(k, weight, inside & np.isfinite(weight), upper, lower)
