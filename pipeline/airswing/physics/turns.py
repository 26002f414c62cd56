"""Heading and airspeed at reports near a turn, from the legs around them.

A turn is short compared with the time between reports: near it neither a leg nor the parabola
through three fixes gives the direction of flight at the report (errors of 10 to 20 degrees). The
aircraft flies straight, makes at most one turn of constant rate within the two legs before and the
two after the report, and flies straight on. The mean air vector of a leg, ground vector minus
reported wind, then has a mean direction of both courses, weighted by when the turn began and ended.

Each pair of a begin and an end on a lattice of a quarter of a leg is a hypothesis. Initial course
and turn follow from the four legs by linear least squares; the probability of the hypothesis from
the misfit of the legs (with the determinant: the evidence of a linear model; MacKay 1992, Neural
Computation 4:415-447), from the bank it needs (ordinary turns have 15 to 25 degrees: FAA-H-8083-15B
ch. 4) and from the roll flags of the report and its neighbours (G: bank below five degrees, B:
above). Heading and standard error are mean and spread over all hypotheses. The airspeed is that of
the adjacent legs, longer than their mean vectors because these are shortened by the turn.

The error of assuming a constant rate is a share of the turn: `SHAPE`. The first and last report of
a flight have legs on one side only, and a larger error. Valid for intervals of half a minute to
some minutes; several turns within four legs are treated as one, and the misfit of the legs
increases the standard error. Units: m s-1, s, radians.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.flags import ROLL
from airswing.physics.atmosphere import GRAVITY
from airswing.physics.bank import LIMIT
from airswing.physics.triangle import wrap_signed

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

REACH = 2
"""Legs used on each side."""
NODES = 4
"""Steps of a leg at which a turn may begin or end."""
# Error of a leg's air vector in addition to that of its fixes: coded winds, gusts; m s-1.
WANDER = 0.7
# Change of direction between two legs, beyond three standard errors, that is a turn, rad.
LEAST_TURN = float(np.radians(2.0))
# Median bank of a turn, and the spread of its logarithm.
BANK, BANK_SPREAD = float(np.radians(12.0)), 0.7
WRONG_FLAG = -3.0  # Logarithm of the odds that a roll flag is wrong
TURN = float(np.radians(60.0))  # Standard deviation of turns, rad
# Prior odds that there is no turn, within a flight and at its ends.
STRAIGHT, STRAIGHT_AT_END = 1.0, 0.3
# Part of the turn by which a leg, and the heading, differ from those of a constant rate.
MISFIT, SHAPE = 0.02, 0.05
SHORTEST = 0.3  # Least length of a mean vector over the airspeed
ROWS = 128
"""Reports per block, whose arrays fit the processor's cache."""


class NearTurns(NamedTuple):
    """Headings and airspeeds with their standard errors; arrays of shape (reports near turns,)."""

    report: Index  # near a turn, or at an end of a flight
    heading: Array  # direction of the air vector, from north clockwise, rad
    airspeed: Array  # its length, m s-1
    heading_error: Array
    airspeed_error: Array


class _Legs(NamedTuple):
    """Legs from each report to the next, with the roll flags of the reports; (report,)."""

    direction: Array  # of the air vector, rad; NaN where there is none
    speed: Array  # its length, m s-1
    error: Array  # standard error of the direction, rad
    seconds: Array
    flight: Index
    roll: Index


def near_turns(
    leg: tuple[Array, Array, Array],
    wind: tuple[Array, Array],
    straight: tuple[Array, Array, Array, Array],
    seconds: Array,
    flight: NDArray[np.integer],
    *,
    roll_flag: NDArray[np.integer] | None = None,
) -> NearTurns:
    """Estimate heading and airspeed at the reports near a turn and at the ends of flights.

    Parameters
    ----------
    leg : three ndarrays, shape (report,)
        Eastward and northward mean ground velocity from each report to the next of its flight, and
        the standard error of a component, m s-1; NaN where there is none.
    wind : two ndarrays, shape (report,)
        Eastward and northward reported wind, m s-1.
    straight : four ndarrays, shape (report,)
        Eastward and northward ground velocity at each report assuming straight flight, and its
        standard errors along and across the track, m s-1.
    seconds, flight : ndarray, shape (report,)
        Ascending within a flight; number of the flight, whose reports are consecutive.
    roll_flag : ndarray of int, shape (report,), optional
        Codes of `airswing.flags.ROLL`.
    """
    size = seconds.size
    roll = np.zeros(size, np.int64) if roll_flag is None else np.asarray(roll_flag, np.int64)
    # mean air vector of each leg: ground vector minus the mean of the reported winds
    air = np.full((2, size), np.nan)
    for mean, ground, blown in zip(air, leg[:2], wind, strict=True):
        mean[:-1] = ground[:-1] - 0.5 * (blown[:-1] + blown[1:])
    speed = np.hypot(*air)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.hypot(leg[2], WANDER) / speed
    direction = np.where(np.isfinite(error), np.arctan2(*air), np.nan)
    legs = _Legs(direction, speed, error, seconds, np.asarray(flight, np.int64), roll)
    east, north = straight[0] - wind[0], straight[1] - wind[1]
    airspeed = np.hypot(east, north)
    with np.errstate(divide="ignore", invalid="ignore"):
        assumed = np.arctan2(east, north), airspeed, straight[3] / airspeed, straight[2]
    index = np.flatnonzero(_near_turn(legs) & np.isfinite(airspeed) & (airspeed > 0.0))
    if not index.size:
        return NearTurns(index, *(np.zeros(0) for _ in range(4)))
    parts = []
    for start in range(0, index.size, ROWS):
        rows = index[start : start + ROWS]
        parts.append(_estimates(rows, legs, tuple(values[rows] for values in assumed)))
    return NearTurns(index, *(np.concatenate(values) for values in zip(*parts, strict=True)))


