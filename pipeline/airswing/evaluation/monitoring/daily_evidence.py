"""What every aircraft's days tell: of its compass, of its wind's disagreement, that it flew.

Assumes screened headings in the ragged form, in memory or opened lazily; read some whole aircraft
at a time, so that what is held is one row an aircraft and day, whatever the number of reports.

The compass's rows are the daily sums of
:mod:`airswing.evaluation.compass_changes.change_kernels`: normal matrix and right side of A to E
and a third and fourth harmonic (radians), the airspeed scale and the reference's bias (m/s), each
flight's own bias eliminated: what a flight's reports share is no report's own error. The
disagreement's row is the mean of the logarithm of the wind vector difference (m/s), so that a rise
is a factor, with the number of reports for a normal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.compass_changes.change_dates import SUMMED_FROM, block_day_sums
from airswing.evaluation.disagreement import reference_mean, vector_difference
from airswing.evaluation.monitoring.fleet_watch import UNKNOWNS
from airswing.evaluation.monitoring.sequential_test import Floats, Index
from airswing.flags import mended
from airswing.products.ragged import blocks, row_bounds

WINDS = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
)
CORRECTED = ("corrected_eastward_wind", "corrected_northward_wind", "correction_applied")
Names = NDArray[np.str_]
LEAST = 0.3
"""m/s below which a wind vector difference is that: its logarithm would tell of rounding."""


@dataclass(frozen=True)
class Rows:
    """One row an aircraft and day with reports, by aircraft and day (days since 1970)."""

    aircraft: Index  # (rows,)
    day: Index  # (rows,)
    count: Floats  # (rows,): used reports with a wind; none where screening left none
    # normal, right: (rows, 12, 12) and (rows, 12): of the compass; zero where screening left none
    normal: NDArray[np.float32]
    right: NDArray[np.float32]
    # log_difference, difference: (rows,): sum of the logarithm of the wind vector difference, and
    # of the difference, m/s
    log_difference: Floats
    difference: Floats

    def of(self, chosen: object) -> Rows:
        """Some of the rows."""
        return Rows(*(getattr(self, one.name)[chosen] for one in fields(self)))


def joined_rows(parts: Sequence[tuple[Names, Rows]]) -> tuple[Names, Rows]:
    """Rows of several parts of an archive, such as months, as one.

    Parameters
    ----------
    parts : sequence of (array of str, Rows)
        Names of the aircraft that the rows of each part number.

    Returns
    -------
    names : array of str
        In alphabetical order.
    rows : Rows
        A day of an aircraft that several parts have is one row.
    """
    names = np.unique(np.concatenate([own for own, _ in parts]))
    columns = {
        one.name: np.concatenate([getattr(rows, one.name) for _, rows in parts])
        for one in fields(Rows)
    }
    owner = np.concatenate([np.searchsorted(names, own)[rows.aircraft] for own, rows in parts])
    columns["aircraft"], day = owner, columns["day"]
    order = np.lexsort((day, owner))
    other = (np.diff(day[order]) != 0) | (np.diff(owner[order]) != 0)
    first = np.flatnonzero(np.append(True, other))[: order.size]
    for name, values in columns.items():
        if name in ("aircraft", "day"):
            columns[name] = values[order][first]
        elif order.size:
            columns[name] = np.add.reduceat(values[order], first)
    return names, Rows(**columns)


def daily_rows(
    headings: xr.Dataset,
    members: list[str],
    *,
    abscissa: str,
    corrected: xr.Dataset | None = None,
) -> Rows:
    """Rows of a fleet.

    Parameters
    ----------
    members : list of str
        References whose mean is compared with.
    abscissa : {"magnetic", "true"}
    corrected : Dataset, optional
        The same reports: winds that were corrected are taken as corrected.
    """
    argument = "magnetic_heading" if abscissa == "magnetic" else "heading"
    parts: list[Rows] = []
    mended_blocks = None if corrected is None else blocks(corrected, CORRECTED)
    first = 0
    for block in blocks(headings, [*SUMMED_FROM, "flight", *WINDS, argument]):
        winds = None if mended_blocks is None else next(mended_blocks)
        parts += _block_rows(block, winds, members, argument, first)
        first += block.sizes["aircraft"]
    columns = [np.concatenate([getattr(p, one.name) for p in parts]) for one in fields(Rows)]
    return Rows(*columns)


def _block_rows(
    block: xr.Dataset, winds: xr.Dataset | None, members: list[str], argument: str, first: int
) -> list[Rows]:
    """Rows of the aircraft of one block, each aircraft's own."""
    difference = _differences(block, winds, members)
    used = (block["screening"].to_numpy() == 0) & np.isfinite(difference)
    columns = [used * 1.0, np.log(np.maximum(difference, LEAST)), difference]
    columns = [np.where(used, column, 0.0) for column in columns]
    day = block["time"].to_numpy().astype("datetime64[D]").astype(np.int64)
    sums = block_day_sums(block, members, argument, fewest=1, by_flight=True)
    found = []
    for k, bounds in enumerate(zip(*row_bounds(block["row_size"].to_numpy()), strict=True)):
        own = slice(*bounds)
        days, place = np.unique(day[own], return_inverse=True)
        count, logarithm, total = (
            np.bincount(place, column[own], days.size).astype(np.float64) for column in columns
        )
        normal = np.zeros((days.size, UNKNOWNS, UNKNOWNS), np.float32)
        right = np.zeros((days.size, UNKNOWNS), np.float32)
        if (known := sums[k]) is not None:
            at = np.searchsorted(days, known.day)
            normal[at], right[at] = known.normal, known.right
        number = np.full(days.size, first + k)
        found.append(Rows(number, days, count, normal, right, logarithm, total))
    return found


def _differences(block: xr.Dataset, winds: xr.Dataset | None, members: list[str]) -> Floats:
    """Wind vector difference of every report, corrected where it was corrected, m/s."""
    reference = reference_mean(block, members)
    u, v = (block[name].to_numpy() for name in WINDS[:2])
    if winds is not None:
        applied = mended(winds["correction_applied"].to_numpy())
        u = np.where(applied, winds["corrected_eastward_wind"].to_numpy(), u)
        v = np.where(applied, winds["corrected_northward_wind"].to_numpy(), v)
    found = vector_difference(u, v, *(reference[name].to_numpy() for name in WINDS[2:]))
    return found.astype(np.float64)
