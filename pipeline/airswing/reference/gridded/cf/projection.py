"""From places on the earth to a Dataset's horizontal coordinates, and the grid's direction there.

Assumptions and validity
------------------------
* Three kinds of frame: longitude and latitude; the same about a rotated pole; and any projection
  PROJ knows, by its PROJ string, in metres. Latitudes are used as they are written, on the
  sphere or ellipsoid of the projection: models have no other datum.
* The direction of a projected grid is that of true north in its plane, by central difference
  (error below 1e-9 rad). On projections that are not conformal the x direction would differ.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Proj
from pyproj.exceptions import CRSError

from airswing.errors import InputError
from airswing.reference.geometry.grids import Grid, rotation
from airswing.units import MODEL_EARTH_RADIUS

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray as xr

Floats = NDArray[np.float64]

# The usual sphere: GRIB keys name the projection, and the coordinates settle its scale.
_SPHERE = f"+R={MODEL_EARTH_RADIUS:.0f}"
# Half step (degrees) towards north by which a projected grid's direction is found.
_NORTH_STEP = 1e-4
_REMEDY = (
    'Say it in the configuration as projection: a PROJ string such as "+proj=lcc +lat_1=38.5 '
    '+lat_2=38.5 +lat_0=38.5 +lon_0=-97.5 +R=6371229", or as CF grid mapping attributes'
)


@dataclass(frozen=True, slots=True)
class Frame:
    """A system of horizontal coordinates."""

    kind: str  # longitude_latitude, rotated_longitude_latitude or projected
    proj: str = ""  # PROJ string of a projection
    pole_latitude: float = 90.0  # north pole of a rotated frame, degrees
    pole_longitude: float = 180.0
    turned: float = 0.0  # the true north pole's longitude in it, degrees

    @property
    def meridional(self) -> bool:
        """Columns are meridians, of the earth or of the rotated frame."""
        return self.kind != "projected"

    def _rotated(self) -> Grid:
        """The rotation, as GRIB has it: by its southern pole."""
        return rotation(-self.pole_latitude, self.pole_longitude + 180.0)

    def xy(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Coordinates of places: degrees, or metres of a projection; NaN where it has no image."""
        if self.kind == "longitude_latitude":
            return longitude, latitude
        if self.kind == "rotated_longitude_latitude":
            x, y = self._rotated().plane(latitude, longitude)
            return x + self.turned, y
        known = np.isfinite(latitude) & np.isfinite(longitude)
        plane = np.full((2, latitude.size), np.nan)
        # A Proj belongs to the thread that made it.
        plane[:, known] = Proj(self.proj, preserve_units=False)(longitude[known], latitude[known])
        plane[~np.isfinite(plane)] = np.nan
        return plane[0], plane[1]

    def places(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Latitudes and longitudes of coordinates, degrees: the inverse of :meth:`xy`."""
        if self.kind == "longitude_latitude":
            return y, x
        if self.kind == "rotated_longitude_latitude":
            back = Frame(self.kind, "", self.pole_latitude, self.turned, self.pole_longitude)
            longitude, latitude = back.xy(y, x)
            return latitude, longitude
        longitude, latitude = Proj(self.proj, preserve_units=False)(x, y, inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def convergence(self, latitude: Floats, longitude: Floats) -> Floats:
        """Angle that turns components along the frame to true east and north, radians.

        ``u_e = cos(a) u + sin(a) v``, ``v_e = -sin(a) u + cos(a) v``.
        """
        if self.kind == "longitude_latitude":
            return np.zeros_like(latitude)
        if self.kind == "rotated_longitude_latitude":
            return self._rotated().convergence(latitude, longitude)
        north, south = np.minimum(latitude + _NORTH_STEP, 90.0), latitude - _NORTH_STEP
        (x1, y1), (x0, y0) = self.xy(north, longitude), self.xy(south, longitude)
        return np.asarray(np.arctan2(x0 - x1, y1 - y0))


LONGITUDE_LATITUDE = Frame("longitude_latitude")


def frame_of(mapping: Mapping[str, object] | str, *, file: str, field: str) -> Frame:
    """Turn a CF grid mapping (appendix F), or a PROJ or WKT string, into a frame.

    Raises
    ------
    InputError
        Where the projection is not known, naming file and field.
    """
    try:
        if isinstance(mapping, str):
            return _frame(mapping)
        return _frame(json.dumps({k: _plain(v) for k, v in mapping.items()}, default=str))
    except (CRSError, KeyError, ValueError, TypeError) as error:
        named = mapping if isinstance(mapping, str) else mapping.get("grid_mapping_name", "")
        raise InputError(
            "projection not known",
            file=file,
            field=field,
            found=named or str(mapping)[:300],
            remedy=_REMEDY,
        ) from error


# files of an archive share a projection, and PROJ takes milliseconds to read one
@lru_cache(maxsize=64)
def _frame(text: str) -> Frame:
    """The frame of a string: JSON of CF attributes, or what PROJ reads.

    Remembered, as PROJ looks a name up among all datums for each.
    """
    crs = CRS.from_cf(json.loads(text)) if text.startswith("{") else CRS.from_user_input(text)
    described = crs.to_cf()
    kind = described.get("grid_mapping_name")
    if kind == "rotated_latitude_longitude":
        return Frame(
            "rotated_longitude_latitude",
            pole_latitude=float(described["grid_north_pole_latitude"]),
            pole_longitude=float(described["grid_north_pole_longitude"]),
            turned=float(described.get("north_pole_grid_longitude", 0.0)),
        )
    if kind == "latitude_longitude" or crs.is_geographic:
        return LONGITUDE_LATITUDE
    return Frame("projected", proj=_proj_string(crs))


def grib_projection(variable: xr.DataArray) -> str | None:
    """PROJ string of the grid a GRIB decoder noted with a variable.

    On a sphere of any size: what it is laid through settles the scale. None where the grid is
    not a projection, or its keys are not there.
    """
    attrs = variable.attrs
    kind = attrs.get("GRIB_gridType")
    try:
        if kind == "lambert":
            one, two, lov, lad = (
                float(attrs[f"GRIB_{key}InDegrees"]) for key in ("Latin1", "Latin2", "LoV", "LaD")
            )
            return f"+proj=lcc +lat_1={one} +lat_2={two} +lat_0={lad} +lon_0={lov} {_SPHERE}"
        if kind == "polar_stereographic":
            lad = float(attrs["GRIB_LaDInDegrees"])
            lov = float(attrs["GRIB_orientationOfTheGridInDegrees"])
            pole = 90.0 if lad >= 0 else -90.0
            return f"+proj=stere +lat_0={pole} +lat_ts={lad} +lon_0={lov} {_SPHERE}"
        if kind == "mercator":
            middle = float(attrs["GRIB_longitudeOfFirstGridPointInDegrees"])
            lad = float(attrs["GRIB_LaDInDegrees"])
            # Any meridian will do: one east of the first column keeps all clear of the seam.
            return f"+proj=merc +lat_ts={lad} +lon_0={middle + 90.0} {_SPHERE}"
    except (KeyError, TypeError, ValueError):
        pass
    return None


def unknown_projection(file: str, found: str) -> InputError:
    """Say that projected coordinates come without their projection."""
    return InputError(
        "coordinates of a projection that is not said",
        file=file,
        field="projection",
        found=found,
        remedy=_REMEDY,
    )


def _plain(value: object) -> object:
    """Attribute values as PROJ takes them: no numpy scalars, a list of one as a number."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.size > 1 else value.ravel()[0].item()
    return value.item() if isinstance(value, np.generic) else value


def _proj_string(crs: CRS) -> str:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a PROJ string names no datum: none is needed here
        return str(Proj(crs).srs)
