"""Exact one-step whitening of values along flights.

Assumptions: within one flight the error of a wind component is a first-order autoregressive
(Ornstein-Uhlenbeck) process in the distance flown and in ln p, plus independent errors; both are
multiplied by a factor that depends on the level only, and where errors along and across the
heading differ (a compass scatters across it alone) by one of the direction. Flights are
independent of each other here (what they share is handled by the day fields of
:mod:`airswing.gap.model.sums`). For such errors the Kalman recursion of one state gives the
exact Cholesky whitening in linear time: the innovation divided by its standard deviation is white.
The gains depend on the geometry alone, so the same recursion whitens residuals and design columns.

Validity: any spacing of reports; gaps of any length (the state then forgets). Units: metres, ln p
without unit, metres per second. All work is vectorised over flights: one loop over the position of
a report in its flight.

Source: Kalman (1960); the state-space form of an Ornstein-Uhlenbeck process plus white noise is
that of Jones (1980), Technometrics 22, 389-395.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.physics.great_circle import central_angle

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Values a report over which each is whitened report after report: numpy loops over short stretches
#: of every column else, and moving them there and back costs less.
FEW = 32
# Rounder than units.EARTH_RADIUS, by 1.4 in a million: lengths of the noise are stated on it.
SPHERE = 6.371e6


@dataclass(frozen=True)
class FlightOrder:
    """Reports arranged by their position in the flight."""

    # (n,): reports in the order: first reports of all flights (longest flight first), then second
    # reports, and so on
    index: Integers
    # (m + 1,): block ``j`` is ``index[starts[j]:starts[j + 1]]``: the ``j``-th reports of the
    # flights that are longer than ``j``
    starts: Integers


@dataclass(frozen=True)
class Evened:
    """Factors on vectors along and across the heading: E = a I + (b - a) h h', symmetric."""

    nose: Floats  # (2, n): h, unit vector (east, north) of each report's heading
    along: float  # b
    across: float  # a

    @classmethod
    def about(cls, heading: Floats, along: float, across: float) -> Evened:
        """Of headings, (n,) rad."""
        return cls(np.stack([np.sin(heading), np.cos(heading)]), along, across)

    def of(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Vectors (..., 2, n) evened."""
        nose = self.nose.astype(values.dtype)
        part = values[..., 0, :] * nose[0] + values[..., 1, :] * nose[1]
        part *= self.along - self.across
        out = self.across * values
        out[..., 0, :] += part * nose[0]
        out[..., 1, :] += part * nose[1]
        return np.asarray(out, values.dtype)

    def by_report(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Vectors (n, 2, ...) evened."""
        last = np.moveaxis(values, (0, 1), (-1, -2))
        return np.moveaxis(self.of(last), (-1, -2), (0, 1))

    @property
    def inverse(self) -> Evened:
        """What undoes it."""
        return Evened(self.nose, 1.0 / self.along, 1.0 / self.across)

    def take(self, index: Integers) -> Evened:
        """Those of some reports."""
        return Evened(self.nose[:, index], self.along, self.across)


@dataclass(frozen=True)
class Gains:
    """Coefficients of the whitening recursion, one per report, in the reports' own order."""

    # (n,): correlation of the state with that at the flight's previous report; 0 at the first
    decay: Floats
    gain: Floats  # (n,): Kalman gain; 0 where the report is masked
    # (n,): 1 over the standard deviation of the innovation, 0 where masked; s m-1 (values are first
    # divided by nothing: the level factor is contained)
    weight: Floats
    scale: Floats  # (n,): 1 over the level factor, which multiplies values before the recursion
    evened: Evened | None = None  # how errors along and across the heading are made alike


def flight_order(flight: NDArray[np.integer], time: Floats) -> FlightOrder:
    """Arrange reports by position in their flight.

    Parameters
    ----------
    flight : (n,) int
        Flight number of each report, unique over the archive.
    time : (n,) float
        Time of each report, s.
    """
    n = flight.size
    by_flight = np.lexsort((time, flight))
    sorted_flight = flight[by_flight]
    first = (
        np.flatnonzero(np.r_[True, sorted_flight[1:] != sorted_flight[:-1]])
        if n
        else (np.zeros(0, np.int64))
    )
    length = np.diff(np.r_[first, n])
    position = np.arange(n) - np.repeat(first, length)
    rank_of_flight = np.empty(first.size, np.int64)
    rank_of_flight[np.argsort(-length, kind="stable")] = np.arange(first.size)
    order = np.lexsort((np.repeat(rank_of_flight, length), position))
    counts = np.bincount(position, minlength=1 if n else 0) if n else np.zeros(0, np.int64)
    return FlightOrder(by_flight[order], np.r_[0, np.cumsum(counts)].astype(np.int64))


def flight_steps(
    latitude: Floats, longitude: Floats, log_pressure: Floats, order: FlightOrder
) -> tuple[Floats, Floats]:
    """Distance flown and change of ln p since the previous report of the same flight.

    Parameters
    ----------
    latitude, longitude : (n,) float
        Position, degrees.
    log_pressure : (n,) float
        ln of pressure.
    order : FlightOrder
        Arrangement from :func:`flight_order`.

    Returns
    -------
    distance : (n,) float
        Great-circle distance on a sphere of 6371 km, m; infinite at the first report of a flight.
    step : (n,) float
        Absolute change of ln p; infinite at the first report.
    """
    distance = np.full(latitude.size, np.inf)
    step = np.full(latitude.size, np.inf)
    lat, lon = np.radians(latitude), np.radians(longitude)
    for before, now in _neighbours(order):
        distance[now] = SPHERE * central_angle(lat[before], lon[before], lat[now], lon[now])
        step[now] = np.abs(log_pressure[now] - log_pressure[before])
    return distance, step


def _neighbours(order: FlightOrder) -> list[tuple[Integers, Integers]]:
    """Pairs (previous report, this report) for every block but the first."""
    starts = order.starts
    return [
        (
            order.index[starts[j - 1] : starts[j - 1] + starts[j + 1] - starts[j]],
            order.index[starts[j] : starts[j + 1]],
        )
        for j in range(1, starts.size - 1)
    ]


def kalman_gains(
    order: FlightOrder,
    decay: Floats,
    level_factor: Floats,
    keep: NDArray[np.bool_],
    *,
    correlated_sd: float,
    white_sd: float,
    doubt: Floats | None = None,
) -> Gains:
    """Gains of the whitening recursion.

    Parameters
    ----------
    decay : (n,) float
        Correlation of the correlated part with that at the previous report; any value at a
        flight's first report.
    level_factor : (n,) float
        Factor on both standard deviations.
    keep : (n,) bool
        False: the report is treated as missing.
    correlated_sd, white_sd : float
        Standard deviations of the two parts at level factor 1, m s-1.
    doubt : (n,) float, optional
        Further white error of each report, m s-1.
    """
    n, index = decay.size, order.index
    used = np.where(np.isfinite(decay), decay, 0.0).astype(float)
    signal, white = correlated_sd**2, np.full(n, white_sd**2)
    if doubt is not None:
        white += (doubt / level_factor) ** 2
    # a flight's first report has nothing before it: the process starts from its own variance
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
    """Whiten values along flights.

    Parameters
    ----------
    values : (n, 2, ...) float
        Vectors (east, north) by report: residuals, or design columns in the trailing dimensions.
    gains : Gains
        Coefficients of these n reports, from :func:`kalman_gains`.

    Returns
    -------
    (n, 2, ...) float
        Whitened values, of unit variance where the noise model holds; 0 at masked reports.
    """
    blocks = np.ascontiguousarray(np.moveaxis(values[order.index], (0, 1), (-1, -2)))
    whiten_blocks(blocks, order.starts, take_gains(gains, order.index))
    out = np.empty_like(values)
    out[order.index] = np.moveaxis(blocks, (-1, -2), (0, 1))
    return out


def whiten_blocks(values: NDArray[np.floating], starts: Integers, gains: Gains) -> None:
    """Whiten values that lie in the order of :class:`FlightOrder` already, in place.

    Parameters
    ----------
    values : (..., 2, n) float
        Overwritten. The last axis is that of the reports, the one before it of east and north.
    starts : (m + 1,) int
        Blocks of the order.
    gains : Gains
        Of the n reports, in the same order.
    """
    if gains.evened is not None:
        values[...] = gains.evened.of(values)
    many = values[..., :1].size > FEW
    whole = values
    if many:
        values = np.ascontiguousarray(values.reshape(-1, values.shape[-1]).T).T
    kind = values.dtype
    decay, gain = gains.decay.astype(kind), gains.gain.astype(kind)
    values *= gains.scale.astype(kind)
    widest = int(starts[1]) if starts.size > 1 else 0
    state = np.zeros_like(values[..., :widest])  # lies in memory as the values do
    room = np.empty_like(state)
    for first, stop in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        now, before, added = (
            values[..., first:stop],
            *(x[..., : stop - first] for x in (state, room)),
        )
        before *= decay[first:stop]
        now -= before
        np.multiply(now, gain[first:stop], out=added)
        before += added
    values *= gains.weight.astype(kind)
    if many:
        whole[...] = values.reshape(whole.shape)


def take_gains(gains: Gains, index: Integers) -> Gains:
    """Gains of a subset of reports made of whole flights.

    Parameters
    ----------
    index : (m,) int
        The reports to keep.
    """
    evened = None if gains.evened is None else gains.evened.take(index)
    return Gains(
        gains.decay[index], gains.gain[index], gains.weight[index], gains.scale[index], evened
    )
