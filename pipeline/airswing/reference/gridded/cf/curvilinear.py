"""A grid given by the latitude and longitude of every point.

Assumptions and validity
------------------------
* Cells are quadrilaterals between four neighbouring points; inside one, a place's index is that
  of the bilinear map of the four points' unit vectors, found by Newton's method: for cells of
  a few kilometres equal to the projection's to better than 1e-6 grid lengths, for 50 km to 1e-4.
* The grid's direction is that of its rows, by central differences of the points, unless it is
  given at each point.
* A circle that closes on itself is not told: between the last column and the first there is no
  value.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.reference.gridded.cf.axes_grid import bounded, box_of

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_STEPS = 12  # Of Newton's method; 3 to 5 are enough in any cell that is not folded
_MOVES = 6  # Neighbouring cells a place may be handed on to


class CurvilinearGrid:
    """Where points lie on a grid of which only the points are known.

    Parameters
    ----------
    latitude, longitude : (nj, ni) float arrays, degrees
    turned : (nj, ni) float array, optional
        Angle (rad) that turns grid components to true east and north, at each point.

    Raises
    ------
    ValueError
        A latitude or longitude is none.
    """

    periodic = False
    columns_in_a_turn = 0.0

    def __init__(
        self,
        latitude: Floats,
        longitude: Floats,
        *,
        turned: Floats | None = None,
        wind_along_grid: bool = False,
    ) -> None:
        # single precision may put a pole a little beyond 90 degrees
        if not ((np.abs(latitude) < 90.001) & (np.abs(longitude) < 1e4)).all():
            raise ValueError("points whose latitude or longitude is none")
        self.latitude, self.longitude, self.turned = latitude, longitude, turned
        self.wind_along_grid = wind_along_grid
        self.nj, self.ni = (int(n) for n in latitude.shape)

    def directed(self, along: bool) -> CurvilinearGrid:
        """The grid with winds along it or not."""
        return CurvilinearGrid(
            self.latitude, self.longitude, turned=self.turned, wind_along_grid=along
        )

    @property
    def size(self) -> int:
        """Number of grid points."""
        return self.ni * self.nj

    @cached_property
    def key(self) -> str:
        """Short hash of where the grid points are."""
        digest = hashlib.sha256(f"curvilinear {self.ni} {self.nj}".encode())
        for one in (self.latitude, self.longitude, self.turned):
            digest.update(b"|" if one is None else np.ascontiguousarray(one).tobytes())
        return digest.hexdigest()[:16]

    def __repr__(self) -> str:
        return (
            f"CurvilinearGrid({self.ni} x {self.nj}, {self.key}, "
            f"wind_along_grid={self.wind_along_grid})"
        )

    def __getstate__(self) -> tuple[object, ...]:
        return (self.latitude, self.longitude, self.turned, self.wind_along_grid)

    def __setstate__(self, state: tuple[object, ...]) -> None:
        lat, lon, turned, along = state
        self.__init__(lat, lon, turned=turned, wind_along_grid=along)  # type: ignore[misc]

    @cached_property
    def _vectors(self) -> Floats:
        """(nj, ni, 3) unit vectors of the points."""
        return unit_vectors(self.latitude, self.longitude)

    @cached_property
    def _directions(self) -> NDArray[np.complex128]:
        """(nj, ni) unit complex numbers whose argument turns grid components to true ones."""
        if self.turned is not None:
            return np.asarray(np.exp(1j * self.turned))
        if self.ni > 2:
            along = np.asarray(np.gradient(self._vectors, axis=1, edge_order=2))
        else:
            along = np.asarray(np.gradient(self._vectors, axis=1))
        east, north = _axes(self._vectors.reshape(-1, 3))
        along = along.reshape(-1, 3)
        found = (along * east).sum(1) - 1j * (along * north).sum(1)
        return np.asarray((found / np.abs(found)).reshape(self.nj, self.ni))

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        return cKDTree(self._vectors.reshape(-1, 3))

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices of places (n,) in degrees.

        Outside the grid those of the nearest cell, carried on.
        """
        known = np.isfinite(latitude) & np.isfinite(longitude)
        fi, fj = np.full(latitude.size, np.nan), np.full(latitude.size, np.nan)
        target = unit_vectors(latitude[known], longitude[known])
        if not target.size:
            return fi, fj
        _, nearest = self._tree.query(target)
        j, i = np.divmod(nearest, self.ni)
        i, j = (np.clip(i, 0, self.ni - 2), np.clip(j, 0, self.nj - 2))
        for _ in range(_MOVES):
            s, t = self._in_cell(i, j, target)
            moved_i = np.clip(i + _over(s), 0, self.ni - 2)
            moved_j = np.clip(j + _over(t), 0, self.nj - 2)
            if np.array_equal(moved_i, i) and np.array_equal(moved_j, j):
                break
            i, j = moved_i, moved_j
        s, t = self._in_cell(i, j, target)
        fi[known], fj[known] = i + s, j + t
        return fi, fj

    def _corners(self, i: Ints, j: Ints) -> tuple[Floats, Floats, Floats, Floats]:
        v = self._vectors
        return v[j, i], v[j, i + 1], v[j + 1, i], v[j + 1, i + 1]

    def _in_cell(self, i: Ints, j: Ints, target: Floats) -> tuple[Floats, Floats]:
        """Place of targets in cells, by Newton's method in the plane square to the target."""
        p00, p10, p01, p11 = self._corners(i, j)
        east, north = _axes(target)
        s, t = np.full(i.size, 0.5), np.full(i.size, 0.5)
        for _ in range(_STEPS):
            u, w = s[:, None], t[:, None]
            here = (1 - u) * (1 - w) * p00 + u * (1 - w) * p10 + (1 - u) * w * p01 + u * w * p11
            along_s = (1 - w) * (p10 - p00) + w * (p11 - p01)
            along_t = (1 - u) * (p01 - p00) + u * (p11 - p10)
            a, b = (along_s * east).sum(1), (along_t * east).sum(1)
            c, d = (along_s * north).sum(1), (along_t * north).sum(1)
            x, y = (here * east).sum(1), (here * north).sum(1)
            determinant = a * d - b * c
            with np.errstate(divide="ignore", invalid="ignore"):
                ds = (d * x - b * y) / determinant
                dt = (a * y - c * x) / determinant
            # at most two cells a step: one from afar may leap past the place and never return
            s, t = s - np.clip(ds, -2.0, 2.0), t - np.clip(dt, -2.0, 2.0)
        far = (target * (p00 + p11)).sum(1) <= 0.0  # the other side of the earth
        return np.where(far, np.inf, s), np.where(far, np.inf, t)

    def fractional_index(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """Place points on the grid; NaN outside it."""
        fi, fj = self.plane(_floats(latitude), _floats(longitude))
        return bounded(fi, fj, self.ni, self.nj, periodic=False)

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle that turns grid components to true east and north, radians."""
        lat, lon = _floats(latitude), _floats(longitude)
        fi, fj = self.plane(lat, lon)
        fi, fj = np.nan_to_num(fi, posinf=0.0), np.nan_to_num(fj, posinf=0.0)
        i = np.clip(np.floor(fi), 0, self.ni - 2).astype(np.int64)
        j = np.clip(np.floor(fj), 0, self.nj - 2).astype(np.int64)
        s, t = (fi - i)[:, None], (fj - j)[:, None]
        z = self._directions
        z = np.stack([z[j, i], z[j, i + 1], z[j + 1, i], z[j + 1, i + 1]], axis=1)
        weights = np.hstack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
        return np.asarray(np.angle((weights * z).sum(axis=1)))

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid points, degrees, for messages to people."""
        return box_of(self.latitude, self.longitude)

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j) among all points, row after row."""
        return j * self.ni + i


def _floats(values: ArrayLike) -> Floats:
    return np.ascontiguousarray(np.atleast_1d(values), dtype=np.float64)


def _over(place: Floats) -> Ints:
    """Cells by which a place lies beyond its own."""
    return np.clip(np.floor(np.nan_to_num(place, posinf=0.0)), -3, 3).astype(np.int64)


def unit_vectors(latitude: Floats, longitude: Floats) -> Floats:
    """(..., 3) unit vectors of places in degrees."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    return np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=-1)


def _axes(vectors: Floats) -> tuple[Floats, Floats]:
    """True east and north at unit vectors (n, 3)."""
    lam = np.arctan2(vectors[:, 1], vectors[:, 0])
    east = np.stack([-np.sin(lam), np.cos(lam), np.zeros_like(lam)], axis=-1)
    return east, np.cross(vectors, east)
