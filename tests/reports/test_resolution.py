"""Resolution of position, time and wind, from made lattices and real aircraft."""

from __future__ import annotations

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


def found_step(values: np.ndarray, steps: tuple[tuple[float, float], ...]) -> float:
    group = np.zeros(values.size, dtype=int)
    return float(lattice_step(values, group, 1, steps)[0])


def on(step: float, low: float, high: float, number: int = 60) -> np.ndarray:
    return step * np.round(RNG.uniform(low, high, number) / step)


@pytest.mark.parametrize(
    ("step", "digits"),
    [
        (step, digits)
        for step in (1 / 60, 0.01, 0.1 / 60, 0.001, 1 / 3600, 1e-4, 1e-5)
        for digits in (7, 5, 4)
        if step >= 10.0**-digits and (step, digits) != (1 / 3600, 4)  # stored finer than coded
    ],
)
def test_position_survives_the_digits_it_is_stored_with(step, digits):
    assert found_step(np.round(on(step, 30, 50), digits), POSITION_STEPS) == pytest.approx(step)


@pytest.mark.parametrize(
    ("steps", "largest", "present"),
    [
        (TIME_STEPS, 86400, [60.0, 6.0, 1.0, 0.1]),
        (SPEED_STEPS, 60, [KNOT, 1.0, 0.5, 0.1]),
        (DIRECTION_STEPS, 360, [10.0, 5.0, 1.0, 0.1]),
    ],
)
def test_times_speeds_and_directions(steps, largest: float, present: list[float]):
    for step in present:
        assert found_step(on(step, 0, largest), steps) == pytest.approx(step)
    # Whole knots that are stored to a tenth of a metre per second.
    assert found_step(np.round(on(KNOT, 0, 60), 1), SPEED_STEPS) == pytest.approx(KNOT)


def reports(number: int, *, every: float, clock: float, tail: int = 0) -> dict[str, np.ndarray]:
    """A flight due east at 120 m/s whose times are cut to the clock."""
    seconds = np.cumsum(RNG.uniform(0.7, 1.3, number) * every) if clock < 60 else np.nan
    if clock >= 60:
        seconds = np.cumsum(np.round(RNG.uniform(0.7, 1.3, number) * every))
    east = -87.0 + 120.0 * seconds / 111_195.0
    start = np.datetime64("2009-01-05T12:00:00", "ns")
    return {
        "tail": np.full(number, tail),
        "time": start + (np.floor(seconds / clock) * clock * 1e9).astype("timedelta64[ns]"),
        "latitude": np.zeros(number),
        "longitude": np.round(east * 600.0) / 600.0,
        "wind_speed": np.round(RNG.uniform(5, 40, number)) * KNOT,
        "wind_direction": np.round(RNG.uniform(0, 359, number)),
    }


@pytest.mark.parametrize("clock", [1.0, 60.0])
def test_all_four_of_one_aircraft(clock: float):
    found = resolutions(reports(80, every=180.0, clock=clock), np.array([80]))
    assert found["position_resolution"][0] == pytest.approx(0.1 / 60)
    assert found["time_resolution"][0] == clock
    assert found["wind_speed_resolution"][0] == pytest.approx(KNOT)
    assert found["wind_direction_resolution"][0] == 1.0


def test_a_schedule_of_whole_minutes_is_no_cut_clock():
    seconds = 180.0 * np.arange(80)
    made = reports(80, every=180.0, clock=1.0)
    made["time"] = np.datetime64("2009-01-05T12:00:00", "ns") + (seconds * 1e9).astype(
        "timedelta64[ns]"
    )
    made["longitude"] = np.round((-87.0 + 120.0 * seconds / 111_195.0) * 600.0) / 600.0
    assert resolutions(made, np.array([80]))["time_resolution"][0] == 1.0


def test_an_aircraft_with_few_reports_takes_the_usual_step_of_the_others():
    many, few = reports(60, every=180.0, clock=1.0), reports(2, every=180.0, clock=1.0, tail=1)
    joined = {name: np.concatenate([many[name], few[name]]) for name in many}
    found = resolutions(joined, np.array([60, 2]))
    for values in found.values():
        assert values[1] == values[0]
