"""Noise of the wind residual along flights, estimated from the residuals themselves.

Assumptions: the residual of each wind component is g(p) times the sum of an Ornstein-Uhlenbeck
process in distance (and ln p) along the flight and white noise; u and v are independent and alike.
g is piecewise linear in ln p and has mean square 1 over the reports. What flights of one day
share is a separate part, estimated from the day sums (:mod:`airswing.gap.sums.accumulate`). Sensor
effects that are smooth functions of heading are removed by a per-aircraft regression first, so a
badly deviating aircraft does not pass for a noisy model.

Validity: flights of three reports and more; at least some hundred reports. Gross errors are single
reports that stand out from *both* neighbours: a screening on the size of the residual itself would
remove the very effects that are looked for.

Source: method of moments on the autocovariance for the start, then maximum likelihood by the exact
recursion of :mod:`airswing.gap.noise.whitening`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from airswing.gap.noise.whitening import (
    FlightOrder,
    Gains,
    flight_order,
    flight_steps,
    kalman_gains,
    whiten,
)

Floats = NDArray[np.float64]

#: Distances (m) at which the autocovariance along the flight is tabulated.
DISTANCE_EDGES = np.array([0, 10, 25, 50, 75, 100, 150, 200, 300, 400, 600, 900]) * 1e3


@dataclass(frozen=True)
class NoiseModel:
    """Parameters of the residual's noise.

    Attributes
    ----------
    correlated_sd, white_sd : float
        Standard deviation per component of the two parts at g = 1, m s-1.
    length : float
        E-folding distance of the correlated part, m.
    height : float
        E-folding change of ln p of the correlated part.
    level_nodes, level_factors : (m,)
        g at nodes of ln p; constant outside.
    """

    correlated_sd: float
    white_sd: float
    length: float
    height: float
    level_nodes: Floats
    level_factors: Floats

    def factor(self, log_pressure: Floats) -> Floats:
        """Level factor g at the given ln p, dimensionless."""
        return np.interp(log_pressure, self.level_nodes, self.level_factors)

    def decay(self, distance: Floats, step: Floats) -> Floats:
        """Correlation of the correlated part over a distance (m) and a step of ln p."""
        return np.exp(-distance / self.length - step / self.height)


@dataclass(frozen=True)
class NoiseFit:
    """A noise model with what it was fitted to.

    Attributes
    ----------
    model : NoiseModel
    order : FlightOrder
    gains : Gains
    distance_km, autocovariance, autocovariance_model, pair_count : (m,)
        Autocovariance along flights against distance, m2 s-2, data and model.
    gross : (n,) bool
        Reports taken for gross errors.
    """

    model: NoiseModel
    order: FlightOrder
    gains: Gains
    distance_km: Floats
    autocovariance: Floats
    autocovariance_model: Floats
    pair_count: Floats
    gross: NDArray[np.bool_]


def gross_errors(
    residual: Floats, order: FlightOrder, *, threshold: float = 5.0
) -> NDArray[np.bool_]:
    """Mark single reports that stand out from both neighbours of their flight.

    A report is gross when it differs by more than ``threshold`` robust standard deviations from the
    median of itself and its two neighbours (at the ends: the two nearest).

    Parameters
    ----------
    residual : (n, 2) float
        Residual (u, v), m s-1.
    order : FlightOrder
        Arrangement by flight.
    threshold : float
        In robust standard deviations of that difference.

    Returns
    -------
    (n,) bool
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
    middle = used[used > 0]
    spread = np.median(middle) / 0.6745 if middle.size else 1.0
    return np.asarray((np.abs(departure) > threshold * spread).any(axis=1) & known)


