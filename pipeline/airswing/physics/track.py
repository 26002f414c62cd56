"""Ground velocity at each report, from the fixes of the same flight before and after it.

Reports are ordered by flight and time. Positions and times are rounded to a known resolution:
uniform errors, independent between fixes, of variance resolution^2 / 12. (A time *cut* to the
minute shifts every fix by half a minute on average; that cancels in a velocity.) Between fixes the
velocity varies as a random walk of spectral density ``acceleration_density`` per component: 0.02
m2 s-3, which is the 1.8 m2 s-2 that upper-air winds change by over the 20 km of three minutes'
flight (Lindborg 1999, J. Fluid Mech. 388:259-288), with a margin for speed changes.

A chord between two fixes is the velocity at its middle, and reports are at its ends. The velocity
at a fix is therefore the derivative of the parabola through it and one fix on each side: the two
chords, each weighted by the other's duration, with geodesic distances (Karney 2013, J. Geodesy
87:43-55) and the azimuths of both geodesics *at the shared fix*. For close or coarsely timed fixes
the neighbours are noisy: then of all windows reaching 1, 2, 3, 4, 6, 9 or 13 fixes back and forward
the one with the least expected error (rounding plus random walk) is used; no window reaches past a
fix where the track bends. At the ends of a flight there is a single chord; its larger random-walk
error is in its standard error.

Valid for any longitude, not at a pole. Chords with no duration, longer than `MAX_GAP` or faster
than 400 m/s are rejected and divide the flight; a report without chord has no value (NaN). Degrees
for position, seconds, metres; velocities m s-1; angles in results radians.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Geod

from airswing.physics.atmosphere import GRAVITY
from airswing.physics.triangle import bearing, vector_from_bearing, wrap_signed
from airswing.units import METRES_PER_DEGREE

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

MAX_GROUND_SPEED = 400.0  # m s-1: above any aircraft that reports winds
MAX_GAP = 1800.0  # Seconds: over half an hour an aircraft may have turned and turned back
ACCELERATION_DENSITY = 0.02
"""m2 s-3 per component."""
# Radians: a change of track by more, beyond three standard errors, is a turn.
BEND = np.radians(5.0)
ARMS = (1, 2, 3, 4, 6, 9, 13)  # Fixes a window may reach, each way

_WGS84 = Geod(ellps="WGS84")


class GroundTrack(NamedTuple):
    """Motion over ground at each report; every array has shape (report,), NaN where unknown."""

    eastward: Array  # ground velocity, m s-1
    northward: Array
    # Standard errors along and across the track, m s-1: rounding of positions (both) and times
    # (along), and the random walk of the velocity inside the window.
    along_error: Array
    cross_error: Array
    # Change of track between the two chords, radians, positive to the right; of speed, over the
    # time between their middles, m s-2.
    turn: Array
    longitudinal_acceleration: Array
    climb_rate: Array  # m s-1
    bank: Array  # of a coordinated turn at that rate of turn, radians, positive to the right
    # Number of fixes that the window reaches back and forward; 0 on the missing side of a flight's
    # end, and both 0 where there is no value.
    before: NDArray[np.int8]
    after: NDArray[np.int8]
    # Mean ground velocity from each report to the next of its flight, in the directions at the
    # middle of that leg, m s-1; NaN where there is no valid chord; and the standard error of a
    # component across the leg, from the rounding of positions.
    leg_eastward: Array
    leg_northward: Array
    leg_error: Array


class _Fixes(NamedTuple):
    """The reports as fixes, with the chord from each to the next (last entry: none)."""

    latitude: Array
    longitude: Array
    seconds: Array
    altitude: Array
    position_variance: Array  # m2, mean of the two components
    time_variance: Array  # s2
    distance: Array  # of the chord to the next fix, m
    forward: Array  # its azimuth at this fix, radians
    backward: Array  # azimuth at the next fix back to this one, radians
    duration: Array  # of the chord to the next fix, s
    segment: Index  # number of the unbroken run of fixes


def ground_track(
    latitude: ArrayLike,
    longitude: ArrayLike,
    seconds: ArrayLike,
    altitude: ArrayLike,
    flight: ArrayLike,
    *,
    position_step: ArrayLike,
    time_step: ArrayLike,
    acceleration_density: float = ACCELERATION_DENSITY,
    widen: bool = True,
) -> GroundTrack:
    """Ground velocity at every report of an archive, with its standard error.

    Parameters
    ----------
    latitude, longitude, seconds, altitude, flight : array_like, shape (report,)
        Degrees; since any fixed instant, ascending within a flight; pressure altitude, m; number of
        the flight, whose reports are consecutive.
    position_step, time_step : array_like, scalar or shape (report,)
        Resolution of the positions (degrees) and of the times (s); NaN counts as zero.
    acceleration_density : float
        Spectral density of each component's acceleration, m2 s-3.
    widen : bool
        Whether windows may reach past the neighbouring fixes where that lowers the error.

    References
    ----------
    Jacobs et al. 2010 step a, with the chords centred at the report.
    """
    lat, lon, when, height = (
        np.asarray(value, dtype=np.float64).reshape(-1)
        for value in (latitude, longitude, seconds, altitude)
    )
    step, tick = (
        np.broadcast_to(np.nan_to_num(np.asarray(value, np.float64)), lat.shape)
        for value in (position_step, time_step)
    )
    fixes = _make_fixes(lat, lon, when, height, np.asarray(flight).reshape(-1), step, tick)
    # the plain window: one fix each way, none where there is no chord of any duration
    linked = _same_run(fixes.segment, 1)
    after = (linked & (fixes.duration > 0.0)).astype(np.int64)
    before = np.zeros_like(after)
    before[1:] = after[:-1]
    # a fix at the same time as its neighbour has no plain window
    stuck = linked & (fixes.duration == 0.0)
    stuck[1:] |= stuck[:-1].copy()
    before[stuck], after[stuck] = 0, 0
    if widen:
        _widen(fixes, before, after, acceleration_density)
    return _motion(fixes, before, after, acceleration_density)


def _make_fixes(
    lat: Array,
    lon: Array,
    when: Array,
    height: Array,
    number: NDArray[np.integer],
    step: Array,
    tick: Array,
) -> _Fixes:
    distance, forward, backward, duration = (np.full(lat.shape, np.nan) for _ in range(4))
    placed = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(when)
    # only chords within a flight: geodesics take most of the time
    pair = np.flatnonzero((number[1:] == number[:-1]) & placed[1:] & placed[:-1])
    forward[pair], backward[pair], distance[pair] = _geodesic(lat, lon, pair, pair + 1)
    duration[:-1] = np.diff(when)
    # rounding may change the duration by one step and the distance by two
    slack = 2.0 * METRES_PER_DEGREE * step
    # zero is valid: two reports of one minute are in one run, although without a chord
    sound = (duration >= 0.0) & (duration <= MAX_GAP)
    sound &= distance - slack <= MAX_GROUND_SPEED * (duration + np.where(tick > 1.0, tick, 0.0))
    segment = np.concatenate([[0], np.cumsum(~sound[:-1])]) if lat.size else np.zeros(0)
    # A step of longitude is shorter by the cosine: the mean variance of the two components.
    shrink = (1.0 + np.cos(np.radians(lat)) ** 2) / 2.0
    return _Fixes(
        lat,
        lon,
        when,
        height,
        # rounding to steps is uniform over a step, whose variance is a twelfth of its square
        (METRES_PER_DEGREE * step) ** 2 / 12.0 * shrink,
        tick**2 / 12.0,
        distance,
        forward,
        backward,
        duration,
        segment.astype(np.int64),
    )


def _geodesic(lat: Array, lon: Array, start: Index, end: Index) -> tuple[Array, Array, Array]:
    """Azimuth at the first point, azimuth at the second back to the first, and distance."""
    away, back, length = _WGS84.inv(lon[start], lat[start], lon[end], lat[end])
    return np.radians(away), np.radians(back), np.asarray(length, dtype=np.float64)


def _same_run(segment: Index, offset: int) -> Mask:
    there = np.arange(segment.size) + offset
    inside = (there >= 0) & (there < segment.size)
    return np.asarray(inside & (segment.take(there, mode="clip") == segment))


def _variances(before: Array, after: Array, density: float) -> tuple[Array, Array]:
    """Noise gain (s-2) and random walk (m2 s-2) of a window with these arms in seconds; 0 = none.

    The parabola's derivative weighs the fixes by -b/(a(a+b)), (b-a)/(ab), a/(b(a+b)) for arms a, b.
    A random walk's mean over a chord differs from its end by density * duration / 3.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        total = before + after
        weights = (
            before / (after * total),
            (after - before) / (before * after),
            after / (before * total),
        )
        centred = weights[0] ** 2 + weights[1] ** 2 + weights[2] ** 2
        single = 2.0 / total**2
        two_sided = (before > 0.0) & (after > 0.0)
        gain = np.where(two_sided, centred, single)
        wander = density / 3.0 * np.where(two_sided, before * after / total, total)
    moving = total > 0.0
    return np.where(moving, gain, np.inf), np.where(moving, wander, 0.0)


