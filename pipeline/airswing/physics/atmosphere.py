"""ICAO standard atmosphere in two layers; true airspeed from Mach number or calibrated airspeed.

Altitudes are *pressure* altitudes: geopotential metres of the standard atmosphere, as on an
altimeter set to 1013.25 hPa. The troposphere (lapse rate 6.5 K/km) reaches to 11 km, the isothermal
lower stratosphere (216.65 K) lies above; valid from -5 to 20 km. Air is dry, of constant heat
capacities, and the flow subsonic. The indicated airspeed is taken as the calibrated one: position
and instrument error become part of the aircraft's airspeed scale. Temperatures are static,
pressures those of the aircraft's level. NaN in gives NaN out, and so does a temperature or pressure
that is not positive. SI units.

References
----------
ICAO Doc 7488/3; the compressible pitot equation after Saint-Venant, as in Gracey, Measurement of
Aircraft Speed and Altitude, NASA RP-1046 (1980).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Constants of ICAO Doc 7488/3.
STANDARD_PRESSURE = 101325.0  # Pa at zero altitude
STANDARD_TEMPERATURE = 288.15  # K at zero altitude
LAPSE_RATE = 0.0065  # K m-1 below the tropopause
TROPOPAUSE_ALTITUDE = 11000.0  # geopotential m
GRAVITY = 9.80665  # m s-2, standard acceleration of free fall
GAS_CONSTANT = 287.05287  # J kg-1 K-1 of dry air
HEAT_RATIO = 1.4  # ratio of the specific heats of air
_POWER = HEAT_RATIO / (HEAT_RATIO - 1.0)  # 3.5
TROPOPAUSE_TEMPERATURE = STANDARD_TEMPERATURE - LAPSE_RATE * TROPOPAUSE_ALTITUDE
_EXPONENT = GRAVITY / (GAS_CONSTANT * LAPSE_RATE)
_SCALE_HEIGHT = GAS_CONSTANT * TROPOPAUSE_TEMPERATURE / GRAVITY
# Pa at 11 km: 22632 to five figures.
TROPOPAUSE_PRESSURE = STANDARD_PRESSURE * (
    (TROPOPAUSE_TEMPERATURE / STANDARD_TEMPERATURE) ** _EXPONENT
)


def pressure_from_altitude(altitude: ArrayLike) -> Array:
    """Pressure (Pa) at pressure altitudes (m, any shape): ICAO Doc 7488/3, equations 12."""
    height = np.asarray(altitude, dtype=np.float64)
    # the factor of each layer is one in the other, so that no branch is needed
    lower = np.minimum(height, TROPOPAUSE_ALTITUDE)
    upper = np.maximum(height - TROPOPAUSE_ALTITUDE, 0.0)
    ratio = 1.0 - (LAPSE_RATE / STANDARD_TEMPERATURE) * lower
    return np.asarray(STANDARD_PRESSURE * ratio**_EXPONENT * np.exp(-upper / _SCALE_HEIGHT))


def altitude_from_pressure(pressure: ArrayLike) -> Array:
    """Pressure altitude (m) of pressures (Pa, any shape): the inverse of `pressure_from_altitude`.

    NaN where the pressure is not positive.
    """
    value = np.asarray(pressure, dtype=np.float64)
    value = np.where(value > 0.0, value, np.nan)
    # as above, in logarithms: each layer adds zero in the other
    lower = np.maximum(value, TROPOPAUSE_PRESSURE)
    upper = np.minimum(value, TROPOPAUSE_PRESSURE)
    ratio = (lower / STANDARD_PRESSURE) ** (1.0 / _EXPONENT)
    troposphere = (STANDARD_TEMPERATURE / LAPSE_RATE) * (1.0 - ratio)
    return np.asarray(troposphere - _SCALE_HEIGHT * np.log(upper / TROPOPAUSE_PRESSURE))


def standard_temperature(altitude: ArrayLike) -> Array:
    """Standard atmosphere's temperature (K) at pressure altitudes (m, any shape)."""
    height = np.asarray(altitude, dtype=np.float64)
    return np.asarray(STANDARD_TEMPERATURE - LAPSE_RATE * np.minimum(height, TROPOPAUSE_ALTITUDE))


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
    speed of sound; the Mach number is that with this impact pressure at ``pressure``.
    """
    level = np.asarray(pressure, dtype=np.float64)
    level = np.where(level > 0.0, level, np.nan)
    at_sea_level = np.asarray(calibrated, dtype=np.float64) / speed_of_sound(STANDARD_TEMPERATURE)
    half = 0.5 * (HEAT_RATIO - 1.0)
    impact = STANDARD_PRESSURE * ((1.0 + half * at_sea_level**2) ** _POWER - 1.0)
    mach = np.sqrt(((impact / level + 1.0) ** (1.0 / _POWER) - 1.0) / half)
    return airspeed_from_mach(mach, temperature)
