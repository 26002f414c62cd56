"""Exact one-step whitening of vectors along flights, and leave-one-out errors.

For the noise of :mod:`airswing.gap.noise.model` the Kalman recursion of one state is the exact
Cholesky whitening in linear time: the innovation divided by its standard deviation is white. The
gains depend on the geometry alone, so that one recursion whitens residuals and design columns. The
work is vectorised over flights, in a loop over the position of a report in its flight.

Source: Jones (1980), Technometrics 22, 389-395 (state space form of an Ornstein-Uhlenbeck process
with white noise); de Jong (1988), Biometrika 75, 594-600 (backward recursion of the leave-one-out
errors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.physics.great_circle import central_angle

#: Columns of a report above which values are transposed for the recursion: numpy works on
#: contiguous rows of many columns faster than on short stretches of every column.
FEW_COLUMNS = 32
#: Radius of the sphere on which the correlation length of the noise is defined, m.
SPHERE_RADIUS = 6.371e6


@dataclass(frozen=True)
class FlightOrder:
    """Reports ordered by their position in the flight."""

    # (n,): first reports of all flights (longest flight first), then second reports, and so on
    index: Integers
    # (m + 1,): block j, index[starts[j]:starts[j + 1]], holds the reports at position j of the
    # flights that have more than j reports
    starts: Integers


@dataclass(frozen=True)
class DirectionFactors:
    """Scaling of vectors along and across the heading, E = a I + (b - a) h h'."""

    heading_vector: Floats  # (2, n): h, unit vector (east, north) of each report's heading
    along: float  # b
    across: float  # a

    @classmethod
    def from_heading(cls, heading: Floats, along: float, across: float) -> DirectionFactors:
        """Return the scaling for headings, (n,) rad."""
        return cls(np.stack([np.sin(heading), np.cos(heading)]), along, across)

    def scale(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Scale vectors of shape (..., 2, n)."""
        unit = self.heading_vector.astype(values.dtype)
        projection = values[..., 0, :] * unit[0] + values[..., 1, :] * unit[1]
        projection *= self.along - self.across
        out = self.across * values
        out[..., 0, :] += projection * unit[0]
        out[..., 1, :] += projection * unit[1]
        return np.asarray(out, values.dtype)

    def scale_reports(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Scale vectors of shape (n, 2, ...)."""
        scaled = self.scale(np.moveaxis(values, (0, 1), (-1, -2)))
        return np.moveaxis(scaled, (-1, -2), (0, 1))

    @property
    def inverse(self) -> DirectionFactors:
        """The inverse scaling."""
        return DirectionFactors(self.heading_vector, 1.0 / self.along, 1.0 / self.across)


@dataclass(frozen=True)
class Gains:
    """Coefficients of the whitening recursion, one per report, in the order of the reports."""

    # (n,): correlation of the state with that at the previous report; 0 at the first of a flight
    decay: Floats
    gain: Floats  # (n,): Kalman gain; 0 where the report is masked
    weight: Floats  # (n,): inverse standard deviation of the innovation, s m-1; 0 where masked
    scale: Floats  # (n,): inverse of the level factor, applied before the recursion
    # scaling that makes errors isotropic, applied first; None where they are isotropic
    direction: DirectionFactors | None = None


def flight_order(flight: NDArray[np.integer], time: Floats) -> FlightOrder:
    """Order reports by their position in the flight; flight numbers are unique in an archive."""
    n = flight.size
    if not n:
        return FlightOrder(np.zeros(0, np.int64), np.zeros(1, np.int64))
    by_flight = np.lexsort((time, flight))
    _, first, length = np.unique(flight[by_flight], return_index=True, return_counts=True)
    position = np.arange(n) - np.repeat(first, length)
    length_rank = np.empty(first.size, np.int64)
    length_rank[np.argsort(-length, kind="stable")] = np.arange(first.size)
    order = np.lexsort((np.repeat(length_rank, length), position))
    return FlightOrder(by_flight[order], np.r_[0, np.cumsum(np.bincount(position))])


def neighbour_pairs(order: FlightOrder) -> list[tuple[Integers, Integers]]:
    """Return the pairs (previous report, report) of every block but the first."""
    starts = order.starts
    return [
        (
            order.index[starts[j - 1] : starts[j - 1] + starts[j + 1] - starts[j]],
            order.index[starts[j] : starts[j + 1]],
        )
        for j in range(1, starts.size - 1)
    ]


def flight_steps(
    latitude: Floats, longitude: Floats, log_pressure: Floats, order: FlightOrder
) -> tuple[Floats, Floats]:
    """Distance (m) and absolute change of ln p since the previous report of the flight, (n,).

    Both are infinite at the first report of a flight. Positions are in degrees.
    """
    distance, step = np.full((2, latitude.size), np.inf)
    lat, lon = np.radians(latitude), np.radians(longitude)
    for before, now in neighbour_pairs(order):
        distance[now] = SPHERE_RADIUS * central_angle(lat[before], lon[before], lat[now], lon[now])
        step[now] = np.abs(log_pressure[now] - log_pressure[before])
    return distance, step


def kalman_gains(
    order: FlightOrder,
    decay: Floats,
    level_factor: Floats,
    keep: Booleans,
    *,
    correlated_sd: float,
    white_sd: float,
    extra_sd: Floats | None = None,
) -> Gains:
    """Compute the gains of the whitening recursion; reports not kept are treated as missing.

    ``decay`` is the correlation of the correlated part with that at the previous report, not used
    at the first of a flight; ``level_factor`` multiplies both standard deviations, given at factor
    1; ``extra_sd`` is that of a further white error of each report. All (n,), m s-1.
    """
    n, index = decay.size, order.index
    used = np.where(np.isfinite(decay), decay, 0.0).astype(float)
    signal, white = correlated_sd**2, np.full(n, white_sd**2)
    if extra_sd is not None:
        white += (extra_sd / level_factor) ** 2
    # the process starts from its stationary variance at the first report of a flight
    used[index[: order.starts[1]] if n else index] = 0.0
    phi2, white, kept = used[index] ** 2, white[index], keep[index]  # blocks are then slices
    before, total = np.empty(n), np.empty(n)
    variance = np.zeros(0)
    for first, stop in zip(order.starts[:-1].tolist(), order.starts[1:].tolist(), strict=True):
        now = slice(first, stop)
        if first:
            variance = phi2[now] * variance[: stop - first] + signal * (1 - phi2[now])
        else:
            variance = np.full(stop, signal)
        before[now] = variance
        np.add(variance, white[now], out=total[now])
        variance = variance * (1 - np.where(kept[now], variance / total[now], 0.0))
    gain, weight = np.zeros(n), np.zeros(n)
    gain[index] = np.where(kept, before / total, 0.0)
    weight[index] = np.where(kept, 1 / np.sqrt(total), 0.0)
    return Gains(used, gain, weight, 1.0 / level_factor)


def whiten(values: NDArray[np.floating], order: FlightOrder, gains: Gains) -> NDArray[np.floating]:
    """Whiten vectors (n, 2, ...) along flights: residuals, or design columns.

    The result has unit variance where the noise model holds; it is 0 at masked reports.
    """
    index, way = order.index, gains.direction
    if way is not None:
        way = DirectionFactors(way.heading_vector[:, index], way.along, way.across)
    parts = gains.decay[index], gains.gain[index], gains.weight[index], gains.scale[index]
    blocks = np.ascontiguousarray(np.moveaxis(values[index], (0, 1), (-1, -2)))
    whiten_blocks(blocks, order.starts, Gains(*parts, way))
    out = np.empty_like(values)
    out[index] = np.moveaxis(blocks, (-1, -2), (0, 1))
    return out


def whiten_blocks(values: NDArray[np.floating], starts: Integers, gains: Gains) -> None:
    """Whiten, in place, vectors (..., 2, n) that are in the order of a :class:`FlightOrder`.

    ``starts`` are the blocks of the order, ``gains`` those of the n reports in the same order.
    """
    if gains.direction is not None:
        values[...] = gains.direction.scale(values)
    transposed = values[..., :1].size > FEW_COLUMNS
    target = values
    if transposed:
        values = np.ascontiguousarray(values.reshape(-1, values.shape[-1]).T).T
    kind = values.dtype
    decay, gain = gains.decay.astype(kind), gains.gain.astype(kind)
    values *= gains.scale.astype(kind)
    widest = int(starts[1]) if starts.size > 1 else 0
    states = np.zeros_like(values[..., :widest])  # same memory layout as the values
    increments = np.empty_like(states)
    for first, stop in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        innovation = values[..., first:stop]
        state, increment = states[..., : stop - first], increments[..., : stop - first]
        state *= decay[first:stop]
        innovation -= state
        np.multiply(innovation, gain[first:stop], out=increment)
        state += increment
    values *= gains.weight.astype(kind)
    if transposed:
        target[...] = values.reshape(target.shape)


def interpolation_errors(values: Floats, order: FlightOrder, gains: Gains) -> tuple[Floats, Floats]:
    """Return the values (n, 2) minus their expectation given all other reports of the flight.

    With V the covariance of a flight's errors, the error of report i given all others is [V^-1 r]_i
    / [V^-1]_ii, with variance 1 / [V^-1]_ii. It is computed in linear time by the whitening
    recursion and its adjoint, which runs backward along the flight. Errors (n, 2) and precision
    (n,), the inverse variance as mean over directions, are 0 at masked reports.
    """
    white = whiten(values, order, gains)
    score, precision = np.zeros_like(white), np.zeros(values.shape[0])
    adjoint: Floats = np.zeros((0, values.shape[1]))
    adjoint_weight: Floats = np.zeros(0)
    blocks = [order.index[a:b] for a, b in zip(order.starts[:-1], order.starts[1:], strict=True)]
    for now, after in zip(blocks[::-1], [np.zeros(0, np.int64), *blocks[:0:-1]], strict=True):
        decay = gains.decay[after]
        state, information = np.zeros((now.size, values.shape[1])), np.zeros(now.size)
        state[: after.size] = decay[:, None] * adjoint
        information[: after.size] = decay**2 * adjoint_weight
        weight, gain = gains.weight[now], gains.gain[now]
        weighted = weight[:, None] * white[now]
        score[now] = weighted + gain[:, None] * state
        precision[now] = weight**2 + gain**2 * information
        adjoint = (1 - gain)[:, None] * state - weighted
        adjoint_weight = weight**2 + (1 - gain) ** 2 * information
    score *= gains.scale[:, None]
    precision *= gains.scale**2
    known = (precision > 0) & (gains.weight > 0)
    errors = np.divide(score, precision[:, None], out=np.zeros_like(score), where=known[:, None])
    if gains.direction is not None:
        errors = np.asarray(gains.direction.inverse.scale_reports(errors))
    return errors, np.where(known, precision, 0.0)
