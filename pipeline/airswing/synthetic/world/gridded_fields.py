"""The references' gridded winds of one archive, as files would hold them, and their sampling.

Assumes hourly (or coarser, regular) fields on one Lambert grid and isobaric levels. Winds are
kept the way they are written: along the grid or along the earth, rounded to the packing's
decimal. Sampling is bilinear on the grid, linear in ln p and in time, without extrapolation;
rotation to true east and north is done at the points. Units: hPa, hours since the archive's
start, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airswing.synthetic.world.lambert import LambertGrid
from airswing.synthetic.world.true_atmosphere import Reference, World

__all__ = ["GriddedReference", "ReferenceChange", "build_references", "sample_reference"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceChange:
    """What an effect does to the fields of one reference."""

    # speeds too strong by this much, where ``above_hpa`` / ``below_hpa`` allow
    speed_percent: float = 0.0
    # above_hpa, below_hpa: acts only at pressures lower / higher than these
    above_hpa: float | None = None
    below_hpa: float | None = None
    offset_hours: float = 0.0  # the field stamped t is that of t + offset
    # fraction of the rotation a reader will leave out: 1 for winds along the grid flagged as
    # earth's, -1 for the reverse
    unrotated: float = 0.0


@dataclass
class GriddedReference:
    """Fields of one reference as stored."""

    name: str  # reference
    grid: LambertGrid  # where
    levels: Array  # (L,): hPa, decreasing
    hours: Array  # (T,): valid times in hours since the start
    # (T, 2, L, rows, columns): stored components in m/s
    wind: NDArray[np.float32] = field(repr=False)
    grid_relative: bool = True  # what the flag in the file says


def _turned(wind: NDArray[np.float32], angle: Array) -> NDArray[np.float32]:
    """Return earth winds as components along axes turned by ``angle`` (radians, of rows x columns).

    The inverse of eastward = cos u + sin v, northward = -sin u + cos v.
    """
    cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    east, north = wind[:, 0], wind[:, 1]
    return np.stack([cosine * east - sine * north, sine * east + cosine * north], axis=1)


def _changed(
    wind: NDArray[np.float32], levels: Array, change: ReferenceChange
) -> NDArray[np.float32]:
    """Apply a speed bias to earth winds."""
    if change.speed_percent == 0.0:
        return wind
    acts = np.ones(levels.size, bool)
    if change.above_hpa is not None:
        acts &= levels <= change.above_hpa
    if change.below_hpa is not None:
        acts &= levels > change.below_hpa
    factor = np.where(acts, 1.0 + change.speed_percent / 100.0, 1.0).astype(np.float32)
    return wind * factor[:, None, None]


def build_references(
    world: World,
    grid: LambertGrid,
    *,
    names: tuple[str, ...],
    grid_relative: dict[str, bool],
    levels: Array,
    hours: Array,
    changes: dict[str, ReferenceChange] | None = None,
    decimals: int = 1,
) -> dict[str, GriddedReference]:
    """Return the stored fields of several references.

    Parameters
    ----------
    grid : LambertGrid
        Grid of all of them.
    grid_relative : dict
        For each name, whether components lie along the grid.
    levels : ndarray (L,)
        hPa.
    hours : ndarray (T,)
        Valid times, hours since the start.
    changes : dict, optional
        Effects on a reference by name.
    decimals : int
        Decimals kept by the packing.

    Returns
    -------
    dict of GriddedReference
        By name.
    """
    lat, lon = grid.coordinates
    x, y = plane(lat, lon)
    zeta = np.log(levels / 1000.0)
    angle = grid.convergence(lon)
    cache: dict[float, NDArray[np.float32]] = {}
    out = {}
    for name in names:
        change = (changes or {}).get(name, ReferenceChange())
        stamp = hours + change.offset_hours
        if change.offset_hours not in cache:
            cache[change.offset_hours] = world.large_scale_on_grid(x, y, zeta, stamp)
        large = cache[change.offset_hours]
        wind = Reference(world, name).on_grid(x, y, zeta, stamp, large_scale=large)
        wind = _changed(wind, levels, change)
        flag = grid_relative[name]
        if abs(change.unrotated) == 1.0:
            flag = change.unrotated < 0
        turn = (1.0 if flag else 0.0) + change.unrotated
        if turn != 0.0:
            wind = _turned(wind, turn * angle)
        out[name] = GriddedReference(name, grid, levels, hours, np.round(wind, decimals), flag)
    return out


def plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return the world's own plane coordinates in km: a Lambert plane about 43 N, 90 W.

    Parameters
    ----------
    latitude, longitude : ndarray
        Degrees.

    Returns
    -------
    x, y : ndarray
        km east and north of 43 N, 90 W.
    """
    frame = LambertGrid(43.0, -90.0, 1, 1, 1000.0, -90.0, 43.0)
    row, column = frame.indices(latitude, longitude)
    return column, row


