"""Flights and phases: midnight, antimeridian, ground stops, rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from airswing.flags import PHASE
from airswing.reports.flights import climb_rate, derive_flight, derive_phase, step_distance

FOOT = 0.3048
DEGREE = 2 * np.pi * 6371008.8 / 360.0  # m along a great circle


def columns(
    minutes: Any, *, longitude: Any = None, label: Any = -1, tail: Any = 0, altitude: Any = 6000.0
) -> dict[str, np.ndarray]:
    minutes = np.asarray(minutes, dtype=float)
    start = np.datetime64("2009-01-05T23:30:00", "ns")
    east = -87.0 + 0.06 * minutes if longitude is None else longitude  # 111 m/s at the equator
    return {
        "tail": np.broadcast_to(np.int32(tail), minutes.shape).copy(),
        "time": start + np.round(minutes * 60e9).astype("timedelta64[ns]"),
        "latitude": np.zeros(minutes.shape),
        "longitude": np.broadcast_to(np.asarray(east, dtype=float), minutes.shape).copy(),
        "flight": np.broadcast_to(np.int32(label), minutes.shape).copy(),
        "pressure_altitude": np.broadcast_to(
            np.asarray(altitude, dtype=np.float32), minutes.shape
        ).copy(),
    }


def test_distance_of_one_degree_and_across_the_antimeridian():
    found = step_distance(np.array([0.0, 0.0, 0.0, 1.0]), np.array([178.5, 179.5, -179.5, -179.5]))
    np.testing.assert_allclose(found, DEGREE, rtol=1e-9)


def test_midnight_ends_no_flight():
    assert derive_flight(columns([0, 15, 29, 31, 45])).tolist() == [0] * 5


def test_the_antimeridian_ends_no_flight():
    east = np.array([179.0, 179.6, -179.8, -179.2])
    assert derive_flight(columns([0, 10, 20, 30], longitude=east)).tolist() == [0] * 4


def test_a_gap_over_45_minutes_ends_an_unlabelled_flight():
    assert derive_flight(columns([0, 10, 54, 64, 110])).tolist() == [0, 0, 0, 0, 1]


def test_a_ground_stop_ends_an_unlabelled_flight():
    minutes = [0, 5, 10, 35, 40]
    east = np.array([0.0, 0.3, 0.6, 0.62, 0.9])
    assert derive_flight(columns(minutes, longitude=east)).tolist() == [0, 0, 0, 1, 1]


def test_a_jump_ends_an_unlabelled_flight():
    east = np.array([0.0, 0.3, 5.3, 5.6])
    assert derive_flight(columns([0, 5, 10, 15], longitude=east)).tolist() == [0, 0, 1, 1]


def test_the_same_number_on_two_days_is_two_flights():
    minutes = [0, 60, 120, 1440, 1500]
    assert derive_flight(columns(minutes, label=7)).tolist() == [0, 0, 0, 1, 1]


def test_labels_may_alternate_without_breaking_each_other():
    label = np.array([3, 1, 3, 1, 1])
    assert derive_flight(columns([0, 10, 20, 30, 40], label=label)).tolist() == [0, 1, 0, 1, 1]


def test_reports_without_a_label_belong_to_the_flight_around_them():
    minutes = np.arange(24) * 5.0 + np.repeat([0, 180], 12)
    label = np.where(np.arange(24) % 2 == 0, np.repeat([4, 9], 12), -1)
    assert derive_flight(columns(minutes, label=label)).tolist() == [0] * 12 + [1] * 12
    # At both ends too, where no gap, stop or jump lies between.
    label = np.array([-1, -1, 4, 4, -1, -1])
    assert derive_flight(columns([0, 5, 10, 15, 20, 25], label=label)).tolist() == [0] * 6
    assert derive_flight(columns([0, 5, 60, 65, 70, 200], label=label)).tolist() == [
        *(0, 0, 1, 1, 1, 2)
    ]


def test_a_gap_within_a_label_is_bridged_as_for_labelled_reports():
    label = np.array([4, -1, 4, 4])
    assert derive_flight(columns([0, 100, 200, 210], label=label)).tolist() == [0] * 4
    assert derive_flight(columns([0, 100, 500, 510], label=label)).tolist() == [0, 1, 2, 2]


@pytest.mark.parametrize("labels", [(-1, -1), (3, 7), (3, -1)])
def test_two_aircraft_under_one_identifier_are_separated(labels: tuple[int, int]):
    minutes = np.repeat(np.arange(20.0), 2) + np.tile([0, 0.4], 20)
    second = np.tile([False, True], 20)
    east = np.where(second, 10.0, -87.0) + 0.06 * minutes
    label = np.where(second, labels[1], labels[0])
    found = derive_flight(columns(minutes, longitude=east, label=label))
    assert found.tolist() == np.where(second, 1, 0).tolist()


def test_a_wrong_position_does_not_end_a_flight():
    east = -87.0 + 0.06 * np.arange(10.0) * 5
    east[4] = 0.0
    found = derive_flight(columns(np.arange(10) * 5.0, longitude=east))
    assert found.tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0, 0]


def test_numbers_are_unique_over_tails():
    found = derive_flight(columns([0, 10, 0, 10], tail=np.array([0, 0, 1, 1]), label=5))
    assert found.tolist() == [0, 0, 1, 1]


def test_no_reports_no_flights():
    assert derive_flight(columns([])).size == 0


def test_climb_rate_of_a_steady_climb_and_of_a_lone_report():
    seconds = np.array([0.0, 60.0, 120.0, 0.0])
    rate = climb_rate(seconds, 5.0 * seconds, np.array([0, 0, 0, 1]))
    np.testing.assert_allclose(rate[:3], 5.0)
    assert np.isnan(rate[3])


def profile(step: float, altitude_step_ft: float) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Climb at 1500 ft/min to 25,000 ft, cruise, descend; every ``step`` minutes."""
    minutes = np.arange(0.0, 60.0, step)
    feet = np.interp(minutes, [0, 1, 17, 40, 57, 60], [0, 500, 25000, 25000, 500, 500])
    coded = altitude_step_ft * np.round(feet / altitude_step_ft)
    truth = np.select(
        [
            (minutes > 1) & (minutes < 17),
            (minutes > 17) & (minutes < 40),
            (minutes > 40) & (minutes < 57),
        ],
        [PHASE["ascent"], PHASE["cruise"], PHASE["descent"]],
        PHASE["unknown"],
    )
    near = (
        np.abs(minutes[:, np.newaxis] - [1.0, 17.0, 40.0, 57.0]).min(axis=1) < max(step, 0.5) + 0.6
    )
    return columns(minutes, altitude=coded * FOOT), np.where(near, -1, truth)