def _local_speed(fixes: _Fixes) -> Array:
    """Path over elapsed time in the widest window, for the variance; NaN where unknown."""
    reach = ARMS[-1]
    index = np.arange(fixes.seconds.size)
    first = np.searchsorted(fixes.segment, fixes.segment, side="left")
    last = np.searchsorted(fixes.segment, fixes.segment, side="right") - 1
    start, stop = np.maximum(index - reach, first), np.minimum(index + reach, last)
    # whole millimetres: the sum is exact, so that it does not depend on the flights before
    steps = np.rint(1e3 * np.nan_to_num(fixes.distance)).astype(np.int64)
    path = np.concatenate([[0], np.cumsum(steps)])
    elapsed = fixes.seconds[stop] - fixes.seconds[start]
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = 1e-3 * (path[stop] - path[start]) / elapsed
    return np.asarray(np.where(elapsed > 0.0, np.minimum(speed, MAX_GROUND_SPEED), np.nan))


def _bends(fixes: _Fixes) -> Index:
    """Running count of fixes, up to and with each, where the track bends beyond its error."""
    bend = np.zeros(fixes.seconds.size, dtype=bool)
    middle = np.flatnonzero(_same_run(fixes.segment, 1) & _same_run(fixes.segment, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = 1.0 / fixes.distance[middle - 1], 1.0 / fixes.distance[middle]
        variance = fixes.position_variance[middle] * ((a + b) ** 2 + a**2 + b**2)
        change = wrap_signed(fixes.forward[middle] - fixes.backward[middle - 1] - np.pi)
        bend[middle] = np.abs(change) > BEND + 3.0 * np.sqrt(variance)
    return np.cumsum(bend)


def _widen(fixes: _Fixes, before: Index, after: Index, density: float) -> None:
    """Widen the windows that then have a lower expected variance of the velocity (in place)."""
    speed = _local_speed(fixes)
    # an error of time moves a fix only along the track: a component has half of its variance
    noise = fixes.position_variance + 0.5 * speed**2 * fixes.time_variance
    everyone, when = np.arange(fixes.seconds.size), fixes.seconds
    gain, wander = _variances(
        when - when[everyone - before], when[everyone + after] - when, density
    )
    # rounding falls as 1/t^2, the random walk grows as t: below this the plain window is the best
    rows = np.flatnonzero(np.isfinite(noise) & (noise * gain > 0.5 * wander))
    bends = _bends(fixes)
    # a report in the middle of a bend keeps its plain window: a wider one would cut the corner
    straight = bends[rows] == bends[np.maximum(rows - 1, 0)]
    best = noise[rows] * gain[rows] + wander[rows]
    centred = (before[rows] > 0) & (after[rows] > 0)
    behind = {arm: _reachable(fixes, bends, rows, -arm) for arm in ARMS}
    ahead = {arm: _reachable(fixes, bends, rows, arm) for arm in ARMS}
    anyone = np.ones(rows.size, dtype=bool)
    # single chords first: any centred window then replaces them
    for back, front in sorted(product((0, *ARMS), repeat=2), key=lambda arms: min(arms) > 0):
        two_sided = back > 0 and front > 0
        allowed = behind.get(back, anyone) & ahead.get(front, anyone)
        allowed &= straight if max(back, front) > 1 else anyone
        place = np.flatnonzero(allowed if two_sided else allowed & ~centred)
        arm_1 = when[rows[place]] - when[rows[place] - back]
        arm_2 = when[rows[place] + front] - when[rows[place]]
        gain, wander = _variances(arm_1, arm_2, density)
        cost = noise[rows[place]] * gain + wander
        timed = (arm_1 > 0.0) & (arm_2 > 0.0) if two_sided else arm_1 + arm_2 > 0.0
        # a centred window replaces a chord to one side at any cost: the chord lags
        better = timed & ((cost < best[place]) | (two_sided & ~centred[place]))
        place = place[better]
        best[place], centred[place] = cost[better], two_sided
        before[rows[place]], after[rows[place]] = back, front


def _reachable(fixes: _Fixes, bends: Index, rows: Index, offset: int) -> Mask:
    """Whether the fix at an offset is in the same run with no bend strictly between."""
    reachable = _same_run(fixes.segment, offset)[rows]
    if abs(offset) > 1:
        low, high = (rows, rows + offset - 1) if offset > 0 else (rows + offset, rows - 1)
        reachable &= bends.take(high, mode="clip") == bends.take(low, mode="clip")
    return reachable


def _motion(fixes: _Fixes, before: Index, after: Index, density: float) -> GroundTrack:
    east_1, north_1, climb_1, arm_1 = _chord(fixes, before, -1)
    east_2, north_2, climb_2, arm_2 = _chord(fixes, after, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Parabola through three fixes: each chord counts by the other's duration.
        share = np.select([before == 0, after == 0], [0.0, 1.0], arm_2 / (arm_1 + arm_2))
    east, north, climb = (
        # of two chords either may be absent
        np.select([share == 1.0, share == 0.0], [back, front], share * back + (1.0 - share) * front)
        for back, front in ((east_1, east_2), (north_1, north_2), (climb_1, climb_2))
    )
    gain, wander = _variances(arm_1, arm_2, density)
    with np.errstate(invalid="ignore"):
        cross = gain * fixes.position_variance + wander
        # An error of time moves a fix along the track by the speed, and not across it.
        along = cross + gain * (east**2 + north**2) * fixes.time_variance
    centred = (before > 0) & (after > 0)
    # between the middles of the two chords
    interval = np.where(centred, 0.5 * (arm_1 + arm_2), np.nan)
    turn = wrap_signed(bearing(east_2, north_2) - bearing(east_1, north_1))
    speed_1, speed_2 = np.hypot(east_1, north_1), np.hypot(east_2, north_2)
    rate = np.hypot(east, north) * turn / interval
    # Legs to the next fix. A geodesic's azimuth changes on the way (convergence of meridians): the
    # middle has half of it.
    sound = _same_run(fixes.segment, 1) & (fixes.duration > 0.0)
    bend = wrap_signed(fixes.backward + np.pi - fixes.forward)
    with np.errstate(divide="ignore", invalid="ignore"):
        leg_speed = np.where(sound, fixes.distance / fixes.duration, np.nan)
        leg_error = np.sqrt(2.0 * fixes.position_variance) / fixes.duration
    return GroundTrack(
        east,
        north,
        np.sqrt(np.where(np.isfinite(east), along, np.nan)),
        np.sqrt(np.where(np.isfinite(east), cross, np.nan)),
        turn,
        (speed_2 - speed_1) / interval,
        climb,
        np.arctan(rate / GRAVITY),
        before.astype(np.int8),
        after.astype(np.int8),
        *vector_from_bearing(leg_speed, fixes.forward + 0.5 * bend),
        np.where(sound, leg_error, np.nan),
    )


def _chord(fixes: _Fixes, reach: Index, side: int) -> tuple[Array, Array, Array, Array]:
    """Velocity and climb (m s-1) along the chord on one side, in the directions at the report.

    NaN where there is no chord; last comes its duration, s, then 0.
    """
    size = fixes.seconds.size
    distance, azimuth = (np.full(size, np.nan) for _ in range(2))
    # chords to the next fix are known; only wider windows need a geodesic
    rows = np.flatnonzero(reach == 1)
    if side > 0:
        distance[rows], azimuth[rows] = fixes.distance[rows], fixes.forward[rows]
    else:
        distance[rows], azimuth[rows] = fixes.distance[rows - 1], fixes.backward[rows - 1]
    rows = np.flatnonzero(reach > 1)
    azimuth[rows], _, distance[rows] = _geodesic(
        fixes.latitude, fixes.longitude, rows, rows + side * reach[rows]
    )
    everyone = np.arange(size)
    # a reach of zero has no chord: zero over zero is NaN
    there = everyone + side * reach
    duration = side * (fixes.seconds[there] - fixes.seconds)
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = side * distance / duration
        climb = side * (fixes.altitude[there] - fixes.altitude) / duration
    east, north = vector_from_bearing(speed, azimuth)
    return east, north, climb, np.where(reach > 0, duration, 0.0)