def sample_reference(
    stored: GriddedReference,
    latitude: Array,
    longitude: Array,
    pressure: Array,
    hours: Array,
    *,
    shift: tuple[Array, Array] | None = None,
) -> dict[str, Array]:
    """Return a reference's wind and its gradients at points.

    Parameters
    ----------
    latitude, longitude : ndarray (n,)
        Degrees.
    pressure : ndarray (n,)
        hPa.
    hours : ndarray (n,)
        Hours since the start.
    shift : (ndarray, ndarray), optional
        Rows and columns (n,) to look away from each point.

    Returns
    -------
    dict of ndarray (n,)
        ``u, v`` true eastward and northward wind in m/s; ``dudt, dvdt`` m s-2; ``dudlnp, dvdlnp``
        m/s per unit ln p; ``dudx, dvdx, dudy, dvdy`` s-1 towards true east and north; NaN outside.
    """
    row, column = stored.grid.indices(latitude, longitude)
    if shift is not None:
        row, column = row + shift[0], column + shift[1]
    zeta = np.log(stored.levels)
    depth = np.interp(np.log(pressure), zeta[::-1], np.arange(zeta.size)[::-1].astype(float))
    step = (hours - stored.hours[0]) / (stored.hours[1] - stored.hours[0])
    inside = (row >= 0) & (row <= stored.grid.rows - 1)
    inside &= (column >= 0) & (column <= stored.grid.columns - 1)
    inside &= (pressure >= stored.levels.min()) & (pressure <= stored.levels.max())
    inside &= (step >= 0) & (step <= stored.hours.size - 1)
    shape = (stored.hours.size, stored.levels.size, stored.grid.rows, stored.grid.columns)
    lows, fractions = [], []
    for index, size in zip((step, depth, row, column), shape, strict=True):
        low = np.clip(np.floor(index), 0, size - 2).astype(int)
        lows.append(low)
        fractions.append(index - low)
    corners = _corners(stored.wind, lows)
    result = _interpolated(corners, fractions, stored, zeta, lows, longitude, latitude)
    for values in result.values():
        values[~inside] = np.nan
    return result


def _corners(wind: NDArray[np.float32], lows: list[NDArray[np.int64]]) -> Array:
    """Return the 16 neighbours of each point, shape (2 time, 2 level, 2 row, 2 column, 2 uv, n)."""
    flat = wind.reshape(-1)
    sizes = wind.shape
    strides = np.array([np.prod(sizes[axis + 1 :]) for axis in range(5)], dtype=np.int64)
    base = sum(low * strides[axis] for low, axis in zip(lows, (0, 2, 3, 4), strict=True))
    out = np.empty((2, 2, 2, 2, 2, base.size))
    for corner in np.ndindex(2, 2, 2, 2, 2):
        shift = int(np.dot(corner[:4], strides[[0, 2, 3, 4]]) + corner[4] * strides[1])
        out[corner] = flat[base + shift]
    return out


def _interpolated(
    corners: Array,
    fractions: list[Array],
    stored: GriddedReference,
    zeta: Array,
    lows: list[NDArray[np.int64]],
    longitude: Array,
    latitude: Array,
) -> dict[str, Array]:
    """Reduce the corners along each axis, once with weights and once with differences."""

    def blend(values: Array, weight: Array) -> Array:
        return np.asarray(values[0] + (values[1] - values[0]) * weight)

    t, z, r, c = fractions
    over_time = blend(corners, t)
    over_level = blend(over_time, z)
    wind = blend(blend(over_level, r), c)
    by_time = blend(blend(blend(corners[1] - corners[0], z), r), c)
    by_level = blend(blend(over_time[1] - over_time[0], r), c)
    by_row = blend(over_level[1] - over_level[0], c)
    by_column = blend(over_level[:, 1] - over_level[:, 0], r)
    step_seconds = 3600.0 * (stored.hours[1] - stored.hours[0])
    layer = zeta[lows[1] + 1] - zeta[lows[1]]
    length = stored.grid.spacing / _map_factor(latitude, stored.grid.standard_parallel)
    angle = stored.grid.convergence(longitude)
    turn = angle if stored.grid_relative else np.zeros_like(angle)
    cosine, sine = np.cos(turn), np.sin(turn)

    def earth(pair: Array) -> tuple[Array, Array]:
        return cosine * pair[0] + sine * pair[1], cosine * pair[1] - sine * pair[0]

    out: dict[str, Array] = {}
    out["u"], out["v"] = earth(wind)
    out["dudt"], out["dvdt"] = earth(by_time / step_seconds)
    out["dudlnp"], out["dvdlnp"] = earth(by_level / layer)
    along_x, along_y = earth(by_column / length), earth(by_row / length)
    cosine, sine = np.cos(angle), np.sin(angle)
    for name, by_x, by_y in zip(("u", "v"), along_x, along_y, strict=True):
        out[f"d{name}dx"] = cosine * by_x + sine * by_y
        out[f"d{name}dy"] = cosine * by_y - sine * by_x
    return out


def _map_factor(latitude: Array, parallel: float) -> Array:
    """Return the map scale of a tangent Lambert cone (Snyder 1987, eq. 15-4 with k from n)."""
    cone = np.sin(np.radians(parallel))
    lat, par = np.radians(latitude), np.radians(parallel)
    stretch = (np.tan(np.pi / 4 + par / 2) / np.tan(np.pi / 4 + lat / 2)) ** cone
    return np.asarray(np.cos(par) * stretch / np.cos(lat))
