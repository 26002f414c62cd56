"""Floors and directions that are never sent are told from simulated reports, and mapped."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame
from tests.gap.witness.test_learned import setting_of

from airswing.errors import InputError
from airswing.gap.archive.direction_lattice import lattice_of
from airswing.gap.closure.of_scatter import reduction_of_steps
from airswing.gap.effects.base import ActiveEffect
from airswing.gap.effects.empirical import mapped_speed
from airswing.gap.scatter.coded_values import wind_coding
from airswing.gap.simulation.forward import simulate
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.learned import Sample
from airswing.gap.witness.sent_winds import _area, _Half, _scatter_of_days, sent_winds, struck_of
from airswing.units import KNOT


def sent_as(frame, change):
    """The frame with other reported winds."""
    speed, direction = np.hypot(frame.u_rep, frame.v_rep), np.arctan2(frame.u_rep, frame.v_rep)
    speed, direction = change(speed, direction)
    u, v = speed * np.sin(direction), speed * np.cos(direction)
    return dataclasses.replace(frame, u_rep=u, v_rep=v)


def told_of(frame):
    setting = setting_of(frame)
    fold = np.arange(setting.day.max() + 1) % 5
    return sent_winds(Bench.of(setting, frame.residual), fold)


@pytest.fixture(scope="module")
def plain():
    return make_frame(seed=6, aircraft=6, days=14, noise=0.5)


@pytest.fixture(scope="module")
def floored(plain):
    return sent_as(plain, lambda speed, direction: (np.maximum(speed, 14 * KNOT), direction))


def test_nothing_is_told_of_winds_as_they_are(plain):
    assert told_of(plain) is None


def test_a_floor_is_told_mapped_and_closed(plain, floored):
    found = told_of(floored)
    assert found is not None and found.telling[0] == "wind_speed"
    assert len(found.aircraft) >= 5
    low = np.array([2.0, 6.0, 10.0]) * KNOT
    np.testing.assert_allclose(mapped_speed(low, found.speeds, found.sent), 14 * KNOT, rtol=0.02)
    high = np.array([20.0, 35.0]) * KNOT
    np.testing.assert_allclose(mapped_speed(high, found.speeds, found.sent), high, rtol=0.08)
    true = (np.hypot(*floored.residual.T).mean() - np.hypot(*plain.residual.T).mean()) / KNOT
    assert abs(found.closes - true) < max(2 * found.closes_error, 0.3 * true)


def test_what_shows_on_some_days_alone_is_less_sure_than_what_shows_every_day():
    rng = np.random.default_rng(8)
    day = np.repeat(np.arange(20), 200)
    sample = Sample(np.arange(day.size), day, np.zeros(day.size, bool))
    label = np.repeat([1, 0], day.size)

    def halves(shift):
        """Scores of real reports, raised by a shift of each day, and of simulated ones."""
        score = rng.normal(size=2 * day.size) + label * np.tile(shift[day], 2)
        return [_Half(None, score[:, None], label, score, np.zeros(day.size, bool))]

    always, sometimes = halves(np.full(20, 0.2)), halves(np.where(np.arange(20) < 3, 1.3, 0.0))
    assert _area(always) == pytest.approx(_area(sometimes), abs=0.03)
    # of 200 reports and as many simulated ones an area scatters by 0.029, its mean of 20 days
    # by 0.0065
    assert _scatter_of_days(sample, always) == pytest.approx(0.0065, rel=0.4)
    assert _scatter_of_days(sample, sometimes) > 3 * _scatter_of_days(sample, always)


def test_directions_that_are_never_sent_are_told(plain):
    step = np.radians(45.0)
    turned = sent_as(
        plain,
        lambda speed, direction: (
            speed,
            np.where(speed < 25 * KNOT, np.round(direction / step) * step, direction),
        ),
    )
    found = told_of(turned)
    assert found is not None and found.telling[0] == "wind_direction"
    assert found.speeds is None
    assert found.directions.max() > 0.5  # the sectors that hold the eight directions
    assert found.lattice.step == 45.0 and found.lattice.share > 0.95
    assert found.lattice.below == pytest.approx(25 * KNOT, rel=0.05)
    true = (np.hypot(*turned.residual.T).mean() - np.hypot(*plain.residual.T).mean()) / KNOT
    closes = reduction_of_steps(turned, turned.residual, found.lattice, found.aircraft)
    assert closes.interval[0] < true < closes.interval[1]
    assert closes.kt == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize(("step", "below", "share"), [(22.5, 12.0, 1.0), (30.0, 9.0, 0.7)])
def test_steps_of_directions_are_read_off_the_winds_sent(step, below, share):
    rng = np.random.default_rng(2)
    wind = rng.normal(3.0, 8.0, (2, 6000))
    speed, turn = np.hypot(*wind), np.degrees(np.arctan2(*wind))
    hit = (speed < below) & (rng.uniform(size=speed.size) < share)
    whole = np.radians(np.round(np.where(hit, step * np.round(turn / step), turn)))
    found = lattice_of(speed * np.sin(whole), speed * np.cos(whole))
    assert found.step == step
    assert (found.below, found.share) == pytest.approx((below, share), rel=0.06)
    assert lattice_of(*wind) is None


def test_what_hardly_shows_on_one_aircraft_shows_on_a_fleet():
    rng = np.random.default_rng(0)
    error, level = 0.013, 0.04
    fleet = level * rng.uniform(0.5, 1.5, 14) + error * rng.standard_normal(14)
    assert struck_of(fleet, error).sum() >= 13
    few = error * rng.standard_normal(14)
    few[[2, 7]] = 0.1, 0.14
    assert list(np.flatnonzero(struck_of(few, error))) == [2, 7]


def test_a_map_of_speeds_is_simulated(plain):
    """Between its points linear, beyond them moved along; directions stay."""
    values = {
        "component": "reported_speed",
        "variables": ["wind_speed"],
        "edges": [[0.0, 6.0, 8.0, 20.0]],
        "values": [6.0, 6.0, 8.0, 21.0],
    }
    sent = simulate(plain, effects=[ActiveEffect("empirical", values)])
    before, after = np.hypot(plain.u_ref, plain.v_ref), np.hypot(sent.u_rep, sent.v_rep)
    assert after[before < 6.0] == pytest.approx(6.0)
    middle = (before > 8.0) & (before < 20.0)
    assert after[middle] == pytest.approx(8.0 + (before[middle] - 8.0) * 13 / 12)
    beyond = before > 20.0
    assert after[beyond] == pytest.approx(before[beyond] + 1.0)
    np.testing.assert_allclose(
        sent.u_rep * plain.v_ref - sent.v_rep * plain.u_ref, 0.0, atol=1e-6 * before.max() ** 2
    )


def test_a_map_needs_one_value_for_each_speed(plain):
    values = {
        "component": "reported_speed",
        "variables": ["wind_speed"],
        "edges": [[0.0, 6.0, 8.0]],
        "values": [6.0, 6.0],
    }
    with pytest.raises(InputError, match="one number per speed"):
        simulate(plain, effects=[ActiveEffect("empirical", values)])


def test_a_floor_is_no_coarse_coding(floored):
    """All the floor's reports have one even speed; a coding in twos has all even speeds."""

    def coded(step):
        def change(speed, direction):
            return step * KNOT * np.round(speed / (step * KNOT)), direction

        return sent_as(floored, change)

    assert wind_coding(coded(1.0)) is None
    assert wind_coding(coded(2.0)).parameters["step"] == 2.0
