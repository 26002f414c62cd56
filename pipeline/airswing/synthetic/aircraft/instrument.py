"""The unit on board: flux valve, airspeed, the wind it computes and how it codes it.

Assumptions
-----------
The flux valve is a vector instrument. The earth's field (H, declination, Z) is turned into the
airframe by the true magnetic heading, distorted by soft iron (a matrix) and hard iron (a
constant vector), then seen in the plane of a pendulous sensing element that hangs along the
apparent vertical: acceleration or bank tilts the plane and lets the vertical field in. The
indicated heading is the angle of what is sensed, plus misalignment, plus the declination the
unit has stored. Wind = GPS ground velocity - indicated airspeed along the indicated heading.
No formula for a deviation curve is used anywhere: curves come out of the vectors.

Sign conventions: body axes forward, right, down; headings clockwise from north. Heading error =
indicated - true. With hard iron p the sine law gives sin(error) = -(p_f sin m + p_r cos m)/H, m
the *indicated* magnetic heading, exactly.

Validity: perturbations well below H. Units: radians, nT, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Unit", "coded", "compute_wind", "deviation_curve", "sensed_heading"]

Array = NDArray[np.float64]


@dataclass
class Unit:
    """State of the unit at every report; every field broadcasts to (n,)."""

    # hard_forward, hard_right: hard iron and heater currents along the body axes, nT
    hard_forward: Array
    hard_right: Array
    # soft_sine, soft_cosine: symmetric traceless soft iron: the matrix [[1 - s, -c], [-c, 1 + s]]
    soft_sine: Array
    soft_cosine: Array
    rotation: Array  # misalignment and other errors that add to the heading, radians
    # third_sine, third_cosine: three-cycle error (a fault of the valve's windings), radians
    third_sine: Array
    third_cosine: Array
    # tilt_forward, tilt_right: tilt of the sensing plane: forward side down, right side down,
    # radians
    tilt_forward: Array
    tilt_right: Array
    # airspeed_factor, airspeed_offset: indicated = factor x true + offset (m/s)
    airspeed_factor: Array
    airspeed_offset: Array

    @classmethod
    def perfect(cls, count: int) -> Unit:
        """Return a unit without errors for ``count`` reports."""
        zeros = {name: np.zeros(count) for name in cls.__dataclass_fields__}
        unit = cls(**zeros)
        unit.airspeed_factor = np.ones(count)
        return unit


def sensed_heading(magnetic: Array, horizontal: Array, down: Array, unit: Unit) -> Array:
    """Return the magnetic heading the unit indicates.

    Parameters
    ----------
    magnetic : ndarray (n,)
        True magnetic heading, radians.
    horizontal, down : ndarray (n,)
        The earth's field H and Z, nT.

    Returns
    -------
    ndarray (n,)
        Indicated magnetic heading, radians.

    References
    ----------
    Archibald Smith's equations as in the Admiralty Manual; tilt terms as in any treatment of
    compass turning errors (northerly turning error = tan(dip) tan(bank) at north).
    """
    level_forward = horizontal * np.cos(magnetic)
    level_right = -horizontal * np.sin(magnetic)
    forward = (1.0 - unit.soft_sine) * level_forward - unit.soft_cosine * level_right
    right = -unit.soft_cosine * level_forward + (1.0 + unit.soft_sine) * level_right
    forward = forward + unit.hard_forward
    right = right + unit.hard_right
    sensed_forward = forward * np.cos(unit.tilt_forward) + down * np.sin(unit.tilt_forward)
    below = down * np.cos(unit.tilt_forward) - forward * np.sin(unit.tilt_forward)
    sensed_right = right * np.cos(unit.tilt_right) + below * np.sin(unit.tilt_right)
    valve = np.arctan2(-sensed_right, sensed_forward)
    winding = unit.third_sine * np.sin(3 * valve) + unit.third_cosine * np.cos(3 * valve)
    return np.asarray(valve + winding + unit.rotation)


def compute_wind(
    ground_east: Array, ground_north: Array, airspeed: Array, heading: Array
) -> tuple[Array, Array]:
    """Return the wind of the triangle ground - air.

    Parameters
    ----------
    ground_east, ground_north : ndarray (n,)
        Ground velocity, m/s.
    airspeed : ndarray (n,)
        m/s.
    heading : ndarray (n,)
        True heading the unit believes in, radians.

    Returns
    -------
    u, v : ndarray (n,)
        Eastward and northward wind, m/s.
    """
    return (
        ground_east - airspeed * np.sin(heading),
        ground_north - airspeed * np.cos(heading),
    )


def coded(
    eastward: Array, northward: Array, *, direction_step: Array, speed_step: Array
) -> tuple[Array, Array]:
    """Return wind as whole steps of direction and speed.

    Parameters
    ----------
    eastward, northward : ndarray (n,)
        m/s.
    direction_step : ndarray (n,)
        Degrees.
    speed_step : ndarray (n,)
        kt.

    Returns
    -------
    direction, speed : ndarray (n,)
        Degrees the wind comes from, in [0, 360) with 360 written for north; kt.
    """
    speed = np.hypot(eastward, northward) * 3600.0 / 1852.0
    direction = np.degrees(np.arctan2(-eastward, -northward)) % 360.0
    whole = np.round(np.round(direction / direction_step) * direction_step, 9) % 360.0
    strength = np.round(np.round(speed / speed_step) * speed_step, 9)
    whole = np.where(strength == 0, 0.0, np.where(whole == 0, 360.0, whole))
    return whole, strength


def deviation_curve(horizontal: float, down: float, unit: Unit) -> dict[str, float]:
    """Return the coefficients of a unit's heading error against *indicated* magnetic heading.

    Parameters
    ----------
    horizontal, down : float
        The earth's field, nT.
    unit : Unit
        Errors of one unit (scalars or arrays of length 1).

    Returns
    -------
    dict
        A, B, C, D, E in degrees: least squares over headings spread evenly, and
        ``residual_rms``, what five coefficients cannot hold.
    """
    true = np.linspace(0.0, 2 * np.pi, 7200, endpoint=False)
    indicated = sensed_heading(true, np.full(7200, horizontal), np.full(7200, down), unit)
    error = np.pi - (np.pi - (indicated - true)) % (2 * np.pi)
    even = np.radians(np.arange(0.0, 360.0, 0.5))
    turned = indicated % (2 * np.pi)
    order = np.argsort(turned)
    curve = np.degrees(np.interp(even, turned[order], error[order], period=2 * np.pi))
    basis = np.stack(
        [np.ones(720), np.sin(even), np.cos(even), np.sin(2 * even), np.cos(2 * even)], axis=1
    )
    values = np.linalg.lstsq(basis, curve, rcond=None)[0]
    out = {name: float(value) for name, value in zip("ABCDE", values, strict=True)}
    out["residual_rms"] = float(np.sqrt(np.mean((curve - basis @ values) ** 2)))
    return out