def _near_turn(legs: _Legs) -> Mask:
    """Reports next to a bend of the path or banked, and the first and last of every flight."""
    bend = np.zeros(legs.seconds.size, bool)
    error = 3.0 * np.hypot(legs.error[1:], legs.error[:-1]) + LEAST_TURN
    change = np.abs(wrap_signed(np.diff(legs.direction)))
    bend[1:] = np.nan_to_num(change) > np.nan_to_num(error, nan=np.inf)
    near = bend.copy()
    near[1:] |= bend[:-1]
    near[:-1] |= bend[1:]
    # number of adjacent legs of each report, 0 to 2
    linked = np.isfinite(legs.direction).astype(np.int64)
    linked[1:] += linked[:-1].copy()
    return np.asarray(((near | (legs.roll == ROLL["bad"])) & (linked > 0)) | (linked == 1))


class _Window(NamedTuple):
    """The legs around some reports; leg ``REACH`` is the one that begins at the report."""

    present: Mask  # whether there is a leg, (m, 4)
    times: Array  # of the fixes since the report, (m, 5) s; a mean leg further where none is
    base: Array  # direction of a leg adjacent to the report, (m,) rad
    offset: Array  # directions from the base, turned through the legs between, (m, 4) rad
    weight: Array  # one over the variance of `offset`, (m, 4); 0 where there is no leg
    speed: Array  # (m, 4) m s-1; 0 where there is no leg
    roll: Index  # (m, 5)

    @property
    def duration(self) -> Array:
        """Durations of the legs, (m, 4) s."""
        return np.diff(self.times, axis=1)

    @property
    def turn(self) -> Array:
        """Turn between the legs, (m,) rad."""
        offset = np.where(self.present, self.offset, 0.0)
        return np.asarray(offset.max(axis=1) - offset.min(axis=1))


def _window(index: Index, legs: _Legs) -> _Window:
    size = legs.seconds.size
    at = index[:, None] + np.arange(-REACH, REACH + 1)
    fix = np.clip(at, 0, size - 1)
    same = (at == fix) & (legs.flight[fix] == legs.flight[index][:, None])
    leg = fix[:, :-1]
    there = same[:, :-1] & same[:, 1:] & np.isfinite(legs.direction[leg])
    # a leg beyond a gap is not used
    for k in range(REACH - 2, -1, -1):
        there[:, k] &= there[:, k + 1]
    for k in range(REACH + 1, 2 * REACH):
        there[:, k] &= there[:, k - 1]
    direction = np.where(there, legs.direction[leg], 0.0)
    base = np.where(there[:, REACH], direction[:, REACH], direction[:, REACH - 1])
    off = np.zeros(leg.shape)
    for side in (range(REACH, 2 * REACH), range(REACH - 1, -1, -1)):
        last, turned = base, np.zeros(index.size)
        for k in side:
            course = np.where(there[:, k], direction[:, k], last)
            turned = turned + wrap_signed(course - last)
            off[:, k], last = turned, course
    # times of the fixes relative to the report's, in steps of a mean leg without a fix
    times = legs.seconds[fix] - legs.seconds[index][:, None]
    total = np.where(there, np.diff(times, axis=1), 0.0).sum(axis=1)
    mean = total / np.maximum(there.sum(axis=1), 1)
    mean = np.where(mean > 0.0, mean, 60.0)  # s: of a single fix there is no leg
    for k in range(REACH):
        after, before = REACH + k, REACH - 1 - k
        times[:, after + 1] = np.where(there[:, after], times[:, after + 1], times[:, after] + mean)
        times[:, before] = np.where(there[:, before], times[:, before], times[:, before + 1] - mean)
    speed = np.where(there, legs.speed[leg], 0.0)
    roll = np.where(same, legs.roll[fix], ROLL["missing"])
    window = _Window(there, times, base, off, np.zeros(leg.shape), speed, roll)
    spread = np.where(there, legs.error[leg], 1.0) ** 2 + (MISFIT * window.turn[:, None]) ** 2
    return window._replace(weight=np.where(there, 1.0 / spread, 0.0))


