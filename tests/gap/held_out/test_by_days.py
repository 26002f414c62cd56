"""Effects of the reference's wind told by days: sizes, their errors, and the covariance beside."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.exogenous import exogenous
from airswing.gap.effects import CATALOGUE
from airswing.gap.held_out.by_days import ByDays, Coefficient, Column
from airswing.gap.noise.model import fit_noise, flown
from airswing.gap.noise.shared_error import Lasting, Observations, SharedError

GRID, BIAS = CATALOGUE["reference_grid_relative"], CATALOGUE["reference_speed_bias"]


@pytest.fixture(scope="module")
def made():
    frame = make_frame(seed=5, aircraft=3, days=33)
    quiet = exogenous(frame)
    day = (frame.day - frame.day.min()).astype(np.int64)
    return (frame, quiet), fit_noise(frame.residual, flown(quiet)), day


def test_observations_are_means_of_ten_minutes_of_a_flight(made):
    (frame, quiet), noise, day = made
    seen = Observations.of(flown(quiet), day, ~noise.gross)
    assert seen.count.sum() == (seen.which >= 0).sum() == (~noise.gross).sum()
    own = seen.which == 7
    assert np.ptp(frame.time[own]) < 600.0
    assert np.unique(frame.flight[own]).size == 1
    np.testing.assert_allclose(seen.mean(frame.u_ref)[7], frame.u_ref[own].mean())
    np.testing.assert_allclose(seen.place[7, 2], frame.time[own].mean() / 3600.0)


def test_whitened_draws_of_the_covariance_are_independent(made):
    (_, quiet), noise, day = made
    seen = Observations.of(flown(quiet), day, ~noise.gross)
    error = SharedError(noise.model, (300.0, 6.0, 0.4))
    own = np.flatnonzero(seen.day == 3)
    drawn = np.zeros((seen.day.size, 400))
    drawn[own] = error._root(seen, own) @ np.random.default_rng(0).normal(size=(own.size, 400))
    white = error.whitened(seen, own, drawn)
    np.testing.assert_allclose(np.cov(white), np.eye(own.size), atol=0.3)
    found = SharedError.fitted(noise.model, seen, np.zeros((seen.day.size, 2)) + 1e-3)
    assert found.scale < 1e-3  # the whole is as large as the residual is


def test_hats_of_what_lasts_are_one_together(made):
    (_, quiet), noise, day = made
    lasting = Lasting.of(Observations.of(flown(quiet), day, ~noise.gross).place)
    np.testing.assert_allclose(lasting.columns[:, lasting.blocks[0]].sum(axis=1), 1.0)
    assert [p.shape[0] for p in lasting.precision] == [b.stop - b.start for b in lasting.blocks]


@pytest.mark.parametrize("added", [0.0, 1.0])
def test_an_angle_of_the_grid_comes_out_as_large_as_it_is(made, added):
    frames, noise, day = made
    column, other = Column.of(*frames, GRID, 0), Column.of(*frames, BIAS, 0)
    assert column.told is column.own  # across the reference's wind, error and all
    assert other.told is not other.own
    rest = frames[0].residual + added / column.size * column.own
    found = ByDays.of(frames, noise, day, rest, [column, other]).weigh(0)
    assert found.value * column.size == pytest.approx(added, abs=3 * found.error * column.size)
    assert (found.deviations > 4) == (added > 0)


def test_what_is_nowhere_has_no_coefficient(made):
    frames, noise, day = made
    nothing = Column(np.zeros_like(frames[0].residual), np.zeros_like(frames[0].residual))
    assert ByDays.of(frames, noise, day, frames[0].residual, [nothing]).weigh(0) is None


def test_what_days_left_out_do_not_show_has_no_deviations():
    assert Coefficient(1.0, 0.1, 10.0, energy=3.0, doubt=1.0).deviations == pytest.approx(10)
    assert Coefficient(1.0, 0.1, 10.0, energy=1.0, doubt=1.0).deviations == 0
