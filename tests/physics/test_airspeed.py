"""True airspeed from Mach and from calibrated airspeed, by hand and against MetPy."""

import numpy as np
import pytest

from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    airspeed_from_mach,
    pressure_from_altitude,
    speed_of_sound,
    standard_temperature,
)
from airswing.units import KNOT


def test_speed_of_sound_of_the_standard_atmosphere():
    """ICAO Doc 7488/3: 340.294 m/s at sea level, 295.069 in the lower stratosphere."""
    assert speed_of_sound(288.15) == pytest.approx(340.294, abs=1e-3)
    assert speed_of_sound(216.65) == pytest.approx(295.069, abs=1e-3)
    assert np.isnan(speed_of_sound(-1.0))


def test_true_airspeed_by_hand():
    """250 kt at sea level is 250 kt; at FL350 the pitot equation is worked by hand.

    Impact pressure 101325 ((1 + 0.2 (250/661.479)^2)^3.5 - 1) over 23842 Pa gives the Mach number,
    and 576.42 kt is the speed of sound at 218.81 K.
    """
    assert airspeed_from_calibrated(250 * KNOT, 101325.0, 288.15) == pytest.approx(250 * KNOT)
    altitude = 35000 * 0.3048
    found = airspeed_from_calibrated(
        250 * KNOT, pressure_from_altitude(altitude), standard_temperature(altitude)
    )
    impact = 101325.0 * ((1 + 0.2 * (250 / 661.4786) ** 2) ** 3.5 - 1)
    mach = np.sqrt(5 * ((1 + impact / 23842.3) ** (2 / 7) - 1))
    assert found / KNOT == pytest.approx(mach * 576.42, abs=0.05)


def test_mach_against_metpy():
    """MetPy's dry air: the speed of sound from its gas constant and heat ratio."""
    constants = pytest.importorskip("metpy.constants")
    ratio = float(constants.dry_air_spec_heat_ratio.magnitude)
    gas = float(constants.dry_air_gas_constant.to("J/(kg K)").magnitude)
    found = airspeed_from_mach(0.78, 220.0)
    assert found == pytest.approx(0.78 * np.sqrt(ratio * gas * 220.0), rel=2e-4)
