"""Noise of the wind residual along flights: model, fit, and exact whitening.

The model is that of docs/gap.md, section 2; the level factor g is piecewise linear in ln p and has
mean square 1. Gross errors are single reports that differ from *both* neighbours: a screening on
the size of the residual would remove effects.

The Kalman recursion of one state is the exact Cholesky whitening in linear time, vectorised over
flights.

Source: Jones (1980), Technometrics 22, 389-395 (state space form of an Ornstein-Uhlenbeck process
with white noise, maximum likelihood); de Jong (1988), Biometrika 75, 594-600 (backward recursion of
the leave-one-out errors).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from airswing.gap.archive.acceleration import SPHERE_RADIUS
from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.design import unit_vectors
from airswing.physics.great_circle import central_angle
from airswing.physics.robust_spread import robust_sd


@dataclass(frozen=True)
class FlightOrder:
    """Reports ordered by their position in the flight."""

    # (n,): first reports of all flights (longest flight first), then second reports, and so on
    index: Integers
    # (m + 1,): block j, index[starts[j]:starts[j + 1]], holds the reports at position j of the
    # flights that have more than j reports
    starts: Integers


@dataclass(frozen=True)
class Gains:
    """Coefficients of the whitening recursion, one per report, in the order of the reports."""

    # (n,): correlation of the state with that at the previous report; 0 at the first of a flight
    decay: Floats
    gain: Floats  # (n,): Kalman gain; 0 where the report is masked
    weight: Floats  # (n,): inverse standard deviation of the innovation, s m-1; 0 where masked
    scale: Floats  # (n,): inverse of the level factor, applied before the recursion
    # (n, 2, 2): scaling that makes errors isotropic, applied first; None where they are
    direction: NDArray[np.floating] | None = None


def direction_factors(heading: Floats, along: float, across: float) -> Floats:
    """Matrices (n, 2, 2) that scale vectors along and across headings (n,), rad."""
    unit = np.stack([np.sin(heading), np.cos(heading)], -1)
    return np.asarray(across * np.eye(2) + (along - across) * unit[:, :, None] * unit[:, None])


def scaled(
    values: NDArray[np.floating], factors: NDArray[np.floating] | None
) -> NDArray[np.floating]:
    """Vectors (n, 2, ...) times the matrix of each report; unchanged without matrices."""
    if factors is None:
        return values
    return np.asarray(np.einsum("nij,nj...->ni...", factors.astype(values.dtype), values))


def flight_order(flight: NDArray[np.integer], time: Floats) -> FlightOrder:
    """Order reports by their position in the flight; flight numbers are unique in an archive."""
    by_flight = np.lexsort((time, flight))
    _, first, length = np.unique(flight[by_flight], return_index=True, return_counts=True)
    position = np.arange(flight.size) - np.repeat(first, length)
    length_rank = np.argsort(np.argsort(-length, kind="stable"))
    order = np.lexsort((np.repeat(length_rank, length), position))
    return FlightOrder(by_flight[order], np.r_[0, np.cumsum(np.bincount(position))])


def neighbour_pairs(order: FlightOrder) -> list[tuple[Integers, Integers]]:
    """Return the pairs (previous report, report) of every block but the first."""
    blocks = np.split(order.index, order.starts[1:-1])
    return [(before[: now.size], now) for before, now in pairwise(blocks)]


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
    phi2, white, valid = used[index] ** 2, white[index], keep[index]  # blocks are then slices
    before, total = np.empty(n), np.empty(n)
    variance = np.full(n, signal)
    for first, stop in zip(order.starts[:-1].tolist(), order.starts[1:].tolist(), strict=True):
        now = slice(first, stop)
        variance = phi2[now] * variance[: stop - first] + signal * (1 - phi2[now])
        before[now] = variance
        np.add(variance, white[now], out=total[now])
        variance = variance * (1 - np.where(valid[now], variance / total[now], 0.0))
    gain, weight = np.zeros(n), np.zeros(n)
    gain[index] = np.where(valid, before / total, 0.0)
    weight[index] = np.where(valid, 1 / np.sqrt(total), 0.0)
    return Gains(used, gain, weight, 1.0 / level_factor)


def whiten(values: NDArray[np.floating], order: FlightOrder, gains: Gains) -> NDArray[np.floating]:
    """Whiten vectors (n, 2, ...) along flights: residuals, or design columns.

    The result has unit variance where the noise model holds; it is 0 at masked reports.
    """
    index = order.index
    parts = gains.decay[index], gains.gain[index], gains.weight[index], gains.scale[index]
    isotropic = scaled(values, gains.direction)[index]
    blocks = np.ascontiguousarray(np.moveaxis(isotropic, (0, 1), (-1, -2)))
    whiten_blocks(blocks, order.starts, Gains(*parts))
    out = np.empty_like(values)
    out[index] = np.moveaxis(blocks, (-1, -2), (0, 1))
    return out


def whiten_blocks(values: NDArray[np.floating], starts: Integers, gains: Gains) -> None:
    """Whiten, in place, isotropic vectors (..., 2, n) in the order of a :class:`FlightOrder`.

    ``starts`` are the blocks of the order, ``gains`` those of the n reports in the same order.
    """
    # numpy works on contiguous rows of many columns faster than on short stretches of every column
    transposed = values[..., :1].size > 32
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
    / [V^-1]_ii, with variance 1 / [V^-1]_ii. Errors (n, 2) and precision (n,), the inverse variance
    as mean over directions, are 0 at masked reports.
    """
    white = np.asarray(whiten(values, order, gains), np.float64)
    score, precision = weighted_scores(white, order, gains)
    valid = (precision > 0) & (gains.weight > 0)
    errors = np.divide(score, precision[:, None], out=np.zeros_like(score), where=valid[:, None])
    if gains.direction is not None:
        errors = scaled(errors, np.linalg.inv(gains.direction))
    return errors, np.where(valid, precision, 0.0)


