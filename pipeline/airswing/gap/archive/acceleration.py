"""Longitudinal acceleration at a report, estimated from all flights of the archive.

The difference of the mean speeds over two chords (segments between reports) is as noisy as the
acceleration itself. In climb and descent it is replaced by the mean of all flights by level; after
levelling off (extrapolated from the climb rate and the remaining height) by a function of the time
since, common to all flights, of which mean speeds over chords are known integrals.

The departure of a single flight from the mean is an error of Berkson's kind, which does not
attenuate a regression (Carroll et al. 2006, Measurement Error in Nonlinear Models, ch. 1.4). SI
units.
"""

from __future__ import annotations

import numpy as np

from airswing.flags import PHASE
from airswing.gap.arrays import Floats, Integers
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.physics.great_circle import central_angle
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats

#: Times after levelling off at which the acceleration is fitted, s; it is zero at the last.
KNOTS = np.array([0.0, 20.0, 40.0, 65.0, 100.0, 150.0, 210.0])
#: Reports (climb, descent) and flights (levelling off) below which nothing is fitted: the mean of
#: fifty is known to a seventh of their scatter.
FEWEST = 50
#: Radius of the sphere on which distances along flights are measured, m.
SPHERE_RADIUS = 6.371e6


def acceleration_at_reports(
    acceleration: Floats,
    pressure: Floats,
    phase: Integers,
    flight: Integers,
    time: Floats,
    latitude: Floats,
    longitude: Floats,
) -> Floats:
    """Estimate the longitudinal acceleration at each report, (n,) m s-2.

    Columns are those of a `Frame`, in order of flight and time; ``acceleration`` is the one
    measured over two chords, NaN where unknown. All NaN where no acceleration is known.
    """
    if not np.isfinite(acceleration).any():
        return acceleration
    log_pressure = np.log(pressure)
    out = expected_acceleration(acceleration, log_pressure, phase, flight)
    since = time_since_levelling(time, altitude_from_pressure(pressure), phase, flight)
    pairs = np.flatnonzero(np.isfinite(since[:-1]) & np.isfinite(since[1:]))
    pairs = pairs[flight[pairs] == flight[pairs + 1]]
    start, end = since[pairs], since[pairs + 1]
    lat, lon = np.radians(latitude), np.radians(longitude)
    chord = central_angle(lat[pairs], lon[pairs], lat[pairs + 1], lon[pairs + 1])
    speed = SPHERE_RADIUS * chord / np.maximum(end - start, 1.0)
    fitted = fit_levelling(start, end, speed, flight[pairs])
    if fitted is not None:
        near = since < KNOTS[-1]
        out[near] = np.interp(since[near], KNOTS, fitted)
    return out


def expected_acceleration(
    acceleration: Floats, log_pressure: Floats, phase: Integers, flight: Integers
) -> Floats:
    """Estimate the acceleration in climb and descent by the mean of all flights by level.

    Outside climb and descent, and below 50 reports, it is the measured value (0 where unknown) with
    the smoothing by chords removed.
    """
    measured = np.nan_to_num(acceleration)
    out = measured.copy()
    linked = (flight[2:] == flight[1:-1]) & (flight[:-2] == flight[1:-1])
    # inverts, to second order, the difference of two chords: a mean under a triangle over one
    # report to either side, of variance 1/6
    sharp = 7.0 / 6.0 * measured[1:-1] - 1.0 / 12.0 * (measured[2:] + measured[:-2])
    out[1:-1][linked] = sharp[linked]
    # reports next to another phase include the change of speed between the phases
    inside = np.zeros(phase.size, bool)
    same = (phase[1:] == phase[:-1]) & (flight[1:] == flight[:-1])
    inside[1:-1] = same[1:] & same[:-1]
    for code in (PHASE["ascent"], PHASE["descent"]):
        rows = np.flatnonzero(phase == code)
        used = rows[inside[rows] & np.isfinite(acceleration[rows])]
        if used.size < FEWEST:
            continue
        middle = np.median(acceleration[used])
        bound = 3 * robust_sd(acceleration[used], middle) + 1e-9  # all values may be equal
        used = used[np.abs(acceleration[used] - middle) < bound]
        # extended by 1e-6: knots must increase where all reports are on one level
        knots = np.linspace(log_pressure[rows].min(), log_pressure[rows].max() + 1e-6, 6)
        base = hats(log_pressure[used], knots)
        # prior of the weight of five reports at each knot: sparse levels keep the median
        normal = base @ base.T + 5.0 * np.eye(knots.size)
        profile = np.linalg.solve(normal, base @ (acceleration[used] - middle))
        out[rows] = middle + profile @ hats(log_pressure[rows], knots)
    return out


