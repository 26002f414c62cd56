"""A grid given by one coordinate along each axis, evenly spaced or not.

Assumptions and validity
------------------------
* Both coordinates change in one direction; longitudes may come in any convention and may cross
  their seam. Between grid points an index is linear in the coordinate: exact for evenly spaced
  axes, and the meaning of "bilinear" for Gaussian latitudes.
* A longitude axis whose last column is one step from the first is a full circle.
* Poleward of the outermost row there is no value.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import wrap_degrees
from airswing.reference.gridded.cf.projection import Frame

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Points this many grid lengths outside the outermost row or column count as on it:
#: coordinates are often stored in single precision.
EDGE_TOLERANCE = 1e-4
_LAID = 1e-2  # Grid lengths by which points may miss the rows and columns of their projection
_OUTLINED = 60  # Points along each axis from which the outline is told
_FULL_CIRCLE = 1e-2  # Columns by which a circle may seem to miss 360 degrees and still be one


@dataclass(frozen=True, eq=False)
class AxesGrid:
    """Where points lie on a grid of two axes, whose coordinates are as stored."""

    frame: Frame
    x: Floats
    y: Floats
    wind_along_grid: bool = False

    @property
    def ni(self) -> int:
        """Points along x."""
        return int(self.x.size)

    @property
    def nj(self) -> int:
        """Points along y."""
        return int(self.y.size)

    @property
    def size(self) -> int:
        """Number of grid points."""
        return self.ni * self.nj

    @cached_property
    def key(self) -> str:
        """Short hash of where the grid points are."""
        digest = hashlib.sha256(repr(self.frame).encode())
        for axis in (self.x, self.y):
            digest.update(b"|" + np.ascontiguousarray(axis).tobytes())
        return digest.hexdigest()[:16]

    def __repr__(self) -> str:
        return (
            f"AxesGrid({self.frame.kind}, {self.ni} x {self.nj}, {self.key}, "
            f"wind_along_grid={self.wind_along_grid})"
        )

    @cached_property
    def _columns(self) -> Floats:
        """Column coordinates by increasing column in one direction; longitudes without a seam."""
        return np.unwrap(self.x, period=360.0) if self.frame.meridional else self.x

    @cached_property
    def periodic(self) -> bool:
        """The column after the last is the first."""
        if not self.frame.meridional or self.ni < 2:
            return False
        span = abs(float(self._columns[-1] - self._columns[0]))
        step = span / (self.ni - 1)
        return abs(span + step - 360.0) < _FULL_CIRCLE * step

    @property
    def columns_in_a_turn(self) -> float:
        """Columns in a full turn of longitude, 0 where columns are not meridians."""
        if not self.frame.meridional or self.ni < 2:
            return 0.0
        if self.periodic:
            return float(self.ni)
        return 360.0 * (self.ni - 1) / abs(float(self._columns[-1] - self._columns[0]))

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices of places (n,) in degrees, inside the grid or not."""
        x, y = self.frame.xy(latitude, longitude)
        columns = self._columns
        if self.frame.meridional:
            x = _near(x, columns)
            if self.periodic:
                # Between the last column and the first, a turn further on.
                columns = np.append(
                    columns, columns[0] + np.copysign(360.0, columns[1] - columns[0])
                )
        return _index_along(columns, x), _index_along(self.y, y)

    def fractional_index(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """Fractional indices along x and y; NaN outside the grid."""
        fi, fj = self.plane(_floats(latitude), _floats(longitude))
        return bounded(fi, fj, self.ni, self.nj, periodic=self.periodic)

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle that turns grid components to true east and north, radians."""
        return self.frame.convergence(_floats(latitude), _floats(longitude))

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid points, degrees, for messages to people."""
        some = [
            axis[np.linspace(0, axis.size - 1, _OUTLINED).astype(int)] for axis in (self.x, self.y)
        ]
        x, y = (lattice.ravel() for lattice in np.meshgrid(*some))
        return box_of(*self.frame.places(x, y))

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j) among all points, row after row."""
        return j * self.ni + i


def _floats(values: ArrayLike) -> Floats:
    return np.ascontiguousarray(np.atleast_1d(values), dtype=np.float64)


def _near(longitude: Floats, columns: Floats) -> Floats:
    """Longitudes in the turn that starts just before the first column."""
    span = columns[-1] - columns[0]
    gap = max(360.0 - abs(float(span)), 0.0)
    along = np.copysign(1.0, span)
    past = np.mod(along * (longitude - columns[0]) + gap / 2.0, 360.0) - gap / 2.0
    return np.asarray(columns[0] + along * past)


def _index_along(axis: Floats, values: Floats) -> Floats:
    """Fractional index of values on an axis of two or more, either way, extended at its ends."""
    if axis[-1] < axis[0]:
        axis, values = -axis, -values
    k = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, axis.size - 2)
    return np.asarray(k + (values - axis[k]) / (axis[k + 1] - axis[k]))


def bounded(fi: Floats, fj: Floats, ni: int, nj: int, *, periodic: bool) -> tuple[Floats, Floats]:
    """Indices with NaN outside the grid; those a rounding outside are put on its edge."""
    with np.errstate(invalid="ignore"):
        inside = (fj >= -EDGE_TOLERANCE) & (fj <= nj - 1 + EDGE_TOLERANCE)
        if not periodic:
            inside &= (fi >= -EDGE_TOLERANCE) & (fi <= ni - 1 + EDGE_TOLERANCE)
    fi = np.mod(fi, ni) if periodic else np.clip(fi, 0.0, ni - 1.0)
    fj = np.clip(fj, 0.0, nj - 1.0)
    return np.where(inside, fi, np.nan), np.where(inside, fj, np.nan)


def through_points(frame: Frame, latitude: Floats, longitude: Floats) -> AxesGrid | None:
    """The grid of a projection whose points (nj, ni), degrees, are known and its axes are not.

    None where the points are not rows and columns of the projection.
    """
    x, y = (one.reshape(latitude.shape) for one in frame.xy(latitude.ravel(), longitude.ravel()))
    if min(latitude.shape) < 2:
        return None
    columns, rows = x.mean(axis=0), y.mean(axis=1)
    steps = np.diff(columns), np.diff(rows)
    if not all((one > 0).all() or (one < 0).all() for one in steps):
        return None
    wide, high = (float(np.abs(one).min()) for one in steps)
    off = max(np.abs(x - columns).max() / wide, np.abs(y - rows[:, None]).max() / high)
    return AxesGrid(frame, columns, rows) if off < _LAID else None


def box_of(latitude: Floats, longitude: Floats) -> tuple[float, float, float, float]:
    """South, north, west and east of places, degrees; longitudes from -180 to 180."""
    east = wrap_degrees(longitude)
    return (
        float(np.nanmin(latitude)),
        float(np.nanmax(latitude)),
        float(np.nanmin(east)),
        float(np.nanmax(east)),
    )
