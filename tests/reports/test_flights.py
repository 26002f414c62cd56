"""Flights, phases and resolutions derived from reports."""

import numpy as np
import pytest

from airswing.flags import PHASE
from airswing.reports.flights import (
    DIRECTION_STEPS,
    POSITION_STEPS,
    SPEED_STEPS,
    TIME_STEPS,
    derive_flight,
    derive_phase,
    lattice_step,
    resolutions,
)
from airswing.units import KNOT


def columns(minutes, east=None, label=-1, altitude=6000.0):
    """One aircraft at the equator: by default 111 m/s due east."""
    minutes = np.asarray(minutes, dtype=float)
    values = {
        "tail": np.int32(0),
        "latitude": 0.0,
        "longitude": -87.0 + 0.06 * minutes if east is None else np.asarray(east, dtype=float),
        "flight": np.asarray(label, dtype=np.int32),
        "pressure_altitude": np.asarray(altitude, dtype=np.float32),
    }
    start = np.datetime64("2009-01-05T23:30:00", "ns")
    return {
        "time": start + np.round(minutes * 60e9).astype("timedelta64[ns]"),
        **{name: np.broadcast_to(value, minutes.shape).copy() for name, value in values.items()},
    }


EVERY_5 = np.arange(10) * 5.0
WRONG = np.where(np.arange(10) == 4, 0.0, -87.0 + 0.3 * np.arange(10))
SECOND_MISSING = np.where(np.arange(24) % 2 == 0, np.repeat([4, 9], 12), -1)
TWO = np.arange(24) * 5.0 + np.repeat([0, 180], 12)


@pytest.mark.parametrize(
    ("minutes", "east", "label", "flights"),
    [
        ([0, 15, 29, 31, 45], None, -1, [0] * 5),  # midnight
        ([0, 10, 20, 30], [179.0, 179.6, -179.8, -179.2], -1, [0] * 4),  # antimeridian
        ([0, 10, 54, 64, 110], None, -1, [0, 0, 0, 0, 1]),  # a gap over 45 minutes
        ([0, 5, 10, 35, 40], [0.0, 0.3, 0.6, 0.62, 0.9], -1, [0, 0, 0, 1, 1]),  # a ground stop
        ([0, 5, 10, 15], [0.0, 0.3, 5.3, 5.6], -1, [0, 0, 1, 1]),  # a jump
        ([0, 60, 120, 1440, 1500], None, 7, [0, 0, 0, 1, 1]),  # one number on two days
        ([0, 10, 20, 30, 40], None, [3, 1, 3, 1, 1], [0, 1, 0, 1, 1]),  # alternating labels
        (TWO, None, SECOND_MISSING, [0] * 12 + [1] * 12),
        ([0, 5, 10, 15, 20, 25], None, [-1, -1, 4, 4, -1, -1], [0] * 6),  # both ends missing
        ([0, 5, 60, 65, 70, 200], None, [-1, -1, 4, 4, -1, -1], [0, 0, 1, 1, 1, 2]),  # after gaps
        ([0, 100, 200, 210], None, [4, -1, 4, 4], [0] * 4),  # a gap within a label is bridged
        ([0, 100, 500, 510], None, [4, -1, 4, 4], [0, 1, 2, 2]),  # one too long for that
        (EVERY_5, WRONG, -1, [0, 0, 0, 0, 1, 0, 0, 0, 0, 0]),  # one wrong position
        ([], None, -1, []),
    ],
)
def test_flights_of_one_aircraft(minutes, east, label, flights):
    assert derive_flight(columns(minutes, east, label)).tolist() == flights


@pytest.mark.parametrize("step", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("altitude_step_ft", [1.0, 100.0])
def test_phases_of_a_flight_whatever_the_coding(step, altitude_step_ft):
    """Climb at 1500 ft/min to 25,000 ft, cruise, descend; every ``step`` minutes."""
    minutes = np.arange(0.0, 60.0, step)
    changes = np.array([1.0, 17.0, 40.0, 57.0])
    feet = np.interp(minutes, [0, *changes, 60], [0, 500, 25000, 25000, 500, 500])
    names = ["unknown", "ascent", "cruise", "descent", "unknown"]
    truth = np.array([PHASE[name] for name in names])[np.searchsorted(changes, minutes)]
    coded = 0.3048 * altitude_step_ft * np.round(feet / altitude_step_ft)
    derived = derive_phase(columns(minutes, altitude=coded), np.zeros(truth.size, dtype=int))
    away = np.abs(minutes[:, np.newaxis] - changes).min(axis=1) >= max(step, 0.5) + 0.6
    np.testing.assert_array_equal(derived[away], truth[away])


@pytest.mark.parametrize(
    ("altitude", "phase"),
    [
        (6096.0 + 30.48 * (np.arange(40) % 2), "cruise"),  # flicker of a 100 ft code
        (6096.0 + np.arange(20) * 60.0, "cruise"),  # 1 m/s never reaches 300 ft/min
        (3000.0 + np.cumsum(np.repeat([300.0, 60.0], 10)), "ascent"),  # slowing
        (np.full(5, 300.0), "unknown"),  # low level
        (np.full(1, 9000.0), "unknown"),  # alone
    ],
)
def test_phase_of_a_whole_flight(altitude, phase):
    minutes = np.arange(float(altitude.size))
    derived = derive_phase(columns(minutes, altitude=altitude), np.zeros(altitude.size, int))
    assert (derived == PHASE[phase]).all()


RNG = np.random.default_rng(20090105)


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
        (estimate,) = lattice_step(values, np.zeros(values.size, dtype=int), 1, steps)
        assert estimate == pytest.approx(step)


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
    by_quantity = resolutions(reports(seconds, clock), np.array([80]))
    assert by_quantity["position_resolution"][0] == pytest.approx(0.1 / 60)
    assert by_quantity["time_resolution"][0] == found_clock
    assert by_quantity["wind_speed_resolution"][0] == pytest.approx(KNOT)
    assert by_quantity["wind_direction_resolution"][0] == 1.0


def test_an_aircraft_with_few_reports_takes_the_usual_step_of_the_others():
    many, few = reports(IRREGULAR), reports(IRREGULAR[:2], tail=1)
    joined = {name: np.concatenate([many[name], few[name]]) for name in many}
    for values in resolutions(joined, np.array([80, 2])).values():
        assert values[1] == values[0]
