"""A fleet watched night by night: what all have alike is told from what one aircraft has.

Assumes the rows of :mod:`airswing.evaluation.monitoring.daily_evidence` and the test of
:mod:`airswing.evaluation.monitoring.sequential_test`. The common part is watched like an aircraft
of its own: a step of it is the reference's. In a small fleet a night on which one aircraft steps
and half of them or more seem to is taken for the reference's too.

Radians; logarithms of the wind vector difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.monitoring.common_part import FEWEST, common_part, estimated_noise
from airswing.evaluation.monitoring.sequential_test import Floats, Index, Law, Noise, Step, Watch

ENOUGH, FEWEST_TOLD = 20_000, 20
"""Rows that tell the errors of a day, and the fewest aircraft of them."""
LIKELY = 3.0
"""Logarithm of the likelihood ratio beyond which an aircraft seems to have stepped too."""
DEGREE = np.pi / 180.0
UNKNOWNS = 12
"""A to E, third and fourth harmonic (radians), airspeed scale, reference's b_u, b_v (m/s)."""
_ANGLES = np.repeat([1.0, 0.0], [9, 3])
_SCALE = np.repeat([0.0, 1.0, 0.0], [9, 1, 2])
_WINDS = np.repeat([0.0, 1.0], [10, 2])
_HIGHER = np.array([1.0, 1.0, 0.5, 0.5])
COMPASS = Law(
    shapes=1.4
    * DEGREE
    * np.array(
        [
            [1.0, 0, 0, 0, 0, *[0.0] * 7],
            [1.0, 1.0, 1.0, 0, 0, *[0.0] * 7],
            [1.0, 1.0, 1.0, 0.5, 0.5, *[0.0] * 7],
        ]
    ),
    level=DEGREE * np.array([10.0, 10, 10, 5, 5, *_HIGHER, 0, 0, 0]) + 0.05 * _SCALE + 0.7 * _WINDS,
    drift=0.13 * DEGREE * _ANGLES + 0.005 * _SCALE + 0.15 * _WINDS,
    farthest=30.0,
    threshold=7.0,
    weighed_from=4.0,
)
"""Only the compass steps: a bias of the reference or of the airspeed is no change of it."""
COMPASS_NOISE = Noise(4.0, (0.2 * DEGREE) ** 2 * _ANGLES + 0.5**2 * _WINDS)
COMPASS_COMMON = 0.3 * DEGREE * _ANGLES + 0.005 * _SCALE + 0.8 * _WINDS
"""Standard deviation of a day's common part."""
WIND = Law(
    shapes=np.array([[0.4]]),
    level=np.array([1.0]),
    drift=np.array([0.07]),
    farthest=12.0,
    threshold=12.0,
)
"""Logarithm of the wind vector difference: a step of 0.4 is a factor of 1.5."""
WIND_NOISE = Noise(1.5, np.array([0.15**2]))
WIND_COMMON = np.array([0.15])


@dataclass(frozen=True)
class Alarm:
    """A step that a night told."""

    step: Step  # its number is an aircraft's, or -1: of all at once
    night: int
    aircraft: int  # that flew that night


def watch_fleet(
    rows: tuple[Index, Index, NDArray[np.generic], NDArray[np.generic]],
    law: Law,
    *,
    usual: Noise,
    common: Floats,
    number: int,
) -> list[Alarm]:
    """Watch one quantity of a fleet, night by night.

    Parameters
    ----------
    rows : tuple of array
        Aircraft, day, normal matrix (rows, p, p) and right side (rows, p).
    usual : Noise
        Of the days, where there are too few to tell.
    common : array, shape (p,)
        Standard deviation of a day's common part.

    Returns
    -------
    list of Alarm
        In order of the night.
    """
    aircraft, day, normal, right = rows
    if not day.size:
        return []
    noise = _noise(rows, usual, number)
    own = Watch(law, noise, number)
    shared = Watch(replace(law, level=3.0 * common), Noise(1.0, common**2, noise.persistence), 1)
    order = np.argsort(day, kind="stable")
    nights, start = np.unique(day[order], return_index=True)
    alarms: list[Alarm] = []
    for night, of in zip(nights, np.split(order, start[1:]), strict=True):
        squares, sums = (part[of].astype(np.float64) for part in (normal, right))
        found = _night(own, shared, common, int(night), aircraft[of], squares, sums)
        alarms += [Alarm(step, int(night), of.size) for step in found]
    return alarms


def _noise(
    rows: tuple[Index, Index, NDArray[np.generic], NDArray[np.generic]], usual: Noise, number: int
) -> Noise:
    """Errors of the days of a fleet, of large fleets from every so many aircraft."""
    aircraft, day, normal, right = rows
    chosen = aircraft % max(min(aircraft.size // ENOUGH, number // FEWEST_TOLD), 1) == 0
    squares, sums = (part[chosen].astype(np.float64) for part in (normal, right))
    return estimated_noise(squares, sums, aircraft[chosen], day[chosen], usual=usual)


def _night(
    own: Watch,
    shared: Watch,
    common: Floats,
    night: int,
    of: Index,
    normal: Floats,
    right: Floats,
) -> list[Step]:
    """Take a night in: the steps it tells; -1 is the number of all at once."""
    weight, right = own.noise.weights(normal, right)
    level = shared.level(np.array([0]))[0][0]
    alike = common_part(*own.surprise(of, weight, right), level, common)
    own.add(night, of, weight, right - np.einsum("nij,nj->ni", weight, alike.without))
    all_of_them = np.arange(int(alike.weight.any()))
    shared.add(night, all_of_them, *shared.noise.weights(alike.weight[None], alike.right[None]))
    reference = shared.steps(all_of_them)
    for step in reference:
        shared.restart(step)
    steps = own.steps(of)
    if steps and of.size < 2 * FEWEST:
        likely = own.likely(of, LIKELY)
        if len(likely) >= max(2.0, of.size / 2.0):
            strongest = max(likely, key=lambda step: step.statistic)
            reference, steps = [*reference, strongest], likely
            for step in steps:
                own.restart(step)
            return [replace(one, number=-1) for one in reference]
    for step in steps:
        own.restart(step)
    return [*(replace(step, number=-1) for step in reference), *steps]
