"""One model time's winds at its reports, whatever the model winds are stored in.

Linear in the logarithm of pressure in each column of the model, then bilinear in the grid's
index space, both along the grid; the components are turned to true east and north at the
points, after interpolation, as the grid's flag asks.

What is stored is asked for, not read: :func:`winds_at` is a generator that yields lists of
(row of a field, points of the grid) and is sent their values, so that a reader can serve many
model times from one chunk of a file. It asks once for isobaric levels; for native levels first
for the pressure of all levels, then for the winds between which the reports lie.

Assumptions and validity
------------------------
* Levels of one model time share one grid. Isobaric levels have one pressure; native levels have
  one in every column.
* A wind over 150 m s-1 is none: no atmosphere has it.
* Every report's value depends on that report alone: results are identical bit for bit however
  reports are divided among calls.
"""

from __future__ import annotations

import itertools
from collections.abc import Generator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from airswing.physics.triangle import wrap_signed
from airswing.reference.geometry.interpolation import (
    Brackets,
    Corners,
    bilinear,
    bilinear_slopes,
    corners,
    level_brackets,
    weighted,
)
from airswing.reference.geometry.placing import Placing
from airswing.units import MODEL_EARTH_RADIUS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Asked = list[tuple[np.void, Ints]]
"""Rows of fields and the points (any shape) at which their values are wanted."""
Winds = Generator[Asked, list[Floats], Floats]

MAX_WIND = 150.0
"""m s-1: the limit reports have, too; the fastest jet streams measured reach 110 to 120."""
#: Rows of a sample's table, without and with derivatives.
WINDS = ("u", "v")
DERIVATIVES = ("u_lnp", "v_lnp", "u_x", "v_x", "u_y", "v_y", "convergence")
#: Half step of the central differences that give the grid's metric (degrees).
_METRIC_STEP = 1e-3


class Profile(Protocol):
    """One model time as sampling sees it: a grid, and a row a level of u, v and pressure."""

    @property
    def grid(self) -> Placing:
        """Where the columns are."""

    @property
    def native(self) -> bool:
        """Levels have a pressure field; else `level` of the rows is the pressure, Pa."""

    @property
    def u(self) -> NDArray[np.void]:
        """A row a level."""

    @property
    def v(self) -> NDArray[np.void]:
        """A row a level."""

    @property
    def pressure(self) -> NDArray[np.void]:
        """A row a level of native levels, else empty."""


def winds_at(
    model: Profile, latitude: Floats, longitude: Floats, pressure: Floats, *, derivatives: bool
) -> Winds:
    """Ask for what the winds at some reports (degrees, Pa) need, and make them of it.

    With ``derivatives`` also those by ln p, eastward and northward distance, and the grid's
    convergence.

    Returns
    -------
    (2 or 9, n) float array
        Rows `WINDS` then `DERIVATIVES`: m s-1, true east and north; per ln p; s-1; rad.
    """
    rows = len(WINDS) + (len(DERIVATIVES) if derivatives else 0)
    table = np.full((rows, latitude.size), np.nan)
    fi, fj = model.grid.fractional_index(latitude, longitude)
    place = np.flatnonzero(np.isfinite(fi) & np.isfinite(fj) & np.isfinite(pressure))
    if place.size == 0:
        return table
    cell = corners(model.grid, fi[place], fj[place])
    at, nodes = pressure[place], cell.points
    if model.native:  # levels lie otherwise in each column
        # Four columns a report, each a place of its own until the levels are found.
        at, nodes = np.tile(at, 4), nodes.reshape(1, -1)
        asked = [(row, nodes[0]) for row in model.pressure]
        levels, top_down = _from_the_top(np.stack((yield asked)))
    else:
        levels, top_down = np.asarray(model.u["level"], dtype=np.float64), True
    brackets = level_brackets(levels, at, both=derivatives)
    u, v = (model.u, model.v) if top_down else (model.u[::-1], model.v[::-1])
    values = yield from _between_levels(u, v, nodes, brackets, both=derivatives)
    lat, lon = latitude[place], longitude[place]
    found = _to_true(model.grid, values, brackets, cell, lat, lon, derivatives)
    with np.errstate(invalid="ignore", over="ignore"):
        found[:, ~(np.hypot(found[0], found[1]) <= MAX_WIND)] = np.nan
    table[:, place] = found
    return table


def _from_the_top(levels: Floats) -> tuple[Floats, bool]:
    """Level pressures by increasing pressure, and whether they came in that order.

    Native levels are numbered from the ground up by some models, from the top down by others.
    """
    if np.nansum(levels[-1] - levels[0]) < 0:
        return levels[::-1], False
    return levels, True


