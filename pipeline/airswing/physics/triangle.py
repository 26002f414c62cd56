"""The wind triangle: ground velocity = air velocity + wind, and the heading error it implies.

Everything is horizontal and the sideslip is zero, so the air vector lies along the heading. Vectors
are (east, north) components: a calm wind has no direction and an aircraft at rest no heading, so
directions are computed last and only where the speed is not zero (NaN otherwise). Headings and
tracks are radians clockwise from north; a wind *direction* is where it blows from. The heading
error is indicated minus implied by the reference wind (Jacobs et al. 2010, equation 3): positive
when the compass reads too far clockwise. Radians and metres per second. All arguments broadcast;
NaN in gives NaN out.

References
----------
Jacobs et al. 2010, steps b and c; Mulally & Anderson 2011 for the reversal of the TAMDAR wind
computation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Precision = TypeVar("Precision", bound=np.floating)
TURN = 2.0 * np.pi


def wrap_signed(angle: ArrayLike) -> Array:
    """Angle (radians, any shape) reduced to (-pi, pi]: half a turn is positive."""
    value = np.asarray(angle, dtype=np.float64)
    turned = np.pi - np.mod(np.pi - value, TURN)
    # an angle already inside keeps every bit
    return np.asarray(np.where((value > -np.pi) & (value <= np.pi), value, turned))


def wrap_positive(angle: ArrayLike) -> Array:
    """Angle (radians, any shape) reduced to [0, 2 pi)."""
    turned = np.mod(np.asarray(angle, dtype=np.float64), TURN)
    # a tiny negative angle rounds up to the full turn
    return np.asarray(np.where(turned >= TURN, 0.0, turned))


@overload
def wrap_degrees(angle: float | Sequence[float]) -> Array: ...
@overload
def wrap_degrees(angle: NDArray[Precision]) -> NDArray[Precision]: ...
def wrap_degrees(angle: ArrayLike) -> NDArray[np.floating]:
    """Degrees reduced to [-180, 180): longitudes, and differences of directions.

    Single precision stays single.
    """
    return np.asarray((np.asarray(angle) + 180.0) % 360.0 - 180.0)


def bearing(east: ArrayLike, north: ArrayLike) -> Array:
    """Direction a vector points to, radians clockwise from north in [0, 2 pi).

    NaN for the zero vector, which has no direction.
    """
    u, v = np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)
    angle = wrap_positive(np.arctan2(u, v))
    return np.asarray(np.where((u == 0.0) & (v == 0.0), np.nan, angle))


def vector_from_bearing(speed: ArrayLike, direction: ArrayLike) -> tuple[Array, Array]:
    """East and north components (m s-1) of a vector of given length pointing *to* a direction.

    The direction is in radians clockwise from north.
    """
    length, angle = np.asarray(speed, np.float64), np.asarray(direction, np.float64)
    return np.asarray(length * np.sin(angle)), np.asarray(length * np.cos(angle))


def wind_components(speed: ArrayLike, direction: ArrayLike) -> tuple[Array, Array]:
    """Eastward and northward wind (m s-1) from its speed and the direction it blows *from*.

    Radians clockwise from north; ignored (NaN allowed) where the speed is zero.
    """
    length, angle = np.asarray(speed, np.float64), np.asarray(direction, np.float64)
    east, north = vector_from_bearing(-length, angle)
    # NaN times zero is NaN, but a calm wind is zero for any direction.
    calm = length == 0.0
    return np.asarray(np.where(calm, 0.0, east)), np.asarray(np.where(calm, 0.0, north))


def wind_from_direction(eastward: ArrayLike, northward: ArrayLike) -> tuple[Array, Array]:
    """Speed of a wind (m s-1) and the direction it blows *from*.

    Radians in [0, 2 pi); NaN where calm.
    """
    u, v = np.asarray(eastward, np.float64), np.asarray(northward, np.float64)
    return np.asarray(np.hypot(u, v)), bearing(-u, -v)


def direction_in_degrees(
    eastward: NDArray[Precision], northward: NDArray[Precision]
) -> NDArray[Precision]:
    """Direction a wind blows from, degrees in [0, 360); 0 or 180 for a calm, which has none.

    Single precision stays single.
    """
    east, north = np.asarray(eastward), np.asarray(northward)
    direction = np.degrees(np.arctan2(-east, -north)) % 360.0
    # a tiny negative angle rounds up to the full turn
    return np.asarray(direction % 360.0)


def air_vector(
    ground_east: ArrayLike, ground_north: ArrayLike, wind_east: ArrayLike, wind_north: ArrayLike
) -> tuple[Array, Array]:
    """Air vector V_A = V_G - V_W, east and north (Jacobs et al. 2010, step b).

    The reported wind gives the air vector that the unit used, the reference the implied one; m s-1.
    """
    east = np.asarray(ground_east, np.float64) - np.asarray(wind_east, np.float64)
    north = np.asarray(ground_north, np.float64) - np.asarray(wind_north, np.float64)
    return np.asarray(east), np.asarray(north)


def angle_of_vector(
    from_east: ArrayLike, from_north: ArrayLike, to_east: ArrayLike, to_north: ArrayLike
) -> Array:
    """Signed clockwise angle, radians in (-pi, pi], that turns the first vector onto the second.

    NaN where either vector is zero. Exact near zero: computed from the cross and dot products, not
    from the difference of two bearings.
    """
    a, b = np.asarray(from_east, np.float64), np.asarray(from_north, np.float64)
    c, d = np.asarray(to_east, np.float64), np.asarray(to_north, np.float64)
    turned = np.asarray(np.arctan2(c * b - d * a, c * a + d * b))
    # arctan2 gives -pi for a cross product of -0: half a turn is positive here.
    turned = np.where(turned == -np.pi, np.pi, turned)
    none = ((a == 0.0) & (b == 0.0)) | ((c == 0.0) & (d == 0.0))
    return np.asarray(np.where(none, np.nan, turned))


def heading_error(
    air_east: ArrayLike,
    air_north: ArrayLike,
    implied_east: ArrayLike,
    implied_north: ArrayLike,
) -> Array:
    """Heading error psi_err = wrap(arg V_A - arg V'_A), radians in (-pi, pi].

    V_A is the air vector the unit used, V_G - V_W,reported, V'_A that which the reference wind
    implies. Positive when the compass reads too far clockwise; NaN where either vector is zero.
    Jacobs et al. 2010, equation 3 (its prose for step c has the other sign; equation 3 is right).
    """
    return angle_of_vector(implied_east, implied_north, air_east, air_north)


def airspeed_error(
    air_east: ArrayLike,
    air_north: ArrayLike,
    implied_east: ArrayLike,
    implied_north: ArrayLike,
) -> Array:
    """Airspeed error |V_A| - |V'_A| (m s-1), the along-heading partner of the heading error.

    Arguments as for `heading_error`; positive when the unit's airspeed is too high.
    """
    used, implied = np.hypot(air_east, air_north), np.hypot(implied_east, implied_north)
    return np.asarray(used - implied, dtype=np.float64)


def wind_from_triangle(
    ground_east: ArrayLike, ground_north: ArrayLike, airspeed: ArrayLike, heading: ArrayLike
) -> tuple[Array, Array]:
    """Eastward and northward wind a unit computes from ground velocity, airspeed and true heading.

    m s-1; the heading in radians.
    """
    east, north = vector_from_bearing(airspeed, heading)
    return air_vector(ground_east, ground_north, east, north)


def along_cross(east: ArrayLike, north: ArrayLike, heading: ArrayLike) -> tuple[Array, Array]:
    """Components of a vector along a heading (radians) and to its right, in the vector's unit."""
    u, v = np.asarray(east, np.float64), np.asarray(north, np.float64)
    angle = np.asarray(heading, np.float64)
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.asarray(u * sine + v * cosine), np.asarray(u * cosine - v * sine)
