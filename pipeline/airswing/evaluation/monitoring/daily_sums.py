"""Sums of every aircraft and day that the detection of changes works on.

Assumes screened headings in the contiguous ragged form, in memory or lazy; some whole aircraft are
read at a time, so that memory holds one row an aircraft and day whatever the number of reports.

*Compass.* Each report gives two equations, across and along the indicated heading, in the unknowns
:data:`UNKNOWNS`: the coefficients A to E, a third and a fourth harmonic of the deviation (radians),
the airspeed scale and the bias b_u, b_v of the reference's wind (m/s). The higher harmonics absorb
what A to E leave of a curve; without them it looks like a change wherever an aircraft turns to
other headings. A row holds the normal matrix and the right side of a day. The errors of a flight's
reports are correlated (the reference's error is common to them): each flight has a bias,
a random effect that is eliminated.

*Wind.* A row holds the number of reports and the sums of the wind vector difference from the
reference and of its logarithm; a rise of the logarithm is a factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.disagreement import Floats, Ints, member_mean, paired_design, parts_of
from airswing.flags import is_corrected
from airswing.products.ragged import blocks, row_bounds

ANGLES = 5  # A, B, C, D, E
UNKNOWNS = 12
"""A to E, sin 3m, cos 3m, sin 4m, cos 4m (radians), airspeed scale, b_u, b_v (m/s)."""
FLIGHT_BIAS_PRECISION = 1.0
"""Error variance of a report over that of a flight's bias: correlation of 0.5 within a flight."""
GROSS = 8.0
"""Robust standard deviations from a first fit beyond which a report is left out."""
LEAST = 0.3
"""m/s: smaller differences are taken as this, so that rounding does not enter the logarithm."""


@dataclass(frozen=True)
class CompassDays:
    """Normal equations of one row an aircraft and day, sorted by aircraft and day."""

    aircraft: Ints  # (row,)
    day: Ints  # (row,): days since 1970
    normal: NDArray[np.float32]  # (row, 12, 12)
    right: NDArray[np.float32]  # (row, 12)


@dataclass(frozen=True)
class WindDays:
    """Disagreement with the reference of one row an aircraft and day, sorted likewise.

    Every day with a report has a row; its ``count`` is 0 where screening left none.
    """

    aircraft: Ints  # (row,)
    day: Ints  # (row,)
    count: Floats  # (row,): reports used
    difference: Floats  # (row,): summed wind vector difference, m/s
    log_difference: Floats  # (row,): summed natural logarithm of it

    def until(self, last: int) -> WindDays:
        """Rows up to a day, inclusive."""
        chosen = self.day <= last
        return WindDays(*(values[chosen] for values in vars(self).values()))


