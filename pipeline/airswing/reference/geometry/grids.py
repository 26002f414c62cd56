"""Where a point lies on a model's grid, and how the grid is turned there.

Assumptions and validity
------------------------
* Lambert conformal (tangent and secant, either hemisphere), polar
  stereographic (either pole), Mercator, regular and rotated latitude/longitude
  grids of GRIB editions 1 and 2, on a sphere or an ellipsoid of revolution.
  Any other grid is refused by name (`UnplaceableGridError`).
* The projections are Snyder (1987, USGS Professional Paper 1395): equations
  15-1 to 15-10 (Lambert), 21-30 to 21-38 (polar stereographic), 7-6 to 7-7
  (Mercator); rotated latitude/longitude is a plain rotation of the sphere.
* GRIB counts grid lengths of polar stereographic and Mercator grids at the
  latitude LaD (60 degrees in edition 1), of Lambert grids at the standard
  parallels.
* The first value of a message lies at the first grid point (La1, Lo1) and the rest
  follow in the scanning direction, as WMO regulation 92.8 and table 3.4 have it.
  (eccodes' iterator lays projected grids towards increasing x and y from that
  corner whatever the scanning direction.)
* Wind components "relative to the grid" point to increasing x and y of the
  projection, whatever the scanning direction (WMO code table 3.3).
* Degrees outside the kernels, radians inside; metres.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import wrap_degrees
from airswing.units import MODEL_EARTH_RADIUS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Angle = TypeVar("Angle", float, Floats)

#: Points within this many grid lengths of the outermost row or column count as on it;
#: GRIB1 writes coordinates to a thousandth of a degree.
EDGE_TOLERANCE = 1e-6


class UnplaceableGridError(Exception):
    """A grid whose points cannot be placed; the text says which and why."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Everything needed to place points on one grid."""

    kind: str  # lambert, polar_stereographic, mercator, regular_ll or rotated_ll
    ni: int  # points along x (i) and y (j)
    nj: int
    latitude_first: float  # first grid point, degrees (in rotated coordinates for rotated_ll)
    longitude_first: float
    di: float  # step from one index to the next, signed: metres in the plane, or degrees
    dj: float
    radius: float = MODEL_EARTH_RADIUS  # semi-major axis, m
    eccentricity: float = 0.0  # first eccentricity of the earth used
    orientation: float = 0.0  # longitude parallel to the y axis (LoV), degrees
    true_latitude: float = 0.0  # LaD, degrees
    latin1: float = 0.0  # standard parallels of a Lambert cone, degrees
    latin2: float = 0.0
    south: bool = False  # south pole at the centre of a polar stereographic projection
    pole_latitude: float = -90.0  # southern pole of a rotated grid, degrees
    pole_longitude: float = 0.0
    periodic: bool = False  # the column after the last is the first
    wind_along_grid: bool = False  # the message's uvRelativeToGrid flag
    # Order of storage: points run along j first; every other row runs backwards.
    j_consecutive: bool = False
    alternate_rows: bool = False

    @property
    def size(self) -> int:
        """Number of grid points."""
        return self.ni * self.nj

    @property
    def key(self) -> str:
        """Short hash of every parameter."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices of places (n,) in degrees, inside the grid or not."""
        x, y = _project(self, latitude, longitude)
        x0, y0 = _project(
            self, np.array([self.latitude_first]), np.array([self.longitude_first]), on_grid=True
        )
        fi, fj = (x - x0) / self.di, (y - y0) / self.dj
        turn = self.columns_in_a_turn
        if turn:
            fi = _unwrap(fi, turn, self.ni)
        return fi, fj

    @property
    def columns_in_a_turn(self) -> float:
        """Columns in a full turn of longitude, 0 where columns are not meridians."""
        if self.kind in ("regular_ll", "rotated_ll"):
            return abs(360.0 / self.di)
        if self.kind == "mercator":
            scale = _parallel(np.radians(self.true_latitude), self.eccentricity)
            return float(abs(2.0 * np.pi * self.radius * scale / self.di))
        return 0.0

    def fractional_index(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """Fractional indices from the first point along x and y; NaN outside the grid."""
        fi, fj = self.plane(_floats(latitude), _floats(longitude))
        with np.errstate(invalid="ignore"):
            inside = (fj >= -EDGE_TOLERANCE) & (fj <= self.nj - 1 + EDGE_TOLERANCE)
            if not self.periodic:
                inside &= (fi >= -EDGE_TOLERANCE) & (fi <= self.ni - 1 + EDGE_TOLERANCE)
        fi = np.mod(fi, self.ni) if self.periodic else np.clip(fi, 0.0, self.ni - 1.0)
        fj = np.clip(fj, 0.0, self.nj - 1.0)
        return np.where(inside, fi, np.nan), np.where(inside, fj, np.nan)

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle (rad) that turns grid components to true east and north.

        ``u_e = cos(a) u_g + sin(a) v_g``, ``v_e = -sin(a) u_g + cos(a) v_g``.
        """
        lat, lon = _floats(latitude), _floats(longitude)
        if self.kind == "lambert":
            return np.asarray(_cone(self) * np.radians(wrap_degrees(lon - self.orientation)))
        if self.kind == "polar_stereographic":
            sign = -1.0 if self.south else 1.0
            return np.asarray(sign * np.radians(wrap_degrees(lon - self.orientation)))
        if self.kind == "rotated_ll":
            return _rotated_convergence(self, lat, lon)
        return np.zeros_like(lat)

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid in whole degrees, for messages to people."""
        lat, lon = (
            lattice.ravel().astype(np.float64)
            for lattice in np.meshgrid(np.arange(-90, 91), np.arange(-180, 180))
        )
        fi, fj = self.fractional_index(lat, lon)
        inside = np.isfinite(fi) & np.isfinite(fj)
        if not inside.any():
            # A grid between whole degrees: its first point stands for it.
            lat, lon = _floats(self.latitude_first), _floats(self.longitude_first)
            inside = np.ones(1, dtype=bool)
        lat, lon = lat[inside], lon[inside]
        return float(lat.min()), float(lat.max()), float(lon.min()), float(lon.max())

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j), from the first point, in the message's list of values."""
        if self.j_consecutive:
            if self.alternate_rows:
                j = np.where(i % 2 == 1, self.nj - 1 - j, j)
            return i * self.nj + j
        if self.alternate_rows:
            i = np.where(j % 2 == 1, self.ni - 1 - i, i)
        return j * self.ni + i


