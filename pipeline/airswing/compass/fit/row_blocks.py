"""Rows in which a block of reports is worked on, and the residual of the vector equation in them.

Assumes what :mod:`airswing.compass.fit.normal_equations` says of the equation. Quantities that are
made by the same operation stand under each other, so that one call of numpy makes them all: with
blocks short enough for the processor's cache a call costs as much as some hundred reports. Radians
and metres per second, single precision.
"""

from __future__ import annotations

import threading

import numpy as np

from airswing.compass.fit.observations import ROOM, Array, Observations, Single
from airswing.compass.fleet.flight_segments import ROWS

BLOCK = 12800
"""Reports whose rows stay in the cache."""


class Rows:
    """What a block of reports is worked in, one row for each quantity.

    What is weighted, and then what is summed by blocks, takes the place of ``obs``, ``turn`` and
    ``trig``, which are not needed any more: fewer rows stay in the cache.
    """

    def __init__(self, size: int) -> None:
        # one allocation for all kinds of rows, as `cut` deals them out; single precision halves
        # what a pass reads
        self.memory = np.empty((ROWS + 5 + 12 + 2 + 2 + 1) * size, np.float32)
        self.size = -1
        self.cut(size)

    def cut(self, size: int) -> None:
        """Make rows for so many reports; each kind stands in one piece."""
        if size == self.size:
            return
        self.size, self.taken = size, 0
        shared = self._next(ROWS)
        # Room for the reports made ready; fitted true heading, and delta(m) less the heading
        # error, radians; sine and cosine of both.
        self.obs, self.turn = shared[:ROOM], shared[ROOM : ROOM + 2]
        self.trig = shared[ROOM + 2 : ROOM + 6].reshape(2, 2, size)
        # `cross` and `along` times the weights; what the blocks of a flight are summed from.
        self.weighted_cross, self.weighted_along, self.sums = shared[:8], shared[8:12], shared
        # 1, g sin m, g cos m, sin m cos m, sin2 m; `cross` and, under it, `along`.
        self.unit, self.both = self._next(5), self._next(12)
        # Across: `unit` times the airspeed, sine and cosine of the fitted true heading, the
        # residual. Along: the residual, the airspeed, sine and cosine. The residuals touch.
        self.cross, self.along, self.residual = self.both[:8], self.both[8:], self.both[7:9]
        # Across and along, twice; fitted airspeed.
        self.weight, self.part, self.speed = self._next(2), self._next(2), self._next(1)[0]
        self.unit[0] = 1.0

    def _next(self, rows: int) -> Single:
        begin, self.taken = self.taken, self.taken + rows * self.size
        return self.memory[begin : self.taken].reshape(rows, self.size)


class _Scratch(threading.local):
    """Rows of a block, kept by each thread: asking for new memory costs more than the sums."""

    def __init__(self) -> None:
        self.rows = Rows(BLOCK)

    def of(self, size: int) -> Rows:
        """Rows for so many reports."""
        if size > BLOCK:
            return Rows(size)
        self.rows.cut(size)
        return self.rows


_SCRATCH = _Scratch()


def rows_for(size: int) -> Rows:
    """Rows of this thread for so many reports, valid until the thread asks for others."""
    return _SCRATCH.of(size)


def fill(obs: Observations, theta: Array, joint: bool, rows: Rows) -> None:
    """Find what the rows hold at the parameters theta (8,).

    All but the products with the airspeed and the weights.
    """
    a, b, c, d, e, s, b_u, b_v = theta.tolist()
    unit, turn, trig = rows.unit, rows.turn, rows.trig
    np.multiply(obs.turned, obs.gain, out=unit[1:3])
    # Backwards, so that sin m cos m comes before sin2 m.
    np.multiply(obs.turned[0], obs.turned, out=unit[4:2:-1])
    # cos 2m = 1 - 2 sin2 m and sin 2m = 2 sin m cos m: no further sines.
    np.dot(np.array([a + e, b, c, 2 * d, -2 * e], dtype=np.float32), unit, out=turn[1])
    np.subtract(obs.heading, turn[1], out=turn[0])
    turn[1] -= obs.error
    np.sin(turn, out=trig[0])
    np.cos(turn, out=trig[1])
    np.multiply(trig[:, 1], obs.implied, out=rows.residual)
    np.multiply(obs.airspeed, 1 - s, out=rows.speed)
    rows.along[0] -= rows.speed
    rows.cross[5:7] = rows.along[2:] = trig[:, 0]
    if joint and (b_u or b_v):
        # The reference's bias turned across and along by sine and cosine of the true
        # heading.
        bias = np.array([[-b_v, b_u], [b_u, b_v]], dtype=np.float32)
        rows.residual += np.dot(bias, rows.along[2:], out=rows.part)
