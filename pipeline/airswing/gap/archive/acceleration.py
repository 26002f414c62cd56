"""Longitudinal acceleration at a report: what the fleet's flights tell, not two noisy chords.

Assumptions: a difference of two chords is as noisy as the acceleration it should show, and a
regression on it too flat. The schedule of a flight tells it better:

* in climb and descent, the fleet's mean by level;
* after levelling off, an acceleration ``a(t)`` in the time since, alike for the fleet: the aircraft
  gains speed as it nears its cruising speed, within a minute or so, less than the interval between
  reports in cruise, so chords show a part of it that depends on when the report fell (0.7 to 0.9 in
  trials). The mean speeds over whole chords are known integrals of ``a`` and give its values at a
  few knots by least squares; the moment of levelling follows from the climb before it and the
  height that was left to climb;
* elsewhere in cruise, as measured, with the chords' spreading to neighbouring reports undone.

Validity: 50 reports and 50 flights to tell; else as measured. What one flight departs from the
fleet is an error of Berkson's kind, which flattens no regression. SI units.

Source: Carroll et al. 2006, Measurement Error in Nonlinear Models, ch. 1.4 (Berkson error).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.flags import PHASE
from airswing.gap.noise.whitening import flight_order, flight_steps
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats

Floats = NDArray[np.float64]

SHARPENING = (7.0 / 6.0, -1.0 / 12.0)
"""Weights of a report and its neighbours that undo, to second order, the difference of two chords:
a mean under a triangle that reaches one report each way, of variance 1/6."""
KNOTS = np.array([0.0, 20.0, 40.0, 65.0, 100.0, 150.0, 210.0])
"""Times after levelling at which the acceleration is fitted, s; nothing at the last."""
SMOOTH = 12.0
"""Weight of differences of the acceleration between knots, s (against steps of speed of 1 m/s)."""
FEWEST = 50
"""Flights below which no curve is fitted."""
CHORDS = 4
"""Chords in cruise used of each flight."""


def acceleration_at_reports(
    acceleration: Floats,
    pressure: Floats,
    phase: NDArray[np.integer],
    flight: NDArray[np.integer],
    time: Floats,
    latitude: Floats,
    longitude: Floats,
) -> Floats:
    """Longitudinal acceleration with which the reports were made.

    Parameters
    ----------
    acceleration : (n,) float
        Measured over two chords, m s-2; NaN unknown.
    pressure : (n,) float
        Pa.
    phase, flight : (n,) int
        In order of flight and time.
    time : (n,) float
        s.
    latitude, longitude : (n,) float
        Degrees.

    Returns
    -------
    (n,) float
        m s-2; NaN everywhere where no acceleration is known.
    """
    if not np.isfinite(acceleration).any():
        return acceleration
    out = expected_acceleration(acceleration, np.log(pressure), phase, flight)
    since = time_since_levelling(time, altitude_from_pressure(pressure), phase, flight)
    distance, _ = flight_steps(latitude, longitude, np.log(pressure), flight_order(flight, time))
    known = np.flatnonzero(np.isfinite(since[:-1]) & np.isfinite(since[1:]))
    known = known[flight[known] == flight[known + 1]]
    start, end = since[known], since[known + 1]
    speed = distance[known + 1] / np.maximum(end - start, 1.0)
    gain = fit_gain(start, end, speed, flight[known])
    if gain is not None:
        near = since < KNOTS[-1]
        out[near] = np.interp(since[near], KNOTS, gain)
    return out


def expected_acceleration(
    acceleration: Floats,
    log_pressure: Floats,
    phase: NDArray[np.integer],
    flight: NDArray[np.integer],
) -> Floats:
    """Longitudinal acceleration to be expected: the fleet's mean by level in climb and descent.

    A difference of two chords is as noisy as what it should show. Speeding up in climb and slowing
    down in descent follow the schedule of the flight, which many flights together tell well. What
    one flight departs from it is then an error of Berkson's kind, which flattens no regression.

    Parameters
    ----------
    acceleration : (n,) float
        Measured, m s-2; NaN unknown.
    log_pressure : (n,) float
        ln of pressure.
    phase, flight : (n,) int
        In order of flight and time.

    Returns
    -------
    (n,) float
        m s-2; outside climb and descent, and where fewer than 50 reports tell, as measured (0
        where unknown) with the chords' spreading to neighbouring reports undone.
    """
    measured = np.nan_to_num(acceleration)
    out = measured.copy()
    linked = (flight[2:] == flight[1:-1]) & (flight[:-2] == flight[1:-1])
    sharp = SHARPENING[0] * measured[1:-1] + SHARPENING[1] * (measured[2:] + measured[:-2])
    out[1:-1][linked] = sharp[linked]
    # the windows of a report next to another phase hold the change of speed between the two
    inside = np.zeros(phase.size, bool)
    same = (phase[1:] == phase[:-1]) & (flight[1:] == flight[:-1])
    inside[1:-1] = same[1:] & same[:-1]
    for which in (PHASE["ascent"], PHASE["descent"]):
        own = np.flatnonzero(phase == which)
        telling = own[inside[own] & np.isfinite(acceleration[own])]
        # of fewer a profile over the level follows single reports
        if telling.size < 50:
            continue
        middle = np.median(acceleration[telling])
        # a hair more: where all are alike the spread is nil, and none would be near
        bound = 3 * robust_sd(acceleration[telling], middle) + 1e-9
        near = telling[np.abs(acceleration[telling] - middle) < bound]
        # a hair beyond the last: knots increase where all are flown at one level
        knots = np.linspace(log_pressure[own].min(), log_pressure[own].max() + 1e-6, 6)
        base = hats(log_pressure[near], knots)
        # worth five reports a knot: a layer hardly flown in keeps the middle
        normal = base @ base.T + 5.0 * np.eye(knots.size)
        profile = np.linalg.solve(normal, base @ (acceleration[near] - middle))
        out[own] = middle + profile @ hats(log_pressure[own], knots)
    return out


def time_since_levelling(
    time: Floats, altitude: Floats, phase: NDArray[np.integer], flight: NDArray[np.integer]
) -> Floats:
    """Time since the climb ended at the first reports of a cruise.

    Parameters
    ----------
    time, altitude : (n,) float
        s, m.
    phase, flight : (n,) int
        In order of flight and time.

    Returns
    -------
    (n,) float
        s; NaN but at the first `CHORDS` + 1 reports in cruise after a climb of two reports.
    """
    out = np.full(time.size, np.nan)
    climb, cruise = phase == PHASE["ascent"], phase == PHASE["cruise"]
    one = (flight[1:-1] == flight[:-2]) & (flight[1:-1] == flight[2:])
    last = 1 + np.flatnonzero(one & climb[:-2] & climb[1:-1] & cruise[2:])
    rate = (altitude[last] - altitude[last - 1]) / np.maximum(time[last] - time[last - 1], 1.0)
    left = (altitude[last + 1] - altitude[last]) / np.maximum(rate, 0.5)
    level = time[last] + np.clip(left, 0.0, time[last + 1] - time[last])
    own = np.ones(last.size, bool)
    for k in range(1, CHORDS + 2):
        at = np.minimum(last + k, time.size - 1)
        own &= (last + k < time.size) & (flight[at] == flight[last]) & cruise[at]
        out[at[own]] = time[at[own]] - level[own]
    return out


def fit_gain(
    start: Floats, end: Floats, speed: Floats, flight: NDArray[np.integer]
) -> Floats | None:
    """Fit the acceleration after levelling off.

    Parameters
    ----------
    start, end : (m,) float
        Chords in cruise, s after levelling off, in order of flight and time.
    speed : (m,) float
        Mean ground speed over them, m s-1.
    flight : (m,) int

    Returns
    -------
    (len(KNOTS),) float or None
        m s-2 at `KNOTS`; None for too few flights.

    Notes
    -----
    Steps of speed from chord to chord are fitted, so a flight's own speed does not matter; steps
    four robust standard deviations off the fit (turns) do not enter.
    """
    same = flight[1:] == flight[:-1]
    step = np.diff(speed)[same]
    if np.unique(flight[1:][same]).size < FEWEST:
        return None
    columns = np.diff(_mean_gained(start, end), axis=0)[same]
    slope = np.diff(np.eye(KNOTS.size), axis=0)[:-1, :-1]
    used, found = np.ones(step.size, bool), np.zeros(KNOTS.size - 1)
    for _ in range(3):
        left = step - columns @ found
        spread = robust_sd(left) + 1e-3
        normal = columns[used].T @ columns[used] / spread**2 + SMOOTH**2 * slope.T @ slope
        normal += 1e-9 * np.eye(KNOTS.size - 1)
        found = np.linalg.solve(normal, columns[used].T @ step[used] / spread**2)
        used = np.abs(step - columns @ found) < 4.0 * spread
    return np.concatenate([found, [0.0]])


def _mean_gained(start: Floats, end: Floats) -> Floats:
    """Mean over chords of the speed gained since levelling, per unit of each knot, (m, knots)."""
    fine = np.arange(0.0, KNOTS[-1] + 1.0)
    hat = np.stack([np.interp(fine, KNOTS, row) for row in np.eye(KNOTS.size)[:-1]], -1)
    gained = np.cumsum(hat, axis=0) - 0.5 * hat
    whole = np.cumsum(gained, axis=0) - 0.5 * gained
    length = np.maximum(end - start, 1.0)[:, None]
    late = np.maximum(end - KNOTS[-1], 0.0) - np.maximum(start - KNOTS[-1], 0.0)
    inside = [
        np.stack([np.interp(np.minimum(t, KNOTS[-1]), fine, column) for column in whole.T], -1)
        for t in (start, end)
    ]
    return np.asarray((inside[1] - inside[0] + late[:, None] * gained[-1]) / length)
