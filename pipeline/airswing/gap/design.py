"""Regressors of the model: exogenous heading and airspeed, weather, and doubt of the heading.

Assumptions: aircraft hold their *track*: they crab into the wind they meet. The indicated heading
``arg(V_G - W_reported)`` then moves with the very model error that is in the residual, and the
indicated airspeed with the noise of the report, so that columns evaluated at them correlate with
the residual by construction (a false two-cycle deviation of 0.3 m/s rms in trials). Columns are
therefore evaluated at

* the heading that the large-scale wind implies, ``arg(V_G - W)``, plus the aircraft's smooth
  deviation (regression of the difference on two harmonics);
* the large-scale part of the *reported* wind, a fit by day to position and level: the reference
  wind holds the model error of the residual, which makes the regression of reports on model winds
  flatter than 1 (0.87 whitened in trials; 0.99 to 1.03 on the reported wind's large-scale part);
* the airspeed of the aircraft's own profile by level and phase, plus the flight's mean departure.

Random heading differences s between the two leave a factor exp(-k^2 s^2 / 2) on harmonic k: 0.1 %
for one cycle at 2.5 degrees.

The error that the aircraft of one day share is a field of that day, curved in place and height; the
error that lasts over the archive is the reference's climatology by height, region and hour. Places
are in units of the archive's spread, clipped at three of them.

Where the heading is off by eps (near a turn: `airswing.physics.turns`), a column of the deviation
misses about airspeed x deviation x eps, at random from report to report: white noise that is added
to that of the report. So is the rounding of headings that come in coarse steps, which would pass
for errors of many kinds. SI units and radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import heading_lattices
from airswing.gap.arrays import Floats
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats
from airswing.physics.triangle import wrap_signed
from airswing.units import DAY


def exogenous(frame: Frame) -> Frame:
    """Frame whose heading and airspeed may be used in design columns.

    ``heading``, ``magnetic_heading`` and ``airspeed`` are replaced, the reference's wind and shear
    by the large-scale reported ones.
    """
    smooth, shear = _large_scale(frame)
    implied = np.arctan2(frame.ground_u - smooth[:, 0], frame.ground_v - smooth[:, 1])
    difference = wrap_signed(frame.heading - implied)
    declination = np.nan_to_num(wrap_signed(frame.heading - frame.magnetic_heading))
    finite = np.isfinite(frame.dudlnp) & np.isfinite(frame.dvdlnp)
    heading = implied + smooth_deviation(difference, implied - declination, frame.aircraft)
    return replace(
        frame,
        u_ref=smooth[:, 0],
        v_ref=smooth[:, 1],
        dudlnp=np.where(finite, shear[:, 0], np.nan),
        dvdlnp=np.where(finite, shear[:, 1], np.nan),
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(heading - declination, 2 * np.pi),
        airspeed=typical_airspeed(frame),
    )


def _large_scale(frame: Frame) -> tuple[Floats, Floats]:
    """Fit by day of the reported wind, and its derivative by ln p, each (n, 2), m s-1."""
    x, y, z = _places(frame)
    hour = np.mod(frame.time / DAY, 1.0) - 0.5
    unit, zero = np.ones_like(x), np.zeros_like(x)
    terms = [unit, x, y, z, z * z, z**3, x * z, y * z, hour, hour * z, x * x, y * y, x * y]
    rates = [zero, zero, zero, unit, 2 * z, 3 * z * z, x, y, zero, hour, zero, zero, zero]
    design, slopes = np.stack(terms, -1), np.stack(rates, -1)
    wind = np.stack([frame.u_rep, frame.v_rep], -1)
    fit, shear = np.empty_like(wind), np.empty_like(wind)
    spread = np.log(frame.pressure).std() or 1.0  # of a unit of z
    # two reports' worth on all but the constant: a day with few keeps its mean wind
    ridge = 2.0 * np.diag(np.arange(len(terms)) > 0) + 1e-6 * np.eye(len(terms))
    day = np.floor((frame.time - frame.epoch) / DAY)
    for one_day in np.unique(day):
        index = np.flatnonzero(day == one_day)
        rows = design[index]
        theta = np.linalg.solve(rows.T @ rows + ridge, rows.T @ wind[index])
        fit[index], shear[index] = rows @ theta, slopes[index] @ theta / spread
    return fit, shear


def smooth_deviation(difference: Floats, angle: Floats, aircraft: NDArray[np.integer]) -> Floats:
    """Per-aircraft regression of an angle (rad) on a constant and two cycles of another.

    Differences beyond three robust standard deviations do not enter.
    """
    cycles = [f(k * angle) for k in (1, 2) for f in (np.sin, np.cos)]
    design = np.stack([np.ones_like(angle), *cycles], -1)
    out = np.zeros_like(difference)
    for a in np.unique(aircraft):
        index = np.flatnonzero(aircraft == a)
        middle = np.median(difference[index])
        # of an aircraft without any scatter all are near
        spread = robust_sd(difference[index], middle) + 1e-9
        near = index[np.abs(difference[index] - middle) < 3.0 * spread]
        normal = design[near].T @ design[near]
        # an aircraft that flew few headings has no cycles rather than large ones
        ridge = (1e-3 * near.size + 1e-9) * np.eye(5)
        fit = np.linalg.solve(normal + ridge, design[near].T @ difference[near])
        out[index] = design[index] @ fit
    return out


def typical_airspeed(frame: Frame) -> Floats:
    """Airspeed from the aircraft's own profile and the flight's mean departure from it, (n,)."""
    airspeed, log_pressure = frame.airspeed, np.log(frame.pressure)
    # slightly beyond the last, so that knots increase where all reports are at one level
    knots = np.linspace(log_pressure.min(), log_pressure.max() + 1e-6, 7)
    base = hats(log_pressure, knots).T
    climbing = np.stack([frame.phase == 1, frame.phase == 3], -1)[:, :, None]
    design = np.concatenate([base, (climbing * base[:, None, :]).reshape(base.shape[0], -1)], -1)
    out = np.empty_like(airspeed)
    for a in np.unique(frame.aircraft):
        index = np.flatnonzero(frame.aircraft == a)
        middle = np.median(airspeed[index])
        # worth one report: knots an aircraft never flew at fall back to its median
        normal = design[index].T @ design[index] + np.eye(design.shape[1])
        profile = np.linalg.solve(normal, design[index].T @ (airspeed[index] - middle))
        out[index] = middle + design[index] @ profile
    _, number = np.unique(frame.flight, return_inverse=True)
    count = np.bincount(number)
    # two reports' worth of the profile: a flight of one or two would be its own typical airspeed
    return np.asarray(out + (np.bincount(number, airspeed - out) / (count + 2.0))[number])


def day_field_columns(frame: Frame) -> Floats:
    """Columns (n, 2, 20) of the day fields: u and v times {1, x, y, z} and products of two.

    The weather a model misses reaches some hundred km and a part of the troposphere: with fields
    linear in place, scores of the fleet's effects scatter from day to day by four to ten times that
    of independent errors, with the products by two to four.
    """
    x, y, z = _places(frame)
    squares = [x * x - 1, x * y, y * y - 1, x * z, y * z, z * z - 1]
    return _by_component(np.stack([np.ones_like(x), x, y, z, *squares], -1))


def climatology_columns(frame: Frame) -> Floats:
    """Columns (n, 2, m) of the reference's own climatology: u and v by height, region and hour.

    The error of a reference over a region changes with height: without the products of three
    places, errors that last pass for winds turned or stretched.
    """
    x, y, z = _places(frame)
    angle = 2 * np.pi * frame.time / DAY
    flat = [x, y, x * y, x * x - 1, y * y - 1]
    terms = [np.ones(frame.size), z, z * z - 1, *flat, *(term * z for term in flat)]
    terms += [x * (z * z - 1), y * (z * z - 1), np.sin(angle), np.cos(angle)]
    return _by_component(np.stack(terms, -1))


def _places(frame: Frame) -> list[Floats]:
    """Longitude, latitude and ln p from the archive's middle, in units of its spread."""
    out = []
    for values in (frame.longitude, frame.latitude, np.log(frame.pressure)):
        spread = float(np.std(values))
        out.append(np.clip((values - np.mean(values)) / (spread if spread > 0 else 1.0), -3, 3))
    return out