class _Turns:
    """Hypothetical turns of a window: begin and end on the lattice, (m, h), single precision."""

    def __init__(self, window: _Window) -> None:
        self.window = window
        fraction = np.arange(NODES) / NODES
        nodes = window.times[:, :-1, None] + window.duration[:, :, None] * fraction
        nodes = np.concatenate([nodes.reshape(len(nodes), -1), window.times[:, -1:]], axis=1)
        first, last = np.triu_indices(nodes.shape[1], 1)
        # single precision: the 136 hypotheses of a report take most of the time, and a thousandth
        # of a leg is far below the resolution of begin and end
        nodes = nodes.astype(np.float32)
        self.begin, self.end = nodes[:, first], nodes[:, last]
        self.length = self.end - self.begin

    def completed(self, k: int) -> Single:
        """Part of the turn that is completed at fix `k`."""
        at = self.window.times[:, k : k + 1].astype(np.float32)
        return np.asarray(np.clip((at - self.begin) / self.length, 0.0, 1.0))

    @cached_property
    def sums(self) -> list[Single]:
        """Integral up to each fix of the completed part, and of its square, (2, m, h) s."""
        out = []
        for k in range(2 * REACH + 1):
            at = self.window.times[:, k : k + 1].astype(np.float32)
            share = self.completed(k)
            beyond = np.maximum(at - self.end, np.float32(0.0))
            integral = share * share * self.length * np.float32(0.5)
            of_square = share**3 * self.length * np.float32(1 / 3)
            out.append(np.asarray(np.stack([integral, of_square]) + beyond, np.float32))
        return out

    def means(self, leg: int) -> Single:
        """Mean and mean square over a leg of the completed part, (2, m, h)."""
        duration = self.window.duration[:, leg : leg + 1].astype(np.float32)
        return np.asarray((self.sums[leg + 1] - self.sums[leg]) / duration, np.float32)

    def banked(self, k: int, steep: NDArray[np.bool_]) -> Single:
        """Log odds of the roll flag at fix `k`, where turns are `steep` enough to set it."""
        at = self.window.times[:, k : k + 1].astype(np.float32)
        flag = self.window.roll[:, k : k + 1]
        turning = (self.begin < at) & (self.end > at) & steep
        wrong = ((flag == ROLL["good"]) & turning) | ((flag == ROLL["bad"]) & ~turning)
        return np.where(wrong, np.float32(WRONG_FLAG), np.float32(0.0))


class _Fitted(NamedTuple):
    """Course before, turn and heading of every hypothesis, and its probability; (m, h)."""

    turn: Single
    offset: Single  # heading at the report from the window's base, rad
    variance: Single  # of the heading, rad2
    probability: Single
    straight: Array  # probability of no turn, (m,)


def _fit_hypotheses(window: _Window, turns: _Turns) -> _Fitted:
    weight, off = window.weight, window.offset
    s = weight.sum(axis=1)[:, None].astype(np.float32)
    sy = (weight * off).sum(axis=1)[:, None].astype(np.float32)
    syy = (weight * off**2).sum(axis=1)[:, None].astype(np.float32)
    sg, sgy = np.zeros_like(turns.begin), np.zeros_like(turns.begin)
    # The prior of the turn is one more row of the least squares.
    sgg = np.full_like(turns.begin, 1.0 / TURN**2)
    for k in range(2 * REACH):
        share, information = turns.means(k)[0], weight[:, k : k + 1].astype(np.float32)
        weighted = information * share
        sg += weighted
        sgg += weighted * share
        sgy += weighted * off[:, k : k + 1].astype(np.float32)
    determinant = s * sgg - sg * sg
    turn = (s * sgy - sg * sy) / determinant
    before = (sgg * sy - sg * sgy) / determinant
    misfit = syy - before * sy - turn * sgy
    log = -0.5 * (misfit + np.log(determinant)) - np.float32(np.log(TURN))
    log += _prior(window, turns, turn)
    inside = window.present[:, REACH - 1] & window.present[:, REACH]
    none = -0.5 * (syy - sy * sy / s + np.log(s))[:, 0]
    none += np.log(np.where(inside, STRAIGHT, STRAIGHT_AT_END))
    flags = window.roll[:, REACH - 1 : REACH + 2] == ROLL["bad"]
    none = none + WRONG_FLAG * flags.sum(axis=1)
    # subtracted before the exponential, which would underflow
    best = np.maximum(log.max(axis=1), none)
    chance, level = np.exp(log - best[:, None]), np.exp(none - best)
    total = chance.sum(axis=1) + level
    # The heading at the report is the initial course plus the completed part of the turn; a lattice
    # step of begin and end adds a uniform error, step^2 / 12.
    done = turns.completed(REACH)
    step = (window.duration.max(axis=1, keepdims=True) / NODES).astype(np.float32)
    within = (done > 0.0) & (done < 1.0)
    lattice = np.where(within, (turn / turns.length * step) ** 2 / np.float32(12.0), 0.0)
    variance = (sgg - 2.0 * done * sg + done * done * s) / determinant + lattice
    return _Fitted(turn, before + turn * done, variance, chance / total[:, None], level / total)


