"""One model time in, winds at its reports out.

Bilinear in the grid's index space, linear in the logarithm of pressure, both
along the grid; the components are turned to true east and north at the
points, after interpolation, as each message's flag asks.

Assumptions and validity
------------------------
* A corner that is missing (bitmap) and has weight gives no value; a corner
  without weight is not looked at. Nothing is extrapolated, neither outside
  the grid nor above or below the levels.
* Levels of one model time share one grid. Isobaric levels have one pressure;
  native hybrid levels have a pressure field, interpolated like the wind.
* Every report's value depends on that report alone: results are identical bit
  for bit however reports are divided among calls.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.reference.fields import ISOBARIC
from airswing.reference.grids import Grid
from airswing.reference.packing import UnreadableMessageError
from airswing.reference.values import field_values

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Rows of a sample's table, without and with derivatives.
WINDS = ("u", "v")
DERIVATIVES = ("u_lnp", "v_lnp", "u_x", "v_x", "u_y", "v_y", "convergence")

#: Radius of the sphere on which distances for derivatives are measured (m).
EARTH_RADIUS = 6371229.0
#: Half step of the central differences that give the grid's metric (degrees).
_METRIC_STEP = 1e-3


class SourceFile(NamedTuple):
    """A file as the catalogue saw it."""

    path: str
    size: int
    mtime_ns: int
    sample: str


@dataclass(frozen=True, slots=True, eq=False)
class ModelTime:
    """One reference's wind profile at one valid time: where it lies, nothing decoded.

    Parameters
    ----------
    valid : int
        Valid time, ns since 1970.
    lead : int
        Lead time, s.
    grid : Grid
    level_kind : int
        `fields.ISOBARIC` or `fields.HYBRID`.
    u, v, pressure : (level,) arrays of `fields.FIELD_DTYPE`
        One row a level, isobaric levels by increasing pressure; `pressure` is
        empty for isobaric levels. ``file`` numbers `files`.
    files : tuple of SourceFile
    """

    valid: int
    lead: int
    grid: Grid
    level_kind: int
    u: NDArray[Any]
    v: NDArray[Any]
    pressure: NDArray[Any]
    files: tuple[SourceFile, ...]


NOT_OPENED, REPLACED = "cannot be opened", "replaced since it was catalogued"


def of_a_lost_file(reason: str) -> bool:
    """Whether a problem is of a file that vanished or changed, not of what stands in it.

    Parameters
    ----------
    reason : str
        Of `Sample.problems`.

    Returns
    -------
    bool
        Such a problem may be gone when the file is there again, though nothing tells it is another.
    """
    return reason.startswith((NOT_OPENED, REPLACED))


class Sample(NamedTuple):
    """Winds of one model time at its reports.

    `table` is (2 or 9, report): rows `WINDS` then `DERIVATIVES`, true east and
    north, m s-1; per ln p; s-1; rad. `problems` lists (file, reason) of what could not
    be read; `decoded` counts messages read, `octets` their length, and `seconds` is the
    time that reading and decoding them took.
    """

    table: Floats
    problems: tuple[tuple[str, str], ...]
    decoded: int
    octets: int = 0
    seconds: float = 0.0


class _Reader:
    """Values of fields at corner points, with unreadable files and messages noted once."""

    def __init__(self, model: ModelTime, *, sparse: bool) -> None:
        self.model, self.sparse = model, sparse
        self.problems: dict[tuple[str, str], None] = {}
        self.descriptors: dict[int, int] = {}
        self.decoded = self.octets = 0
        self.seconds = 0.0

    def close(self) -> None:
        for descriptor in self.descriptors.values():
            if descriptor >= 0:
                os.close(descriptor)

    def _descriptor(self, number: int) -> int:
        if number not in self.descriptors:
            self.descriptors[number] = self._open(self.model.files[number])
        return self.descriptors[number]

    def _open(self, file: SourceFile) -> int:
        try:
            descriptor = os.open(file.path, os.O_RDONLY)
        except OSError as error:
            self.problems[file.path, f"{NOT_OPENED}: {error.strerror}"] = None
            return -1
        status = os.fstat(descriptor)
        if (status.st_size, status.st_mtime_ns) != (file.size, file.mtime_ns):
            os.close(descriptor)
            self.problems[file.path, REPLACED] = None
            return -1
        return descriptor

    def values(self, row: Any, points: Ints) -> Floats:
        """(4, n) values at corner points, NaN where the field cannot be read."""
        number = int(row["file"])
        descriptor = self._descriptor(number)
        if descriptor < 0:
            return np.full(points.shape, np.nan)
        began = time.perf_counter()
        try:
            values = field_values(descriptor, row, self.model.grid.size, points, sparse=self.sparse)
        except (UnreadableMessageError, OSError) as error:
            place = f"message at {int(row['offset'])}: {error}"
            self.problems[self.model.files[number].path, place] = None
            return np.full(points.shape, np.nan)
        self.seconds += time.perf_counter() - began
        self.decoded += 1
        self.octets += int(row["length"])
        return values


class _Corners(NamedTuple):
    """Corner points (4, n) of each report's cell and its place in the cell, 0 to 1."""

    points: Ints
    x: Floats
    y: Floats


