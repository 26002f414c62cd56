"""A bias of the model's wind beyond a level, and what only looks like one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.reference_speed_bias import LEVELS
from airswing.gap.held_out.days_left_out import term_coefficients
from airswing.gap.held_out.level_or_other import goes_by
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

BELOW_700 = 1 + len(LEVELS) + LEVELS.index(700.0)


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=3, aircraft=5, days=30, noise=0.3, model_error=0.5)


def searched(frame, where):
    """Model winds a fifth too strong there; what a search for a bias alone comes to."""
    factor = np.where(where, 1.2, 1.0)
    wrong = replace(frame, u_ref=factor * frame.u_ref, v_ref=factor * frame.v_ref)
    one = {"reference_speed_bias": CATALOGUE["reference_speed_bias"]}
    return run_pass(held_archive(wrong), Search(one, Rules(), False, 0, lambda *_: None))


def test_a_bias_below_a_level_is_one(frame):
    made = searched(frame, frame.pressure > 7e4)
    found = made.standing.found
    assert [term.candidate.subset for term in found.terms] == [(BELOW_700,)]
    assert goes_by(made.problem, found.terms, term_coefficients(found.given, found.terms)) is None
    assert made.standing.probability[0] > 0.9


def test_a_bias_where_it_is_warm_is_no_bias_below_a_level(frame):
    made = searched(frame, frame.temperature > 273.0)
    assert not made.standing.found.terms
    (doubtful,) = made.standing.doubtful
    assert doubtful.term.candidate.name == "reference_speed_bias"
    assert doubtful.probability == 0.0
    assert "goes by temperature" in doubtful.reason


def test_a_bias_at_all_levels_is_not_refused(frame):
    made = searched(frame, frame.pressure > 0.0)
    assert made.standing.found.terms
    assert not made.standing.doubtful
