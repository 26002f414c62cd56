"""Geomagnetic field at many reports: IGRF on a fixed lattice, interpolated.

Assumptions
-----------
The main field of the International Geomagnetic Reference Field (IGRF-14, through ``ppigrf``):
neither crustal anomalies nor magnetic storms, which move declination by some tenths of a degree.
Height is taken above the WGS84 ellipsoid; giving pressure altitude instead is wrong by a few
hundred metres at most, 0.02 % of the field.

Method
------
IGRF costs tens of microseconds a point, so it is evaluated at the nodes of a lattice and the
components X (north), Y (east), Z (down) are interpolated, never the angles: cubic (four-point
Lagrange) in latitude and longitude between nodes 2 degrees apart, linear in height between 0 and
16 km and linear in time between IGRF's own epochs five years apart, where IGRF is itself linear,
so that the interpolation in time is exact. Nodes are at fixed places of the globe and are computed
in tiles of one shape, so that the field at a report is the same to the last bit whatever the other
reports. Tiles are kept for the life of the process.

Validity
--------
1900 to 2030, heights -1 to 20 km, any longitude, both sides of the antimeridian; NaN outside the
epochs and outside the covered tiles. Against IGRF itself the components are within about 1 nT;
declination is within 0.01 degrees wherever the horizontal field exceeds 5,000 nT.

References
----------
Alken et al. 2021, International Geomagnetic Reference Field: the thirteenth generation, Earth
Planets Space 73:49 (and its fourteenth generation of 2024).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import cache, lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

STEP = 2.0
"""Degrees between nodes."""
FIRST_LATITUDE = -89.0  # Degrees: no node on a pole, where east has no direction
FIRST_LONGITUDE = -180.0
# Nodes two degrees apart.
ROWS, COLUMNS = 90, 180
TILE = 10  # Nodes along each side of a tile
TOP_HEIGHT = 16000.0  # Metres: the upper of the two height nodes; the lower is zero
# Years of IGRF-14: its Gauss coefficients are linear in time between them.
FIRST_EPOCH, LAST_EPOCH, EPOCH_STEP = 1900, 2030, 5
BLOCK = 32768
"""Points interpolated at once: the working arrays then stay in the processor's cache."""
_VALUES = 12  # 3 components x 2 heights x (value at the epoch, change to the next)


class GeomagneticField(NamedTuple):
    """The field at each point."""

    declination: Array  # angle from true to magnetic north, radians, positive east
    horizontal: Array  # horizontal field, nT
    dip: Array  # below the horizontal, radians, positive down (north of the dip equator)