def corners(grid: Grid, fi: Floats, fj: Floats) -> _Corners:
    """Corner points and cell coordinates of fractional indices.

    Parameters
    ----------
    grid : Grid
    fi, fj : (n,) float arrays
        Inside the grid (no NaN).

    Returns
    -------
    points : (4, n) int array
        Places of (i, j), (i+1, j), (i, j+1), (i+1, j+1) in the message.
    x, y : (n,) float arrays
        Distance from the first corner, 0 to 1.
    """
    i = np.floor(fi).astype(np.int64)
    if not grid.periodic:
        i = np.clip(i, 0, max(grid.ni - 2, 0))
    j = np.clip(np.floor(fj).astype(np.int64), 0, max(grid.nj - 2, 0))
    x, y = fi - i, fj - j
    i0, i1 = i % grid.ni, (i + 1) % grid.ni if grid.periodic else np.minimum(i + 1, grid.ni - 1)
    j1 = np.minimum(j + 1, grid.nj - 1)
    position = grid.position
    points = np.stack([position(i0, j), position(i1, j), position(i0, j1), position(i1, j1)])
    return _Corners(points, x, y)


def bilinear(values: Floats, x: Floats, y: Floats) -> Floats:
    """Interpolate corner values; corners without weight are not looked at.

    Parameters
    ----------
    values : (4, ..., n) float array
        As `corners` orders them; NaN where missing.
    x, y : (n,) float arrays

    Returns
    -------
    (..., n) float array
    """
    return _weighted(values, ((1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y))


def bilinear_slopes(values: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the bilinear interpolant by x and by y (per grid length)."""
    return (
        _weighted(values, (y - 1, 1 - y, -y, y)),
        _weighted(values, (x - 1, -x, 1 - x, x)),
    )


def _weighted(values: Floats, weights: Sequence[Floats]) -> Floats:
    total = np.zeros(values.shape[1:])
    for value, weight in zip(values, weights, strict=True):
        total += np.where(weight == 0.0, 0.0, weight * value)
    return total


class _Brackets(NamedTuple):
    """Level above (k) and weight of the level below (k + 1) of each report.

    `inside`: the report lies between levels; `upper`, `lower`: ln p of both levels.
    """

    k: Ints
    weight: Floats
    inside: NDArray[np.bool_]
    upper: Floats
    lower: Floats


def level_brackets(levels: Floats, pressure: Floats, *, both: bool = False) -> _Brackets:
    """Levels around each report and the weight of the lower one, linear in ln p.

    Parameters
    ----------
    levels : (level,) or (level, n) float array, Pa
        Increasing along the first axis.
    pressure : (n,) float array, Pa
    both : bool
        Always name two levels (derivatives need them), even on a level.

    Returns
    -------
    k, weight, inside, upper, lower
        `weight` is 0 on level `k` itself; `k + 1` is then not needed unless `both`.
    """
    count = levels.shape[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        if levels.ndim == 1:
            k = np.searchsorted(levels, pressure, side="right") - 1
            inside = (pressure >= levels[0]) & (pressure <= levels[-1])
        else:
            k = (levels <= pressure).sum(axis=0) - 1
            inside = (pressure >= levels[0]) & (pressure <= levels[-1])
        highest = count - 2 if both and count > 1 else count - 1
        k = np.clip(k, 0, highest)
        below = np.minimum(k + 1, count - 1)
        columns = np.arange(pressure.size)
        first = levels[k] if levels.ndim == 1 else levels[k, columns]
        second = levels[below] if levels.ndim == 1 else levels[below, columns]
        upper, lower, lnp = np.log(first), np.log(second), np.log(pressure)
        weight = np.where(pressure == first, 0.0, (lnp - upper) / (lower - upper))
        weight = np.where(pressure == second, np.where(below > k, 1.0, 0.0), weight)
    return _Brackets(k, weight, inside & np.isfinite(weight), upper, lower)


def sample_model_time(
    model: ModelTime,
    latitude: Floats,
    longitude: Floats,
    pressure: Floats,
    *,
    sparse: bool = True,
    derivatives: bool = False,
) -> Sample:
    """Winds of one model time at reports.

    Parameters
    ----------
    model : ModelTime
    latitude, longitude : (n,) float arrays, degrees
    pressure : (n,) float array, Pa
    sparse : bool
        Read simply packed fields in place instead of decoding them whole.
    derivatives : bool
        Also give derivatives by ln p, eastward and northward distance, and the
        grid's convergence.

    Returns
    -------
    Sample
    """
    rows = len(WINDS) + (len(DERIVATIVES) if derivatives else 0)
    table = np.full((rows, latitude.size), np.nan)
    fi, fj = model.grid.fractional_index(latitude, longitude)
    place = np.flatnonzero(np.isfinite(fi) & np.isfinite(fj) & np.isfinite(pressure))
    if place.size == 0:
        return Sample(table, (), 0)
    cell = corners(model.grid, fi[place], fj[place])
    reader = _Reader(model, sparse=sparse)
    try:
        model, levels = _level_pressures(model, reader, cell)
        brackets = level_brackets(levels, pressure[place], both=derivatives)
        along = _along_grid(model, reader, cell, brackets, derivatives=derivatives)
    finally:
        reader.close()
    lat, lon = latitude[place], longitude[place]
    table[:, place] = _to_true(model.grid, along, brackets, lat, lon, derivatives=derivatives)
    problems = tuple(reader.problems)
    return Sample(table, problems, reader.decoded, reader.octets, reader.seconds)


def _level_pressures(model: ModelTime, reader: _Reader, cell: _Corners) -> tuple[ModelTime, Floats]:
    """Level pressures from the top down, and the model time in that order.

    Hybrid levels are numbered from the ground up by some models, from the top down by others.
    """
    if model.level_kind == ISOBARIC:
        return model, np.asarray(model.u["level"], dtype=np.float64)
    fields = [bilinear(reader.values(row, cell.points), cell.x, cell.y) for row in model.pressure]
    levels = np.stack(fields)
    if np.nansum(levels[-1] - levels[0]) < 0:
        levels = levels[::-1]
        model = replace(model, u=model.u[::-1], v=model.v[::-1], pressure=model.pressure[::-1])
    return model, levels


def _along_grid(
    model: ModelTime, reader: _Reader, cell: _Corners, brackets: _Brackets, *, derivatives: bool
) -> Floats:
    """(2 or 6, 2, n): u, v and their index slopes on the level above and below."""
    values = np.zeros((4, 2, 2, cell.x.size))
    values[..., ~brackets.inside] = np.nan
    inside = np.flatnonzero(brackets.inside)
    weight = brackets.weight[inside]
    upper = inside if derivatives else inside[weight < 1.0]
    lower = inside if derivatives else inside[weight > 0.0]
    if model.u.size == 1:
        lower = lower[:0]
    level = np.concatenate([brackets.k[upper], brackets.k[lower] + 1])
    side = np.repeat([0, 1], [upper.size, lower.size])
    report = np.concatenate([upper, lower])
    order = np.argsort(level, kind="stable")
    level, side, report = level[order], side[order], report[order]
    edges = np.flatnonzero(np.diff(level, prepend=-1, append=-1))  # none where no report is inside
    for start, stop in itertools.pairwise(edges):
        here, group, above = int(level[start]), report[start:stop], side[start:stop]
        points = cell.points[:, group]
        for row, field in enumerate((model.u[here], model.v[here])):
            values[:, row, above, group] = reader.values(field, points)
    along = bilinear(values, cell.x, cell.y)
    if not derivatives:
        return along
    return np.concatenate([along, *bilinear_slopes(values, cell.x, cell.y)])


def _to_true(
    grid: Grid, along: Floats, brackets: _Brackets, lat: Floats, lon: Floats, *, derivatives: bool
) -> Floats:
    """Combine both levels and turn to true east and north."""
    weight = brackets.weight
    mixed = [_weighted(pair, (1.0 - weight, weight)) for pair in along]
    convergence = grid.convergence(lat, lon)
    angle = convergence if grid.wind_along_grid else np.zeros_like(lat)
    wind = _turned(mixed[0], mixed[1], angle)
    if not derivatives:
        return np.stack(wind)
    depth = brackets.lower - brackets.upper
    with np.errstate(divide="ignore", invalid="ignore"):
        u_shear, v_shear = ((pair[1] - pair[0]) / depth for pair in along[:2])
    shear = _turned(u_shear, v_shear, angle)
    slopes = _true_slopes(grid, mixed, wind, angle, lat, lon)
    # The grid's own angle whatever the flag says: a wrong flag is told by it.
    return np.stack([*wind, *shear, *slopes, convergence])


def _turned(u: Floats, v: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """Grid components to true east and north."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * u + sine * v, -sine * u + cosine * v


def _true_slopes(
    grid: Grid,
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
        stretch = np.cos(np.radians(lat)) if step_lon else np.ones_like(lat)
        distance = 2.0 * np.radians(_METRIC_STEP) * EARTH_RADIUS * stretch
        one = (lat + step_lat, lon + step_lon)
        two = (lat - step_lat, lon - step_lon)
        (i1, j1), (i0, j0) = grid.plane(*one), grid.plane(*two)
        di, dj = (_short(grid, i1 - i0)) / distance, (j1 - j0) / distance
        turning = np.zeros_like(lat)
        if grid.wind_along_grid:
            turned = grid.convergence(*one) - grid.convergence(*two)
            turning = np.arctan2(np.sin(turned), np.cos(turned)) / distance
        u, v = _turned(mixed[2] * di + mixed[4] * dj, mixed[3] * di + mixed[5] * dj, angle)
        result += [u + wind[1] * turning, v - wind[0] * turning]
    return result


def _short(grid: Grid, steps: Floats) -> Floats:
    """Column differences across the seam of a full circle taken the short way."""
    if grid.kind in ("regular_ll", "rotated_ll", "mercator"):
        turn = grid.columns_in_a_turn
        return np.asarray(np.mod(steps + turn / 2.0, turn) - turn / 2.0)
    return steps