def previous_and_next(order: FlightOrder, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index of the previous and next report of the same flight, -1 where there is none.

    Parameters
    ----------
    order : FlightOrder
    n : int
        Number of reports.

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
        bound = 8 * _robust_sd(values) + 1e-12
        good = np.abs(values - np.median(values)) < bound
        used = design * good
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


def _robust_sd(values: Floats) -> float:
    """Standard deviation from the median absolute deviation."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def level_factors(
    residual: Floats, log_pressure: Floats, *, nodes: int = 5
) -> tuple[Floats, Floats]:
    """Robust standard deviation by level, relative to that of all.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    log_pressure : (n,) float
    nodes : int
        Number of levels, at equal counts of reports.

    Returns
    -------
    level_nodes, level_factors : (m,) float
    """
    edges = np.unique(np.quantile(log_pressure, np.linspace(0, 1, nodes + 1)))
    if edges.size < 3:
        return np.array([float(np.median(log_pressure))]), np.ones(1)
    which = np.clip(np.searchsorted(edges, log_pressure, "right") - 1, 0, edges.size - 2)
    centre = np.array([np.median(log_pressure[which == k]) for k in range(edges.size - 1)])
    sd = np.array([_robust_sd(residual[which == k].ravel()) for k in range(edges.size - 1)])
    sd = np.maximum(sd, 0.2 * sd.max() + 1e-9)
    counts = np.bincount(which, minlength=edges.size - 1)
    return centre, sd / np.sqrt(np.average(sd**2, weights=counts))


def autocovariance(
    residual: Floats, distance: Floats, order: FlightOrder, *, most_lags: int = 30
) -> tuple[Floats, Floats, Floats]:
    """Autocovariance along flights against the distance flown.

    Parameters
    ----------
    residual : (n, 2) float
        m s-1.
    distance : (n,) float
        Distance since the previous report, m; infinite at the first of a flight.
    order : FlightOrder
    most_lags : int
        Largest difference of position considered.

    Returns
    -------
    centre, covariance, count : (m,) float
        Mean distance of the pairs (m), mean product of the two components (m2 s-2), pairs. The
        first entry is distance zero.
    """
    along = np.zeros(residual.shape[0])
    blocks = [
        order.index[order.starts[j] : order.starts[j + 1]] for j in range(order.starts.size - 1)
    ]
    for j in range(1, len(blocks)):
        along[blocks[j]] = along[blocks[j - 1][: blocks[j].size]] + distance[blocks[j]]
    bins = DISTANCE_EDGES.size - 1
    total, reach, count = np.zeros(bins + 1), np.zeros(bins + 1), np.zeros(bins + 1)
    total[0], count[0] = 0.5 * float((residual**2).sum()), float(residual.shape[0])
    for j in range(1, len(blocks)):
        for lag in range(1, min(j, most_lags) + 1):
            now, last = blocks[j], blocks[j - lag][: blocks[j].size]
            gap = along[now] - along[last]
            where = np.searchsorted(DISTANCE_EDGES, gap, "right") - 1
            ok = (where >= 0) & (where < bins)
            product = 0.5 * (residual[now] * residual[last]).sum(axis=1)
            total[1:] += np.bincount(where[ok], product[ok], minlength=bins)
            reach[1:] += np.bincount(where[ok], gap[ok], minlength=bins)
            count[1:] += np.bincount(where[ok], minlength=bins)
    with np.errstate(invalid="ignore"):
        return reach / count, total / count, count


def _likelihood(
    values: Floats,
    order: FlightOrder,
    distance: Floats,
    step: Floats,
    keep: NDArray[np.bool_],
    parameters: Floats,
) -> float:
    """Minus log likelihood of standardised residuals, squared innovations winsorised at 4 sd."""
    signal, white, length, height = np.exp(parameters)
    decay = np.exp(-distance / length - step / height)
    gains = kalman_gains(
        order, decay, np.ones(distance.size), keep, correlated_sd=signal, white_sd=white
    )
    innovation = whiten(values, order, gains)
    weight = gains.weight[keep]
    return float(
        0.5 * np.minimum(innovation[keep] ** 2, 16.0).sum() - values.shape[1] * np.log(weight).sum()
    )


@dataclass(frozen=True)
class Flown:
    """Where and how reports were flown, as the noise needs it.

    Attributes
    ----------
    aircraft, flight : (n,) int
    time : (n,) float
        s.
    latitude, longitude : (n,) float
        degrees.
    pressure : (n,) float
        Pa.
    heading : (n,) float
        rad, true.
    airspeed : (n,) float
        m s-1.
    doubt : (n,) float or None
        Further white error of each report (see :mod:`airswing.physics.turns`), m s-1.
    """

    aircraft: NDArray[np.integer]
    flight: NDArray[np.integer]
    time: Floats
    latitude: Floats
    longitude: Floats
    pressure: Floats
    heading: Floats
    airspeed: Floats
    doubt: Floats | None = None


def flown(frame: object, doubt: Floats | None = None) -> Flown:
    """Columns of a frame that the noise needs.

    Parameters
    ----------
    frame : Frame
        With the heading and airspeed that design columns are made of.
    doubt : (n,) float, optional
        Further white error of each report, m s-1.

    Returns
    -------
    Flown
    """
    names = [one.name for one in fields(Flown) if one.name != "doubt"]
    return Flown(**{name: getattr(frame, name) for name in names}, doubt=doubt)


def fit_noise(
    residual: Floats, reports: Flown, *, most_reports: int = 24_000, seed: int = 0
) -> NoiseFit:
    """Fit the noise model and return the whitening gains of every report.

    Parameters
    ----------
    residual : (n, 2) float
        Reported minus simulated wind (u, v), m s-1.
    reports : Flown
    most_reports : int
        Whole flights are drawn until this many reports enter the likelihood.
    seed : int
        Of that draw.

    Returns
    -------
    NoiseFit
    """
    order = flight_order(reports.flight, reports.time)
    log_pressure = np.log(reports.pressure)
    distance, step = flight_steps(reports.latitude, reports.longitude, log_pressure, order)
    smooth = remove_smooth_effects(residual, reports.aircraft, reports.heading, reports.airspeed)
    gross = gross_errors(smooth, order)
    nodes, factors = level_factors(smooth[~gross], log_pressure[~gross])
    values = smooth / np.interp(log_pressure, nodes, factors)[:, None]
    chosen = _draw_flights(reports.flight, most_reports, seed)
    model = _maximise(values, chosen, reports.flight, reports.time, distance, step, ~gross)
    model = replace(model, level_nodes=nodes, level_factors=factors)
    gains = _gains(model, order, distance, step, log_pressure, ~gross, reports.doubt)
    centre, covariance, count = autocovariance(
        np.where(gross[chosen, None], 0.0, values[chosen]),
        distance[chosen],
        flight_order(reports.flight[chosen], reports.time[chosen]),
    )
    fitted = model.correlated_sd**2 * np.exp(-centre / model.length)
    fitted[0] = model.correlated_sd**2 + model.white_sd**2
    return NoiseFit(model, order, gains, centre / 1e3, covariance, fitted, count, gross)


def fitted_gains(fit: NoiseFit, residual: Floats, reports: Flown) -> NoiseFit:
    """Gains of reports the noise was not fitted to: the fitted model, their own gross errors.

    Parameters
    ----------
    fit : NoiseFit
        Of a sample of the archive.
    residual : (n, 2) float
    reports : Flown

    Returns
    -------
    NoiseFit
    """
    order = flight_order(reports.flight, reports.time)
    log_pressure = np.log(reports.pressure)
    distance, step = flight_steps(reports.latitude, reports.longitude, log_pressure, order)
    gross = gross_errors(
        remove_smooth_effects(residual, reports.aircraft, reports.heading, reports.airspeed), order
    )
    gains = _gains(fit.model, order, distance, step, log_pressure, ~gross, reports.doubt)
    return replace(fit, order=order, gains=gains, gross=gross)


def _gains(
    model: NoiseModel,
    order: FlightOrder,
    distance: Floats,
    step: Floats,
    log_pressure: Floats,
    keep: NDArray[np.bool_],
    doubt: Floats | None,
) -> Gains:
    """Gains of a model on reports."""
    return kalman_gains(
        order,
        model.decay(distance, step),
        model.factor(log_pressure),
        keep,
        correlated_sd=model.correlated_sd,
        white_sd=model.white_sd,
        doubt=doubt,
    )


def _draw_flights(flight: NDArray[np.integer], most: int, seed: int) -> NDArray[np.int64]:
    """Reports of randomly drawn whole flights, about ``most`` of them."""
    if flight.size <= most:
        return np.arange(flight.size)
    numbers = np.unique(flight)
    share = most / flight.size
    kept = np.random.default_rng(seed).random(numbers.size) < share
    return np.flatnonzero(kept[np.searchsorted(numbers, flight)])


def _maximise(
    values: Floats,
    chosen: NDArray[np.int64],
    flight: NDArray[np.integer],
    time: Floats,
    distance: Floats,
    step: Floats,
    keep: NDArray[np.bool_],
) -> NoiseModel:
    """Maximum likelihood of the four parameters on the chosen flights."""
    order = flight_order(flight[chosen], time[chosen])
    spread = max(_robust_sd(values[chosen].ravel()), 1e-3)
    start = np.log([0.9 * spread, 0.4 * spread, 150e3, 0.7])
    bounds = np.log(
        [[0.1 * spread, 5 * spread], [0.05 * spread, 2 * spread], [10e3, 2000e3], [0.05, 20.0]]
    )
    own = values[chosen], order, distance[chosen], step[chosen], keep[chosen]

    def cost(parameters: Floats) -> float:
        inside = np.clip(parameters, bounds[:, 0], bounds[:, 1])
        return _likelihood(*own, inside) + 1e3 * float(((parameters - inside) ** 2).sum())

    best = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"maxfev": 160, "xatol": 0.01, "fatol": 0.3, "initial_simplex": _simplex(start)},
    )
    found = np.exp(np.clip(best.x, bounds[:, 0], bounds[:, 1]))
    return NoiseModel(found[0], found[1], found[2], found[3], np.zeros(1), np.ones(1))


def _simplex(start: Floats) -> Floats:
    """Start simplex: steps of a third in each logarithm."""
    return np.vstack([start, start + 0.35 * np.eye(start.size)])
