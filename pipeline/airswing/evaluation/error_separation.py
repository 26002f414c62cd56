"""Error variance of the reports alone: kernels.

*Neighbours.* Two aircraft near each other share the error of the reference and the weather. Half
the mean squared difference of two neighbours' differences from the reference, extrapolated to zero
separation, is the error variance of the reports (the intercept of Hollingsworth & Loennberg 1986,
Tellus 38A, 111-136, as a variogram, in which differences between regions cancel). Errors of
different aircraft are taken as independent; motion of the air on scales below the nearest pairs
counts as error of the reports.

The expected half square of a pair is the mean of both reports' error variances (of the cell, phase
of flight and layer, plus that of the aircraft's class) plus the difference of the reference's
errors at that separation, proportional to the disagreement of both cells. This linear model is
fitted by weighted least squares for each bootstrap draw of days. Cells weigh as reports do.

*Reported winds.* Their error variance exceeds that of the corrected winds by the mean square of the
correction c (reported minus corrected), which is known exactly, plus twice the mean of c d, d being
the corrected wind's disagreement. The mean of c d contains the covariance of c with the error of
the corrected wind, which is wanted, and with the reference's error, which is the error of the
estimate. Neither days nor aircraft are independent, and its variance is that of both clusters less
that of their intersection (Cameron, Gelbach & Miller 2011, J. Bus. Econ. Stat. 29, 238-249), for
this fleet in this archive.

Plain arrays, SI units, degrees for places, seconds for time; variances in m2/s2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airswing.units import MODEL_EARTH_RADIUS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = (30_000.0, 0.06, 1350.0)
"""Separation beyond which a pair is no longer near: m, ln p, s."""
FEWEST_PAIRS, FEWEST_OF_CELL, FEWEST_DAYS = 400, 150, 8
"""Below these the parts of the error cannot be separated."""
_MOST_AT_ONCE = 20_000  # reports of a day; more are thinned at random
_TERMS = 4  # terms of the reference's error as a function of separation
_BINS = 8  # classes of separation, each with one variance of half squares


@dataclass(frozen=True)
class PairTable:
    """All near pairs of an archive."""

    day: Ints  # (pair,): from 0, in order of time
    cells: Ints  # (pair, 2): of both reports
    classes: Ints  # (pair, 2)
    separation: Floats  # (pair, 3)
    squares: Floats  # (pair,): half squares


@dataclass(frozen=True)
class Separated:
    """Error variances: the estimate first, then those of the bootstrap draws of days."""

    by_cell: Floats  # (1 + draw, cell): cells with too few pairs have one value in common
    by_class: Floats  # (1 + draw, class)
    resolved: NDArray[np.bool_]  # (cell,): whether a cell has enough pairs


def neighbouring_pairs(
    latitude: Floats, longitude: Floats, pressure: Floats, time: Floats, aircraft: Ints
) -> tuple[Ints, Floats]:
    """Find the pairs of reports of different aircraft that are near; degrees, Pa, s.

    Returns the places of both reports (pair, 2) and their separation (pair, 3): distance,
    difference of ln p and of time, in units of :data:`REACH`.
    """
    chosen = np.arange(latitude.size)
    if chosen.size > _MOST_AT_ONCE:
        drawn = np.random.default_rng(chosen.size).permutation(chosen)
        chosen = np.sort(drawn[:_MOST_AT_ONCE])
    phi, lam = np.radians(latitude[chosen]), np.radians(longitude[chosen])
    place = np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=1)
    place *= MODEL_EARTH_RADIUS / REACH[0]
    where = np.column_stack([place, np.log(pressure[chosen]) / REACH[1], time[chosen] / REACH[2]])
    found = cKDTree(where).query_pairs(1.0, output_type="ndarray").astype(np.int64)
    found = found[np.diff(aircraft[chosen][found], axis=1)[:, 0] != 0]
    apart = np.abs(np.diff(where[found], axis=1)[:, 0])
    distance = np.sqrt((apart[:, :3] ** 2).sum(axis=1))
    return chosen[found], np.column_stack([distance, apart[:, 3:]])


def half_squares(east: Floats, north: Floats, pairs: Ints) -> Floats:
    """Half the squared difference of two neighbours (pair,), the mean of both components, m2/s2.

    ``east`` and ``north`` are report minus reference, (report,), m/s; ``pairs`` (pair, 2) places.
    """
    squares = np.diff(east[pairs], axis=1) ** 2 + np.diff(north[pairs], axis=1) ** 2
    # half for two components, half for two reports: the error variance of one
    return np.asarray(0.25 * squares[:, 0], dtype=np.float64)


def separate(
    table: PairTable, number: Floats, amplitude: Floats, weights: Floats
) -> Separated | None:
    """Separate the reports' error variance from the reference's; None with too few pairs or days.

    ``number`` (cell, class) of reports weights cells and classes; the reference's part is
    proportional to ``amplitude`` (cell,), the mean square disagreement; ``weights`` (1 + draw, day)
    are the weights of each day, the first row being ones.
    """
    if table.day.size < FEWEST_PAIRS or np.unique(table.day).size < FEWEST_DAYS:
        return None
    # each pair counts in the cells of both its reports
    resolved = np.bincount(table.cells.ravel(), minlength=len(number)) >= 2 * FEWEST_OF_CELL
    column = np.where(resolved, np.cumsum(resolved) - 1, int(resolved.sum()))
    cells, classes = int(column.max()) + 1, number.shape[1]
    design = np.zeros((table.day.size, cells + classes + _TERMS))
    row = np.arange(table.day.size)
    for end in (0, 1):
        np.add.at(design, (row, column[table.cells[:, end]]), 0.5)
        np.add.at(design, (row, cells + table.classes[:, end]), 0.5)
    # A correlation that is smooth at zero separation decreases as a square there, and more slowly
    # further out: the squares of the three parts, and the fourth power of the whole.
    scale = np.sqrt(amplitude[table.cells]).prod(axis=1)
    scale /= max(float(scale.mean()), 1e-12)  # the terms are in the units of the half squares
    squared = table.separation**2
    terms = np.column_stack([squared, squared.sum(axis=1) ** 2])
    design[:, cells + classes :] = terms * scale[:, None]
    drawn = _solved(design, table, weights, cells + classes)
    of_cell = number / np.maximum(number.sum(axis=1, keepdims=True), 1.0)
    of_class = number / np.maximum(number.sum(axis=0, keepdims=True), 1.0)
    cell_part, class_part = drawn[:, column], drawn[:, cells : cells + classes]
    by_class = cell_part @ of_class + class_part
    return Separated(cell_part + class_part @ of_cell.T, by_class, resolved)


def _solved(design: Floats, table: PairTable, weights: Floats, variances: int) -> Floats:
    """Weighted least squares for every draw of the days: (draw, column)."""
    # the variance of a half square is the square of its mean, here by separation
    distance = np.sqrt((table.separation**2).sum(axis=1))
    place = np.minimum((distance * _BINS).astype(np.int64), _BINS - 1)
    count = np.maximum(np.bincount(place, minlength=_BINS), 1)
    mean = np.bincount(place, weights=table.squares, minlength=_BINS) / count
    precision = 1.0 / np.maximum(mean[place], 1e-12) ** 2
    matrix = np.zeros((weights.shape[1], design.shape[1], design.shape[1]))
    right = np.zeros(matrix.shape[:2])
    order = np.argsort(table.day, kind="stable")
    ends = np.searchsorted(table.day[order], np.arange(1, weights.shape[1]))
    for day, rows in enumerate(np.split(order, ends)):
        weighted = design[rows] * precision[rows, None]
        matrix[day], right[day] = weighted.T @ design[rows], weighted.T @ table.squares[rows]
    matrix, right = np.tensordot(weights, matrix, axes=1), weights @ right
    diagonal = np.einsum("dii->di", matrix)
    # a cell without a pair in the days drawn has no row and must stay solvable
    ridge = 1e-9 * diagonal + 1e-30
    # cells and classes both contain the mean; this assigns it to the classes
    ridge[:, :variances] += 1e-4 * diagonal[:, :variances].mean(axis=1, keepdims=True)
    whole = matrix + ridge[..., None] * np.eye(matrix.shape[-1])
    return np.asarray(np.linalg.solve(whole, right[..., None])[..., 0])


def added_variance(
    key: Ints,
    number: Floats,
    change: Floats,
    crossed: Floats,
    weights: Floats,
    *,
    cells: int,
    seed: int,
) -> Floats:
    """Error variance of the reported winds less that of the corrected winds, (1 + draw, 1 + cell).

    The estimate, then draws of days (by ``weights``) and aircraft; of all reports, then of each
    cell; NaN without reports. ``key`` (3, group) are aircraft, day and cell of groups of reports;
    of each group ``number`` of reports, summed c squared (mean of both components) and summed
    products c d (of both components).
    """
    aircraft, day, cell = key
    days, craft = weights.shape[1], int(aircraft.max(initial=0)) + 1

    def by(other: Ints, size: int, values: Floats) -> Floats:
        table = np.bincount(cell * size + other, values, cells * size).reshape(cells, size)
        return np.vstack([table.sum(axis=0), table])

    flown = by(aircraft, craft, number)
    total = flown.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = by(day, days, crossed).sum(axis=1) / total
        known = by(day, days, change).sum(axis=1) / total
        by_day, by_aircraft = (
            (by(other, size, crossed) - mean[:, None] * by(other, size, number)) / total[:, None]
            for other, size in ((day, days), (aircraft, craft))
        )
        together = np.bincount(aircraft * days + day, crossed - mean[0] * number)
        each = np.bincount(cell, (crossed - mean[1:][cell] * number) ** 2, cells)
        intersection = np.append((together**2).sum(), each) / total**2
    members = (flown > 0).sum(axis=1)
    by_aircraft *= np.sqrt(members / np.maximum(members - 1.0, 1.0))[:, None]
    drawn = np.random.default_rng([seed, 1]).normal(size=(len(weights), craft))
    drawn[0] = 0.0
    of_days, of_aircraft = (weights - 1.0) @ by_day.T, drawn @ by_aircraft.T
    share: Floats | float = 1.0
    if len(weights) > 1:
        # the intersection is counted once
        variances = of_days[1:].var(axis=0), (by_aircraft**2).sum(axis=1)
        both = variances[0] + variances[1]
        once = np.maximum(both - intersection, np.maximum(*variances))
        share = np.sqrt(np.divide(once, both, out=np.ones_like(both), where=both > 0.0))
    return np.asarray(known + mean + share * (of_days + of_aircraft))
