"""Linear B-splines on increasing knots: a piecewise-linear partition of unity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Short = NDArray[np.int32]


def hats(values: Floats, knots: Floats) -> Floats:
    """Hat functions (k, n) of values (n,) at knots (k,).

    They sum to 1 over k; values outside the knots take the nearest; NaN gives zeros.
    """
    ramps = (values - knots[:-1, None]) / np.diff(knots)[:, None]
    np.clip(ramps, 0.0, 1.0, out=ramps)
    out = np.empty((knots.size, values.size))
    out[0], out[-1] = 1.0 - ramps[0], ramps[-1]
    out[1:-1] = ramps[:-1] - ramps[1:]
    out[:, np.isnan(values)] = 0.0
    return out


def hats_not_zero(values: Floats, knots: Floats) -> tuple[Short, Floats]:
    """The one or two nonzero hat functions at each value, for many knots.

    Row of :func:`hats` and its value, each (n, 2); of one knot, which is one everywhere, (n, 1).
    Values (n,) without NaN.
    """
    if knots.size == 1:
        return np.zeros((values.size, 1), dtype=np.int32), np.ones((values.size, 1))
    lower = np.zeros(values.size, dtype=np.int32)
    for knot in knots[1:-1]:
        lower += values >= knot
    shares = np.empty((values.size, 2))
    np.clip((values - knots[lower]) / np.diff(knots)[lower], 0.0, 1.0, out=shares[:, 1])
    np.subtract(1.0, shares[:, 1], out=shares[:, 0])
    return np.stack([lower, lower + np.int32(1)], axis=1), shares


def hat_products(values: Sequence[Floats], knots: Sequence[Floats]) -> tuple[Short, Floats]:
    """Products of the hat functions of several coordinates (n,), each at knots of its axis.

    Places of those that may differ from zero in the grid of all knots, the last coordinate varying
    fastest, and their values, each (n, 2^coordinates); the values at a place add up to one.
    """
    index, value = np.zeros((len(values[0]), 1), dtype=np.int32), np.ones((len(values[0]), 1))
    for coordinate, nodes in zip(values, knots, strict=True):
        lower, share = hats_not_zero(coordinate, nodes)
        index = (index * np.int32(nodes.size))[:, :, np.newaxis] + lower[:, np.newaxis]
        value = value[:, :, np.newaxis] * share[:, np.newaxis]
        index, value = index.reshape(len(index), -1), value.reshape(len(value), -1)
    return index, value
