"""Robust joint fit of one aircraft to one reference or a pool of them.

Assumes the vector equation of :mod:`airswing.compass.fit.normal_equations`. A pool's fit uses the
observations of all its members, each with a bias b and a scatter of its own; flights (and days) as
clusters answer for the members sharing the aircraft's own errors. Valid where a few flights or more
are there; :mod:`airswing.compass.fit.deviation` decides what to publish.

The steps: a start from a thin sample of the reports (two steps at least, a new scatter each), one
from a larger sample with its first scatter held, then full passes with that scatter, until a step
is below three standard errors (clustered): one pass where reports are many.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airswing.compass.fit.normal_equations import (
    COMPASS,
    PassSums,
    Scatter,
    accumulate,
)
from airswing.compass.fit.observations import Observations, Reports
from airswing.compass.fit.sandwich import (
    MANY,
    Array,
    Index,
    degrees_of_freedom,
    group_sums,
    influences,
    inverse_root,
)
from airswing.compass.fleet.flight_segments import (
    SLOPES,
    Blocks,
    Edges,
    Places,
    duration_of,
    find_edges,
    make_blocks,
    speed_counts,
)
from airswing.units import Picked

THIN, MIDDLE = 1000, 4000
"""Reports a start takes: first to find the place, then to be near enough for one full pass."""
# Standard errors of the sample (reports taken as independent) that end a start: Newton's step with
# robust weights leaves two or three hundredths of itself, less than the sample is off.
START_STEP = 15.0
# Standard errors (clustered) that end the full passes: the estimate is settled to a tenth of its
# error or better.
FINAL_STEP = 3.0
# Bounds alone: steps on few reports and passes over all end as soon as a step is small.
START_STEPS, PASSES = 25, 12
ENOUGH = 2e-6
"""Radians: a smaller step is rounding in single precision."""


@dataclass(frozen=True)
class AircraftFit:
    """One aircraft's fit before the fleet is looked at; radians and m/s."""

    theta: Array  # A, B, C, D, E, s, then b_u, b_v of every member, (p,)
    free: Index  # which of them were fitted; the others are zero
    normal: Array  # of all p, (p, p)
    kappa: float  # mean slope of the robust score (Huber): steps and spreads are divided by it
    flight: Array  # influence of every flight, (flights, p)
    day: Array  # and of every day, (days, p)
    day_number: Index  # days since 1970, (days,)
    freedom: Array  # degrees of freedom of every coefficient's standard error, (p,)
    converged: bool
    rms_before: float  # robust rms of the heading error without and with the curve, radians
    rms_after: float
    flight_order: Index = field(repr=False)  # order in time of the rows of ``flight``
    # One for each reference: sums by block where their places were given, its scatter as the last
    # pass took it, seconds a block of its reports lasts.
    blocks: list[Blocks] = field(repr=False, default_factory=list)
    scatters: list[Scatter] = field(repr=False, default_factory=list)
    durations: list[int] = field(repr=False, default_factory=list)

    @cached_property
    def covariance(self) -> Array:
        """Clustered by flight."""
        return np.asarray(self.flight.T @ self.flight)

    @cached_property
    def day_covariance(self) -> Array:
        """Clustered by day."""
        return np.asarray(self.day.T @ self.day)


