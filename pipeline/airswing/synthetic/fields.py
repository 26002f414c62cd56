"""Gridded winds of the sample's models: grid, stored fields, sampling, GRIB files.

Tangent Lambert cone on a sphere, regular times, isobaric levels of whole hPa. Winds are stored as
in the files: along the grid or earth-relative, rounded to the packing's decimal; GRIB1 for the RUC,
GRIB2 for RTFDAA. Sampling is bilinear on the grid, linear in ln p and in time.

Units: degrees and m for grids, hPa, hours since the start of the archive, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path

import numpy as np
import pyproj

from airswing.synthetic.atmosphere import Array, Fields, World, model_wind

GRIB_RADIUS = {1: 6367470.0, 2: 6371229.0}
"""Earth radius of each edition, m (code tables 7, bit 2 unset, and 3.2, value 6, of the WMO)."""
_DECIMALS = 1  # stored decimals of m/s


@dataclass(frozen=True)
class LambertGrid:
    """A grid with points in rows from the south-west corner."""

    first_latitude: float  # of the south-west point, degrees
    first_longitude: float
    columns: int
    rows: int
    spacing: float  # at the standard parallel, m
    orientation: float = -95.0  # longitude of the meridian parallel to y (LoV), degrees east
    standard_parallel: float = 25.0  # latitude where the cone touches, degrees
    radius: float = GRIB_RADIUS[1]  # of the earth, m

    @cached_property
    def projection(self) -> pyproj.Proj:
        """The cone's projection."""
        touching = self.standard_parallel
        cone = {"proj": "lcc", "lat_1": touching, "lat_2": touching, "lat_0": touching}
        return pyproj.Proj(cone | {"lon_0": self.orientation, "R": self.radius})

    @cached_property
    def _origin(self) -> tuple[float, float]:
        x, y = self.projection(self.first_longitude, self.first_latitude)
        return float(x), float(y)

    def indices(self, latitude: Array, longitude: Array) -> tuple[Array, Array]:
        """Fractional row and column of points given in degrees."""
        x, y = self.projection(longitude, latitude)
        x0, y0 = self._origin
        return (np.asarray(y) - y0) / self.spacing, (np.asarray(x) - x0) / self.spacing

    def convergence(self, longitude: Array) -> Array:
        """Angle from grid to earth winds, radians: eastward = cos u + sin v of the grid winds.

        Snyder (1987), Map Projections, USGS PP 1395, eq. 14-4 with n = sin(standard parallel).
        """
        turn = np.radians((longitude - self.orientation + 180.0) % 360.0 - 180.0)
        return np.asarray(turn * np.sin(np.radians(self.standard_parallel)))

    @cached_property
    def coordinates(self) -> tuple[Array, Array]:
        """Latitude and longitude (rows, columns) of every point, degrees."""
        x0, y0 = self._origin
        px, py = np.meshgrid(
            x0 + self.spacing * np.arange(self.columns), y0 + self.spacing * np.arange(self.rows)
        )
        lon, lat = self.projection(px, py, inverse=True)
        return np.asarray(lat), np.asarray(lon)


def centred_grid(
    latitude: float, longitude: float, *, columns: int, rows: int, spacing: float, radius: float
) -> LambertGrid:
    """Grid whose middle is at a place (degrees); its first point to 0.001 degree, as in GRIB1."""
    probe = LambertGrid(latitude, longitude, columns, rows, spacing, radius=radius)
    x, y = probe.projection(longitude, latitude)
    corner = probe.projection(
        x - spacing * (columns - 1) / 2, y - spacing * (rows - 1) / 2, inverse=True
    )
    first = round(float(corner[1]), 3), round(float(corner[0]), 3)
    return LambertGrid(*first, columns, rows, spacing, radius=radius)


_PLANE = LambertGrid(43.0, -90.0, 1, 1, 1000.0, -90.0, 43.0)


def plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Plane coordinates of the world: km east and north of 43 N, 90 W (degrees in)."""
    row, column = _PLANE.indices(latitude, longitude)
    return column, row


@dataclass(frozen=True)
class ReferenceChange:
    """Effect on the fields of one model."""

    speed_percent: float = 0.0  # speeds too strong by this much
    above_hpa: float | None = None  # acts only at this and lower pressures
    below_hpa: float | None = None  # acts only at higher pressures
    offset_hours: float = 0.0  # the field stamped t is that of t + offset
    # Fraction of the rotation a reader leaves out: 1 for winds along the grid flagged as the
    # earth's, -1 for the reverse.
    unrotated: float = 0.0


@dataclass
class GriddedReference:
    """Fields of one model as stored."""

    name: str
    grid: LambertGrid
    levels: Array  # (L,) hPa, decreasing
    hours: Array  # (T,) valid times
    wind: Fields = field(repr=False)  # (T, 2, L, rows, columns) m/s
    grid_relative: bool = True  # flag in the file


def build_reference(
    world: World,
    grid: LambertGrid,
    name: str,
    levels: Array,
    hours: Array,
    change: ReferenceChange,
) -> GriddedReference:
    """Stored fields of a model at ``levels`` (hPa) and valid times."""
    lat, lon = grid.coordinates
    places = *plane(lat, lon), np.log(levels / 1000.0), hours + change.offset_hours
    wind = model_wind(world, name, *places, world.large_scale_on_grid(*places))
    if change.speed_percent != 0.0:
        acts = np.ones(levels.size, bool)
        if change.above_hpa is not None:
            acts &= levels <= change.above_hpa
        if change.below_hpa is not None:
            acts &= levels > change.below_hpa
        factor = np.where(acts, 1.0 + change.speed_percent / 100.0, 1.0).astype(np.float32)
        wind = wind * factor[:, None, None]
    flag = change.unrotated != 1.0
    turn = float(flag) + change.unrotated
    if turn != 0.0:
        # To axes turned by the angle: the inverse of eastward = cos u + sin v.
        angle = turn * grid.convergence(lon)
        cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
        east, north = wind[:, 0], wind[:, 1]
        wind = np.stack([cosine * east - sine * north, sine * east + cosine * north], axis=1)
    return GriddedReference(name, grid, levels, hours, np.round(wind, _DECIMALS), flag)


def sample_reference(
    stored: GriddedReference,
    latitude: Array,
    longitude: Array,
    pressure: Array,
    hours: Array,
    *,
    shift: tuple[Array, Array] | None = None,
) -> Array:
    """True wind (2, n) of a model at points (degrees, hPa, hours), m/s; NaN outside.

    ``shift`` is the displacement of each point in rows and columns.
    """
    grid = stored.grid
    row, column = grid.indices(latitude, longitude)
    if shift is not None:
        row, column = row + shift[0], column + shift[1]
    zeta = np.log(stored.levels)
    depth = np.interp(np.log(pressure), zeta[::-1], np.arange(zeta.size)[::-1].astype(float))
    step = (hours - stored.hours[0]) / (stored.hours[1] - stored.hours[0])
    inside = (pressure >= stored.levels.min()) & (pressure <= stored.levels.max())
    shape = (stored.hours.size, stored.levels.size, grid.rows, grid.columns)
    lows, fractions = [], []
    for index, size in zip((step, depth, row, column), shape, strict=True):
        inside &= (index >= 0) & (index <= size - 1)
        low = np.clip(np.floor(index), 0, size - 2).astype(int)
        lows.append(low)
        fractions.append(index - low)
    # neighbours of each point: (2 times, 2 levels, 2 rows, 2 columns, 2 components, n)
    t, z, r, c = lows
    wind = np.empty((2, 2, 2, 2, 2, t.size))
    for corner in np.ndindex(2, 2, 2, 2):
        dt, dz, dr, dc = corner
        wind[corner] = stored.wind[t + dt, :, z + dz, r + dr, c + dc].T
    for fraction in fractions:
        wind = wind[0] + (wind[1] - wind[0]) * fraction
    turn = grid.convergence(longitude) if stored.grid_relative else np.zeros(t.size)
    cosine, sine = np.cos(turn), np.sin(turn)
    earth = np.stack([cosine * wind[0] + sine * wind[1], cosine * wind[1] - sine * wind[0]])
    return np.where(inside, earth, np.nan)


def _template(grid: LambertGrid, *, edition: int, grid_relative: bool, component: int) -> int:
    """EcCodes handle of a message on a grid, of u (component 0) or v (1)."""
    import eccodes

    keys: dict[str, float | int | str] = {"centre": 7}  # NCEP
    if edition == 1:
        keys["generatingProcessIdentifier"] = 105
    keys |= {
        "gridType": "lambert",
        "Nx": grid.columns,
        "Ny": grid.rows,
        "latitudeOfFirstGridPointInDegrees": grid.first_latitude,
        "longitudeOfFirstGridPointInDegrees": grid.first_longitude % 360.0,
        "LoVInDegrees": grid.orientation % 360.0,
        "DxInMetres": int(grid.spacing),
        "DyInMetres": int(grid.spacing),
        "Latin1InDegrees": grid.standard_parallel,
        "Latin2InDegrees": grid.standard_parallel,
        "latitudeOfSouthernPoleInDegrees": -90.0,
        "longitudeOfSouthernPoleInDegrees": 0.0,
        "projectionCentreFlag": 0,
        "iScansNegatively": 0,
        "jScansPositively": 1,
        "jPointsAreConsecutive": 0,
    }
    if edition == 2:
        keys |= {"shapeOfTheEarth": 6, "LaDInDegrees": grid.standard_parallel}
    keys |= {"uvRelativeToGrid": int(grid_relative), "typeOfLevel": "isobaricInhPa"}
    if edition == 1:
        keys |= {"table2Version": 2, "indicatorOfParameter": 33 + component}
    else:
        keys |= {"discipline": 0, "parameterCategory": 2, "parameterNumber": 2 + component}
    keys |= {"bitsPerValue": 0, "decimalPrecision": _DECIMALS}
    handle: int = eccodes.codes_grib_new_from_samples(f"GRIB{edition}")
    for key, value in keys.items():
        eccodes.codes_set(handle, key, value)
    return handle


def write_reference(
    directory: Path,
    stored: GriddedReference,
    *,
    start: datetime,
    edition: int,
    lead_hours: int,
    times_per_file: int = 1,
) -> None:
    """Write the fields of one model as GRIB files, in order of time."""
    import eccodes

    directory.mkdir(parents=True, exist_ok=True)
    flag, path = stored.grid_relative, directory
    templates = [
        _template(stored.grid, edition=edition, grid_relative=flag, component=component)
        for component in (0, 1)
    ]
    for step, hour in enumerate(stored.hours):
        base = start + timedelta(hours=float(hour) - lead_hours)
        if step % times_per_file == 0:
            stem = f"{stored.name}_{base:%Y%m%d%H}_f{lead_hours:02d}"
            path = directory / f"{stem}.{'grb' if edition == 1 else 'grb2'}"
            path.unlink(missing_ok=True)
        with path.open("ab") as sink:
            for index, component in np.ndindex(stored.levels.size, 2):
                handle = templates[component]
                eccodes.codes_set(handle, "dataDate", int(f"{base:%Y%m%d}"))
                eccodes.codes_set(handle, "dataTime", int(f"{base:%H%M}"))
                eccodes.codes_set(handle, "endStep", lead_hours)
                eccodes.codes_set(handle, "level", int(stored.levels[index]))
                # Encoding changes that of the handle.
                eccodes.codes_set(handle, "decimalPrecision", _DECIMALS)
                values = stored.wind[step, component, index].astype(np.float64)
                eccodes.codes_set_values(handle, values.ravel())
                sink.write(eccodes.codes_get_message(handle))
    for handle in templates:
        eccodes.codes_release(handle)