def compass_days(headings: xr.Dataset, members: list[str], *, abscissa: str) -> CompassDays:
    """Sum the reports of a fleet, against the mean of some references, for changes of compasses.

    ``abscissa`` is the argument of the deviation: ``magnetic`` or ``true``.
    """
    argument = "magnetic_heading" if abscissa == "magnetic" else "heading"
    names = ["heading_error", "airspeed_error", "airspeed", "heading", argument]
    none = np.zeros(0, np.int64)
    parts: list[tuple[NDArray[np.generic], ...]] = [
        (none, none, np.zeros((0, UNKNOWNS, UNKNOWNS), "f4"), np.zeros((0, UNKNOWNS), "f4"))
    ]
    first = 0
    for block in blocks(headings, [*names, "time", "flight", "screening"]):
        part = block.sel(reference=members)
        error, along = (member_mean(part[name]).to_numpy().astype(float) for name in names[:2])
        airspeed, heading, magnetic = (block[name].to_numpy().astype(float) for name in names[2:])
        good = np.isfinite(error + along + airspeed + heading + magnetic)
        good &= block["screening"].to_numpy() == 0
        columns = (
            np.radians(magnetic),
            np.radians(heading),
            airspeed,
            airspeed * np.radians(error),
            along,
            block["time"].to_numpy().astype("datetime64[D]").astype(np.int64),
            block["flight"].to_numpy().astype(np.int64),
        )
        bounds = zip(*row_bounds(block["row_size"].to_numpy()), strict=True)
        for number, (start, stop) in enumerate(bounds, first):
            rows = np.flatnonzero(good[start:stop]) + start
            if rows.size:
                days, normal, right = normal_equations_by_day(*(one[rows] for one in columns))
                # in single precision: a large fleet has millions of these matrices
                sums = normal.astype(np.float32), right.astype(np.float32)
                parts.append((np.full(days.size, number), days, *sums))
        first += block.sizes["aircraft"]
    return CompassDays(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def normal_equations_by_day(
    magnetic: Floats,
    heading: Floats,
    airspeed: Floats,
    cross: Floats,
    along: Floats,
    day: Ints,
    flight: Ints,
) -> tuple[Ints, Floats, Floats]:
    """Normal equations of one aircraft by day, each flight's bias eliminated.

    Headings (n,) in radians, speeds in m/s; ``cross`` is airspeed times heading error, ``along``
    the airspeed error. Returns the days (d,), normal matrices (d, 12, 12) and right sides (d, 12).
    """
    across, ahead = compass_design(magnetic, heading, airspeed)
    kept = np.flatnonzero(_not_gross(across, ahead, cross, along))
    order = kept[np.lexsort((flight[kept], day[kept]))]
    # a flight past midnight is one flight of each day
    new = (np.diff(day[order]) != 0) | (np.diff(flight[order]) != 0)
    start = np.flatnonzero(np.append(order.size > 0, new))
    one, two, y_one, y_two = across[order], ahead[order], cross[order], along[order]
    normal, right = np.empty((start.size, UNKNOWNS, UNKNOWNS)), np.empty((start.size, UNKNOWNS))
    # by pairs of columns: no loop over flights, and no matrix for each report
    for i in range(UNKNOWNS):
        right[:, i] = np.add.reduceat(one[:, i] * y_one + two[:, i] * y_two, start)
        for j in range(i, UNKNOWNS):
            products = one[:, i] * one[:, j] + two[:, i] * two[:, j]
            normal[:, i, j] = normal[:, j, i] = np.add.reduceat(products, start)
    normal, right = without_flight_bias(normal, right)
    days, first = np.unique(day[order], return_index=True)
    place = np.searchsorted(start, first)
    return days, np.add.reduceat(normal, place), np.add.reduceat(right, place)


def compass_design(magnetic: Floats, heading: Floats, airspeed: Floats) -> tuple[Floats, Floats]:
    """Rows of a report's two equations in the unknowns :data:`UNKNOWNS`, each (n, 12).

    Headings in radians, airspeed in m/s.
    """
    cross, along = paired_design(magnetic, heading, airspeed)
    waves = [wave(k * magnetic) for k in (3, 4) for wave in (np.sin, np.cos)]
    place = [ANGLES] * len(waves)
    higher = airspeed[:, np.newaxis] * np.column_stack(waves)
    return np.insert(cross, place, higher, axis=1), np.insert(along, place, 0.0, axis=1)


def without_flight_bias(normal: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Eliminate a bias of the reference's wind of each flight, a random effect.

    ``normal`` (..., p, p) and ``right`` (..., p) are of one flight each; the columns of b_u, b_v
    come last.
    """
    side = normal[..., -2:]
    inside = side[..., -2:, :] + FLIGHT_BIAS_PRECISION * np.eye(2)
    gain = np.swapaxes(np.linalg.solve(inside, np.swapaxes(side, -1, -2)), -1, -2)
    return (
        normal - gain @ np.swapaxes(side, -1, -2),
        right - np.einsum("...ij,...j->...i", gain, right[..., -2:]),
    )


def _not_gross(across: Floats, ahead: Floats, cross: Floats, along: Floats) -> NDArray[np.bool_]:
    """Reports within :data:`GROSS` robust standard deviations of a first fit."""
    keep = np.isfinite(cross + along)
    for _ in range(2):
        one, two = (rows if keep.all() else rows[keep] for rows in (across, ahead))
        theta = np.linalg.pinv(one.T @ one + two.T @ two, hermitian=True) @ (
            one.T @ cross[keep] + two.T @ along[keep]
        )
        distance = np.hypot(cross - across @ theta, along - ahead @ theta)
        # the median of a Rayleigh variable is 1.177 times its parameter
        keep = distance < GROSS * np.nanmedian(distance[keep]) / 1.177
    return np.asarray(keep)


def wind_days(
    headings: xr.Dataset, members: list[str], *, corrected: xr.Dataset | None = None
) -> WindDays:
    """Sum the wind vector differences of a fleet from the mean of some references, by day.

    Corrected winds, where given, are used where a correction was applied.
    """
    tables = []
    for part in parts_of(headings, {"": members}, ["screening"], corrected):
        applied = False if part.applied is None else is_corrected(part.applied)
        wind = np.where(applied, part.corrected, part.wind)
        difference = np.hypot(*(wind - part.model[""]))
        used = (part.column("screening") == 0) & np.isfinite(difference)
        values = {
            "count": used * 1.0,
            "difference": np.where(used, difference, 0.0),
            "log_difference": np.where(used, np.log(np.maximum(difference, LEAST)), 0.0),
        }
        frame = pd.DataFrame({"aircraft": part.aircraft, "day": part.day} | values)
        tables.append(frame.groupby(["aircraft", "day"], as_index=False).sum())
    whole = pd.concat(tables)
    return WindDays(*(whole[name].to_numpy() for name in WindDays.__dataclass_fields__))


def rows_by_aircraft(aircraft: Ints, number: int) -> list[slice]:
    """Rows of each aircraft, in sorted sums."""
    edges = np.searchsorted(aircraft, np.arange(number + 1))
    return [slice(int(low), int(high)) for low, high in pairwise(edges)]