def weighted_scores(white: Floats, order: FlightOrder, gains: Gains) -> tuple[Floats, Floats]:
    """Adjoint of the whitening of values (n, 2), without its direction factors.

    Returns the scores (n, 2) and the diagonal of the inverse covariance, (n,).
    """
    score, precision = np.zeros_like(white), np.zeros(white.shape[0])
    adjoint: Floats = np.zeros((0, white.shape[1]))
    adjoint_weight: Floats = np.zeros(0)
    blocks = np.split(order.index, order.starts[1:-1])
    for now, after in zip(blocks[::-1], [np.zeros(0, np.int64), *blocks[:0:-1]], strict=True):
        decay = gains.decay[after]
        state, information = np.zeros((now.size, white.shape[1])), np.zeros(now.size)
        state[: after.size] = decay[:, None] * adjoint
        information[: after.size] = decay**2 * adjoint_weight
        weight, gain = gains.weight[now], gains.gain[now]
        weighted = weight[:, None] * white[now]
        score[now] = weighted + gain[:, None] * state
        precision[now] = weight**2 + gain**2 * information
        adjoint = (1 - gain)[:, None] * state - weighted
        adjoint_weight = weight**2 + (1 - gain) ** 2 * information
    return score * gains.scale[:, None], precision * gains.scale**2


@dataclass(frozen=True)
class NoiseModel:
    """Parameters of the noise of the residual."""

    # standard deviation per component of the two parts at g = 1, m s-1
    correlated_sd: float
    white_sd: float
    length: float  # e-folding distance of the correlated part, m
    height: float  # e-folding change of ln p of the correlated part
    # (m,): nodes of ln p and g at the nodes; g is constant outside
    level_nodes: Floats
    level_factors: Floats
    # factors on errors along and across the heading, with mean square 1
    along: float = 1.0
    across: float = 1.0

    def factor(self, log_pressure: Floats) -> Floats:
        """Return the level factor g at values of ln p, dimensionless."""
        return np.interp(log_pressure, self.level_nodes, self.level_factors)

    def decay(self, distance: Floats, step: Floats) -> Floats:
        """Return the correlation of the correlated part over distances (m) and steps of ln p."""
        return np.exp(-distance / self.length - step / self.height)

    def direction_factors(self, heading: Floats) -> Floats | None:
        """Matrices from isotropic errors to those at headings (n,), rad; None if isotropic."""
        if self.along == self.across:
            return None
        return direction_factors(heading, self.along, self.across)