def rotation(pole_latitude: float, pole_longitude: float) -> Grid:
    """A rotated frame by its southern pole, degrees: its indices are its coordinates."""
    return Grid(
        "rotated_ll",
        ni=1,
        nj=1,
        latitude_first=0.0,
        longitude_first=0.0,
        di=1.0,
        dj=1.0,
        pole_latitude=pole_latitude,
        pole_longitude=pole_longitude,
    )


def _floats(values: ArrayLike) -> Floats:
    return np.ascontiguousarray(np.atleast_1d(values), dtype=np.float64)


def _unwrap(fi: Floats, turn: float, ni: int) -> Floats:
    """Bring column coordinates to the turn that starts just west of the first column."""
    gap = max(turn - (ni - 1), 0.0)
    return np.asarray(np.mod(fi + gap / 2.0, turn) - gap / 2.0)


def _parallel(phi: Angle, e: float) -> Angle:
    """Snyder 14-15: radius of a parallel over the semi-major axis."""
    found: Angle = np.cos(phi) / np.sqrt(1.0 - (e * np.sin(phi)) ** 2)
    return found


def _colatitude(phi: Angle, e: float) -> Angle:
    """Snyder 15-9: isometric colatitude t."""
    t: Angle = np.tan(np.pi / 4.0 - phi / 2.0)
    if e:
        s = e * np.sin(phi)
        t = t / ((1.0 - s) / (1.0 + s)) ** (e / 2.0)
    return t