@dataclass(frozen=True, eq=False)
class FieldLattice:
    """IGRF at the nodes of a global lattice, filled where reports are."""

    # (interval,): first years of the five-year intervals held, ascending
    intervals: NDArray[np.int64]
    # (interval, 90, 180, 12): X, Y, Z at both heights at the first year, and their change to the
    # next; nT. NaN where no report is near.
    nodes: Array

    @classmethod
    def covering(
        cls, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike, seconds: ArrayLike
    ) -> Self:
        """Compute the lattice around some reports.

        Parameters
        ----------
        latitude, longitude : array_like, shapes that broadcast
            Degrees; longitudes may run from -180 or from 0.
        height : array_like
            Metres; taken for the shape alone, both height nodes are always made.
        seconds : array_like
            Since 1970-01-01T00:00 UTC.

        Returns
        -------
        FieldLattice
            Points that are not finite, and times outside 1900-2030, are left out.
        """
        lat, lon, _, when = _flat(latitude, longitude, height, seconds)
        bounds = _epoch_seconds()
        asked = np.zeros(bounds.size, dtype=bool)
        touched = np.zeros((ROWS // TILE, COLUMNS // TILE), dtype=bool)
        for part in _blocks(lat.size):
            usable = _usable(lat[part], lon[part], when[part])
            # the interval that begins at or before the time
            asked[np.searchsorted(bounds, when[part][usable], side="right") - 1] = True
            _touch(touched, lat[part][usable], lon[part][usable])
        asked[-2] |= asked[-1]  # the very last instant closes the last interval
        years = FIRST_EPOCH + EPOCH_STEP * np.flatnonzero(asked[:-1])
        tiles = np.argwhere(touched)
        nodes = np.full((years.size, ROWS, COLUMNS, _VALUES), np.nan)
        for row, column in tiles:
            rows = slice(row * TILE, (row + 1) * TILE)
            columns = slice(column * TILE, (column + 1) * TILE)
            nodes[:, rows, columns] = _tile(int(row), int(column))[asked[:-1]]
        return cls(years.astype(np.int64), nodes)

    def at(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike, seconds: ArrayLike
    ) -> GeomagneticField:
        """Interpolate the field at points whose shapes broadcast.

        Parameters
        ----------
        latitude, longitude : array_like
            Degrees.
        height : array_like
            Metres above the ellipsoid (pressure altitude will do).
        seconds : array_like
            Since 1970-01-01T00:00 UTC.

        Returns
        -------
        GeomagneticField
            Of the broadcast shape; NaN where the lattice holds no nodes.
        """
        shape = np.broadcast_shapes(
            *(np.shape(value) for value in (latitude, longitude, height, seconds))
        )
        north, east, down = self.components(latitude, longitude, height, seconds)
        horizontal = np.hypot(north, east)
        return GeomagneticField(
            np.arctan2(east, north).reshape(shape),
            horizontal.reshape(shape),
            np.arctan2(down, horizontal).reshape(shape),
        )

    def components(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike, seconds: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Return north, east and down components (nT) at the flattened points, as for `at`."""
        lat, lon, level, when = _flat(latitude, longitude, height, seconds)
        found = np.full((3, lat.size), np.nan)
        if self.intervals.size == 0:
            return found[0], found[1], found[2]
        for part in _blocks(lat.size):
            found[:, part] = self._interpolated(lat[part], lon[part], level[part], when[part])
        return found[0], found[1], found[2]

    def _interpolated(self, lat: Array, lon: Array, height: Array, seconds: Array) -> Array:
        interval, elapsed = self._time_position(seconds)
        outside = ~(np.isfinite(lon + height + elapsed) & (np.abs(lat) <= 90.0))
        lat, lon = np.where(outside, 0.0, lat), np.where(outside, 0.0, lon)
        row, row_weights = _row_stencil(lat)
        column, column_weights = _column_stencil(lon)
        rows = self.nodes.reshape(-1, _VALUES)
        total = np.zeros((lat.size, _VALUES))
        for i in range(4):
            base = (interval * ROWS + row + i) * COLUMNS
            across = np.zeros_like(total)
            for j in range(4):
                node = np.take(rows, base + (column + j) % COLUMNS, axis=0)
                node *= column_weights[j][:, np.newaxis]
                across += node
            across *= row_weights[i][:, np.newaxis]
            total += across
        # The first six are X, Y, Z at both heights, the last six their change over the
        # interval.
        at_time = total[:, :6] + total[:, 6:] * elapsed[:, np.newaxis]
        upward = (height / TOP_HEIGHT)[:, np.newaxis]
        field = at_time[:, :3] + (at_time[:, 3:] - at_time[:, :3]) * upward
        return np.asarray(np.where(outside, np.nan, field.T))

    def _time_position(self, seconds: Array) -> tuple[NDArray[np.int64], Array]:
        """Interval and elapsed fraction of it; NaN where the time is in no interval."""
        starts, stops = (
            _epoch_seconds()[(self.intervals + later - FIRST_EPOCH) // EPOCH_STEP]
            for later in (0, EPOCH_STEP)
        )
        place = np.searchsorted(starts, seconds, side="right") - 1
        place = np.clip(place, 0, starts.size - 1)
        elapsed = (seconds - starts[place]) / (stops[place] - starts[place])
        return place, np.where((elapsed >= 0.0) & (elapsed <= 1.0), elapsed, np.nan)


def _flat(*values: ArrayLike) -> tuple[Array, ...]:
    arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
    return tuple(np.ascontiguousarray(array).reshape(-1) for array in arrays)


def _blocks(points: int) -> Iterator[slice]:
    for start in range(0, points, BLOCK):
        yield slice(start, min(start + BLOCK, points))


@lru_cache(maxsize=1)
def _epoch_seconds() -> Array:
    years = range(FIRST_EPOCH, LAST_EPOCH + EPOCH_STEP, EPOCH_STEP)
    dates = np.array([f"{year}-01-01" for year in years], dtype="datetime64[s]")
    return dates.astype(np.int64).astype(np.float64)


def _row_stencil(latitude: Array) -> tuple[NDArray[np.int64], list[Array]]:
    """First of the four node rows around a latitude, and their weights; one-sided at the poles."""
    position = (latitude - FIRST_LATITUDE) / STEP
    # near a pole the point is not in the middle of the four nodes
    first = np.clip(np.floor(position).astype(np.int64) - 1, 0, ROWS - 4)
    return first, _lagrange(position - first)


def _column_stencil(longitude: Array) -> tuple[NDArray[np.int64], list[Array]]:
    """First of the four node columns around a longitude (to wrap modulo 180), and weights."""
    position = np.mod(longitude - FIRST_LONGITUDE, 360.0) / STEP
    first = np.floor(position).astype(np.int64) - 1
    return first, _lagrange(position - first)


def _lagrange(position: Array) -> list[Array]:
    """Weights of four nodes at 0, 1, 2, 3 for the cubic through them."""
    a, b, c, d = position, position - 1.0, position - 2.0, position - 3.0
    return [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]


def _usable(latitude: Array, longitude: Array, seconds: Array) -> NDArray[np.bool_]:
    bounds = _epoch_seconds()
    inside = (np.abs(latitude) <= 90.0) & np.isfinite(longitude)
    return np.asarray(inside & (seconds >= bounds[0]) & (seconds <= bounds[-1]))


def _touch(touched: NDArray[np.bool_], latitude: Array, longitude: Array) -> None:
    """Mark the tiles with a node of the stencil of any point."""
    row, _ = _row_stencil(latitude)
    column, _ = _column_stencil(longitude)
    # The corners of the 4 x 4 stencil: a tile is longer than a stencil, so no tile lies
    # between.
    for i in (0, 3):
        for j in (0, 3):
            touched[(row + i) // TILE, (column + j) % COLUMNS // TILE] = True


@cache
def _tile(row: int, column: int) -> Array:
    """IGRF at one tile's nodes at the first year of every interval, and the change over it.

    All in one call: most of its time is for the Legendre functions, which all years share.
    """
    import ppigrf

    steps = np.arange(TILE)
    latitude = FIRST_LATITUDE + STEP * (row * TILE + steps)
    longitude = FIRST_LONGITUDE + STEP * (column * TILE + steps)
    kilometres = np.array([0.0, TOP_HEIGHT / 1000.0])
    lat, lon, height = np.meshgrid(latitude, longitude, kilometres, indexing="ij")
    years = range(FIRST_EPOCH, LAST_EPOCH + EPOCH_STEP, EPOCH_STEP)
    dates = [datetime(year, 1, 1) for year in years]
    east, north, upward = ppigrf.igrf(lon, lat, height, dates)
    # ppigrf gives east, north, up with dates first and kilometres last.
    field = np.stack([north, east, -upward], axis=-1).reshape(-1, TILE, TILE, 6)
    return np.concatenate([field[:-1], np.diff(field, axis=0)], axis=-1)
