"""The test of a night: its likelihoods against scipy's, noise found again, steps told and dated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tests.evaluation.daily_fleets import World, daily_sums

from airswing.evaluation.monitoring.common_part import common_part, estimated_noise
from airswing.evaluation.monitoring.fleet_watch import (
    COMPASS,
    COMPASS_COMMON,
    COMPASS_NOISE,
    KeptWatch,
    watch_fleet,
)
from airswing.evaluation.monitoring.sequential_test import Noise, _marginal, _mixture

WORLD = World(days_off=0.0)


def watched(rows, number):
    return watch_fleet(rows[:4], COMPASS, usual=COMPASS_NOISE, common=COMPASS_COMMON, number=number)


def test_the_ratio_is_that_of_the_two_normal_laws():
    """A score of a level known with error, with and without a step drawn from its prior."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(2, 2))
    weight, level = root @ root.T + np.eye(2), np.diag([0.3, 0.1])
    score, shape = rng.normal(size=2) * 3, np.array([2.0, 0.5])
    quiet = weight + weight @ level @ weight
    stepped = quiet + weight @ np.diag(shape**2) @ weight
    expected = multivariate_normal(cov=stepped).logpdf(score) - multivariate_normal(
        cov=quiet
    ).logpdf(score)
    inside, outside = _marginal(weight[None], score[None], level[None])
    assert _mixture(inside, outside, shape)[0] == pytest.approx(expected, rel=1e-9)


def test_the_ratio_of_one_unknown_by_hand():
    """Three days of weight 1 tell 2 each, the level before is known to 1: W~ = 3 / 4, s~ = 6 / 4.

    A step of variance 4: 0.5 x 1.5^2 / (1 / 4 + 3 / 4) - 0.5 ln(1 + 4 x 3 / 4).
    """
    weight, score = _marginal(np.array([[[3.0]]]), np.array([[6.0]]), np.eye(1)[None])
    assert (weight.item(), score.item()) == (0.75, 1.5)
    ratio = _mixture(weight, score, np.array([2.0]))[0]
    assert ratio == pytest.approx(1.125 - 0.5 * np.log(4.0))


def test_a_days_weight_is_the_inverse_of_its_two_errors():
    noise = Noise(2.0, np.array([0.1, 0.0]), persistence=0.5)
    normal, x = np.array([[4.0, 1.0], [1.0, 3.0]]), np.array([1.0, -2.0])
    weight, right = noise.weights(normal, normal @ x)
    expected = np.linalg.inv(2.0 * np.linalg.inv(normal) + np.diag([0.1, 0.0]))
    np.testing.assert_allclose(weight, expected)
    np.testing.assert_allclose(right, expected @ x)
    # three days: 1 + 2 (2/3 x 0.5 + 1/3 x 0.25)
    assert noise.inflation(3) == pytest.approx(1.0 + 2.0 * (2 / 3 * 0.5 + 1 / 3 * 0.25))
    # a day of one heading tells of one direction alone
    single, _ = noise.weights(np.array([[4.0, 0.0], [0.0, 0.0]]), np.zeros(2))
    np.testing.assert_allclose(single, [[1 / 0.6, 0.0], [0.0, 0.0]])


