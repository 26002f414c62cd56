"""Earth's magnetic field over the region of a sample archive, from IGRF.

Assumes a field that is linear in time over an archive and smooth over 1.5 degrees: a lattice of
`ppigrf` values, bilinear in place. Apart from the package's lattice, so that the truth of the
archives is independent of it. The field falls by 0.05 % a kilometre (3 / radius): one height serves
climb and cruise. Units: degrees for places, radians for the declination, nT.
"""

from __future__ import annotations

import contextlib
import io
from datetime import datetime, timedelta

import numpy as np
import ppigrf
from scipy.interpolate import RegularGridInterpolator

from airswing.synthetic.atmosphere import Array

_STEP = 1.5  # degrees
_HEIGHT_KM = 4.0


class EarthField:
    """Field vectors over a region and a span of time.

    Parameters
    ----------
    start : datetime
        Hour zero, UTC.
    days : float
        Length of the archive.
    box : tuple of float
        South, north, west, east, degrees.
    """

    def __init__(
        self, start: datetime, days: float, box: tuple[float, float, float, float]
    ) -> None:
        self.start, self.days, self.box = start, days, box
        south, north, west, east = box
        lat = np.arange(np.floor(south) - 1, north + 1 + _STEP, _STEP)
        lon = np.arange(np.floor(west) - 1, east + 1 + _STEP, _STEP)
        columns, rows = np.meshgrid(lon, lat)
        ends = []
        for span in (0.0, days):
            with contextlib.redirect_stdout(io.StringIO()):
                parts = ppigrf.igrf(
                    columns.ravel(), rows.ravel(), _HEIGHT_KM, start + timedelta(days=span)
                )
            east_, north_, up = (np.asarray(part).reshape(rows.shape) for part in parts)
            ends.append(np.stack([east_, north_, -up], axis=-1))
        self._first = RegularGridInterpolator((lat, lon), ends[0])
        self._change = RegularGridInterpolator((lat, lon), ends[1] - ends[0])

    def at(self, latitude: Array, longitude: Array, hours: Array) -> tuple[Array, Array, Array]:
        """Field at points (n,).

        Returns
        -------
        declination : array
            Radians, east positive.
        horizontal, down : array
            nT.
        """
        points = np.stack([latitude, longitude], axis=-1)
        share = (hours / (24.0 * self.days))[:, None]
        east, north, down = (self._first(points) + share * self._change(points)).T
        return np.arctan2(east, north), np.hypot(east, north), down


def declination_of_year(
    latitude: Array, longitude: Array, year: float, box: tuple[float, float, float, float]
) -> Array:
    """Declination (radians) of a table of some epoch, at points in degrees inside a box."""
    when = datetime(int(year), 1, 1) + timedelta(days=365.25 * (year - int(year)))
    return EarthField(when, 1.0, box).at(latitude, longitude, np.zeros_like(latitude))[0]
