"""Position of a point on a model's grid, and the direction of the grid there.

`AxesGrid` is given by one coordinate along each axis of longitude and latitude, of a rotated pole
or of a projection of PROJ; its index is linear in the coordinate between grid points. `PointsGrid`
is given by the latitude and longitude of every point; the index inside a cell is that of the
bilinear map of its corners' unit vectors, equal to the projection's to 1e-6 grid lengths for cells
of a few kilometres, 1e-4 for 50 km. Latitudes are used as written, on the sphere or ellipsoid of
the projection. A grid's direction is that of true north in its plane. Degrees outside, radians for
directions, metres in projections.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
import threading
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Proj
from pyproj.exceptions import CRSError

from airswing.errors import InputError
from airswing.physics.triangle import wrap_degrees

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Points up to this many grid lengths outside the outermost row or column count as on it:
#: coordinates are often stored in single precision or to a thousandth of a degree.
EDGE_TOLERANCE = 1e-4
_FULL_CIRCLE = 1e-2  # columns by which the span of a full circle may differ from 360 degrees
_NORTH_STEP = 1e-4  # degrees, half the step towards north that gives a grid's direction
_SAME_POINTS = 1e-2  # grid lengths by which points may differ from the axes of a projection
_OUTLINE_POINTS = 60  # along each axis
_NEWTON_STEPS, _EXACT = 12, 1e-9  # most steps, and the size (cells) of the last one
_NEIGHBOUR_STEPS = 6  # neighbouring cells searched from the nearest point
_LOCAL = threading.local()  # a Proj belongs to the thread that made it

PROJECTION_REMEDY = (
    'Give it in the configuration as projection: a PROJ string such as "+proj=lcc +lat_1=38.5 '
    '+lat_2=38.5 +lat_0=38.5 +lon_0=-97.5 +R=6371229", or as CF grid mapping attributes'
)


class UnplaceableGridError(Exception):
    """A grid whose points cannot be placed; the text gives its name and the reason."""


def _proj(text: str) -> Proj:
    cache: dict[str, Proj] = _LOCAL.__dict__.setdefault("projections", {})
    if text not in cache:
        cache[text] = Proj(text, preserve_units=False)
    return cache[text]


@dataclass(frozen=True, slots=True)
class Frame:
    """A system of horizontal coordinates x, y.

    `kind` is ``longitude_latitude``, ``rotated`` (longitude and latitude about another pole), or
    ``projected`` (metres).
    """

    kind: str = "longitude_latitude"
    proj: str = ""

    @property
    def meridional(self) -> bool:
        """Whether x is a longitude in degrees, of the earth or about a rotated pole."""
        return self.kind != "projected"

    @property
    def turn(self) -> float:
        """Length of a full circle along x: degrees, metres of a Mercator projection, or inf."""
        if self.meridional:
            return 360.0
        if "proj=merc" not in self.proj:
            return math.inf
        (west, east), _ = _proj(self.proj)([0.0, 1e6], [0.0, 0.0], inverse=True)
        return 360.0 / abs(float(wrap_degrees(east - west))) * 1e6

    @property
    def north_up(self) -> bool:
        """Whether y points to true north everywhere."""
        return self.kind == "longitude_latitude" or "proj=merc" in self.proj

    def xy(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Coordinates (n,) of places (n,) in degrees; NaN where the projection has no image."""
        if self.kind == "longitude_latitude":
            return longitude, latitude
        finite = np.isfinite(latitude) & np.isfinite(longitude)
        plane = np.full((2, latitude.size), np.nan)
        east = wrap_degrees(longitude[finite])  # PROJ refuses longitudes beyond 573 degrees
        plane[:, finite] = _proj(self.proj)(east, latitude[finite])
        plane[~np.isfinite(plane)] = np.nan
        x, y = np.degrees(plane) if self.kind == "rotated" else plane
        return x, y

    def places(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Latitudes and longitudes (degrees) of coordinates: the inverse of :meth:`xy`."""
        if self.kind == "longitude_latitude":
            return y, x
        if self.kind == "rotated":
            x, y = np.radians(x), np.radians(y)
        longitude, latitude = _proj(self.proj)(x, y, inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def convergence(self, latitude: Floats, longitude: Floats) -> Floats:
        """Angle (n,) in rad that turns components along the frame to true east and north.

        ``u_e = cos(a) u + sin(a) v``, ``v_e = -sin(a) u + cos(a) v``.
        """
        if self.north_up:
            return np.zeros_like(latitude)
        if self.kind == "projected":
            factors = _proj(self.proj).get_factors(wrap_degrees(longitude), latitude)
            return np.asarray(np.radians(factors.meridian_convergence))
        # PROJ gives no factors of a rotated pole
        north, south = np.minimum(latitude + _NORTH_STEP, 90.0), latitude - _NORTH_STEP
        (x1, y1), (x0, y0) = self.xy(north, longitude), self.xy(south, longitude)
        dx = wrap_degrees(x1 - x0) * np.cos(np.radians((y0 + y1) / 2.0))
        return np.asarray(np.arctan2(-dx, y1 - y0))


LONGITUDE_LATITUDE = Frame()


def rotated_frame(pole_latitude: float, pole_longitude: float, turned: float = 0.0) -> Frame:
    """Longitude and latitude about a rotated north pole (degrees).

    `turned` is the longitude of the true north pole in the rotated frame.
    """
    return Frame(
        "rotated",
        f"+proj=ob_tran +o_proj=longlat +o_lat_p={pole_latitude!r} +o_lon_p={turned!r} "
        f"+lon_0={pole_longitude - 180.0!r} +R=1",
    )


def frame_of(mapping: Mapping[str, object] | str, *, field: str) -> Frame:
    """Frame of a CF grid mapping (CF appendix F), or of a PROJ or WKT string."""
    try:
        if isinstance(mapping, str):
            return _frame(mapping)
        # no numpy values, a list of one as a number
        lists = {key: np.ravel(np.asarray(value)).tolist() for key, value in mapping.items()}
        attributes = {key: v[0] if len(v) == 1 else v for key, v in lists.items()}
        return _frame(json.dumps(attributes, default=str))
    except (CRSError, KeyError, ValueError, TypeError) as error:
        named = mapping if isinstance(mapping, str) else mapping.get("grid_mapping_name", "")
        raise InputError(
            "projection not known",
            field=field,
            found=named or str(mapping)[:300],
            remedy=PROJECTION_REMEDY,
        ) from error


@lru_cache(maxsize=64)  # PROJ takes milliseconds to read one, and the files of an archive share it
def _frame(text: str) -> Frame:
    crs = CRS.from_cf(json.loads(text)) if text.startswith("{") else CRS.from_user_input(text)
    described = crs.to_cf()
    kind = described.get("grid_mapping_name")
    if kind == "rotated_latitude_longitude":
        return rotated_frame(
            float(described["grid_north_pole_latitude"]),
            float(described["grid_north_pole_longitude"]),
            float(described.get("north_pole_grid_longitude", 0.0)),
        )
    if kind == "latitude_longitude" or crs.is_geographic:
        return LONGITUDE_LATITUDE
    # a PROJ string names no datum: none is needed here
    with warnings.catch_warnings(action="ignore"):
        return Frame("projected", str(Proj(crs).srs))


class Grid(ABC):
    """A horizontal grid of ni columns and nj rows."""

    name: str
    ni: int
    nj: int
    key: str  # short hash of the positions of the grid points
    wind_along_grid: bool  # wind components point along the grid, not to true east and north
    periodic: bool = False  # the column after the last is the first
    north_up: bool = False  # the grid's y direction is true north everywhere

    @property
    def size(self) -> int:
        """Number of grid points."""
        return self.ni * self.nj

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Grid) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(self.key)

    def __repr__(self) -> str:
        along = f"wind_along_grid={self.wind_along_grid}"
        return f"<Grid {self.name}, {self.ni} x {self.nj}, {self.key}, {along}>"

    @abstractmethod
    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices (n,) along x and y of places (n,) in degrees, also outside."""

    @abstractmethod
    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle (n,) in rad that turns grid components to true ones: see `Frame.convergence`."""

    @abstractmethod
    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid points, degrees; longitudes -180 to 180."""

    def directed(self, along: bool) -> Self:
        """The same grid with wind components along it or not."""
        grid = copy.copy(self)
        grid.wind_along_grid = along
        return grid

    def fractional_index(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Floats, Floats]:
        """Fractional indices (n,) along x and y of places in degrees; NaN outside the grid."""
        fi, fj = self.plane(as_floats(latitude), as_floats(longitude))
        with np.errstate(invalid="ignore"):
            inside = (fj >= -EDGE_TOLERANCE) & (fj <= self.nj - 1 + EDGE_TOLERANCE)
            if self.periodic:
                fi = np.mod(fi, self.ni)
            else:
                inside &= (fi >= -EDGE_TOLERANCE) & (fi <= self.ni - 1 + EDGE_TOLERANCE)
                fi = np.clip(fi, 0.0, self.ni - 1.0)
        fj = np.clip(fj, 0.0, self.nj - 1.0)
        return np.where(inside, fi, np.nan), np.where(inside, fj, np.nan)

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j) in the stored list of values."""
        return j * self.ni + i

    def contains(self, latitude: ArrayLike, longitude: ArrayLike) -> NDArray[np.bool_]:
        """Whether places (degrees) lie inside the grid."""
        fi, fj = self.fractional_index(latitude, longitude)
        return np.isfinite(fi) & np.isfinite(fj)


class AxesGrid(Grid):
    """A grid of one coordinate along each axis, in the order in which values are stored.

    Values may be stored column after column, and every other row (or column) backwards.
    """

    def __init__(
        self,
        frame: Frame,
        x: Floats,
        y: Floats,
        wind_along_grid: bool = False,
        by_column: bool = False,
        alternate: bool = False,
    ) -> None:
        self.frame, self.x, self.y, self.wind_along_grid = frame, x, y, wind_along_grid
        self.by_column, self.alternate = by_column, alternate
        self.ni, self.nj, self.name, self.north_up = x.size, y.size, frame.kind, frame.north_up
        self.key = _short_hash(repr((frame, by_column, alternate)), x, y)
        self._columns, self._turn = x, frame.turn
        if np.isfinite(self._turn) and self.ni > 1:
            self._columns = np.unwrap(x, period=self._turn)
            span = abs(float(self._columns[-1] - self._columns[0]))
            step = span / (self.ni - 1)
            self.periodic = abs(span + step - self._turn) < _FULL_CIRCLE * step

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices (n,) along x and y of places (n,) in degrees, also outside."""
        x, y = self.frame.xy(latitude, longitude)
        columns, turn = self._columns, self._turn
        if np.isfinite(turn) and self.ni > 1:
            # in the circle that starts halfway between the last and the first column
            span = float(columns[-1] - columns[0])
            gap, along = max(turn - abs(span), 0.0), np.copysign(1.0, span)
            past = np.mod(along * (x - columns[0]) + gap / 2.0, turn) - gap / 2.0
            x = columns[0] + along * past
            if self.periodic:
                columns = np.append(columns, columns[0] + along * turn)
        return _index_along(columns, x), _index_along(self.y, y)

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle (n,) in rad that turns grid components to true east and north."""
        return self.frame.convergence(as_floats(latitude), as_floats(longitude))

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid points, degrees."""
        ends = (np.linspace(0, n - 1, _OUTLINE_POINTS).astype(int) for n in (self.ni, self.nj))
        x, y = np.meshgrid(*(axis[some] for axis, some in zip((self.x, self.y), ends, strict=True)))
        return _box(*self.frame.places(x.ravel(), y.ravel()))

    def position(self, i: Ints, j: Ints) -> Ints:
        """Place of the point (i, j) in the stored list of values."""
        if self.by_column:
            if self.alternate:
                j = np.where(i % 2 == 1, self.nj - 1 - j, j)
            return i * self.nj + j
        if self.alternate:
            i = np.where(j % 2 == 1, self.ni - 1 - i, i)
        return j * self.ni + i


