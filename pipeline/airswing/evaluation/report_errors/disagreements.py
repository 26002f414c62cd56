"""What reports and references disagree by, laid out by day, cell and class of aircraft.

Assumes screened headings and their correction with reports in the same order. A cell is a phase of
flight in a layer of pressure (those of :mod:`airswing.evaluation.error_profiles`). A report counts
where it has a reported wind, a corrected one (what could not be corrected is left out) and every
reference asked for. Aircraft are put in classes by their disagreement, each in one of its own while
there are few. Of archives too large to pair whole days are taken, evenly spread. m/s, m2/s2,
degrees, Pa, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.error_profiles import CELLS, STATES, profile_cells
from airswing.evaluation.report_errors.neighbours import half_squares, neighbouring_pairs
from airswing.evaluation.report_errors.separation import PairTable
from airswing.flags import CORRECTION
from airswing.products.ragged import aircraft_of_report, blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Columns = dict[str, NDArray[Any]]  # whole numbers among floats: a type of its own for each name

# Looked at at most, so that years take no more room than months.
MOST_REPORTS, MOST_PAIRS, MOST_CLASSES = 1_000_000, 800_000, 40
# Of 1 m/s, for the median speed of a layer.
_SPEED_BINS = 100
_NAMES = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "latitude",
    "longitude",
    "pressure",
    "time",
    "phase",
    "screening",
)
_CORRECTED = ("corrected_eastward_wind", "corrected_northward_wind")
_APPLIED = (CORRECTION["corrected"], CORRECTION["already_corrected"])


@dataclass(frozen=True)
class Disagreements:
    """Sums over all reports, and the reports that are paired."""

    days: NDArray[np.datetime64]  # array of datetime64[D], shape (day,)
    number: Floats  # (cell, day)
    # (cell, day): summed squared disagreement of the corrected winds with the reference, mean of
    # both components
    squares: Floats
    # (combination, cell, day): summed products of their disagreements with two references, mean of
    # both components, by `combinations_with_replacement` of the members
    products: Floats
    # (cell,): summed squares of what the correction changed (reported minus corrected), mean of
    # both components
    change_squares: Floats
    # (cell, day): summed products of that change and the corrected wind's disagreement, of both
    # components: with `squares` and `change_squares` this makes the reported winds' squared
    # disagreement
    crossed: Floats
    # (3, 1 + cell): over all pairs of aircraft and day, sums of the squared `crossed`, of its
    # product with the number of reports, and of their squared number; of all cells together, then
    # of each
    crossed_alone: Floats
    aircraft_crossed: Floats  # (aircraft, cell)
    aircraft_number: Floats  # (aircraft, cell)
    aircraft_day_number: Floats  # (aircraft, day)
    aircraft_squares: Floats  # (state, aircraft, day)
    speeds: Floats  # (cell, speed bin)
    # shape (report,): ``latitude, longitude, pressure, time, aircraft, cell, day`` and, of the
    # corrected winds, ``east, north``: disagreement, m/s
    reports: Columns


def disagreements(
    headings: xr.Dataset, corrected: xr.Dataset, members: list[str], pool: list[str]
) -> Disagreements:
    """Lay out an archive, some whole aircraft at a time.

    Parameters
    ----------
    headings, corrected : Dataset
        In memory or opened lazily.
    members : list of str
        References compared with each other.
    pool : list of str
        References whose mean the pairs are held against.
    """
    every = _days(headings)
    stride = -(-headings.sizes["report"] // MOST_REPORTS)
    stride += stride > 1 and stride % 7 == 0  # no day of the week stands for all
    parts, first = [], 0
    mended = blocks(corrected, [*_CORRECTED, "correction_applied"])
    sums = _Sums(len(every), headings.sizes["aircraft"], len(members))
    for block, better in zip(blocks(headings, list(_NAMES)), mended, strict=True):
        columns = _columns(block, better, members, pool, every)
        columns["aircraft"] += first
        for own in _by_aircraft(columns["aircraft"]):  # the same sums however a fleet is divided
            sums.add({name: values[..., own] for name, values in columns.items()})
        kept = columns["day"] % stride == 0
        parts.append({name: columns[name][kept] for name in _KEPT})
        first += block.sizes["aircraft"]
    reports = {name: np.concatenate([part[name] for part in parts]) for name in _KEPT}
    return sums.of(every, reports)


_KEPT = ("latitude", "longitude", "pressure", "time", "aircraft", "cell", "day", "east", "north")


def _by_aircraft(aircraft: NDArray[np.generic]) -> list[slice]:
    """Reports of each aircraft, which stand together."""
    stops = [*np.flatnonzero(np.diff(aircraft) != 0) + 1, aircraft.size]
    starts = [0, *stops[:-1]]
    return [slice(start, stop) for start, stop in zip(starts, stops, strict=True) if stop > start]


def _days(headings: xr.Dataset) -> NDArray[np.datetime64]:
    """Days with reports, in order."""
    found = [
        np.unique(block["time"].to_numpy().astype("datetime64[D]"))
        for block in blocks(headings, ["time"])
    ]
    days = np.unique(np.concatenate(found)) if found else np.empty(0, "datetime64[D]")
    return np.asarray(days[~np.isnat(days)])


def _columns(
    block: xr.Dataset,
    better: xr.Dataset,
    members: list[str],
    pool: list[str],
    days: NDArray[np.datetime64],
) -> Columns:
    """Usable reports of a block."""
    cell, _ = profile_cells(block)
    model = reference_mean(block, pool)
    wind = {
        "reported": [block[name].to_numpy() for name in _NAMES[:2]],
        "corrected": [better[name].to_numpy() for name in _CORRECTED],
    }
    names = [f"reference_{way}_wind" for way in ("eastward", "northward")]
    pooled = [model[name].to_numpy() for name in names]
    single = [
        [block[name].sel(reference=member).to_numpy() for name in names] for member in members
    ]
    every = [
        *wind["reported"],
        *wind["corrected"],
        *pooled,
        *(part for one in single for part in one),
    ]
    good = (cell >= 0) & np.all(np.isfinite(every), axis=0)
    if "correction_applied" in better:
        good &= np.isin(better["correction_applied"].to_numpy(), _APPLIED)
    time = block["time"].to_numpy()
    good &= ~np.isnat(time)
    found = {
        name: block[name].to_numpy()[good].astype(np.float64)
        for name in ("latitude", "longitude", "pressure")
    }
    found["time"] = time[good].astype("datetime64[ms]").astype(np.float64) / 1000.0
    found["day"] = np.searchsorted(days, time[good].astype("datetime64[D]"))
    found["cell"], found["aircraft"] = cell[good], aircraft_of_report(block)[good].copy()
    for state, (u, v) in wind.items():
        found[state] = np.stack([(u - pooled[0])[good], (v - pooled[1])[good]]).astype(np.float64)
    u, v = wind["corrected"]
    found["of_each"] = np.array(
        [[(u - east)[good], (v - north)[good]] for east, north in single], dtype=np.float64
    )
    found["east"], found["north"] = found["corrected"]
    found["speed"] = np.hypot(*(part[good] for part in pooled)).astype(np.float64)
    return found


class _Sums:
    """Sums of reports as blocks come."""

    def __init__(self, days: int, aircraft: int, members: int) -> None:
        self.combinations = list(combinations_with_replacement(range(members), 2))
        cells = CELLS
        self.number = np.zeros((cells, days))
        self.squares = np.zeros((cells, days))
        self.products = np.zeros((len(self.combinations), cells, days))
        self.change_squares = np.zeros(cells)
        self.crossed = np.zeros((cells, days))
        self.crossed_alone = np.zeros((3, 1 + cells))
        self.aircraft_crossed = np.zeros((aircraft, cells))
        self.aircraft_number = np.zeros((aircraft, cells))
        self.aircraft_day_number = np.zeros((aircraft, days))
        self.aircraft_squares = np.zeros((len(STATES), aircraft, days))
        self.speeds = np.zeros((cells, _SPEED_BINS))

    def add(self, columns: Columns) -> None:
        """Add the reports of one aircraft."""
        day, cell, aircraft = columns["day"], columns["cell"], columns["aircraft"]
        shape = self.number.shape
        number = _summed(cell, day, np.ones(day.size), shape)
        after = columns["corrected"]
        change = columns["reported"] - after
        crossed = _summed(cell, day, (change * after).sum(axis=0), shape)
        change_square = 0.5 * (change**2).sum(axis=0)
        self.number += number
        self.crossed += crossed
        self.squares += _summed(cell, day, 0.5 * (after**2).sum(axis=0), shape)
        self.change_squares += np.bincount(cell, weights=change_square, minlength=shape[0])
        for row, (one, two) in enumerate(self.combinations):
            product = 0.5 * (columns["of_each"][one] * columns["of_each"][two]).sum(axis=0)
            self.products[row] += _summed(cell, day, product, shape)
        sums, counts = (np.vstack([part.sum(axis=0), part]) for part in (crossed, number))
        for row, moment in enumerate((sums**2, sums * counts, counts**2)):
            self.crossed_alone[row] += moment.sum(axis=1)
        own = int(aircraft[0])
        self.aircraft_crossed[own] += crossed.sum(axis=1)
        self.aircraft_number[own] += number.sum(axis=1)
        self.aircraft_day_number[own] += number.sum(axis=0)
        for place, state in enumerate(STATES):
            square = 0.5 * (columns[state] ** 2).sum(axis=0)
            self.aircraft_squares[place, own] += np.bincount(
                day, weights=square, minlength=shape[1]
            )
        speed = np.minimum(columns["speed"], _SPEED_BINS - 1).astype(np.int64)
        self.speeds += _summed(cell, speed, np.ones(day.size), self.speeds.shape)

    def of(self, days: NDArray[np.datetime64], reports: Columns) -> Disagreements:
        """All of it."""
        return Disagreements(
            days,
            self.number,
            self.squares,
            self.products,
            self.change_squares,
            self.crossed,
            self.crossed_alone,
            self.aircraft_crossed,
            self.aircraft_number,
            self.aircraft_day_number,
            self.aircraft_squares,
            self.speeds,
            reports,
        )


def _summed(first: Ints, second: Ints, values: Floats, shape: tuple[int, ...]) -> Floats:
    flat = np.bincount(first * shape[1] + second, weights=values, minlength=shape[0] * shape[1])
    return np.asarray(flat, dtype=np.float64).reshape(shape)


def aircraft_classes(found: Disagreements) -> Ints:
    """Class of every aircraft: one of its own, or with those that disagree as much.

    Returns
    -------
    array of int, shape (aircraft,)
    """
    number = found.aircraft_number.sum(axis=1)
    square = found.aircraft_squares[-1].sum(axis=1) / np.maximum(number, 1.0)
    order = np.argsort(square, kind="stable")
    classes = np.empty(number.size, dtype=np.int64)
    size = min(MOST_CLASSES, number.size)
    classes[order] = np.arange(number.size) * size // max(number.size, 1)
    return classes


def near_pairs(found: Disagreements, classes: Ints) -> PairTable:
    """Pair the neighbouring reports of every day.

    Parameters
    ----------
    classes : array of int, shape (aircraft,)
    """
    table = found.reports
    order = np.argsort(table["day"], kind="stable")
    edges = np.searchsorted(table["day"][order], np.arange(found.days.size + 1))
    rng, most = np.random.default_rng(0), max(MOST_PAIRS // max(found.days.size, 1), 1)
    parts = []
    for day in range(found.days.size):
        rows = order[edges[day] : edges[day + 1]]
        own = {name: values[rows] for name, values in table.items()}
        pairs = neighbouring_pairs(
            own["latitude"], own["longitude"], own["pressure"], own["time"], own["aircraft"]
        )
        if pairs.first.size > most:
            pairs = pairs.some(np.sort(rng.permutation(pairs.first.size)[:most]))
        ends = np.column_stack([pairs.first, pairs.second])
        parts.append(
            (
                np.full(pairs.first.size, day),
                own["cell"][ends],
                classes[own["aircraft"][ends]],
                pairs.separation,
                half_squares(own["east"], own["north"], pairs),
            )
        )
    return PairTable(*(np.concatenate(column) for column in zip(*parts, strict=True)))
