"""Angles along great circles of a sphere: distances are within 0.5 % of the ellipsoid's.

The haversine formula holds for places close together, where the cosine formula loses all digits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
