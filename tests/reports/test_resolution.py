"""Resolution of position, time and wind, from made lattices and real aircraft."""

import numpy as np
import pytest

from airswing.reports.resolution import (
    DIRECTION_STEPS,
    POSITION_STEPS,
    SPEED_STEPS,
    TIME_STEPS,
    lattice_step,
    resolutions,
)
from airswing.units import KNOT

RNG = np.random.default_rng(20090105)


def found_step(values, steps):
    return float(lattice_step(values, np.zeros(values.size, dtype=int), 1, steps)[0])


@pytest.mark.parametrize(
    ("steps", "largest", "present", "digits"),
    [
        (POSITION_STEPS, 50, [1 / 60, 0.01, 0.1 / 60, 0.001, 1 / 3600, 1e-4, 1e-5], 7),
        (POSITION_STEPS, 50, [1 / 60, 0.01, 0.1 / 60, 0.001, 1 / 3600, 1e-4, 1e-5], 5),
        (POSITION_STEPS, 50, [1 / 60, 0.01, 0.1 / 60, 0.001, 1e-4], 4),
        (TIME_STEPS, 86400, [60.0, 6.0, 1.0, 0.1], 7),
        (SPEED_STEPS, 60, [KNOT, 1.0, 0.5, 0.1], 7),
        (SPEED_STEPS, 60, [KNOT], 1),  # whole knots stored to a tenth of a metre per second
        (DIRECTION_STEPS, 360, [10.0, 5.0, 1.0, 0.1], 7),
    ],
)
def test_a_step_survives_the_digits_it_is_stored_with(steps, largest, present, digits):
    for step in present:
        values = np.round(step * np.round(RNG.uniform(0, largest, 60) / step), digits)
        assert found_step(values, steps) == pytest.approx(step)


def reports(seconds, clock=1.0, tail=0):
    """A flight due east at 120 m/s whose times are cut to the clock."""
    east = -87.0 + 120.0 * seconds / 111_195.0
    start = np.datetime64("2009-01-05T12:00:00", "ns")
    return {
        "tail": np.full(seconds.size, tail),
        "time": start + (np.floor(seconds / clock) * clock * 1e9).astype("timedelta64[ns]"),
        "latitude": np.zeros(seconds.size),
        "longitude": np.round(east * 600.0) / 600.0,
        "wind_speed": np.round(RNG.uniform(5, 40, seconds.size)) * KNOT,
        "wind_direction": np.round(RNG.uniform(0, 359, seconds.size)),
    }


IRREGULAR = np.cumsum(RNG.uniform(0.7, 1.3, 80) * 180.0)


@pytest.mark.parametrize(
    ("seconds", "clock", "found_clock"),
    [
        (IRREGULAR, 1.0, 1.0),
        (np.round(IRREGULAR), 60.0, 60.0),
        (180.0 * np.arange(80), 1.0, 1.0),  # a schedule of whole minutes is no truncated clock
    ],
)
def test_all_four_of_one_aircraft(seconds, clock, found_clock):
    found = resolutions(reports(seconds, clock), np.array([80]))
    assert found["position_resolution"][0] == pytest.approx(0.1 / 60)
    assert found["time_resolution"][0] == found_clock
    assert found["wind_speed_resolution"][0] == pytest.approx(KNOT)
    assert found["wind_direction_resolution"][0] == 1.0


def test_an_aircraft_with_few_reports_takes_the_usual_step_of_the_others():
    many, few = reports(IRREGULAR), reports(IRREGULAR[:2], tail=1)
    joined = {name: np.concatenate([many[name], few[name]]) for name in many}
    for values in resolutions(joined, np.array([80, 2])).values():
        assert values[1] == values[0]
