"""Standard atmosphere and true airspeed by hand, against the printed standard and MetPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    airspeed_from_mach,
    altitude_from_pressure,
    pressure_from_altitude,
    speed_of_sound,
    standard_temperature,
)
from airswing.units import KNOT


def test_printed_standard() -> None:
    # ICAO Doc 7488/3 tables, geopotential altitude in m against hPa
    altitude = [0.0, 1000.0, 5000.0, 11000.0, 12000.0, 15000.0, 20000.0]
    pressure = [1013.25, 898.746, 540.199, 226.321, 193.304, 120.446, 54.7489]
    found = pressure_from_altitude(np.array(altitude)) / 100.0
    np.testing.assert_allclose(found, pressure, rtol=2e-5)
    np.testing.assert_allclose(
        standard_temperature(np.array([0.0, 11e3, 15e3])), [288.15, *[216.65] * 2]
    )


def test_metpy_agrees_below_the_tropopause() -> None:
    calc = pytest.importorskip("metpy.calc")
    units = pytest.importorskip("metpy.units").units
    altitude = np.linspace(-300.0, 10900.0, 57)
    expected = calc.height_to_pressure_std(altitude * units.m).m_as("Pa")
    # MetPy takes 288 K at the surface, not 288.15 K: that rescales its heights by 0.05 %
    np.testing.assert_allclose(
        pressure_from_altitude(altitude * (288.15 / 288.0)), expected, rtol=4e-5
    )
    np.testing.assert_allclose(altitude_from_pressure(expected), altitude, atol=6.0)


@given(st.floats(-4000.0, 20000.0))
def test_round_trip(altitude: float) -> None:
    back = altitude_from_pressure(pressure_from_altitude(altitude))
    assert back == pytest.approx(altitude, abs=1e-6)


def test_values_without_physical_meaning_give_nan() -> None:
    found = altitude_from_pressure(np.array([0.0, -5.0, np.nan, 50000.0]))
    assert np.isnan(found[:3]).all() and np.isfinite(found[3])
    assert np.isnan(pressure_from_altitude(np.nan))
    assert np.isnan(speed_of_sound(-1.0))


def test_mach_one_is_the_speed_of_sound_of_the_standard_atmosphere():
    """ICAO Doc 7488/3: 340.294 m/s at sea level, 295.069 in the lower stratosphere."""
    assert airspeed_from_mach(1.0, 288.15) == pytest.approx(340.294, abs=1e-3)
    assert airspeed_from_mach(0.5, 216.65) == pytest.approx(0.5 * 295.069, abs=1e-3)


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
