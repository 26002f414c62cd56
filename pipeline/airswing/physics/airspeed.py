"""True airspeed from Mach number or calibrated airspeed.

Assumptions
-----------
Dry air of constant heat capacities (ratio 1.4), no shock: subsonic flow. The indicated airspeed is
taken as the calibrated one: position and instrument error become part of the aircraft's airspeed
scale. Temperatures are static, pressures those of the aircraft's level.

Validity
--------
Mach 0 to 1. NaN in gives NaN out; a temperature or pressure that is not positive gives NaN.

Units
-----
m s-1, K, Pa.

References
----------
ICAO Doc 7488/3 (speed of sound of the standard atmosphere); the compressible pitot equation after
Saint-Venant, as in Gracey, Measurement of Aircraft Speed and Altitude, NASA RP-1046 (1980).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.atmosphere import GAS_CONSTANT, STANDARD_PRESSURE, STANDARD_TEMPERATURE

Array = NDArray[np.float64]

HEAT_RATIO = 1.4  # Ratio of the specific heats of air (ICAO Doc 7488/3)
_POWER = HEAT_RATIO / (HEAT_RATIO - 1.0)  # 3.5


def speed_of_sound(temperature: ArrayLike) -> Array:
    """Speed of sound (m s-1) in dry air of a temperature (K): 340.294 at 288.15 K."""
    kelvin = np.asarray(temperature, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        # NaN where the temperature is not positive
        return np.sqrt(HEAT_RATIO * GAS_CONSTANT * np.where(kelvin > 0.0, kelvin, np.nan))


def airspeed_from_mach(mach: ArrayLike, temperature: ArrayLike) -> Array:
    """True airspeed (m s-1) of a Mach number at a static temperature (K)."""
    return np.asarray(np.asarray(mach, dtype=np.float64) * speed_of_sound(temperature))


def airspeed_from_calibrated(
    calibrated: ArrayLike, pressure: ArrayLike, temperature: ArrayLike
) -> Array:
    """True airspeed (m s-1) of a calibrated one, at a static pressure (Pa) and temperature (K).

    The impact pressure is that of the calibrated airspeed at sea level's standard pressure and
    speed of sound; the Mach number that makes it at ``pressure`` follows.
    """
    level = np.asarray(pressure, dtype=np.float64)
    level = np.where(level > 0.0, level, np.nan)
    at_sea_level = np.asarray(calibrated, dtype=np.float64) / speed_of_sound(STANDARD_TEMPERATURE)
    half = 0.5 * (HEAT_RATIO - 1.0)
    impact = STANDARD_PRESSURE * ((1.0 + half * at_sea_level**2) ** _POWER - 1.0)
    mach = np.sqrt(((impact / level + 1.0) ** (1.0 / _POWER) - 1.0) / half)
    return airspeed_from_mach(mach, temperature)