def test_the_errors_of_days_are_found_again():
    rng = np.random.default_rng(1)
    n, usual = 2000, Noise(1.0, np.array([0.01]))
    aircraft, day = np.repeat(np.arange(20), n // 20), np.tile(np.arange(n // 20), 20)
    count = rng.integers(5, 80, n) * 1.0
    x = rng.normal(size=20)[aircraft] + rng.normal(size=100)[day]  # of its own, of all
    x = x + rng.normal(0, 0.3, n) + rng.normal(size=n) * np.sqrt(4.0 / count)
    found = estimated_noise(count[:, None, None], (count * x)[:, None], aircraft, day, usual=usual)
    assert found.within == pytest.approx(4.0, rel=0.15)
    assert found.between[0] == pytest.approx(0.09, rel=0.25)
    assert found.persistence < 0.05


def test_one_aircraft_far_off_does_not_move_the_common_part():
    weight = np.tile(25.0 * np.eye(1), (9, 1, 1))
    x = np.full(9, 0.5)
    x[3] = 8.0
    found = common_part(weight, 25.0 * x[:, None], np.zeros(1), np.array([1.0]))
    np.testing.assert_allclose(np.delete(found.without, 3), 0.5, atol=0.03)
    few = common_part(weight[:4], 25.0 * x[:4, None], np.array([0.2]), np.array([1.0]))
    assert (few.without == 0.2).all() and not few.weight.any()


@pytest.mark.parametrize("size", [[2, 0, 0, 0, 0], [0, 2.4, 1.5, 0, 0]])
def test_a_compass_that_steps_is_told_dated_and_sized_and_nobody_else(size):
    change = np.zeros((12, 60, 5))
    change[3, 40:] = size
    alarms = watched(daily_sums(WORLD, aircraft=12, days=60, seed=6, change=change), 12)
    assert [alarm.step.number for alarm in alarms] == [3]
    step = alarms[0].step
    assert 41 <= alarms[0].night <= 44
    assert step.earliest <= 40 <= step.latest
    error = np.degrees(step.size[:5]) - size
    assert (np.abs(error) < 4.0 * np.degrees(step.error[:5])).all()


@pytest.mark.parametrize("number", [12, 2])
def test_a_step_of_all_at_once_is_the_references(number):
    change = np.zeros((1, 70, 5))
    change[:, 45:, 0] = 2.5
    alarms = watched(daily_sums(WORLD, aircraft=number, days=70, seed=3, change=change), number)
    assert [alarm.step.number for alarm in alarms] == [-1]
    assert abs(alarms[0].step.day - 45) <= 1
    assert np.degrees(alarms[0].step.size[0]) == pytest.approx(2.5, abs=0.8)


def test_higher_harmonics_are_no_change_where_an_aircraft_turns_to_other_headings():
    """Routes turn on the 60th day; without the unknowns of these harmonics that is told."""
    rows = daily_sums(replace(WORLD, wrong_curve=0.9), aircraft=20, days=64, seed=10)
    assert watched(rows, 20) == []
    known = np.where(np.isin(np.arange(COMPASS.size), [5, 6, 7, 8]), 1e-9, 1.0)
    blind = replace(COMPASS, level=COMPASS.level * known, drift=COMPASS.drift * known)
    alarms = watch_fleet(rows[:4], blind, usual=COMPASS_NOISE, common=COMPASS_COMMON, number=20)
    assert any(alarm.step.day >= 59 for alarm in alarms)


def test_a_quiet_fleet_stays_quiet():
    """15 aircraft-years of heavy tails and lasting errors of the reference."""
    world = replace(WORLD, persistence=0.7, days_off=0.3)
    assert watched(daily_sums(world, aircraft=30, days=180, seed=21), 30) == []


def test_a_watch_that_goes_on_from_a_kept_month_is_the_one_from_the_start():
    """To the last bit, steps before the month among it; other rows before it are walked anew."""
    change = np.zeros((8, 70, 5))
    change[3, 45:] = [3.0, 1.0, 0.0, 0.0, 0.0]
    change[5, 62:] = 4.0
    rows = daily_sums(WORLD, aircraft=8, days=70, seed=5, change=change)[:4]
    law = {"usual": COMPASS_NOISE, "common": COMPASS_COMMON, "number": 8}
    stored = {}
    kept = KeptWatch(lambda: stored.get("as"), lambda arrays: stored.update({"as": arrays}))
    early = tuple(part[rows[1] < 64] for part in rows)
    first = watch_fleet(early, COMPASS, kept=kept, **law)
    assert stored["as"]["month"] == 2  # since 1970: days 59 to 69 are of March
    plain = watch_fleet(rows, COMPASS, **law)
    assert [repr(one) for one in watch_fleet(rows, COMPASS, kept=kept, **law)] == [
        repr(one) for one in plain
    ]
    assert {one.step.number for one in plain} == {3, 5}
    assert [repr(one) for one in first] == [repr(one) for one in plain if one.night < 64]
    stored["as"] = stored["as"] | {"own:right": stored["as"]["own:right"] + 1e3}
    assert [repr(one) for one in watch_fleet(rows, COMPASS, kept=kept, **law)] != [
        repr(one) for one in plain
    ]  # what is kept is what is gone on from
    rows[3][0] += 1.0
    anew = watch_fleet(rows, COMPASS, **law)
    assert [repr(one) for one in watch_fleet(rows, COMPASS, kept=kept, **law)] == [
        repr(one) for one in anew
    ]