@dataclass(frozen=True)
class NoiseFit:
    """A fitted noise model, its whitening gains, and the measured autocovariance."""

    model: NoiseModel
    order: FlightOrder
    gains: Gains
    # (m,): autocovariance along flights against distance, measured and of the model, m2 s-2
    distance_km: Floats
    autocovariance: Floats
    autocovariance_model: Floats
    pair_count: Floats
    gross: Booleans  # (n,): reports set aside as gross errors


def fit_noise(
    residual: Floats, frame: Frame, extra_sd: Floats | None = None, *, seed: int = 0
) -> NoiseFit:
    """Fit the noise model to a residual (n, 2) and compute the whitening gains of every report.

    The frame holds the heading and airspeed from which design columns are computed; ``extra_sd``
    (n,) is the standard deviation of a further white error, m s-1. The likelihood is that of whole
    flights drawn with the ``seed``.
    """
    order = flight_order(frame.flight, frame.time)
    log_pressure = np.log(frame.pressure)
    distance, step = flight_steps(frame.latitude, frame.longitude, log_pressure, order)
    smooth = remove_smooth_effects(residual, frame)
    gross = gross_errors(smooth, order)
    nodes, factors = level_factors(smooth[~gross], log_pressure[~gross])
    level = np.interp(log_pressure, nodes, factors)
    values = smooth / level[:, None]
    extra = np.zeros(level.size) if extra_sd is None else extra_sd / level
    sides = ((smooth * unit)[~gross].sum(axis=1) for unit in unit_vectors(frame.heading))
    across, along = (max(robust_sd(side), 1e-9) for side in sides)
    # errors of the reference are isotropic, those of a compass are across the heading
    if max(along, across) < 1.1 * min(along, across):
        along = across = 1.0
    else:
        mean = float(np.hypot(along, across) / np.sqrt(2.0))
        along, across = along / mean, across / mean
        values = np.asarray(scaled(values, direction_factors(frame.heading, 1 / along, 1 / across)))
    # the likelihood is evaluated about a hundred times: on about 24,000 reports of whole flights
    numbers, most = np.unique(frame.flight), 24_000
    drawn = np.random.default_rng(seed).random(numbers.size) < most / level.size
    rows = np.flatnonzero(drawn[np.searchsorted(numbers, frame.flight)])
    flight, time = frame.flight[rows], frame.time[rows]
    distance, step = distance[rows], step[rows]
    signal, white, length, height = _maximise(
        values[rows], flight_order(flight, time), distance, step, ~gross[rows], extra[rows]
    )
    model = NoiseModel(signal, white, length, height, nodes, factors, along, across)
    gains = whitening_gains(model, order, frame, ~gross, extra_sd)
    counted = np.where(gross[rows, None], 0.0, values[rows])
    measured = _autocovariance(counted, distance, step, flight, time, model)
    return NoiseFit(model, order, gains, *measured, gross)


def whitening_gains(
    model: NoiseModel, order: FlightOrder, frame: Frame, keep: Booleans, extra_sd: Floats | None
) -> Gains:
    """Gains of a model at reports, those not kept treated as missing; see `fit_noise`."""
    log_pressure = np.log(frame.pressure)
    decay = model.decay(*flight_steps(frame.latitude, frame.longitude, log_pressure, order))
    sd = model.correlated_sd, model.white_sd, extra_sd
    gains = kalman_gains(order, decay, model.factor(log_pressure), keep, *sd)
    direction = model.direction_factors(frame.heading)
    return gains if direction is None else replace(gains, direction=np.linalg.inv(direction))


