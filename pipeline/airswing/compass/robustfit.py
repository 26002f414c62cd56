"""Robust joint fit of one aircraft to one reference or a pool of them.

Assumes the vector equation of :mod:`airswing.compass.kernel`. A pool's fit uses the observations
of all its members, each with a bias b and a scatter of its own; flights (and days) as clusters
answer for the members sharing the aircraft's own errors. Valid where a few flights or more are
there; :mod:`airswing.compass.deviation` decides what to publish.

The steps: a start from a thin sample of the reports (a new scatter each step), then full passes
with the scatter held, until a step is below a tenth of the smallest standard error.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airswing.compass.clusters import (
    MANY,
    Array,
    Index,
    degrees_of_freedom,
    group_sums,
    influences,
)
from airswing.compass.kernel import (
    COMPASS,
    Observations,
    PassSums,
    Scatter,
    accumulate,
    robust_scatter,
)

THIN = 1500
START_STEPS, PASSES = 25, 12
ENOUGH = 2e-6
"""Radians: a smaller step is rounding in single precision."""


@dataclass(frozen=True)
class AircraftFit:
    """One aircraft's fit before the fleet is looked at; radians and m/s.

    Attributes
    ----------
    theta : array, shape (p,)
        A, B, C, D, E, s, then b_u, b_v of every member.
    free : array of int
        Which of them were fitted; the others are zero.
    normal : array, shape (p, p)
    kappa : float
    flight, day : array, shape (flights | days, p)
        Influence of every cluster.
    day_number : array of int, shape (days,)
        Days since 1970 of the rows of ``day``.
    freedom : array, shape (p,)
    score_by_day, normal_by_day : array
        For halves and for adding months.
    converged : bool
    rms_before, rms_after : float
        Robust rms of the heading error before and after the curve, radians.
    """

    theta: Array
    free: Index
    normal: Array
    kappa: float
    flight: Array
    day: Array
    day_number: Index
    freedom: Array
    converged: bool
    rms_before: float
    rms_after: float
    flight_order: Index = field(repr=False)

    @property
    def covariance(self) -> Array:
        """Clustered by flight."""
        return np.asarray(self.flight.T @ self.flight)


def fit_aircraft(
    members: list[Observations],
    flight_day: NDArray[np.integer],
    *,
    joint: bool = True,
    harmonics: int = 2,
) -> AircraftFit | None:
    """Fit A..E, airspeed scale and reference bias of one aircraft.

    Parameters
    ----------
    members : list of Observations
        One for each reference of the pool; flights numbered alike in all.
    flight_day : array of int, shape (flights,)
        Day on which each flight began.
    joint : bool
        Fit along and cross components together; else the heading error alone.
    harmonics : int
        1 or 2 cycles.

    Returns
    -------
    AircraftFit or None
        None where there is no report at all.
    """
    members = [obs for obs in members] if all(obs.flight.size for obs in members) else []
    if not members:
        return None
    size = COMPASS + 1 + 2 * len(members)
    compass = np.arange(1 + 2 * harmonics)
    free = np.concatenate([compass, np.arange(COMPASS, size)]) if joint else compass
    flights = flight_day.size
    theta, scatters = _start(members, free, size, flights, joint)
    by_flight = min(flights, np.unique(flight_day).size) < MANY
    for step_number in range(PASSES):
        last = step_number > 0
        parts = [accumulate(obs, _local(theta, k), scatters[k], flights, joint=joint,
                            by_flight=by_flight and last)
                 for k, obs in enumerate(members)]
        normal, score, kappa = _joined(parts, size)
        step = _solve(normal[np.ix_(free, free)], score[free]) / kappa
        theta[free] += step
        naive = np.sqrt(np.diagonal(np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)))
        converged = bool(np.all(np.abs(step) <= 0.1 * naive + ENOUGH))
        if converged and last:
            break
    return _finish(theta, free, normal, kappa, parts, flight_day, converged, by_flight)


def _local(theta: Array, member: int) -> Array:
    return np.concatenate([theta[:COMPASS + 1], theta[_bias(member)]])


def _bias(member: int) -> Index:
    return COMPASS + 1 + 2 * member + np.arange(2)


def _place(member: int) -> Index:
    return np.concatenate([np.arange(COMPASS + 1), _bias(member)])


def _start(
    members: list[Observations], free: Index, size: int, flights: int, joint: bool
) -> tuple[Array, list[Scatter]]:
    thin = [obs.take(slice(None, None, max(obs.flight.size // THIN, 1))) for obs in members]
    theta = np.zeros(size)
    for _ in range(START_STEPS):
        scatters = [robust_scatter(obs, _local(theta, k), joint=joint)
                    for k, obs in enumerate(thin)]
        parts = [accumulate(obs, _local(theta, k), scatters[k], flights, joint=joint)
                 for k, obs in enumerate(thin)]
        normal, score, _ = _joined(parts, size)
        square = normal[np.ix_(free, free)]
        step = _solve(square, score[free])
        theta[free] += step
        if np.all(np.abs(step) * np.sqrt(np.diagonal(square)) < 0.3):
            break
    return theta, [robust_scatter(obs, _local(theta, k), joint=joint)
                   for k, obs in enumerate(thin)]


def _joined(parts: list[PassSums], size: int) -> tuple[Array, Array, float]:
    normal, score = np.zeros((size, size)), np.zeros(size)
    for k, part in enumerate(parts):
        place = _place(k)
        normal[np.ix_(place, place)] += part.normal
        score[place] += part.score
    weight = sum(part.weight for part in parts)
    slope = sum(part.slope for part in parts)
    return normal, score, max(slope / weight, 0.2) if weight > 0 else 1.0


def _solve(normal: Array, score: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diagonal(normal), 1e-30))
    square = normal / np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
    return np.asarray(np.linalg.solve(square, score / scale) / scale)


def _finish(
    theta: Array,
    free: Index,
    normal: Array,
    kappa: float,
    parts: list[PassSums],
    flight_day: NDArray[np.integer],
    converged: bool,
    by_flight: bool,
) -> AircraftFit:
    size, flights = theta.size, flight_day.size
    score = np.zeros((flights, size))
    normals = np.zeros((flights, size, size)) if by_flight else None
    for k, part in enumerate(parts):
        place = _place(k)
        score[:, place] += part.flight_score
        if normals is not None and part.flight_normal is not None:
            normals[:, place[:, np.newaxis], place] += part.flight_normal
    day_number, day = np.unique(np.asarray(flight_day, dtype=np.int64), return_inverse=True)
    square = normal[np.ix_(free, free)]
    score = score[:, free] - score[:, free].mean(axis=0)
    if normals is not None:
        normals = normals[:, free[:, np.newaxis], free]
    day_normals = None if normals is None else group_sums(normals, day, day_number.size)
    influence = [np.zeros((count, size)) for count in (flights, day_number.size)]
    influence[0][:, free] = influences(score, square, normals, kappa)
    influence[1][:, free] = influences(group_sums(score, day, day_number.size), square,
                                       day_normals, kappa)
    freedom = np.full(size, np.inf)
    freedom[free] = degrees_of_freedom(square, normals, flights)
    weight = sum(part.weight for part in parts) or 1.0
    return AircraftFit(theta, free, normal, kappa, influence[0], influence[1], day_number,
                       freedom, converged,
                       float(np.sqrt(sum(part.before2 for part in parts) / weight)),
                       float(np.sqrt(sum(part.after2 for part in parts) / weight)),
                       np.argsort(flight_day, kind="stable"))
