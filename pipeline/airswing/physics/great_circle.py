"""Angles on a sphere; distances along great circles are within 0.5 % of the ellipsoid's.

The haversine formula holds for places close together, where the cosine formula loses all digits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import wrap_degrees

Array = NDArray[np.float64]


def central_angle(
    latitude: ArrayLike, longitude: ArrayLike, to_latitude: ArrayLike, to_longitude: ArrayLike
) -> Array:
    """Angle between places as seen from the centre; all in radians, broadcast, NaN kept."""
    north, south = np.asarray(to_latitude), np.asarray(latitude)
    half_north = np.sin((north - south) / 2.0)
    half_east = np.sin((np.asarray(to_longitude) - np.asarray(longitude)) / 2.0)
    chord = half_north**2 + np.cos(north) * np.cos(south) * half_east**2
    # rounding may exceed one for antipodes
    return np.asarray(2.0 * np.arcsin(np.sqrt(np.clip(chord, 0.0, 1.0))))


def middle_longitude(longitude: Array) -> float:
    """Longitude in degrees opposite the widest gap or, without a gap, the fewest places."""
    degree = np.floor(longitude % 360.0).astype(np.int64) % 360
    count = np.bincount(degree, minlength=360)
    # twice around, for a gap across the meridian where counting begins
    least, place = np.tile(count == count.min(), 2), np.arange(720)
    run = place - np.maximum.accumulate(np.where(least, 0, place))
    last = int(np.argmax(np.minimum(run, 360)))
    return (last + 1 - float(run[last]) / 2.0 + 180.0) % 360.0


def unwrapped(longitude: Array) -> Array:
    """Longitudes in degrees without a jump between the places, which may be beyond -180 or 180."""
    middle = float(wrap_degrees(middle_longitude(longitude)))
    return np.asarray(wrap_degrees(longitude - middle) + middle)