def _maximise(
    values: Floats,
    order: FlightOrder,
    distance: Floats,
    step: Floats,
    keep: Booleans,
    extra_sd: Floats,
) -> Floats:
    """Return correlated_sd, white_sd, length and height of maximum likelihood, (4,)."""
    # at least 1 mm/s, for finite logarithms in an archive without any noise
    spread = max(robust_sd(values.ravel()), 1e-3)
    # most of the scatter is correlated over about 150 km; logarithms keep parameters positive
    start = np.log([0.9 * spread, 0.4 * spread, 150e3, 0.7])
    bounds = np.log(
        [[0.1 * spread, 5 * spread], [0.05 * spread, 2 * spread], [10e3, 2000e3], [0.05, 20.0]]
    )
    # reordered once, not in each likelihood
    index, order = order.index, replace(order, index=np.arange(distance.size))
    values, keep = values[index].T.copy(), keep[index]
    distance, step, extra_sd = distance[index], step[index], extra_sd[index]
    level_factor = np.ones(distance.size)

    def cost(parameters: Floats) -> float:
        # the simplex method has no bounds: beyond them the cost is that of the edge and a penalty
        inside = np.clip(parameters, bounds[:, 0], bounds[:, 1])
        signal, white, length, height = np.exp(inside)
        decay = np.exp(-distance / length - step / height)
        gains = kalman_gains(order, decay, level_factor, keep, signal, white, extra_sd)
        innovation = values.copy()
        whiten_blocks(innovation, order.starts, gains)
        # winsorised at four standard deviations: undetected gross errors must not widen the noise
        misfit = 0.5 * np.minimum(innovation[:, keep] ** 2, 16.0).sum()
        misfit -= values.shape[0] * np.log(gains.weight[keep]).sum()
        return float(misfit + 1e3 * float(((parameters - inside) ** 2).sum()))

    # initial steps of 0.35 in each logarithm: the default steps are shares of the values, which
    # vanish for a logarithm near 0. A third of a nat is below the resolution of the reports.
    simplex = np.vstack([start, start + 0.35 * np.eye(start.size)])
    options = {"maxfev": 160, "xatol": 0.01, "fatol": 0.3, "initial_simplex": simplex}
    best = minimize(cost, start, method="Nelder-Mead", options=options)
    return np.asarray(np.exp(np.clip(best.x, bounds[:, 0], bounds[:, 1])))


