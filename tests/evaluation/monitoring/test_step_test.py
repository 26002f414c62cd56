"""The sequential test: likelihoods against scipy's, estimated noise, detected steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.evaluation.daily_fleets import World, daily_sums, watched

from airswing.evaluation.monitoring.fleet_watch import (
    COMPASS,
    estimated_noise,
    watch_fleet,
)
from airswing.evaluation.monitoring.step_test import (
    SINGLE_DAY,
    Noise,
    corroborated_ratio,
)

WORLD = World(days_off=0.0)


def test_the_errors_of_days_are_estimated():
    rng = np.random.default_rng(1)
    n, usual = 2000, Noise(1.0, np.array([0.01]))
    aircraft, day = np.repeat(np.arange(20), n // 20), np.tile(np.arange(n // 20), 20)
    count = rng.integers(5, 80, n) * 1.0
    x = rng.normal(size=20)[aircraft] + rng.normal(size=100)[day]  # of each, of all
    x = x + rng.normal(0, 0.3, n) + rng.normal(size=n) * np.sqrt(4.0 / count)
    found = estimated_noise(count[:, None, None], (count * x)[:, None], aircraft, day, usual=usual)
    assert found.within == pytest.approx(4.0, rel=0.15)
    assert found.between[0] == pytest.approx(0.09, rel=0.25)
    assert found.persistence < 0.05


@pytest.mark.parametrize("size", [[2, 0, 0, 0, 0], [0, 2.4, 1.5, 0, 0]])
def test_a_compass_that_steps_is_detected_dated_and_sized_and_no_other(size):
    change = np.zeros((12, 60, 5))
    change[3, 40:] = size
    alarms = watched(WORLD, aircraft=12, days=60, seed=6, change=change).tested.alarms
    assert [alarm.step.number for alarm in alarms] == [3]
    step = alarms[0].step
    assert 41 <= alarms[0].night <= 44
    assert step.earliest <= 40 <= step.latest
    error = np.degrees(step.change[:5]) - size
    assert (np.abs(error) < 4.0 * np.degrees(step.error[:5])).all()


@pytest.mark.parametrize("number", [12, 2])
def test_a_step_of_all_aircraft_is_that_of_the_reference(number):
    change = np.zeros((1, 70, 5))
    change[:, 45:, 0] = 2.5
    watch = watched(WORLD, aircraft=number, days=70, seed=3, change=change)
    (alarm,) = watch.tested.alarms
    assert alarm.step.number == -1
    assert abs(alarm.step.day - 45) <= 1
    assert np.degrees(alarm.step.change[0]) == pytest.approx(2.5, abs=0.8)
    if number > 2:  # two aircraft have no common part
        assert not any(entry["changes"] for entry in watch.changes)


def test_higher_harmonics_are_no_change_where_routes_turn():
    """Routes turn on the 60th day; without the unknowns of these harmonics that is an alarm."""
    world = replace(WORLD, wrong_curve=0.9)
    assert watched(world, aircraft=20, days=64, seed=10).tested.alarms == []
    law = COMPASS.law
    known = np.where(np.isin(np.arange(12), [5, 6, 7, 8]), 1e-9, 1.0)
    blind = replace(COMPASS, law=replace(law, level=law.level * known, drift=law.drift * known))
    rows = daily_sums(world, aircraft=20, days=64, seed=10)[:4]
    alarms = watch_fleet(*rows, blind, 20).alarms
    assert any(alarm.step.day >= 59 for alarm in alarms)


def test_a_fleet_without_a_change_has_no_alarm():
    """15 aircraft-years of heavy tails and lasting errors of the reference."""
    world = replace(WORLD, persistence=0.7, days_off=0.3)
    watch = watched(world, aircraft=30, days=180, seed=21)
    assert watch.tested.alarms == []
    assert not any(entry["changes"] for entry in watch.changes)


def test_no_single_day_decides_and_two_do():
    weight = np.tile(9.0 * np.eye(2), (3, 1, 1))
    day = np.array([[20.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    level, shapes = 0.05 * np.eye(2), np.array([[5.0, 5.0]])
    assert corroborated_ratio(weight[:1], 9.0 * day[:1], level, shapes) == SINGLE_DAY
    assert corroborated_ratio(weight, 9.0 * day, level, shapes) <= SINGLE_DAY
    both = corroborated_ratio(weight[:2], 9.0 * day[[0, 0]], level, shapes)
    assert both > SINGLE_DAY + 5.0
