"""A fleet watched night by night: what all have alike is told from what one aircraft has.

Assumes the rows of :mod:`airswing.evaluation.monitoring.daily_evidence` and the test of
:mod:`airswing.evaluation.monitoring.sequential_test`. The common part is watched like an aircraft
of its own: a step of it is the reference's. In a small fleet a night on which one aircraft steps
and half of them or more seem to is taken for the reference's too.

A day is weighed by the errors that the months before its own show: no later night weighs it
otherwise, and the watch goes on from what the end of a month left.

Radians; logarithms of the wind vector difference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.monitoring.common_part import FEWEST, common_part, estimated_noise
from airswing.evaluation.monitoring.sequential_test import Floats, Index, Law, Noise, Step, Watch
from airswing.products.checked import digest

DayRows = tuple[Index, Index, NDArray[np.generic], NDArray[np.generic]]
"""Aircraft, day, normal matrix (rows, p, p) and right side (rows, p)."""

ENOUGH, FEWEST_TOLD = 20_000, 20
"""Rows that tell the errors of a day, and the fewest aircraft of them."""
_STEP = tuple(one.name for one in fields(Step))
TOLD_BY = 28
"""Days before a month that tell its errors; with fewer of them its own days do."""
LIKELY = 3.0
"""Logarithm of the likelihood ratio beyond which an aircraft seems to have stepped too."""
DEGREE = np.pi / 180.0
UNKNOWNS = 12
"""A to E, third and fourth harmonic (radians), airspeed scale, reference's b_u, b_v (m/s)."""
# Which of the unknowns are angles, which the scale and which winds: their sizes are given apart.
_ANGLES = np.repeat([1.0, 0.0], [9, 3])
_SCALE = np.repeat([0.0, 1.0, 0.0], [9, 1, 2])
_WINDS = np.repeat([0.0, 1.0], [10, 2])
# Degrees: how large the third and the fourth harmonic of a level are expected.
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


@dataclass
class FleetWatch:
    """A fleet's watch as it stands where a month begins."""

    own: Watch
    shared: Watch  # of what all have alike
    alarms: list[Alarm] = field(default_factory=list)
    # since 1970: the first whose days it has not taken in; before any day of any archive
    month: int = -(2**31)

    def begin(self, month: int, noise: Noise) -> None:
        """Weigh the days of a month, and of those after it, by their errors."""
        self.month, self.own.noise = month, noise
        self.shared.noise = replace(self.shared.noise, persistence=noise.persistence)


@dataclass(frozen=True)
class KeptWatch:
    """Where the watch of one quantity is kept as the last month began with it.

    Whoever keeps it tells aircraft and code by a mark of its own; that the rows taken in are the
    same is told here, by a hash of those before the month.
    """

    read: Callable[[], Mapping[str, NDArray[np.generic]] | None]
    write: Callable[[Mapping[str, NDArray[np.generic]]], None]

    def take_up(self, watch: FleetWatch, rows: DayRows) -> None:
        """Bring a new watch to where one stands that took in the same rows; else leave it."""
        kept = self.read()
        if kept is None or str(kept["rows"]) != _hash_before(int(kept["month"]), rows):
            return
        watch.month = int(kept["month"])
        for name in ("own", "shared"):
            getattr(watch, name).take_up(
                {key.removeprefix(f"{name}:"): one for key, one in kept.items()}
            )
        steps = zip(*(kept[f"step:{name}"] for name in _STEP), strict=True)
        for told, step in zip(kept["alarms"].tolist(), steps, strict=True):
            plain = (one.item() if np.ndim(one) == 0 else one for one in step)
            watch.alarms.append(Alarm(Step(*plain), *told))

    def keep(self, watch: FleetWatch, rows: DayRows) -> None:
        """Keep a watch that has taken in the rows before its month."""
        found = {
            "month": np.array(watch.month),
            "rows": np.array(_hash_before(watch.month, rows)),
            "alarms": np.array([(one.night, one.aircraft) for one in watch.alarms], np.int64),
        }
        for name in _STEP:
            found[f"step:{name}"] = np.array([getattr(one.step, name) for one in watch.alarms])
        for name in ("own", "shared"):
            arrays = getattr(watch, name).as_arrays()
            found |= {f"{name}:{key}": one for key, one in arrays.items()}
        self.write(found)


def watch_fleet(
    rows: DayRows,
    law: Law,
    *,
    usual: Noise,
    common: Floats,
    number: int,
    kept: KeptWatch | None = None,
) -> list[Alarm]:
    """Watch one quantity of a fleet, night by night.

    Parameters
    ----------
    usual : Noise
        Of the days, where there are too few to tell.
    common : array, shape (p,)
        Standard deviation of a day's common part.
    kept : KeptWatch, optional
        Where to go on from, and where to keep what the last month begins with.

    Returns
    -------
    list of Alarm
        In order of the night.
    """
    months = months_of(rows[1])
    shared = Watch(replace(law, level=3.0 * common), Noise(1.0, common**2), 1)
    watch = FleetWatch(Watch(law, usual, number), shared)
    if kept is not None:
        kept.take_up(watch, rows)
    for month in np.unique(months[months >= watch.month]):
        if month > watch.month:
            begin, end = (_first_day(one) for one in (month, month + 1))
            known = begin - rows[1].min() >= TOLD_BY
            telling = rows[1] < (begin if known else end)
            watch.begin(int(month), _noise(rows, telling, usual, number))
            if kept is not None and known and month == months.max():
                kept.keep(watch, rows)
        chosen = np.flatnonzero(months == month)
        # stable: rows of one group keep their order, so that their sums are the same bit for bit
        order = chosen[np.argsort(rows[1][chosen], kind="stable")]
        nights, start = np.unique(rows[1][order], return_index=True)
        for night, of in zip(nights, np.split(order, start[1:]), strict=True):
            squares, sums = (part[of].astype(np.float64) for part in rows[2:])
            found = _night(watch, common, int(night), rows[0][of], squares, sums)
            watch.alarms += [Alarm(step, int(night), of.size) for step in found]
    return watch.alarms


def months_of(day: Index) -> Index:
    """Months since 1970 of days since then."""
    return day.astype("M8[D]").astype("M8[M]").astype(np.int64)


def _first_day(month: int) -> int:
    return int(np.datetime64(int(month), "M").astype("M8[D]").astype(np.int64))


def _noise(rows: DayRows, telling: NDArray[np.bool_], usual: Noise, number: int) -> Noise:
    """Errors of the days of a fleet from some rows, of large fleets from every so many aircraft."""
    aircraft, day, normal, right = rows
    every = max(min(int(telling.sum()) // ENOUGH, number // FEWEST_TOLD), 1)
    chosen = telling & (aircraft % every == 0)
    squares, sums = (part[chosen].astype(np.float64) for part in (normal, right))
    return estimated_noise(squares, sums, aircraft[chosen], day[chosen], usual=usual)


def _night(
    watch: FleetWatch, common: Floats, night: int, of: Index, normal: Floats, right: Floats
) -> list[Step]:
    """Take a night in: the steps it tells; -1 is the number of all at once."""
    own, shared = watch.own, watch.shared
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


def _hash_before(month: int, rows: DayRows) -> str:
    chosen = months_of(rows[1]) < month
    return digest(*(np.ascontiguousarray(part[chosen]).data for part in rows)).hex()
