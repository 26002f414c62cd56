"""Noise of the wind residual along flights, estimated from the residuals themselves.

Assumptions: the residual of each wind component is g(p) times the sum of an Ornstein-Uhlenbeck
process in distance (and ln p) along the flight and white noise; u and v are independent and alike,
or parts along and across the heading are, each with a factor.
g is piecewise linear in ln p and has mean square 1 over the reports. What flights of one day
share is a separate part, estimated from the day sums (:mod:`airswing.gap.model.sums`). Sensor
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

from airswing.gap.noise.residual_statistics import (
    autocovariance,
    direction_factors,
    gross_errors,
    level_factors,
    remove_smooth_effects,
)
from airswing.gap.noise.whitening import (
    Evened,
    FlightOrder,
    Gains,
    flight_order,
    flight_steps,
    kalman_gains,
    whiten_blocks,
)
from airswing.physics.robust_spread import robust_sd

Floats = NDArray[np.float64]

# Reports the likelihood is maximised on: it is evaluated some hundred times.
MOST_REPORTS = 24_000


@dataclass(frozen=True)
class NoiseModel:
    """Parameters of the residual's noise."""

    # correlated_sd, white_sd: standard deviation per component of the two parts at g = 1, m s-1
    correlated_sd: float
    white_sd: float
    length: float  # e-folding distance of the correlated part, m
    height: float  # e-folding change of ln p of the correlated part
    # level_nodes, level_factors: (m,): g at nodes of ln p; constant outside
    level_nodes: Floats
    level_factors: Floats
    # factors of errors along and across the heading, their mean square 1
    along: float = 1.0
    across: float = 1.0

    def factor(self, log_pressure: Floats) -> Floats:
        """Level factor g at the given ln p, dimensionless."""
        return np.interp(log_pressure, self.level_nodes, self.level_factors)

    def decay(self, distance: Floats, step: Floats) -> Floats:
        """Correlation of the correlated part over a distance (m) and a step of ln p."""
        return np.exp(-distance / self.length - step / self.height)

    def uneven(self, heading: Floats) -> Evened | None:
        """What makes errors that are alike in all directions those of headings (rad, (n,)).

        None where they are alike.
        """
        if self.along == self.across:
            return None
        return Evened.about(heading, self.along, self.across)


@dataclass(frozen=True)
class NoiseFit:
    """A noise model with what it was fitted to."""

    model: NoiseModel
    order: FlightOrder
    gains: Gains
    # distance_km, autocovariance, autocovariance_model, pair_count: (m,): autocovariance along
    # flights against distance, m2 s-2, data and model
    distance_km: Floats
    autocovariance: Floats
    autocovariance_model: Floats
    pair_count: Floats
    gross: NDArray[np.bool_]  # (n,): reports taken for gross errors


def _likelihood(
    values: Floats,
    order: FlightOrder,
    distance: Floats,
    step: Floats,
    keep: NDArray[np.bool_],
    parameters: Floats,
) -> float:
    """Minus log likelihood of standardised residuals, squared innovations winsorised at 4 sd.

    Of reports that lie in the order of their flights already, values (2, n).
    """
    signal, white, length, height = np.exp(parameters)
    decay = np.exp(-distance / length - step / height)
    gains = kalman_gains(
        order, decay, np.ones(distance.size), keep, correlated_sd=signal, white_sd=white
    )
    innovation = values.copy()
    whiten_blocks(innovation, order.starts, gains)
    weight = gains.weight[keep]
    return float(
        # four standard deviations: gross errors that were not seen must not widen the noise
        0.5 * np.minimum(innovation[:, keep] ** 2, 16.0).sum()
        - values.shape[0] * np.log(weight).sum()
    )


@dataclass(frozen=True)
class Flown:
    """Where and how reports were flown, as the noise needs it."""

    aircraft: NDArray[np.integer]  # (n,)
    flight: NDArray[np.integer]  # (n,)
    time: Floats  # (n,): s
    # latitude, longitude: (n,): degrees
    latitude: Floats
    longitude: Floats
    pressure: Floats  # (n,): Pa
    heading: Floats  # (n,): rad, true
    airspeed: Floats  # (n,): m s-1
    # (n,): further white error of each report (see :mod:`airswing.physics.turns`), m s-1
    doubt: Floats | None = None


def flown(frame: object, doubt: Floats | None = None) -> Flown:
    """Columns of a frame that the noise needs.

    Parameters
    ----------
    frame : Frame
        With the heading and airspeed that design columns are made of.
    doubt : (n,) float, optional
        Further white error of each report, m s-1.
    """
    names = [one.name for one in fields(Flown) if one.name != "doubt"]
    return Flown(**{name: getattr(frame, name) for name in names}, doubt=doubt)


