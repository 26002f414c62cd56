"""Flights and phases: midnight, antimeridian, ground stops, rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from airswing.flags import PHASE
from airswing.reports.flights import derive_flight, derive_phase

FOOT = 0.3048


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


STEADY = None  # 111 m/s due east


@pytest.mark.parametrize(
    ("minutes", "east", "label", "flights"),
    [
        pytest.param([0, 15, 29, 31, 45], STEADY, -1, [0] * 5, id="midnight"),
        pytest.param(
            [0, 10, 20, 30], [179.0, 179.6, -179.8, -179.2], -1, [0] * 4, id="antimeridian"
        ),
        pytest.param([0, 10, 54, 64, 110], STEADY, -1, [0, 0, 0, 0, 1], id="gap over 45 minutes"),
        pytest.param(
            [0, 5, 10, 35, 40], [0.0, 0.3, 0.6, 0.62, 0.9], -1, [0, 0, 0, 1, 1], id="ground stop"
        ),
        pytest.param([0, 5, 10, 15], [0.0, 0.3, 5.3, 5.6], -1, [0, 0, 1, 1], id="jump"),
        pytest.param([0, 60, 120, 1440, 1500], STEADY, 7, [0, 0, 0, 1, 1], id="number on two days"),
        pytest.param(
            [0, 10, 20, 30, 40], STEADY, [3, 1, 3, 1, 1], [0, 1, 0, 1, 1], id="alternating labels"
        ),
        pytest.param(
            np.arange(24) * 5.0 + np.repeat([0, 180], 12),
            STEADY,
            np.where(np.arange(24) % 2 == 0, np.repeat([4, 9], 12), -1),
            [0] * 12 + [1] * 12,
            id="every second label missing",
        ),
        pytest.param(
            [0, 5, 10, 15, 20, 25], STEADY, [-1, -1, 4, 4, -1, -1], [0] * 6, id="both ends missing"
        ),
        pytest.param(
            [0, 5, 60, 65, 70, 200],
            STEADY,
            [-1, -1, 4, 4, -1, -1],
            [0, 0, 1, 1, 1, 2],
            id="ends beyond a gap",
        ),
        pytest.param(
            [0, 100, 200, 210], STEADY, [4, -1, 4, 4], [0] * 4, id="gap within a label bridged"
        ),
        pytest.param(
            [0, 100, 500, 510], STEADY, [4, -1, 4, 4], [0, 1, 2, 2], id="too long a gap for that"
        ),
        pytest.param(
            np.arange(10) * 5.0,
            np.where(np.arange(10) == 4, 0.0, -87.0 + 0.3 * np.arange(10)),
            -1,
            [0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
            id="one wrong position",
        ),
        pytest.param([], STEADY, -1, [], id="no reports"),
    ],
)
def test_flights_of_one_aircraft(minutes, east, label, flights):
    found = derive_flight(columns(minutes, longitude=east, label=label))
    assert found.tolist() == flights


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
    known = truth >= 0
    np.testing.assert_array_equal(found[known], truth[known])


STEPS = np.arange(20) * 60.0


@pytest.mark.parametrize(
    ("altitude", "phase"),
    [
        pytest.param(6096.0 + 30.48 * (np.arange(40) % 2), "cruise", id="flicker of a 100 ft code"),
        pytest.param(6096.0 + STEPS, "cruise", id="1 m/s never reaches 300 ft/min"),
        pytest.param(
            3000.0 + np.cumsum(np.r_[np.full(10, 300.0), np.full(10, 60.0)]), "ascent", id="slowing"
        ),
        pytest.param(np.full(5, 300.0), "unknown", id="low level"),
        pytest.param(np.full(1, 9000.0), "unknown", id="lone"),
    ],
)
def test_phase_of_a_whole_flight(altitude: np.ndarray, phase: str):
    size = altitude.size
    found = derive_phase(columns(np.arange(float(size)), altitude=altitude), np.zeros(size, int))
    assert (found == PHASE[phase]).all()