def time_since_levelling(
    time: Floats, altitude: Floats, phase: Integers, flight: Integers
) -> Floats:
    """Seconds since the end of the climb at the first five reports in cruise; else NaN."""
    out = np.full(time.size, np.nan)
    climb, cruise = phase == PHASE["ascent"], phase == PHASE["cruise"]
    linked = (flight[1:-1] == flight[:-2]) & (flight[1:-1] == flight[2:])
    last = 1 + np.flatnonzero(linked & climb[:-2] & climb[1:-1] & cruise[2:])
    rate = (altitude[last] - altitude[last - 1]) / np.maximum(time[last] - time[last - 1], 1.0)
    remaining = (altitude[last + 1] - altitude[last]) / np.maximum(rate, 0.5)
    level = time[last] + np.clip(remaining, 0.0, time[last + 1] - time[last])
    valid = np.ones(last.size, bool)
    for k in range(1, 6):
        at = np.minimum(last + k, time.size - 1)
        valid &= (last + k < time.size) & (flight[at] == flight[last]) & cruise[at]
        out[at[valid]] = time[at[valid]] - level[valid]
    return out


def fit_levelling(start: Floats, end: Floats, speed: Floats, flight: Integers) -> Floats | None:
    """Fit the acceleration after levelling off, m s-2 at `KNOTS`; None for too few flights.

    Differences of speed between successive chords (ends in s after levelling off, mean ground
    speeds in m s-1) do not depend on the cruising speed of a flight. Those four robust standard
    deviations from the fit (turns) are left out.
    """
    same = flight[1:] == flight[:-1]
    if np.unique(flight[1:][same]).size < FEWEST:
        return None
    difference = np.diff(speed)[same]
    columns = np.diff(_mean_speed_gain(start, end), axis=0)[same]
    slope = np.diff(np.eye(KNOTS.size), axis=0)[:-1, :-1]
    used, fitted = np.ones(difference.size, bool), np.zeros(KNOTS.size - 1)
    for _ in range(3):
        spread = robust_sd(difference - columns @ fitted) + 1e-3
        # differences of the acceleration between knots weigh 12 s (relative to speeds of 1 m/s)
        normal = columns[used].T @ columns[used] / spread**2 + 12.0**2 * slope.T @ slope
        normal += 1e-9 * np.eye(KNOTS.size - 1)
        fitted = np.linalg.solve(normal, columns[used].T @ difference[used] / spread**2)
        used = np.abs(difference - columns @ fitted) < 4.0 * spread
    return np.concatenate([fitted, [0.0]])


def _mean_speed_gain(start: Floats, end: Floats) -> Floats:
    """Mean speed gained since levelling off over chords, per unit of each knot, (m, knots)."""
    fine = np.arange(0.0, KNOTS[-1] + 1.0)
    hat = np.stack([np.interp(fine, KNOTS, row) for row in np.eye(KNOTS.size)[:-1]], -1)
    gain = np.cumsum(hat, axis=0) - 0.5 * hat
    integral = np.cumsum(gain, axis=0) - 0.5 * gain

    def integrated(time: Floats) -> Floats:
        inside = np.minimum(time, KNOTS[-1])
        after = np.maximum(time - KNOTS[-1], 0.0)[:, None] * gain[-1]
        columns = [np.interp(inside, fine, column) for column in integral.T]
        return np.asarray(np.stack(columns, -1) + after)

    length = np.maximum(end - start, 1.0)[:, None]
    return np.asarray((integrated(end) - integrated(start)) / length)