def _prior(window: _Window, turns: _Turns, turn: Single) -> Single:
    number = np.maximum(window.present.sum(axis=1), 1)
    speed = (window.speed.sum(axis=1) / number)[:, None].astype(np.float32)
    bank = np.arctan(np.abs(turn) / turns.length * speed / np.float32(GRAVITY))
    # rad: zero has no logarithm; straight flight is a separate hypothesis
    usual = np.log(np.maximum(bank, np.float32(1e-3)) / np.float32(BANK)) / BANK_SPREAD
    mean = window.duration.mean(axis=1)[:, None].astype(np.float32)
    log = -0.5 * usual**2 - np.log(turns.length / mean) - np.log(turns.length.shape[1])
    steep = bank > LIMIT
    for k in range(REACH - 1, REACH + 2):
        log = log + turns.banked(k, steep)
    return np.asarray(log, dtype=np.float32)


def _estimates(index: Index, legs: _Legs, assumed: tuple[Array, ...]) -> tuple[Array, ...]:
    """Heading, airspeed and their standard errors at some reports.

    ``assumed`` holds the same four of straight flight.
    """
    window = _window(index, legs)
    turns = _Turns(window)
    fit = _fit_hypotheses(window, turns)
    straight_heading, straight_speed, straight_heading_error, straight_speed_error = assumed
    straight, turned = fit.straight, 1.0 - fit.straight
    offset = wrap_signed(straight_heading - window.base)
    mean = (fit.probability * fit.offset).sum(axis=1) + straight * offset
    variance = (fit.probability * ((fit.offset - mean[:, None]) ** 2 + fit.variance)).sum(axis=1)
    variance += straight * (straight_heading_error**2 + (offset - mean) ** 2)
    variance += (SHAPE * window.turn * turned) ** 2
    speed, speed_error = _airspeed(window, turns, fit)
    airspeed = turned * speed + straight * straight_speed
    speed_variance = turned * (speed_error**2 + (speed - airspeed) ** 2)
    speed_variance += straight * (straight_speed_error**2 + (straight_speed - airspeed) ** 2)
    heading = np.mod(window.base + mean, 2.0 * np.pi)
    return heading, airspeed, np.sqrt(variance), np.sqrt(speed_variance)


def _airspeed(window: _Window, turns: _Turns, fit: _Fitted) -> tuple[Array, Array]:
    """Airspeed of the adjacent legs where there is a turn, and its standard error.

    The mean of a unit vector that turns is shorter than one by half the variance of its direction.
    """
    turned = np.maximum(1.0 - fit.straight, 1e-6)  # straight flight: not used
    total, share, doubt = (np.zeros(len(turned)) for _ in range(3))
    lengths: list[Array] = []
    for k in (REACH - 1, REACH):
        mean, square = turns.means(k)
        short = 1.0 - 0.5 * fit.turn**2 * np.maximum(square - mean**2, 0.0)
        longer = 1.0 / np.maximum(short, SHORTEST)
        factor = (fit.probability * longer).sum(axis=1) / turned
        spread = (fit.probability * (longer - factor[:, None]) ** 2).sum(axis=1) / turned
        weight = np.where(window.present[:, k], 1.0 / window.duration[:, k], 0.0)
        total += weight * window.speed[:, k] * factor
        doubt += weight * (window.speed[:, k] ** 2 * spread + WANDER**2)
        share += weight
        lengths.append(np.where(window.present[:, k], window.speed[:, k] * factor, np.nan))
    speed = total / share
    change = np.nan_to_num(lengths[1] - lengths[0])  # acceleration, at an unknown time
    # uniform over the change: a twelfth of its square
    return speed, np.sqrt(doubt / share + change**2 / 12.0)