def _cone(grid: Grid) -> float:
    """Snyder 15-8 (15-3 on a sphere): cone constant n."""
    one, two = np.radians(grid.latin1), np.radians(grid.latin2)
    e = grid.eccentricity
    if abs(grid.latin1 - grid.latin2) < 1e-9:
        return float(np.sin(one))
    ratio = np.log(_parallel(one, e) / _parallel(two, e))
    return float(ratio / np.log(_colatitude(one, e) / _colatitude(two, e)))


def _project(
    grid: Grid, lat: Floats, lon: Floats, *, on_grid: bool = False
) -> tuple[Floats, Floats]:
    """Plane coordinates (m, or degrees); `on_grid` takes rotated coordinates as they are."""
    if grid.kind == "regular_ll" or (grid.kind == "rotated_ll" and on_grid):
        return lon, lat
    if grid.kind == "rotated_ll":
        return _rotate(grid, lat, lon)
    phi, e, a = np.radians(lat), grid.eccentricity, grid.radius
    if grid.kind == "mercator":
        scale = a * _parallel(np.radians(grid.true_latitude), e)
        with np.errstate(divide="ignore", invalid="ignore"):
            return scale * np.radians(lon), -scale * np.log(_colatitude(phi, e))
    turned = np.radians(wrap_degrees(lon - grid.orientation))
    if grid.kind == "lambert":
        n, one = _cone(grid), np.radians(grid.latin1)
        with np.errstate(divide="ignore", invalid="ignore"):
            rho = a * _parallel(one, e) / n * (_colatitude(phi, e) / _colatitude(one, e)) ** n
            return rho * np.sin(n * turned), -rho * np.cos(n * turned)  # the far pole is nowhere
    sign = -1.0 if grid.south else 1.0
    rho = _polar_scale(grid) * _colatitude(sign * phi, e)
    return rho * np.sin(turned), -sign * rho * np.cos(turned)


def _polar_scale(grid: Grid) -> float:
    """Snyder 21-33/21-34: radius of the projection at t = 1."""
    lad, e = np.radians(abs(grid.true_latitude)), grid.eccentricity
    if abs(grid.true_latitude) > 90.0 - 1e-9:
        return float(2.0 * grid.radius / np.sqrt((1 + e) ** (1 + e) * (1 - e) ** (1 - e)))
    return float(grid.radius * _parallel(lad, e) / _colatitude(lad, e))


def _unit(lat: Floats, lon: Floats) -> Floats:
    phi, lam = np.radians(lat), np.radians(lon)
    return np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])


def _rotated_axes(grid: Grid) -> Floats:
    """Rows: the rotated frame's axes in geographic Cartesian coordinates."""
    pole = -_unit(np.array(grid.pole_latitude), np.array(grid.pole_longitude))
    lat0, lon0 = grid.pole_latitude + 90.0, grid.pole_longitude
    prime = _unit(np.array(lat0), np.array(lon0))
    return np.stack([prime, np.cross(pole, prime), pole])


def _rotate(grid: Grid, lat: Floats, lon: Floats) -> tuple[Floats, Floats]:
    """Rotated longitude and latitude, degrees."""
    x, y, z = _rotated_axes(grid) @ _unit(lat, lon).reshape(3, -1)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def _rotated_convergence(grid: Grid, lat: Floats, lon: Floats) -> Floats:
    """Angle between rotated and true east from the two poles' unit vectors."""
    lam = np.radians(lon)
    r, pole = _unit(lat, lon), _rotated_axes(grid)[2]
    east = np.stack([-np.sin(lam), np.cos(lam), np.zeros_like(lam)])
    north = np.cross(r, east, axis=0)
    grid_east = np.cross(pole[:, None], r, axis=0)
    angle = np.arctan2(-(grid_east * north).sum(axis=0), (grid_east * east).sum(axis=0))
    return np.asarray(angle)
