"""Geomagnetic field at many reports: IGRF interpolated from a fixed lattice.

The main field of the International Geomagnetic Reference Field (IGRF-14, through ``ppigrf``): no
crustal anomalies and no magnetic storms, which change declination by some tenths of a degree.
Height is taken above the WGS84 ellipsoid; giving pressure altitude instead is wrong by a few
hundred metres at most, 0.02 % of the field.

IGRF takes tens of microseconds a point, so it is evaluated at the nodes of a lattice and the
components X (north), Y (east), Z (down) are interpolated, never the angles: cubic (four-point
Lagrange) in latitude and longitude between nodes 2 degrees apart, linear in height between 0 and
16 km and linear in time between the epochs of IGRF five years apart, where IGRF is itself linear.
Nodes are at fixed places of the globe and are computed in tiles of one shape, so that the field at
a report is identical to the last bit for any other reports. Tiles are kept until the process ends.

Valid from 1900 to 2030, heights -1 to 20 km; NaN outside the epochs. Against IGRF itself components
are within about 1 nT, declination within 0.01 degrees where the horizontal field exceeds 5,000 nT.

References
----------
Alken et al. 2021, International Geomagnetic Reference Field: the thirteenth generation, Earth
Planets Space 73:49 (and its fourteenth generation of 2024).
"""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEP = 2.0
"""Degrees between nodes."""
# Degrees: the first nodes; none is on a pole, where east has no direction.
FIRST_LATITUDE, FIRST_LONGITUDE = -89.0, -180.0
ROWS, COLUMNS = 90, 180  # nodes of the globe
TILE = 10  # nodes along each side of a tile
TOP_HEIGHT = 16000.0  # metres: the upper of the two height nodes; the lower is zero
YEARS = range(1900, 2031, 5)
"""Epochs of IGRF-14: its Gauss coefficients are linear in time between them."""
EPOCHS = np.array([f"{year}-01-01" for year in YEARS], "datetime64[s]").astype(np.float64)
"""Their times in seconds since 1970."""
BLOCK = 32768
"""Points interpolated at a time, so that the working arrays stay in the processor's cache."""
_VALUES = 12  # 3 components x 2 heights x (value at an epoch, change to the next)
# (epoch, 90, 180, 12) nT, filled tile by tile; untouched pages take no memory.
_NODES = np.zeros((len(YEARS) - 1, ROWS, COLUMNS, _VALUES))
_FILLED = np.zeros((ROWS // TILE, COLUMNS // TILE), dtype=bool)


class GeomagneticField(NamedTuple):
    """The field at each point."""

    declination: Array  # angle from true to magnetic north, radians, positive east
    horizontal: Array  # horizontal field, nT
    dip: Array  # below the horizontal, radians, positive down (north of the dip equator)


def geomagnetic_field(
    latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike, seconds: ArrayLike
) -> GeomagneticField:
    """Declination, horizontal field and dip at points whose shapes broadcast.

    Latitude and longitude in degrees, height in metres above the ellipsoid (or pressure altitude),
    seconds since 1970-01-01T00:00 UTC. NaN where an argument is not finite, and outside 1900 to
    2030.
    """
    values = (np.asarray(value, np.float64) for value in (latitude, longitude, height, seconds))
    arrays = np.broadcast_arrays(*values)
    points = [np.ascontiguousarray(array).reshape(-1) for array in arrays]
    field = np.empty((3, points[0].size))
    for start in range(0, points[0].size, BLOCK):
        block = slice(start, start + BLOCK)
        field[:, block] = _interpolated(*(values[block] for values in points))
    north, east, down = field.reshape(3, *arrays[0].shape)
    horizontal = np.hypot(north, east)
    return GeomagneticField(np.arctan2(east, north), horizontal, np.arctan2(down, horizontal))


def _interpolated(latitude: Array, longitude: Array, height: Array, seconds: Array) -> Array:
    """North, east and down components (3, n), nT."""
    inside = (np.abs(latitude) <= 90.0) & np.isfinite(longitude + height)
    inside &= (seconds >= EPOCHS[0]) & (seconds <= EPOCHS[-1])
    latitude, longitude = np.where(inside, latitude, 0.0), np.where(inside, longitude, 0.0)
    interval = np.searchsorted(EPOCHS, np.where(inside, seconds, 0.0), side="right") - 1
    interval = np.minimum(interval, EPOCHS.size - 2)
    elapsed = (seconds - EPOCHS[interval]) / (EPOCHS[interval + 1] - EPOCHS[interval])
    # the first of four rows and columns around a point; one-sided near the poles
    position = (latitude - FIRST_LATITUDE) / STEP
    row = np.clip(np.floor(position).astype(np.int64) - 1, 0, ROWS - 4)
    row_weights = _lagrange(position - row)
    position = np.mod(longitude - FIRST_LONGITUDE, 360.0) / STEP
    column = np.floor(position).astype(np.int64) - 1
    column_weights = _lagrange(position - column)
    _fill_tiles(row[inside], column[inside])
    nodes = _NODES.reshape(-1, _VALUES)
    total = np.zeros((latitude.size, _VALUES))
    for i in range(4):
        base = (interval * ROWS + row + i) * COLUMNS
        across = np.zeros_like(total)
        for j in range(4):
            across += nodes[base + (column + j) % COLUMNS] * column_weights[j][:, np.newaxis]
        total += across * row_weights[i][:, np.newaxis]
    # the first six are X, Y, Z at both heights, the last six their change over the interval
    at_time = total[:, :6] + total[:, 6:] * elapsed[:, np.newaxis]
    upward = (height / TOP_HEIGHT)[:, np.newaxis]
    field = at_time[:, :3] + (at_time[:, 3:] - at_time[:, :3]) * upward
    return np.asarray(np.where(inside, field.T, np.nan))


def _lagrange(position: Array) -> list[Array]:
    """Weights of four nodes at 0, 1, 2, 3 for the cubic through them."""
    a, b, c, d = position, position - 1.0, position - 2.0, position - 3.0
    return [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]


def _fill_tiles(row: Index, column: Index) -> None:
    """Compute the tiles with a node of the 4 x 4 stencils that begin at these rows and columns."""
    import ppigrf

    needed = np.zeros_like(_FILLED)
    for i in (0, 3):  # a tile is longer than a stencil: its corners are in all its tiles
        for j in (0, 3):
            needed[(row + i) // TILE, (column + j) % COLUMNS // TILE] = True
    epochs, kilometres = [datetime(year, 1, 1) for year in YEARS], [0.0, TOP_HEIGHT / 1000.0]
    for tile in np.argwhere(needed & ~_FILLED).tolist():
        rows, columns = (np.arange(number * TILE, (number + 1) * TILE) for number in tile)
        latitude, longitude = FIRST_LATITUDE + STEP * rows, FIRST_LONGITUDE + STEP * columns
        lat, lon, height = np.meshgrid(latitude, longitude, kilometres, indexing="ij")
        # all epochs in one call: they share the Legendre functions, which take most of the time;
        # east, north and up, with dates first and kilometres last
        east, north, up = ppigrf.igrf(lon, lat, height, epochs)
        field = np.stack([north, east, -up], axis=-1).reshape(-1, TILE, TILE, 6)
        nodes = np.concatenate([field[:-1], np.diff(field, axis=0)], axis=-1)
        _NODES[:, rows[:, np.newaxis], columns] = nodes
        _FILLED[tuple(tile)] = True
