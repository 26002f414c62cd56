"""The wind profile of one model time, and its winds at reports.

Linear in the logarithm of pressure in each column of the model, then bilinear in the grid's index
space, both along the grid; then the components are rotated to true east and north at the reports.
If u, v and pressure lie on different points, each is interpolated on its grid and the pressure of
native levels is that at the report. Nothing is extrapolated. A missing corner with nonzero weight
makes the value missing. A report's value depends only on that report.
"""

from __future__ import annotations

import itertools
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.physics.triangle import wrap_signed
from airswing.reference.files import SourceFile
from airswing.reference.grids import Floats, Grid, Ints, are_shifted
from airswing.units import MODEL_EARTH_RADIUS

Table = NDArray[np.void]
Request = list[tuple[np.void, Ints]]
"""Rows of fields and the points (any shape) at which their values are needed."""
Winds = Generator[Request, list[Floats], Floats]

U, V, PRESSURE, SURFACE = 0, 1, 2, 3
"""Kinds of field; SURFACE is the surface pressure of hybrid levels."""
ISOBARIC, HYBRID = 0, 1  # kinds of level; further ones are GRIB level types
GIVEN = "given"  # engine of Datasets given in Python
MAX_WIND = 150.0  # m/s; the fastest jet streams measured reach 110 to 120 m/s
MAX_PRESSURE = 120_000.0  # Pa
_METRIC_STEP = 1e-3  # degrees, half the step of the differences that give the grid's metric


def limits(kind: int) -> tuple[float, float]:
    """Lowest and highest possible value of a field of a kind: m/s, or Pa."""
    return (-MAX_WIND, MAX_WIND) if kind < PRESSURE else (0.0, MAX_PRESSURE)


class StoredField(NamedTuple):
    """How the fields of one variable of a Dataset are read."""

    names: tuple[str, ...]  # variables, summed
    dims: tuple[str, ...]
    outer: tuple[tuple[str, int], ...]  # dimensions that a row's `index` counts, and their sizes
    y: str  # dimensions of rows and columns
    x: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]  # length of a chunk along each outer dimension
    scale: float = 1.0  # to SI units
    # "x" or "y": points lie half a grid length before the grid's along this axis, and one more
    # follows the last: the mean of two neighbours counts
    stagger: str = ""
    exponential: bool = False  # the logarithm is stored
    either: str = ""  # dimension along which the first value that is not missing counts

    def places(self, index: NDArray[np.integer]) -> dict[str, NDArray[np.int64]]:
        """Indices along the outer dimensions of rows' `index`."""
        places = np.unravel_index(index, [n for _, n in self.outer]) if self.outer else ()
        return {d: np.asarray(place) for (d, _), place in zip(self.outer, places, strict=True)}

    def chunk_numbers(self, index: NDArray[np.integer]) -> Ints:
        """Numbers of the chunks that hold rows' `index`; rows and columns count as one chunk."""
        number = np.zeros(np.shape(index), dtype=np.int64)
        for (_, size), step, place in zip(
            self.outer, self.chunks, self.places(index).values(), strict=True
        ):
            number = number * size + place // step
        return number