def _between_levels(
    u: NDArray[np.void], v: NDArray[np.void], points: Ints, brackets: Brackets, *, both: bool
) -> Generator[Asked, list[Floats], Floats]:
    """(2, 2, c, n): u and v on the level above and below, at the c columns of each bracket."""
    columns = points.shape[0]
    values = np.zeros((2, 2, *points.shape))
    values[..., ~brackets.inside] = np.nan
    inside = np.flatnonzero(brackets.inside)
    weight = brackets.weight[inside]
    upper = inside if both else inside[weight < 1.0]
    lower = inside if both else inside[weight > 0.0]
    if u.size == 1:
        lower = lower[:0]
    level = np.concatenate([brackets.k[upper], brackets.k[lower] + 1])
    side = np.repeat([0, 1], [upper.size, lower.size])
    node = np.concatenate([upper, lower])
    # Numbers of levels are small, and 16 bits are sorted by their digits.
    order = np.argsort(level.astype("i2" if u.size < 2**15 else "i8"), kind="stable")
    level, side, node = level[order], side[order], node[order]
    edges = np.flatnonzero(np.diff(level, prepend=-1, append=-1))  # none where none is inside
    groups = [slice(start, stop) for start, stop in itertools.pairwise(edges)]
    asked: Asked = []
    for group in groups:
        number, wanted = int(level[group.start]), points[:, node[group]].ravel()
        asked += [(u[number], wanted), (v[number], wanted)]
    found = (yield asked) if asked else []
    for group, one, two in zip(groups, found[::2], found[1::2], strict=True):
        for component, got in enumerate((one, two)):
            values[component, side[group], :, node[group]] = got.reshape(columns, -1).T
    return values


def _to_true(
    grid: Placing,
    values: Floats,
    brackets: Brackets,
    cell: Corners,
    lat: Floats,
    lon: Floats,
    derivatives: bool,
) -> Floats:
    """Combine levels and columns, and turn to true east and north."""
    weight = brackets.weight
    columns = [weighted(pair, (1.0 - weight, weight)).reshape(4, cell.x.size) for pair in values]
    mixed = [bilinear(column, cell.x, cell.y) for column in columns]
    convergence = grid.convergence(lat, lon)
    angle = convergence if grid.wind_along_grid else np.zeros_like(lat)
    wind = _turned(mixed[0], mixed[1], angle)
    if not derivatives:
        return np.stack(wind)
    depth = brackets.lower - brackets.upper
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes_in_columns = [
            ((pair[1] - pair[0]) / depth).reshape(4, cell.x.size) for pair in values
        ]
    u_shear, v_shear = (bilinear(one, cell.x, cell.y) for one in slopes_in_columns)
    shear = _turned(u_shear, v_shear, angle)
    for along in zip(*(bilinear_slopes(one, cell.x, cell.y) for one in columns), strict=True):
        mixed += along
    slopes = _true_slopes(grid, mixed, wind, angle, lat, lon)
    # The grid's own angle whatever the flag says: a wrong flag is told by it.
    return np.stack([*wind, *shear, *slopes, convergence])


def _turned(u: Floats, v: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """Grid components to true east and north."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * u + sine * v, -sine * u + cosine * v


def _true_slopes(
    grid: Placing,
    mixed: list[Floats],
    wind: tuple[Floats, Floats],
    angle: Floats,
    lat: Floats,
    lon: Floats,
) -> list[Floats]:
    """Derivatives of the true components eastward and northward, s-1.

    The chain rule over index space, with the change of the grid's direction
    along the way: ``du_e = cos du_g + sin dv_g + v_e da``.
    """
    result: list[Floats] = []
    for step_lat, step_lon in ((0.0, _METRIC_STEP), (_METRIC_STEP, 0.0)):
        # A degree of longitude is shorter by the cosine of latitude.
        stretch = np.cos(np.radians(lat)) if step_lon else np.ones_like(lat)
        distance = 2.0 * np.radians(_METRIC_STEP) * MODEL_EARTH_RADIUS * stretch
        one = (lat + step_lat, lon + step_lon)
        two = (lat - step_lat, lon - step_lon)
        (i1, j1), (i0, j0) = grid.plane(*one), grid.plane(*two)
        di, dj = (_short(grid, i1 - i0)) / distance, (j1 - j0) / distance
        turning = np.zeros_like(lat)
        if grid.wind_along_grid:
            turned = grid.convergence(*one) - grid.convergence(*two)
            # The short way round: directions may differ by a whole turn.
            turning = wrap_signed(turned) / distance
        u, v = _turned(mixed[2] * di + mixed[4] * dj, mixed[3] * di + mixed[5] * dj, angle)
        result += [u + wind[1] * turning, v - wind[0] * turning]
    return result


def _short(grid: Placing, steps: Floats) -> Floats:
    """Column differences across the seam of a full circle taken the short way."""
    turn = grid.columns_in_a_turn
    if turn:
        return np.asarray(np.mod(steps + turn / 2.0, turn) - turn / 2.0)
    return steps