class PointsGrid(Grid):
    """A grid given by the latitude and longitude (nj, ni; degrees) of every point.

    The angle (rad) that turns grid components to true ones at each point is by default that of the
    rows, by central differences.
    """

    name = "points"

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
            raise ValueError("grid points with an impossible latitude or longitude")
        self.latitude, self.longitude, self.turned = latitude, longitude, turned
        self.wind_along_grid = wind_along_grid
        self.nj, self.ni = (int(n) for n in latitude.shape)
        self.key = _short_hash(f"points {self.ni} {self.nj}", latitude, longitude, turned)

    def __getstate__(self) -> dict[str, object]:
        derived = ("_vectors", "_directions", "_tree")  # large, and computed again when needed
        return {name: value for name, value in self.__dict__.items() if name not in derived}

    @cached_property
    def _vectors(self) -> Floats:  # (nj, ni, 3)
        return _unit_vectors(self.latitude, self.longitude)

    @cached_property
    def _directions(self) -> NDArray[np.complex128]:
        """(nj, ni) unit complex numbers whose argument turns grid components to true ones."""
        if self.turned is not None:
            return np.asarray(np.exp(1j * self.turned))
        order: Literal[1, 2] = 2 if self.ni > 2 else 1
        along = np.asarray(np.gradient(self._vectors, axis=1, edge_order=order)).reshape(-1, 3)
        east, north = _east_north(self._vectors.reshape(-1, 3))
        direction = (along * east).sum(1) - 1j * (along * north).sum(1)
        return np.asarray((direction / np.abs(direction)).reshape(self.nj, self.ni))

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        return cKDTree(self._vectors.reshape(-1, 3))

    def plane(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Fractional indices (n,) of places (n,) in degrees; outside those of the nearest cell."""
        finite = np.isfinite(latitude) & np.isfinite(longitude)
        fi, fj = np.full(latitude.size, np.nan), np.full(latitude.size, np.nan)
        target = _unit_vectors(latitude[finite], longitude[finite])
        if not target.size:
            return fi, fj
        _, nearest = self._tree.query(target)
        j, i = np.divmod(nearest, self.ni)
        i, j = np.clip(i, 0, self.ni - 2), np.clip(j, 0, self.nj - 2)
        for _ in range(_NEIGHBOUR_STEPS):
            before = i, j
            s, t = self._in_cell(i, j, target)
            over_i, over_j = (
                np.clip(np.floor(np.nan_to_num(place, posinf=0.0)), -3, 3).astype(np.int64)
                for place in (s, t)
            )
            i, j = np.clip(i + over_i, 0, self.ni - 2), np.clip(j + over_j, 0, self.nj - 2)
            if np.array_equal((i, j), before):
                break
        fi[finite], fj[finite] = before[0] + s, before[1] + t
        return fi, fj

    def _in_cell(self, i: Ints, j: Ints, target: Floats) -> tuple[Floats, Floats]:
        """Place of targets in cells, by Newton's method in the plane tangent at the target."""
        v = self._vectors
        p00, p10, p01, p11 = v[j, i], v[j, i + 1], v[j + 1, i], v[j + 1, i + 1]
        east, north = _east_north(target)
        s, t = np.full(i.size, 0.5), np.full(i.size, 0.5)
        for _ in range(_NEWTON_STEPS):
            u, w = s[:, None], t[:, None]
            point = (1 - u) * (1 - w) * p00 + u * (1 - w) * p10 + (1 - u) * w * p01 + u * w * p11
            along_s = (1 - w) * (p10 - p00) + w * (p11 - p01)
            along_t = (1 - u) * (p01 - p00) + u * (p11 - p10)
            a, b = (along_s * east).sum(1), (along_t * east).sum(1)
            c, d = (along_s * north).sum(1), (along_t * north).sum(1)
            x, y = (point * east).sum(1), (point * north).sum(1)
            determinant = a * d - b * c
            with np.errstate(divide="ignore", invalid="ignore"):
                step_s = (d * x - b * y) / determinant
                step_t = (a * y - c * x) / determinant
            # at most two cells a step: a longer one may jump past the place and not return
            s, t = s - np.clip(step_s, -2.0, 2.0), t - np.clip(step_t, -2.0, 2.0)
            if np.abs([step_s, step_t]).max() < _EXACT:
                break
        far = (target * (p00 + p11)).sum(1) <= 0.0  # the other side of the earth
        return np.where(far, np.inf, s), np.where(far, np.inf, t)

    def convergence(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Angle (n,) in rad that turns grid components to true east and north."""
        fi, fj = np.nan_to_num(self.plane(as_floats(latitude), as_floats(longitude)), posinf=0.0)
        i = np.clip(np.floor(fi), 0, self.ni - 2).astype(np.int64)
        j = np.clip(np.floor(fj), 0, self.nj - 2).astype(np.int64)
        s, t, z = fi - i, fj - j, self._directions
        low = (1 - s) * z[j, i] + s * z[j, i + 1]
        high = (1 - s) * z[j + 1, i] + s * z[j + 1, i + 1]
        return np.asarray(np.angle((1 - t) * low + t * high))

    def outline(self) -> tuple[float, float, float, float]:
        """South, north, west and east of the grid points, degrees."""
        return _box(self.latitude, self.longitude)


def through_points(frame: Frame, latitude: Floats, longitude: Floats) -> AxesGrid | None:
    """Grid of a projection whose points (nj, ni), degrees, are known and whose axes are not.

    None if the points are not rows and columns of the projection.
    """
    if min(latitude.shape) < 2:
        return None
    x, y = np.reshape(frame.xy(latitude.ravel(), longitude.ravel()), (2, *latitude.shape))
    columns, rows = x.mean(axis=0), y.mean(axis=1)
    steps = np.diff(columns), np.diff(rows)
    if not all((step > 0).all() or (step < 0).all() for step in steps):
        return None
    wide, high = (float(np.abs(step).min()) for step in steps)
    off = max(np.abs(x - columns).max() / wide, np.abs(y - rows[:, None]).max() / high)
    return AxesGrid(frame, columns, rows) if off < _SAME_POINTS else None


def grid_of_points(latitude: Floats, longitude: Floats, turned: Floats | None = None) -> Grid:
    """Grid of the latitude and longitude (nj, ni; degrees) of every point.

    An `AxesGrid` where rows are parallels and columns meridians, else a `PointsGrid`.
    """
    if (latitude == latitude[:, :1]).all() and (longitude == longitude[:1]).all():
        return AxesGrid(LONGITUDE_LATITUDE, longitude[0], latitude[:, 0])
    return PointsGrid(latitude, longitude, turned=turned, wind_along_grid=True)


def are_shifted(first: Grid, second: Grid) -> bool:
    """Whether two grids cover the same area with points at most about a grid length apart.

    So do the grids of u and v on an Arakawa C or B grid, and one grid stored in two orders.
    """
    box, outline = np.array(first.outline()), np.array(second.outline())
    rows, columns = max(min(first.nj, second.nj) - 1, 1), max(min(first.ni, second.ni) - 1, 1)
    steps = np.repeat([(box[1] - box[0]) / rows, (box[3] - box[2]) / columns], 2)
    same_size = abs(first.ni - second.ni) <= 1 and abs(first.nj - second.nj) <= 1
    return same_size and bool((np.abs(box - outline) <= 1.5 * steps + 1e-3).all())


def _short_hash(text: str, *arrays: Floats | None) -> str:
    digest = hashlib.sha256(text.encode())
    for values in arrays:
        digest.update(b"|" if values is None else b"|" + np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def as_floats(values: ArrayLike) -> Floats:
    """A contiguous float array of at least one dimension."""
    return np.ascontiguousarray(np.atleast_1d(values), dtype=np.float64)


def _index_along(axis: Floats, values: Floats) -> Floats:
    """Fractional index of values on a monotonic axis, continued linearly at its ends."""
    if axis.size < 2:
        return np.where(np.isclose(values, axis[0]), 0.0, np.nan)
    step = (axis[-1] - axis[0]) / (axis.size - 1)
    if abs(axis[1] - axis[0] - step) <= 1e-9 * abs(step) and np.allclose(
        axis, axis[0] + step * np.arange(axis.size), rtol=0.0, atol=1e-9 * abs(step)
    ):
        return np.asarray((values - axis[0]) / step)
    if axis[-1] < axis[0]:
        axis, values = -axis, -values
    k = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, axis.size - 2)
    return np.asarray(k + (values - axis[k]) / (axis[k + 1] - axis[k]))


def _box(latitude: Floats, longitude: Floats) -> tuple[float, float, float, float]:
    east = wrap_degrees(longitude)
    south, north = float(np.nanmin(latitude)), float(np.nanmax(latitude))
    return south, north, float(np.nanmin(east)), float(np.nanmax(east))


def _unit_vectors(latitude: Floats, longitude: Floats) -> Floats:
    phi, lam = np.radians(latitude), np.radians(longitude)
    return np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=-1)


def _east_north(vectors: Floats) -> tuple[Floats, Floats]:
    """True east and north at unit vectors (n, 3)."""
    lam = np.arctan2(vectors[:, 1], vectors[:, 0])
    east = np.stack([-np.sin(lam), np.cos(lam), np.zeros_like(lam)], axis=-1)
    return east, np.cross(vectors, east)
