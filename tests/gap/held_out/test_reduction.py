"""What is taken off of a wind: heading and airspeed by the whole wind triangle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from airswing.gap.held_out.reduction import take_off


def test_errors_of_heading_and_airspeed_are_taken_off_exactly():
    heading = np.radians([0.0, 90.0, 215.0, 300.0])
    airspeed = np.array([120.0, 200.0, 150.0, 90.0])
    turned, faster = np.radians([20.0, -35.0, 3.0, 0.0]), np.array([10.0, -12.0, 0.0, 25.0])

    def air(angle, speed):
        return speed[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)

    # The unit takes ground less air velocity, both of these with what it holds them to be.
    residual = air(heading - turned, airspeed - faster) - air(heading, airspeed)
    ones = np.ones(4)
    right = np.stack([np.cos(heading), -np.sin(heading)], axis=1)
    sensor = -(airspeed * turned)[:, None] * right - faster[:, None] * air(heading, ones)
    other = np.array([[0.0, 0.0], [1.0, 2.0], [0.5, 0.0], [0.0, -3.0]])
    frame = SimpleNamespace(heading=heading, airspeed=airspeed, residual=residual + other)
    assert take_off(frame, sensor, other) == pytest.approx(np.zeros((4, 2)), abs=1e-12)
