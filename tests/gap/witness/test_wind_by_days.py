"""Names of the reference's wind by plain means of days."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.layout import effect_columns
from airswing.gap.effects import CATALOGUE
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.belief import STATED
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive
from airswing.gap.witness.bench import Setting
from airswing.gap.witness.wind_by_days import LEAST_BLOCKS, name_by_days, wind_names

GRID = "reference_grid_relative"
EFFECTS = {name: CATALOGUE[name] for name in (GRID, "altitude_offset", "compass_offset")}


def passed(days):
    frame = make_frame(seed=5, aircraft=3, days=days)
    return run_pass(held_archive(frame), Search(EFFECTS, Rules(), False, 0, lambda *_: None))


@pytest.fixture(scope="module")
def made():
    return passed(33)


@pytest.fixture(scope="module")
def turned(made):
    """What a grid's angle left in the winds adds."""
    return effect_columns(made.problem.context, CATALOGUE[GRID])[0]


def test_winds_left_along_the_grid_are_told_by_their_means(made, turned):
    problem = made.problem
    setting, rest = Setting.of(problem, draws=0), problem.archive.residual
    nothing = wind_names(setting, EFFECTS, rest)
    assert {one.name for one in nothing} == {GRID, "altitude_offset"}  # none of the heading
    assert nothing[0].probability < 0.5
    best, other = wind_names(setting, EFFECTS, rest + 1.5 * turned)
    assert (best.name, best.form) == (GRID, 0)
    assert best.probability > STATED
    assert other.deviations < 0.5 * best.deviations


def test_a_few_blocks_of_days_tell_nothing():
    problem = passed(3 * (LEAST_BLOCKS - 1)).problem
    assert not wind_names(Setting.of(problem, draws=0), EFFECTS, problem.archive.residual)


def test_the_name_is_stated_where_no_other_of_the_fleet_stands(made, turned):
    problem, found = made.problem, made.standing.found
    setting, rest = Setting.of(problem, draws=0), problem.archive.residual
    assert name_by_days(problem, found, setting, rest, []) is None
    named = name_by_days(problem, found, setting, rest + 1.5 * turned, [])
    assert named is not None
    assert named.term.key == (GRID, "fleet")
    assert named.probability > STATED
    one, all_of_them = [(0,)], [(0, 1, 2)]
    assert name_by_days(problem, found, setting, rest + 1.5 * turned, one) is not None
    assert name_by_days(problem, found, setting, rest + 1.5 * turned, all_of_them) is None
    told = replace(found, terms=(named.term,))
    assert name_by_days(problem, told, setting, rest + 1.5 * turned, []) is None


def test_a_name_likelier_than_not_and_not_beyond_doubt_says_so(made, turned):
    problem, found = made.problem, made.standing.found
    setting, rest = Setting.of(problem, draws=0), problem.archive.residual
    sizes = np.linspace(0.0, 1.5, 16)
    told = [name_by_days(problem, found, setting, rest + s * turned, []) for s in sizes]
    chances = [one.probability if one else 0.0 for one in told]
    near = [one for one in told if one and one.reason]
    assert near and all(0.5 <= one.probability < STATED for one in near)
    assert all(one.probability >= STATED for one in told if one and not one.reason)
    assert chances == sorted(chances)
