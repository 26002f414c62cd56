"""What sampling asks of a model's grid, wherever the grid was read.

:class:`airswing.reference.geometry.grids.Grid` is the grid of a GRIB message; what comes as an
xarray Dataset has grids of its own (:mod:`airswing.reference.gridded.axes_grid`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Placing(Protocol):
    """A grid on which points can be placed."""

    @property
    def ni(self) -> int:
        """Points along x."""

    @property
    def nj(self) -> int:
        """Points along y."""

    @property
    def size(self) -> int:
        """Number of grid points."""

    @property
    def periodic(self) -> bool:
        """The column after the last is the first."""

    @property
    def wind_along_grid(self) -> bool:
        """Wind components point along the grid, not east and north."""

    @property
    def columns_in_a_turn(self) -> float:
        """Columns in a full turn of longitude, 0 where columns are not meridians."""

    @property
    def key(self) -> str:
        """Short hash of where the grid points are."""

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices of places (degrees), inside the grid or not."""

    def fractional_index(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """Fractional indices of places (degrees), NaN outside the grid."""

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle (rad) that turns grid components to true east and north."""

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east, whole degrees."""

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j) in the stored list of values."""