#: A row is one field of one level. Rows of GRIB and of Datasets share most columns. Of Datasets
#: `index` counts the fields of a variable over its outer dimensions; the value of a pressure is
#: ``a + b * field``; `offset` numbers the stored field, `points` the grid of the field, and `grid`
#: that of the profile it belongs to.
ROW_DTYPE = np.dtype(
    [
        *[(name, "i4") for name in ("file", "offset", "member", "grid", "points", "index")],
        *[(name, "i2") for name in ("subindex", "kind", "level_kind")],
        *[(name, "f8") for name in ("level", "a", "b")],
        *[(name, "i8") for name in ("valid", "lead")],
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class ModelTime:
    """The wind profile of one valid time, small enough to send to another process."""

    grids: tuple[Grid, ...]  # of the rows
    rows: Table  # (2 or 3, level): of u, v and, of native levels, pressure; isobaric by pressure
    files: tuple[SourceFile, ...]  # as the rows' ``file`` numbers them
    stored: tuple[StoredField, ...]  # as the rows' ``offset`` numbers them; empty for GRIB
    engine: str


def on_one_grid(table: Table, grids: Sequence[Grid]) -> Table:
    """Give v and pressure the grid number of u if they lie on points shifted against u's.

    The number of the grid of a row itself is kept in ``points``.
    """
    table["points"] = table["grid"]
    numbers = {kind: np.unique(table["grid"][table["kind"] == kind]).tolist() for kind in range(4)}
    for kind in (V, PRESSURE, SURFACE):
        for number in set(numbers[kind]) - set(numbers[U]):
            shifted = (n for n in numbers[U] if are_shifted(grids[n], grids[number]))
            mine = (table["kind"] == kind) & (table["points"] == number)
            table["grid"][mine] = next(shifted, number)
    return table


class Corners(NamedTuple):
    """Corner points (4, n) of each report's cell and its place in the cell, 0 to 1."""

    points: Ints
    x: Floats
    y: Floats


def corners(grid: Grid, fi: Floats, fj: Floats) -> Corners:
    """Corner points of the cells of fractional indices inside the grid (no NaN).

    (i, j), (i+1, j), (i, j+1), (i+1, j+1), as places in the stored values.
    """
    i = np.floor(fi).astype(np.int64)
    if not grid.periodic:
        i = np.clip(i, 0, max(grid.ni - 2, 0))
    j = np.clip(np.floor(fj).astype(np.int64), 0, max(grid.nj - 2, 0))
    x, y = fi - i, fj - j
    i0, i1 = i % grid.ni, (i + 1) % grid.ni if grid.periodic else np.minimum(i + 1, grid.ni - 1)
    j1, position = np.minimum(j + 1, grid.nj - 1), grid.position
    points = np.stack([position(i0, j), position(i1, j), position(i0, j1), position(i1, j1)])
    return Corners(points, x, y)


def bilinear(values: Floats, x: Floats, y: Floats) -> Floats:
    """Interpolate corner values (4, ..., n); corners without weight are not used."""
    return _weighted(values, ((1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y))


def _weighted(values: Floats, weights: Sequence[Floats]) -> Floats:
    total = np.zeros(values.shape[1:])
    for value, weight in zip(values, weights, strict=True):
        total += np.where(weight == 0.0, 0.0, weight * value)
    return total


class Brackets(NamedTuple):
    """Levels around each report."""

    k: Ints  # level above
    weight: Floats  # of the level below, k + 1
    inside: NDArray[np.bool_]  # whether the report lies between levels
    upper: Floats  # ln p of both levels
    lower: Floats


def level_brackets(levels: Floats, pressure: Floats, *, two: bool = False) -> Brackets:
    """Levels around each report and the weight of the lower one, linear in ln p.

    Levels (level,) or (level, n) increase along the first axis; pressures (n,), Pa. With `two`
    two levels are named (derivatives need them) also on a level; else `weight` is 0 on level `k`
    itself, and `k + 1` is not needed.
    """
    count = levels.shape[0]
    if levels.ndim == 1:
        levels = levels[:, np.newaxis]
        k = np.searchsorted(levels[:, 0], pressure, side="right") - 1
    else:
        with np.errstate(invalid="ignore"):
            k = (levels <= pressure).sum(axis=0) - 1
    columns = np.arange(pressure.size) if levels.shape[1] > 1 else 0
    k = np.clip(k, 0, count - 2 if two and count > 1 else count - 1)
    below = np.minimum(k + 1, count - 1)
    first, second = levels[k, columns], levels[below, columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        # levels below the ground may be missing
        inside = (pressure >= levels[0]) & (pressure <= np.fmax.reduce(levels, axis=0))
        upper, lower, lnp = np.log(first), np.log(second), np.log(pressure)
        weight = np.where(pressure == first, 0.0, (lnp - upper) / (lower - upper))
        weight = np.where(pressure == second, np.where(below > k, 1.0, 0.0), weight)
    return Brackets(k, weight, inside & np.isfinite(weight), upper, lower)


def winds_at(
    model: ModelTime, latitude: Floats, longitude: Floats, pressure: Floats, *, derivatives: bool
) -> Winds:
    """Request the values that the winds at reports (degrees, Pa) need, and compute the winds.

    (2 or 9, n) float: u and v in m/s, true east and north; with `derivatives` also those of both by
    ln p (m/s), eastward and northward (1/s), and the grid's convergence (rad).
    """
    table, grids = np.full((9 if derivatives else 2, latitude.size), np.nan), model.grids
    one_grid = all(grid.key == grids[0].key for grid in grids)
    indices = [g.fractional_index(latitude, longitude) for g in (grids[:1] if one_grid else grids)]
    inside = np.isfinite(pressure)
    for fi, fj in indices:
        inside &= np.isfinite(fi) & np.isfinite(fj)
    place = np.flatnonzero(inside)
    if place.size == 0:
        return table
    cells = [corners(g, fi[place], fj[place]) for g, (fi, fj) in zip(grids, indices, strict=False)]
    cells = cells * 2 if one_grid else cells
    at, nodes = pressure[place], [cell.points for cell in cells[:2]]
    descending = False
    if len(model.rows) > 2:
        if one_grid:  # four columns a report, each with other levels
            at, nodes = np.tile(at, 4), [cells[0].points.reshape(1, -1)] * 2
            levels = np.stack((yield [(row, nodes[0][0]) for row in model.rows[2]]))
        else:
            cell = cells[2]
            asked = yield [(row, cell.points) for row in model.rows[2]]
            levels = np.stack([bilinear(pressures, cell.x, cell.y) for pressures in asked])
        # native levels are numbered from the ground up by some models, downwards by others
        descending = bool(np.nansum(levels[-1] - levels[0]) < 0)
        levels = levels[::-1] if descending else levels
    else:
        levels = np.asarray(model.rows["level"][0], dtype=np.float64)
    brackets = level_brackets(levels, at, two=derivatives)
    step, weight = -1 if descending else 1, brackets.weight
    values = yield from _between_levels(model.rows[:2, ::step], nodes, brackets, two=derivatives)

    def across(component: int, columns: Floats) -> Floats:
        cell = cells[component]
        return bilinear(columns.reshape(4, place.size), cell.x, cell.y)

    lat, lon = latitude[place], longitude[place]
    columns = [_weighted(pair, (1.0 - weight, weight)) for pair in values]
    convergence = grids[0].convergence(lat, lon)
    angle = convergence if grids[0].wind_along_grid else np.zeros_like(lat)
    wind = rotated(across(0, columns[0]), across(1, columns[1]), angle)
    result = np.stack(wind)
    if derivatives:
        with np.errstate(divide="ignore", invalid="ignore"):
            shears = (values[:, 1] - values[:, 0]) / (brackets.lower - brackets.upper)
        shear = rotated(across(0, shears[0]), across(1, shears[1]), angle)
        columns = [column.reshape(4, place.size) for column in columns]
        slopes = _true_slopes(model.grids, columns, cells, wind, angle, lat, lon)
        # the grid's angle regardless of the flag, by which a wrong flag is recognised
        result = np.stack([*wind, *shear, *slopes, convergence])
    with np.errstate(invalid="ignore", over="ignore"):
        result[:, ~(np.hypot(result[0], result[1]) <= MAX_WIND)] = np.nan
    table[:, place] = result
    return table


def _between_levels(
    fields: Table, nodes: Sequence[Ints], brackets: Brackets, *, two: bool
) -> Generator[Request, list[Floats], Floats]:
    """(2, 2, c, n): u and v on the level above and below, at the c columns of each bracket."""
    count, columns = fields.shape[1], nodes[0].shape[0]
    values = np.zeros((2, 2, *nodes[0].shape))
    values[..., ~brackets.inside] = np.nan
    inside = np.flatnonzero(brackets.inside)
    weight = brackets.weight[inside]
    upper = inside if two else inside[weight < 1.0]
    lower = inside if two else inside[weight > 0.0]
    if count == 1:
        lower = lower[:0]
    level = np.concatenate([brackets.k[upper], brackets.k[lower] + 1])
    side = np.repeat([0, 1], [upper.size, lower.size])
    node = np.concatenate([upper, lower])
    # numbers of levels are small, and 16 bits are sorted by their digits
    order = np.argsort(level.astype("i2" if count < 2**15 else "i8"), kind="stable")
    level, side, node = level[order], side[order], node[order]
    edges = np.flatnonzero(np.diff(level, prepend=-1, append=-1))
    groups = [slice(start, stop) for start, stop in itertools.pairwise(edges)]
    asked: Request = []
    for group in groups:
        points = nodes[0][:, node[group]].ravel()
        v_points = points if nodes[0] is nodes[1] else nodes[1][:, node[group]].ravel()
        u, v = fields[:, level[group.start]]
        asked += [(u, points), (v, v_points)]
    answers = (yield asked) if asked else []
    for group, u_values, v_values in zip(groups, answers[::2], answers[1::2], strict=True):
        for component, got in enumerate((u_values, v_values)):
            values[component, side[group], :, node[group]] = got.reshape(columns, -1).T
    return values


def rotated(u: Floats, v: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """True components of a wind from those along a grid, by its convergence (rad)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * u + sine * v, -sine * u + cosine * v


def _true_slopes(
    grids: Sequence[Grid],
    columns: Sequence[Floats],
    cells: Sequence[Corners],
    wind: tuple[Floats, Floats],
    angle: Floats,
    lat: Floats,
    lon: Floats,
) -> list[Floats]:
    """Derivatives of the true components eastward and northward, 1/s.

    The chain rule over index space, with the change of the grid's direction along the way:
    ``du_e = cos du_g + sin dv_g + v_e da``.
    """
    result: list[Floats] = []
    for step_lat, step_lon in ((0.0, _METRIC_STEP), (_METRIC_STEP, 0.0)):
        # a degree of longitude is shorter by the cosine of latitude
        stretch = np.cos(np.radians(lat)) if step_lon else np.ones_like(lat)
        distance = 2.0 * np.radians(_METRIC_STEP) * MODEL_EARTH_RADIUS * stretch
        ahead, behind = (lat + step_lat, lon + step_lon), (lat - step_lat, lon - step_lon)
        slopes = []
        for grid, column, cell in zip(grids, columns, cells, strict=False):
            (i1, j1), (i0, j0) = grid.plane(*ahead), grid.plane(*behind)
            di, dj = i1 - i0, (j1 - j0) / distance
            if grid.periodic:  # the short way across the seam
                di = np.mod(di + grid.ni / 2.0, grid.ni) - grid.ni / 2.0
            di = di / distance
            x, y = cell.x, cell.y
            by_i = _weighted(column, (y - 1, 1 - y, -y, y))
            by_j = _weighted(column, (x - 1, -x, 1 - x, x))
            slopes.append(by_i * di + by_j * dj)
        turning = np.zeros_like(lat)
        if grids[0].wind_along_grid:
            turned = grids[0].convergence(*ahead) - grids[0].convergence(*behind)
            turning = wrap_signed(turned) / distance
        u, v = rotated(slopes[0], slopes[1], angle)
        result += [u + wind[1] * turning, v - wind[0] * turning]
    return result
