"""Error variance of reports by cell and by aircraft, from pairs of neighbours.

Assumes pairs of :mod:`airswing.evaluation.report_errors.neighbours`. The expected half square of a
pair's difference is the mean of both reports' error variances plus what the reference's error
parts with separation; an error variance is that of the report's cell (phase of flight and layer)
plus that of its aircraft's class; the reference's part is in proportion to the disagreement of both
cells. All of it is linear, fitted with weights by days, and drawn again over blocks of days. Cells
are weighted as reports are, not as pairs are. Variances in m2/s2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.evaluation.report_errors.neighbours import TERMS, day_equations, separation_terms

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Below these the parts of the error cannot be told from each other; a cell has two ends a pair.
FEWEST_PAIRS, FEWEST_OF_CELL, FEWEST_DAYS = 400, 150, 8
# Of separation, in which the scatter of half squares is taken as one.
_BINS = 8


@dataclass(frozen=True)
class PairTable:
    """Every near pair of an archive."""

    day: Ints  # (pair,): from 0, in order of time
    # cells, classes: (pair, 2): of both reports
    cells: Ints
    classes: Ints
    separation: Floats  # (pair, 3)
    squares: Floats  # (pair,): half squares


@dataclass(frozen=True)
class Separated:
    """Error variances, the first as found, the others with days drawn again."""

    by_cell: Floats  # (1 + draw, cell): of cells with too few pairs what such cells have together
    by_class: Floats  # (1 + draw, class)
    resolved: NDArray[np.bool_]  # (cell,): whether a cell has pairs enough of its own


def separate(
    table: PairTable, number: Floats, amplitude: Floats, weights: Floats
) -> Separated | None:
    """Separate the reports' error variance from the reference's.

    Parameters
    ----------
    number : array, shape (cell, class)
        Reports, by which cells and classes are weighted.
    amplitude : array, shape (cell,)
        Mean square disagreement, to which the reference's part is in proportion.
    weights : array, shape (1 + draw, day)
        How often each day counts; the first row is ones.

    Returns
    -------
    Separated or None
        None where pairs or days are too few.
    """
    if table.day.size < FEWEST_PAIRS or np.unique(table.day).size < FEWEST_DAYS:
        return None
    ends = np.bincount(table.cells.ravel(), minlength=number.shape[0])
    resolved = ends >= 2 * FEWEST_OF_CELL
    column = np.where(resolved, np.cumsum(resolved) - 1, int(resolved.sum()))
    cells = int(column.max()) + 1
    design = _design(table, column, number.shape[1], amplitude)
    own = cells + number.shape[1]
    matrix, right = _by_day(design, table, weights.shape[1])
    drawn = _solve(np.tensordot(weights, matrix, axes=1), weights @ right, own)
    # A cell's own part and that of its reports' aircraft; a class likewise.
    share = number / np.maximum(number.sum(axis=1, keepdims=True), 1.0)
    of_class = number / np.maximum(number.sum(axis=0, keepdims=True), 1.0)
    by_cell = drawn[:, column] + drawn[:, cells:own] @ share.T
    by_class = drawn[:, column] @ of_class + drawn[:, cells:own]
    return Separated(by_cell, by_class, resolved)


def _design(table: PairTable, column: Ints, classes: int, amplitude: Floats) -> Floats:
    """Rows of both reports' cells and classes, halves, and the reference's part."""
    cells = int(column.max()) + 1
    design = np.zeros((table.day.size, cells + classes + TERMS))
    row = np.arange(table.day.size)
    for end in (0, 1):
        np.add.at(design, (row, column[table.cells[:, end]]), 0.5)
        np.add.at(design, (row, cells + table.classes[:, end]), 0.5)
    scale = np.sqrt(amplitude[table.cells]).prod(axis=1)
    # of mean one: the terms then are in the units of the half squares
    scale /= max(float(scale.mean()), 1e-12)
    design[:, cells + classes :] = separation_terms(table.separation) * scale[:, None]
    return design


def _solve(matrix: Floats, right: Floats, own: int) -> Floats:
    """Solve with the least ridge: cells and classes both hold the mean, which only one can."""
    diagonal = np.einsum("dii->di", matrix)
    # a cell nobody flew in a day drawn has no row: it stays solvable
    ridge = 1e-9 * diagonal + 1e-30
    # so little that what the pairs tell stays, and the mean goes to the classes
    ridge[:, :own] += 1e-4 * diagonal[:, :own].mean(axis=1, keepdims=True)
    whole = matrix + ridge[..., None] * np.eye(matrix.shape[-1])
    return np.asarray(np.linalg.solve(whole, right[..., None])[..., 0])


def _by_day(design: Floats, table: PairTable, days: int) -> tuple[Floats, Floats]:
    """Normal equations of every day, pairs weighted by what a half square scatters."""
    weights = _weights(table.squares, table.separation)
    matrix = np.zeros((days, design.shape[1], design.shape[1]))
    right = np.zeros((days, design.shape[1]))
    order = np.argsort(table.day, kind="stable")
    edges = np.searchsorted(table.day[order], np.arange(days + 1))
    for day in range(days):
        rows = order[edges[day] : edges[day + 1]]
        matrix[day], right[day] = day_equations(design[rows], table.squares[rows], weights[rows])
    return matrix, right


def _weights(squares: Floats, separation: Floats) -> Floats:
    """One over the square of the mean half square at a separation: that is its variance."""
    apart = np.sqrt((separation**2).sum(axis=1))
    place = np.minimum((apart * _BINS).astype(np.int64), _BINS - 1)
    number = np.maximum(np.bincount(place, minlength=_BINS), 1)
    mean = np.bincount(place, weights=squares, minlength=_BINS) / number
    # a bin without a pair has no weight to give
    return np.asarray(1.0 / np.maximum(mean[place], 1e-12) ** 2)
