"""The vector instrument against hand-worked triangles and the classical compass equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airswing.synthetic.instrument import (
    Unit,
    coded,
    deviation_curve,
    sensed_heading,
)

H, DIP = 18500.0, np.radians(71.0)
Z = H * np.tan(DIP)
COMPASS = np.radians(np.arange(0.0, 360.0, 45.0))


def wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def sensed(unit: Unit, heading: np.ndarray) -> np.ndarray:
    return sensed_heading(heading, np.full(heading.size, H), np.full(heading.size, Z), unit)


def test_a_perfect_unit_shows_the_true_heading() -> None:
    error = wrap(sensed(Unit.perfect(8), COMPASS) - COMPASS)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


@given(st.floats(-3000, 3000), st.floats(-3000, 3000), st.lists(st.floats(0, 6.28), min_size=1))
def test_hard_iron_obeys_the_sine_law_in_the_indicated_heading(
    forward: float, right: float, headings: list[float]
) -> None:
    true = np.array(headings)
    unit = Unit.perfect(true.size)
    unit.hard_forward += forward
    unit.hard_right += right
    shown = sensed(unit, true)
    law = -(forward * np.sin(shown) + right * np.cos(shown)) / H
    np.testing.assert_allclose(np.sin(shown - true), law, atol=1e-9)


def test_soft_iron_makes_two_cycles_and_no_one() -> None:
    unit = Unit.perfect(1)
    unit.soft_sine += np.radians(1.2)
    unit.soft_cosine -= np.radians(0.7)
    curve = deviation_curve(H, Z, unit)
    assert curve["D"] == pytest.approx(1.2, abs=0.005)
    assert curve["E"] == pytest.approx(-0.7, abs=0.005)
    assert abs(curve["B"]) + abs(curve["C"]) + abs(curve["A"]) < 0.005


def test_coded_direction_is_where_the_wind_comes_from() -> None:
    u = np.array([0.0, -10, -10, -10, 0, 10, 10, 10])
    v = np.array([-10.0, -10, 0, 10, 10, 10, 0, -10])
    step = np.ones(8)
    direction, speed = coded(u, v, direction_step=step, speed_step=step)
    assert direction.tolist() == [360, 45, 90, 135, 180, 225, 270, 315]
    assert (speed == np.round(np.hypot(u, v) * 3600 / 1852)).all()
