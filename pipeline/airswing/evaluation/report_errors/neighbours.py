"""Pairs of neighbouring reports of different aircraft, and what their disagreements share.

Two aircraft that meet see the same error of the reference and the same weather; what their
differences from the reference do not share is the reports' own. Half the mean squared difference of
two neighbours' differences, carried to no separation at all, is the error variance of the reports
(the intercept of Hollingsworth & Loennberg 1986, Tellus 38A, 111-136, in the form of a variogram:
as it never needs the reference's total variance, what differs from region to region cancels).

Assumes errors of different aircraft are independent of each other, and motion of the air finer than
the nearest pairs counts as error of the reports. Near means within `REACH`. Plain arrays, SI units,
degrees for places, seconds for time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.units import MODEL_EARTH_RADIUS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = (30_000.0, 0.06, 1350.0)  # Separation at which a pair is no longer near: m, ln p, s
# Of what the reference's own error grows by with separation.
TERMS = 4
# Reports of a day looked at together; of more, some are drawn.
_MOST_AT_ONCE = 20_000


class Pairs(NamedTuple):
    """Neighbouring reports of different aircraft."""

    # first, second: (pair,): places of the two reports
    first: Ints
    second: Ints
    separation: Floats  # (pair, 3): distance, difference of ln p and of time, in units of `REACH`

    def some(self, chosen: Ints) -> Pairs:
        """Those at given places."""
        return Pairs(self.first[chosen], self.second[chosen], self.separation[chosen])


def neighbouring_pairs(
    latitude: Floats, longitude: Floats, pressure: Floats, time: Floats, aircraft: Ints
) -> Pairs:
    """Find the pairs of reports of different aircraft that are near.

    Parameters
    ----------
    latitude, longitude : arrays, shape (report,), degrees
    pressure : array, Pa
    time : array, s
    """
    from scipy.spatial import cKDTree

    chosen = np.arange(latitude.size)
    if chosen.size > _MOST_AT_ONCE:
        drawn = np.random.default_rng(chosen.size).permutation(chosen)
        chosen = np.sort(drawn[:_MOST_AT_ONCE])
    phi, lam = np.radians(latitude[chosen]), np.radians(longitude[chosen])
    east, north = np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam)
    place = np.stack([east, north, np.sin(phi)], axis=1) * (MODEL_EARTH_RADIUS / REACH[0])
    where = np.column_stack([place, np.log(pressure[chosen]) / REACH[1], time[chosen] / REACH[2]])
    found = cKDTree(where).query_pairs(1.0, output_type="ndarray").astype(np.int64)
    owner = aircraft[chosen]
    found = found[owner[found[:, 0]] != owner[found[:, 1]]]
    apart = np.abs(where[found[:, 0]] - where[found[:, 1]])
    distance = np.sqrt((apart[:, :3] ** 2).sum(axis=1))
    separation = np.column_stack([distance, apart[:, 3], apart[:, 4]])
    return Pairs(chosen[found[:, 0]], chosen[found[:, 1]], separation)


def separation_terms(separation: Floats) -> Floats:
    """How the reference's error parts with separation: a smooth field's first two even terms.

    A correlation that is smooth at no separation falls off as a square there, and less than that
    further out: the squares of the three parts, and the fourth power of the whole.

    Parameters
    ----------
    separation : array, shape (pair, 3)

    Returns
    -------
    array, shape (pair, 4)
    """
    squares = separation**2
    return np.column_stack([squares, squares.sum(axis=1) ** 2])


def half_squares(east: Floats, north: Floats, pairs: Pairs) -> Floats:
    """Half the squared difference of two neighbours, the mean of both components.

    Parameters
    ----------
    east, north : arrays, shape (report,)
        Report minus reference, m/s.

    Returns
    -------
    array, shape (pair,), m2/s2
    """
    du = east[pairs.first] - east[pairs.second]
    dv = north[pairs.first] - north[pairs.second]
    # half for two components, half for two reports: the error variance of one
    return 0.25 * (du**2 + dv**2)


def day_equations(design: Floats, values: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Normal equations of one day.

    Parameters
    ----------
    design : array, shape (pair, column)
    values, weights : arrays, shape (pair,)

    Returns
    -------
    matrix : array, shape (column, column)
    right : array, shape (column,)
    """
    weighted = design * weights[:, None]
    return weighted.T @ design, weighted.T @ values