@pytest.mark.parametrize("step", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("altitude_step_ft", [1.0, 100.0])
def test_phases_of_a_flight_whatever_the_coding(step, altitude_step_ft):
    flown, truth = profile(step, altitude_step_ft)
    found = derive_phase(flown, np.zeros(truth.size, dtype=int))
    told = truth >= 0
    np.testing.assert_array_equal(found[told], truth[told])


def test_level_flight_in_a_100_ft_code_is_cruise_throughout():
    altitude = 6096.0 + 30.48 * (np.arange(40) % 2)  # flickers between two codes every minute
    found = derive_phase(columns(np.arange(40.0), altitude=altitude), np.zeros(40, dtype=int))
    assert (found == PHASE["cruise"]).all()


def test_slow_drift_of_level_is_cruise_but_a_slowing_climb_stays_one():
    drift = 6096.0 + np.arange(20) * 60.0 * 1.0  # 1 m/s never reaches 300 ft/min
    assert (
        derive_phase(columns(np.arange(20.0), altitude=drift), np.zeros(20, dtype=int))
        == PHASE["cruise"]
    ).all()
    rate = np.r_[np.full(10, 5.0), np.full(10, 1.0)]
    slowing = 3000.0 + np.cumsum(rate) * 60.0
    assert (
        derive_phase(columns(np.arange(20.0), altitude=slowing), np.zeros(20, dtype=int))
        == PHASE["ascent"]
    ).all()


def test_low_level_lone_and_unknown_altitudes_have_no_phase():
    found = derive_phase(columns(np.arange(5.0), altitude=300.0), np.zeros(5, dtype=int))
    assert (found == PHASE["unknown"]).all()
    assert derive_phase(columns([0.0], altitude=9000.0), np.zeros(1, dtype=int)).tolist() == [0]
    altitude = np.array([6000.0, np.nan, 6000.0])
    found = derive_phase(columns([0, 1, 2], altitude=altitude), np.zeros(3, dtype=int))
    assert found.tolist() == [PHASE["cruise"], PHASE["unknown"], PHASE["cruise"]]


def test_interleaved_flights_keep_their_own_phases():
    flown = columns(np.repeat(np.arange(10.0), 2), altitude=6000.0)
    flight = np.tile([0, 1], 10)
    flown["pressure_altitude"][1::2] = 2000.0 + 300.0 * np.arange(10)
    found = derive_phase(flown, flight)
    assert (found[::2] == PHASE["cruise"]).all()
    assert (found[1::2] == PHASE["ascent"]).all()
