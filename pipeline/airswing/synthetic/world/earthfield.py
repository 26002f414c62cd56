"""The earth's magnetic field over the sample's region, from IGRF directly.

Assumes the field is linear in time over an archive and smooth over 1.5 degrees: a lattice of
`ppigrf` values, bilinear in place, linear in time. Kept apart from the package's own lattice so
that the generator stays an independent truth. Units: degrees for places and declination, nT.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
import ppigrf
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

__all__ = ["EarthField", "declination_of_year"]

Array = NDArray[np.float64]
# Degrees between nodes, and km: the field falls by only 0.05 % a km.
_STEP = 1.5
# The field falls by 0.05 % a kilometre (3 / radius): one height serves climb and cruise.
_HEIGHT_KM = 4.0


def _lattice(latitude: Array, longitude: Array, when: datetime) -> Array:
    """Return east, north and down components in nT on a lattice, shape (rows, columns, 3)."""
    lon, lat = np.meshgrid(longitude, latitude)
    with contextlib.redirect_stdout(io.StringIO()):
        parts = ppigrf.igrf(lon.ravel(), lat.ravel(), _HEIGHT_KM, when)
    east, north, up = (np.asarray(part).reshape(lon.shape) for part in parts)
    return np.stack([east, north, -up], axis=-1)


@dataclass(frozen=True)
class EarthField:
    """Field vectors over a region and a span of time."""

    start: datetime  # start of the archive (UTC)
    days: float  # its length
    box: tuple[float, float, float, float]  # south, north, west, east in degrees

    def __post_init__(self) -> None:
        """Evaluate the lattice at both ends of the archive."""
        south, north, west, east = self.box
        lat = np.arange(np.floor(south) - 1, north + 1 + _STEP, _STEP)
        lon = np.arange(np.floor(west) - 1, east + 1 + _STEP, _STEP)
        ends = [_lattice(lat, lon, self.start + timedelta(days=span)) for span in (0.0, self.days)]
        object.__setattr__(self, "_axes", (lat, lon))
        object.__setattr__(self, "_first", RegularGridInterpolator((lat, lon), ends[0]))
        change = RegularGridInterpolator((lat, lon), ends[1] - ends[0])
        object.__setattr__(self, "_change", change)

    def at(self, latitude: Array, longitude: Array, hours: Array) -> tuple[Array, Array, Array]:
        """Return the field at points.

        Parameters
        ----------
        latitude, longitude : ndarray (n,)
            Degrees.
        hours : ndarray (n,)
            Hours since the start.

        Returns
        -------
        declination : ndarray (n,)
            Radians, east positive.
        horizontal, down : ndarray (n,)
            nT.
        """
        points = np.stack([latitude, longitude], axis=-1)
        field = self._first(points)  # type: ignore[attr-defined]
        share = (hours / (24.0 * self.days))[:, None]
        field = field + share * self._change(points)  # type: ignore[attr-defined]
        east, north, down = field.T
        return np.arctan2(east, north), np.hypot(east, north), down


def declination_of_year(
    latitude: Array, longitude: Array, year: float, box: tuple[float, float, float, float]
) -> Array:
    """Return the declination an older table holds, in radians.

    Parameters
    ----------
    latitude, longitude : ndarray (n,)
        Degrees.
    year : float
        Epoch of the table.
    box : (float, float, float, float)
        South, north, west, east in degrees.

    Returns
    -------
    ndarray (n,)
        Declination, east positive.
    """
    when = datetime(int(year), 1, 1) + timedelta(days=365.25 * (year - int(year)))
    old = EarthField(when, 1.0, box)
    return old.at(latitude, longitude, np.zeros_like(latitude))[0]
