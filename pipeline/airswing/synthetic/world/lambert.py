"""The Lambert grid the sample's model winds live on.

Assumes a tangent cone (one standard parallel) and a sphere, as the RUC and WRF files of 2009 do:
6367470 m in GRIB1 and 6371229 m in GRIB2. Angles in degrees at the edges, lengths in metres.
Valid for any region away from the pole; written for grids of some tens of points a side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyproj
from numpy.typing import NDArray

__all__ = ["LambertGrid", "centred_grid"]

Array = NDArray[np.float64]

# Earth radius of GRIB1 in m (WMO Manual on Codes, code table 7, bit 2 unset).
GRIB1_RADIUS = 6367470.0
GRIB2_RADIUS = 6371229.0  # Earth radius of GRIB2 in m (WMO code table 3.2, value 6)


@dataclass(frozen=True)
class LambertGrid:
    """A tangent Lambert conformal grid with points in rows from the south-west corner."""

    # first_latitude, first_longitude: south-west grid point in degrees
    first_latitude: float
    first_longitude: float
    # columns, rows: points along x and along y
    columns: int
    rows: int
    spacing: float  # grid length at the standard parallel in m
    orientation: float = -95.0  # longitude of the meridian parallel to y (LoV), degrees east
    standard_parallel: float = 25.0  # latitude where the cone touches, degrees
    radius: float = GRIB1_RADIUS  # Earth radius in m

    @cached_property
    def _projection(self) -> pyproj.Proj:
        return pyproj.Proj(
            proj="lcc",
            lat_1=self.standard_parallel,
            lat_2=self.standard_parallel,
            lat_0=self.standard_parallel,
            lon_0=self.orientation,
            R=self.radius,
        )

    @cached_property
    def _origin(self) -> tuple[float, float]:
        x, y = self._projection(self.first_longitude, self.first_latitude)
        return float(x), float(y)

    def indices(self, latitude: Array, longitude: Array) -> tuple[Array, Array]:
        """Return fractional row and column of points.

        Parameters
        ----------
        latitude, longitude : ndarray
            Degrees north and east, same shape.

        Returns
        -------
        row, column : ndarray
            Grid lengths from the first point.
        """
        x, y = self._projection(longitude, latitude)
        x0, y0 = self._origin
        return (np.asarray(y) - y0) / self.spacing, (np.asarray(x) - x0) / self.spacing

    def convergence(self, longitude: Array) -> Array:
        """Return the angle that turns grid winds to earth winds, in radians.

        Parameters
        ----------
        longitude : ndarray
            Degrees east.

        Returns
        -------
        ndarray
            (lon - LoV) times the cone constant: eastward = cos u + sin v of the grid winds.

        References
        ----------
        Snyder (1987), Map Projections, USGS PP 1395, eq. 14-4 with n = sin(standard parallel).
        """
        turn = np.radians((longitude - self.orientation + 180.0) % 360.0 - 180.0)
        return np.asarray(turn * np.sin(np.radians(self.standard_parallel)))

    @cached_property
    def coordinates(self) -> tuple[Array, Array]:
        """Latitude and longitude of every point, degrees, shape (rows, columns)."""
        x0, y0 = self._origin
        x = x0 + self.spacing * np.arange(self.columns)
        y = y0 + self.spacing * np.arange(self.rows)
        px, py = np.meshgrid(x, y)
        lon, lat = self._projection(px, py, inverse=True)
        return np.asarray(lat), np.asarray(lon)


def centred_grid(
    latitude: float,
    longitude: float,
    *,
    columns: int,
    rows: int,
    spacing: float,
    orientation: float = -95.0,
    radius: float = GRIB1_RADIUS,
) -> LambertGrid:
    """Return a grid whose middle is at a place.

    Parameters
    ----------
    latitude, longitude : float
        Middle in degrees.
    columns, rows : int
        Points along x and y.
    spacing : float
        Grid length in m.
    orientation : float
        Degrees; RUC's by default.
    radius : float
        Earth radius in m.

    Returns
    -------
    LambertGrid
        First point rounded to 0.001 degree, what a GRIB1 header can hold.
    """
    probe = LambertGrid(latitude, longitude, columns, rows, spacing, orientation, radius=radius)
    x, y = probe._projection(longitude, latitude)
    corner = probe._projection(
        x - spacing * (columns - 1) / 2, y - spacing * (rows - 1) / 2, inverse=True
    )
    return LambertGrid(
        round(float(corner[1]), 3),
        round(float(corner[0]), 3),
        columns,
        rows,
        spacing,
        orientation,
        radius=radius,
    )