def fit_aircraft(
    members: list[Reports],
    flight_day: NDArray[np.integer],
    *,
    joint: bool = True,
    harmonics: int = 2,
    places: list[Places] | None = None,
) -> AircraftFit | None:
    """Fit A..E, airspeed scale and reference bias of one aircraft.

    Parameters
    ----------
    members : list of Reports
        One for each reference of the pool; flights numbered alike in all.
    flight_day : array of int, shape (flights,)
        Day on which each flight began.
    joint : bool
        Fit along and cross components together; else the heading error alone.
    harmonics : int
        1 or 2 cycles; 0: A and the airspeed scale alone, the bias zero.
    places : list of Places, optional
        Of the reports of every member: keeps the sums the fleet's part of the fit is made from.

    Returns
    -------
    AircraftFit or None
        None where there is no report at all, or none near any curve.
    """
    if not members or not all(obs.size for obs in members):
        return None
    members, places = in_order(members, places)
    durations = [duration_of(speed_counts(obs.airspeed)) for obs in members]
    edges = edges_of(members, places, durations)
    size = COMPASS + 1 + 2 * len(members)
    compass = np.arange(1 + 2 * harmonics)
    # on one heading a bias cannot be told from the constant: the fleet's is taken off afterwards
    last = size if harmonics else COMPASS + 1
    free = np.concatenate([compass, np.arange(COMPASS, last)]) if joint else compass
    flights = flight_day.size
    days = days_of(flight_day)
    theta = np.zeros(size)
    middle = [obs.take(slice(None, None, max(obs.size // MIDDLE, 1))) for obs in members]
    thin = [obs.take(slice(None, None, max(obs.size // THIN, 1))) for obs in middle]
    theta, _ = _start(thin, theta, free, joint, False)
    theta, scatters = _start(middle, theta, free, joint, True)
    by_flight = min(flights, days[0].size) < MANY
    for _ in range(PASSES):
        parts = [
            accumulate(
                obs,
                local(theta, k),
                scatters[k],
                flights,
                joint=joint,
                by_flight=by_flight,
                starts=edges[k].start if edges else None,
            )
            for k, obs in enumerate(members)
        ]
        normal, score, kappa = joined(parts, size)
        # Newton's step with robust weights: the mean slope of the score in place of each
        # report's.
        step = solve(normal[np.ix_(free, free)], score[free]) / kappa
        theta[free] += step
        converged = bool(
            np.all(np.abs(step) <= FINAL_STEP * spread_of(normal, parts, free, kappa) + ENOUGH)
        )
        if converged:
            break
    if not any(part.weight for part in parts):
        return None  # few reports on few headings led the curve so far that none is near it
    move = np.zeros(size)
    move[free] = step
    blocks = [
        make_blocks(
            part.block, part.square, edge, place, (theta - move)[bias_of(k)], move[:SLOPES], kappa
        )
        for k, (part, edge, place) in enumerate(zip(parts, edges, places or [], strict=False))
        if part.block is not None
    ]
    found = finish(theta, free, normal, kappa, parts, days, converged, by_flight)
    return replace(found, blocks=blocks, scatters=scatters, durations=durations)


def in_order(
    members: list[Reports], places: list[Places] | None
) -> tuple[list[Reports], list[Places] | None]:
    """Reports flight by flight and, where their times are known, in the order of time."""
    if places is None:
        return [obs.sorted() for obs in members], None
    ordered = []
    for obs, place in zip(members, places, strict=True):
        order = np.lexsort((place.time, obs.flight)) if not obs.in_order else None
        ordered.append((obs, place) if order is None else (obs.at(order), place.at(order)))
    return [one for one, _ in ordered], [one for _, one in ordered]


def edges_of(
    members: list[Reports], places: list[Places] | None, durations: list[int]
) -> list[Edges]:
    """Where the blocks of every member begin; none where no places are known."""
    return [
        find_edges(obs.flight, place.time, seconds)
        for obs, place, seconds in zip(members, places or [], durations, strict=False)
    ]


def days_of(flight_day: NDArray[np.integer]) -> tuple[Index, Index]:
    """Days flown, and the place of each flight's day among them."""
    day = np.asarray(flight_day, dtype=np.int64)
    if np.any(day[1:] < day[:-1]):
        number, place = np.unique(day, return_inverse=True)
        return number, place
    new = np.ones(day.size, dtype=np.bool_)
    np.not_equal(day[1:], day[:-1], out=new[1:])
    return day[new], np.cumsum(new) - 1


def spread_of(normal: Array, parts: list[PassSums], free: Index, kappa: float) -> Array:
    """Standard errors clustered by flight, as good as a stopping rule needs."""
    score = _flight_score(parts, normal.shape[0])[:, _kept(free, normal.shape[0])]
    square = normal[np.ix_(free, free)]
    half = solve(square, score.T @ score)
    return np.asarray(np.sqrt(np.maximum(np.diagonal(solve(square, half.T)), 0.0)) / kappa)


def _kept(free: Index, size: int) -> Picked:
    """Places of the free parameters; all of them as a slice, which copies nothing."""
    return slice(None) if free.size == size else free


def _flight_score(parts: list[PassSums], size: int) -> Array:
    """Score by flight of every parameter, all members together."""
    if len(parts) == 1:
        return parts[0].flight_score
    score = np.zeros((parts[0].flight_score.shape[0], size))
    for k, part in enumerate(parts):
        score[:, _place_of(k)] += part.flight_score
    return score


def local(theta: Array, member: int) -> Array:
    """Parameters of one member's passes: A to E, the airspeed scale, its own bias."""
    return np.concatenate([theta[: COMPASS + 1], theta[bias_of(member)]])


def bias_of(member: int) -> Index:
    """Places of a member's bias among all parameters."""
    return COMPASS + 1 + 2 * member + np.arange(2)


def _place_of(member: int) -> Index:
    """Places of a member's parameters among all."""
    return np.concatenate([np.arange(COMPASS + 1), bias_of(member)])


def _start(
    few: list[Observations], theta: Array, free: Index, joint: bool, hold: bool
) -> tuple[Array, list[Scatter]]:
    theta = theta.copy()
    scatters: list[Scatter] = []
    square = np.ix_(free, free)
    for number in range(START_STEPS):
        known = scatters if hold and scatters else [None] * len(few)
        parts = [
            accumulate(obs, local(theta, k), one, 0, joint=joint, parted=hold)
            for k, (obs, one) in enumerate(zip(few, known, strict=True))
        ]
        scatters = [part.scatter for part in parts if part.scatter]
        normal, score, kappa = joined(parts, theta.size)
        # far from the place most reports lie beyond the cut, kappa is small and the step would
        # overshoot
        step = solve(normal[square], score[free]) / max(kappa, 0.6)
        theta[free] += step
        small = np.all(np.abs(step) * np.sqrt(np.diagonal(normal)[free]) < START_STEP)
        if small and (hold or number):
            break
    return theta, scatters


def joined(parts: list[PassSums], size: int) -> tuple[Array, Array, float]:
    """Normal matrix and score of all parameters, and the mean slope over the mean weight."""
    normal, score = parts[0].normal, parts[0].score
    if len(parts) > 1:
        normal, score = np.zeros((size, size)), np.zeros(size)
        for k, part in enumerate(parts):
            place = _place_of(k)
            normal[np.ix_(place, place)] += part.normal
            score[place] += part.score
    weight = sum(part.weight for part in parts)
    slope = sum(part.slope for part in parts)
    # normal errors give about 0.8; where nearly all reports are gross it would pass through zero
    return normal, score, max(slope / weight, 0.2) if weight > 0 else 1.0


def solve(normal: Array, score: Array) -> Array:
    """Solve symmetric equations, their columns brought to one size."""
    # a parameter that no report tells has a diagonal of nil
    scale = np.sqrt(np.maximum(normal.diagonal(), 1e-30))
    square = normal / (scale * scale[:, np.newaxis])
    # at unit diagonal: keeps a parameter no report tells of solvable, and moves no other
    square.flat[:: scale.size + 1] += 1e-9
    return np.asarray((np.linalg.solve(square, (score.T / scale).T).T / scale).T)


def finish(
    theta: Array,
    free: Index,
    normal: Array,
    kappa: float,
    parts: list[PassSums],
    days: tuple[Index, Index],
    converged: bool,
    by_flight: bool,
) -> AircraftFit:
    """Make the fit of what its last pass left."""
    day_number, day = days
    size, flights = theta.size, day.size
    score = _flight_score(parts, size)
    normals = np.zeros((flights, size, size)) if by_flight else None
    for k, part in enumerate(parts):
        place = _place_of(k)
        if normals is not None and part.flight_normal is not None:
            normals[:, place[:, np.newaxis], place] += part.flight_normal
    square = normal[np.ix_(free, free)]
    kept = _kept(free, size)
    # At the solution scores sum to zero but for the last step: their mean is taken off.
    score = score[:, kept] - score[:, kept].mean(axis=0)
    root = inverse_root(square)
    if normals is not None:
        normals = normals[:, free[:, np.newaxis], free]
    day_normals = None if normals is None else group_sums(normals, day, day_number.size)
    by_day = group_sums(score, day, day_number.size)
    influence = [
        influences(score, root, normals, kappa),
        influences(by_day, root, day_normals, kappa),
    ]
    if free.size < size:
        for k, own in enumerate(influence):
            influence[k] = np.zeros((own.shape[0], size))
            influence[k][:, free] = own
    freedom = np.full(size, np.inf)
    freedom[free] = degrees_of_freedom(square, normals, flights)
    weight = sum(part.weight for part in parts) or 1.0
    return AircraftFit(
        theta,
        free,
        normal,
        kappa,
        influence[0],
        influence[1],
        day_number,
        freedom,
        converged,
        float(np.sqrt(sum(part.before2 for part in parts) / weight)),
        float(np.sqrt(sum(part.after2 for part in parts) / weight)),
        np.argsort(day, kind="stable"),
    )