def _by_component(terms: Floats) -> Floats:
    n, k = terms.shape
    out = np.zeros((n, 2, 2 * k))
    out[:, 0, :k] = terms
    out[:, 1, k:] = terms
    return out


def unit_vectors(heading: Floats) -> tuple[Floats, Floats]:
    """Unit vectors to the right of the heading and along it, each (n, 2) of (u, v)."""
    sine, cosine = np.sin(heading), np.cos(heading)
    return np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)


def _lasting_rounding(frame: Frame, heading: Floats, step: Floats) -> Floats:
    """Standard deviation of white errors whose means scatter like rounding errors, (n,) rad.

    Rounding to ``step`` (n,) rad is the same for as long as an aircraft holds its heading: the
    variance step^2 / 12 counts as many times as that of sums over a flight exceeds it. These sums
    are of the reported headings of all other aircraft, rounded in the same way, and of the
    ``heading`` of columns where there are none.
    """
    fine = step == 0.0
    used = fine if fine.any() else ~fine
    angle = np.where(fine, frame.heading, heading)[used]
    _, flight = np.unique(frame.flight[used], return_inverse=True)
    out = np.zeros(frame.size)
    for width in np.unique(step[~fine]):
        error = angle - width * np.round(angle / width)
        times = (np.bincount(flight, error) ** 2).sum() / (error**2).sum()
        out[step == width] = width * np.sqrt(max(1.0, float(times)) / 12.0)
    return out


def heading_doubt(frame: Frame, columns_frame: Frame) -> Floats:
    """Error of the deviation's columns that the doubt of the heading makes, (n,) m s-1.

    ``columns_frame`` holds the heading of the columns. Standard deviation per
    component; 0 where the heading's error is not known.
    """
    east, north = frame.ground_u - columns_frame.u_ref, frame.ground_v - columns_frame.v_ref
    implied = np.arctan2(east, north)
    squared = wrap_signed(columns_frame.heading - implied) ** 2
    count = np.maximum(np.bincount(frame.aircraft, minlength=len(frame.tails)), 1)
    deviation = np.sqrt(np.bincount(frame.aircraft, squared, minlength=len(frame.tails)) / count)
    # a heading that is off by more than a right angle says nothing
    off = np.minimum(np.nan_to_num(frame.heading_error), np.radians(90.0))
    steps = np.array([lattice.step if lattice else 0.0 for lattice in heading_lattices(frame)])
    rounding = _lasting_rounding(frame, columns_frame.heading, np.radians(steps)[frame.aircraft])
    near_turns = deviation[frame.aircraft] * off
    return np.asarray(columns_frame.airspeed * np.hypot(near_turns, rounding))