def gross_errors(residual: Floats, order: FlightOrder) -> Booleans:
    """Mark reports that differ from their neighbours in the flight, (n,).

    A report is marked when it differs by more than five robust standard deviations from the median
    of the five nearest reports of its flight, itself among them, of which two may be wrong; of
    three in a flight of three or four.
    """
    position = np.repeat(np.arange(order.starts.size - 1), np.diff(order.starts))
    flight = np.arange(position.size) - order.starts[position]
    length = np.bincount(flight)[flight]
    departure = np.zeros_like(residual)
    for width, used in ((3, (length >= 3) & (length < 5)), (5, length >= 5)):
        first = np.clip(position - width // 2, 0, length - width)[used, None]
        nearest = order.index[order.starts[first + np.arange(width)] + flight[used, None]]
        rows = order.index[used]
        departure[rows] = residual[rows] - np.median(residual[nearest], axis=1)
    # reports that are the median themselves have departure 0 and do not enter the spread
    sizes = np.abs(departure[departure != 0.0])
    # half of the values of a normal distribution are within 0.6745 standard deviations
    spread = np.median(sizes) / 0.6745 if sizes.size else 1.0
    return np.asarray((np.abs(departure) > 5.0 * spread).any(axis=1))


def remove_smooth_effects(residual: Floats, frame: Frame) -> Floats:
    """Residual (n, 2) less each aircraft's regression on heading harmonics, airspeed and wind."""
    out = residual.copy()
    for a in np.unique(frame.aircraft):
        rows = np.flatnonzero(frame.aircraft == a)
        heading = frame.heading[rows]
        # columns of a heading error of two cycles, an airspeed factor and a wind
        sine, cosine = np.sin(heading), np.cos(heading)
        across, along = unit_vectors(heading)
        design: Floats = np.empty((8, rows.size, 2))
        harmonics = [np.ones(rows.size), sine, cosine, 2.0 * sine * cosine, cosine**2 - sine**2]
        design[:5] = np.stack(harmonics)[:, :, None] * across
        design[5] = along
        # of the order of 1: a well-conditioned system
        design[:6] *= frame.airspeed[rows, None] / 100.0
        design[6], design[7] = (1.0, 0.0), (0.0, 1.0)
        design = design.reshape(8, -1)
        values = residual[rows].ravel()
        # a wide bound: the scatter still includes the errors that vary with the heading
        bound = 8 * robust_sd(values) + 1e-12
        used = design * (np.abs(values - np.median(values)) < bound)
        # minimum-norm solution: the columns are collinear for an aircraft on one heading
        coefficients = np.linalg.lstsq(used @ design.T, used @ values, rcond=1e-13)[0]
        out[rows] -= (coefficients @ design).reshape(-1, 2)
    return out


def level_factors(residual: Floats, log_pressure: Floats) -> tuple[Floats, Floats]:
    """Robust standard deviation by level relative to that of all reports.

    Returns the median ln p of each level, and its factor (mean square 1 over the reports).
    """
    # five levels of equal counts
    edges = np.unique(np.quantile(log_pressure, np.linspace(0, 1, 6)))
    if edges.size < 3:
        return np.array([float(np.median(log_pressure))]), np.ones(1)
    level = np.clip(np.searchsorted(edges, log_pressure, "right") - 1, 0, edges.size - 2)
    centre = np.array([np.median(log_pressure[level == k]) for k in range(edges.size - 1)])
    sd = np.array([robust_sd(residual[level == k].ravel()) for k in range(edges.size - 1)])
    # at most 25 times the weight of others, where few reports of a level agree by chance
    sd = np.maximum(sd, 0.2 * sd.max() + 1e-9)
    reports = np.bincount(level, minlength=edges.size - 1)
    return centre, sd / np.sqrt(np.average(sd**2, weights=reports))


def _autocovariance(
    residual: Floats,
    distance: Floats,
    step: Floats,
    flight: Integers,
    time: Floats,
    model: NoiseModel,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Mean distance (km), autocovariance, that of the model, and number of pairs, (m,) each."""
    rows = np.lexsort((time, flight))
    along, climbed = (np.cumsum(np.where(np.isfinite(x), x, 0.0)[rows]) for x in (distance, step))
    residual, flight = residual[rows], flight[rows]
    # pairs up to thirty reports apart
    lags = [np.flatnonzero(flight[lag:] == flight[:-lag]) for lag in range(1, 31)]
    before = np.concatenate(lags)
    after = np.concatenate([first + lag for lag, first in enumerate(lags, 1)])
    gap = along[after] - along[before]
    edges = np.array([0, 10, 25, 50, 75, 100, 150, 200, 300, 400, 600, 900]) * 1e3
    where = np.searchsorted(edges, gap, "right")
    # most pairs also changed level: the model is averaged over them; the first value is at zero
    product = 0.5 * (residual[after] * residual[before]).sum(axis=1)
    correlation = model.decay(gap, climbed[after] - climbed[before])
    total, reach, covariance, fitted = (
        np.asarray(np.bincount(where, values, edges.size + 1)[: edges.size], np.float64)
        for values in (np.ones(gap.size), gap / 1e3, product, correlation)
    )
    total[0], covariance[0] = residual.shape[0], 0.5 * (residual**2).sum()
    fitted *= model.correlated_sd**2
    with np.errstate(invalid="ignore"):
        reach, covariance, fitted = reach / total, covariance / total, fitted / total
    fitted[0] = model.correlated_sd**2 + model.white_sd**2
    return reach, covariance, fitted, total