def fit_noise(residual: Floats, reports: Flown, *, seed: int = 0) -> NoiseFit:
    """Fit the noise model and return the whitening gains of every report.

    Parameters
    ----------
    residual : (n, 2) float
        Reported minus simulated wind (u, v), m s-1.
    seed : int
        Of the draw of whole flights, until `MOST_REPORTS` enter the likelihood.
    """
    order = flight_order(reports.flight, reports.time)
    log_pressure = np.log(reports.pressure)
    distance, step = flight_steps(reports.latitude, reports.longitude, log_pressure, order)
    smooth = remove_smooth_effects(residual, reports.aircraft, reports.heading, reports.airspeed)
    gross = gross_errors(smooth, order)
    nodes, factors = level_factors(smooth[~gross], log_pressure[~gross])
    values = smooth / np.interp(log_pressure, nodes, factors)[:, None]
    along, across = direction_factors(smooth[~gross], reports.heading[~gross])
    if along != across:
        evened = Evened.about(reports.heading, 1 / along, 1 / across)
        values = np.ascontiguousarray(evened.by_report(values))
    chosen = _draw_flights(reports.flight, MOST_REPORTS, seed)
    model = _maximise(values, chosen, reports.flight, reports.time, distance, step, ~gross)
    model = replace(model, level_nodes=nodes, level_factors=factors, along=along, across=across)
    gains = _gains(model, order, distance, step, reports, ~gross)
    centre, covariance, correlation, count = autocovariance(
        np.where(gross[chosen, None], 0.0, values[chosen]),
        distance[chosen],
        step[chosen],
        flight_order(reports.flight[chosen], reports.time[chosen]),
        decay=model.decay,
    )
    fitted = model.correlated_sd**2 * correlation
    fitted[0] = model.correlated_sd**2 + model.white_sd**2
    return NoiseFit(model, order, gains, centre / 1e3, covariance, fitted, count, gross)


def gains_without(fit: NoiseFit, reports: Flown, keep: NDArray[np.bool_]) -> Gains:
    """Gains of a fitted model on the reports of its order, some of them left out.

    Parameters
    ----------
    keep : (n,) bool
        False: the report is treated as missing.
    """
    log_pressure = np.log(reports.pressure)
    distance, step = flight_steps(reports.latitude, reports.longitude, log_pressure, fit.order)
    return _gains(fit.model, fit.order, distance, step, reports, keep)


def _gains(
    model: NoiseModel,
    order: FlightOrder,
    distance: Floats,
    step: Floats,
    reports: Flown,
    keep: NDArray[np.bool_],
) -> Gains:
    """Gains of a model on reports."""
    gains = kalman_gains(
        order,
        model.decay(distance, step),
        model.factor(np.log(reports.pressure)),
        keep,
        correlated_sd=model.correlated_sd,
        white_sd=model.white_sd,
        doubt=reports.doubt,
    )
    uneven = model.uneven(reports.heading)
    return gains if uneven is None else replace(gains, evened=uneven.inverse)


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
    # an archive made without any noise: the logarithms below stay finite
    spread = max(robust_sd(values[chosen].ravel()), 1e-3)
    # from a usual flight: most of the scatter correlated, over 150 km; in logarithms none turns
    # negative
    start = np.log([0.9 * spread, 0.4 * spread, 150e3, 0.7])
    bounds = np.log(
        [[0.1 * spread, 5 * spread], [0.05 * spread, 2 * spread], [10e3, 2000e3], [0.05, 20.0]]
    )
    # laid out in the order once, not at each of some hundred likelihoods
    laid, place = chosen[order.index], replace(order, index=np.arange(chosen.size))
    own = values[laid].T.copy(), place, distance[laid], step[laid], keep[laid]

    def cost(parameters: Floats) -> float:
        # the simplex knows no bounds: beyond them the cost is that of the edge and a wall
        inside = np.clip(parameters, bounds[:, 0], bounds[:, 1])
        return _likelihood(*own, inside) + 1e3 * float(((parameters - inside) ** 2).sum())

    best = minimize(
        cost,
        start,
        method="Nelder-Mead",
        # a third of a nat is less than the reports of the fit can tell, and a likelihood costs a
        # pass
        options={"maxfev": 160, "xatol": 0.01, "fatol": 0.3, "initial_simplex": _simplex(start)},
    )
    found = np.exp(np.clip(best.x, bounds[:, 0], bounds[:, 1]))
    return NoiseModel(found[0], found[1], found[2], found[3], np.zeros(1), np.ones(1))


def _simplex(start: Floats) -> Floats:
    """Start simplex: steps of a third in each logarithm."""
    # the simplex method's own steps are shares of the values: one near 0, in logarithms, would
    # stand still
    return np.vstack([start, start + 0.35 * np.eye(start.size)])
