"""ICAO standard atmosphere in two layers: pressure altitude to pressure and back.

Assumptions
-----------
Altitudes are *pressure* altitudes: geopotential metres of the standard atmosphere, what an
altimeter set to 1013.25 hPa shows. The troposphere (lapse rate 6.5 K/km) reaches to 11 km, the
isothermal lower stratosphere (216.65 K) lies above.

Validity
--------
-5 km to 20 km; the two formulas are evaluated outside it too but the standard changes its lapse
rate at 20 km. NaN in gives NaN out; a pressure that is not positive gives NaN.

Units
-----
Metres, pascals, kelvins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

STANDARD_PRESSURE = 101325.0
"""Pa at zero altitude (ICAO Doc 7488/3)."""
STANDARD_TEMPERATURE = 288.15
"""K at zero altitude (ICAO Doc 7488/3)."""
LAPSE_RATE = 0.0065  # K m-1 below the tropopause (ICAO Doc 7488/3)
TROPOPAUSE_ALTITUDE = 11000.0  # Geopotential m (ICAO Doc 7488/3)
GRAVITY = 9.80665
"""m s-2, standard acceleration of free fall (ICAO Doc 7488/3)."""
GAS_CONSTANT = 287.05287
"""J kg-1 K-1 of dry air (ICAO Doc 7488/3)."""

TROPOPAUSE_TEMPERATURE = STANDARD_TEMPERATURE - LAPSE_RATE * TROPOPAUSE_ALTITUDE
_EXPONENT = GRAVITY / (GAS_CONSTANT * LAPSE_RATE)
_SCALE_HEIGHT = GAS_CONSTANT * TROPOPAUSE_TEMPERATURE / GRAVITY
# Pa at 11 km: 22632 to five figures.
TROPOPAUSE_PRESSURE = STANDARD_PRESSURE * (
    (TROPOPAUSE_TEMPERATURE / STANDARD_TEMPERATURE) ** _EXPONENT
)


def pressure_from_altitude(altitude: ArrayLike) -> NDArray[np.float64]:
    """Pressure (Pa) at pressure altitudes (m, any shape): ICAO Doc 7488/3, equations 12."""
    height = np.asarray(altitude, dtype=np.float64)
    # the factor of each layer is one in the other, so that no branch is needed
    lower = np.minimum(height, TROPOPAUSE_ALTITUDE)
    upper = np.maximum(height - TROPOPAUSE_ALTITUDE, 0.0)
    ratio = 1.0 - (LAPSE_RATE / STANDARD_TEMPERATURE) * lower
    return np.asarray(STANDARD_PRESSURE * ratio**_EXPONENT * np.exp(-upper / _SCALE_HEIGHT))


def altitude_from_pressure(pressure: ArrayLike) -> NDArray[np.float64]:
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


def standard_temperature(altitude: ArrayLike) -> NDArray[np.float64]:
    """Standard atmosphere's temperature (K) at pressure altitudes (m, any shape)."""
    height = np.asarray(altitude, dtype=np.float64)
    return np.asarray(STANDARD_TEMPERATURE - LAPSE_RATE * np.minimum(height, TROPOPAUSE_ALTITUDE))
