"""A name that raises the disagreement of weeks left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.held_out.raising import _explained, raising
from airswing.gap.passes import RAISES, Search, run_pass
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

ERROR = np.radians(0.6)


@pytest.fixture(scope="module")
def made():
    """One of five aircraft points 0.6 degrees off; what a search for an offset alone comes to."""
    frame = make_frame(
        seed=3,
        aircraft=5,
        days=14,
        noise=0.3,
        model_error=0.5,
        heading_error=lambda c: np.where(c["aircraft"] == 1, ERROR, 0.0),
    )
    one = {"compass_offset": CATALOGUE["compass_offset"]}
    return run_pass(held_archive(frame), Search(one, Rules(), False, 0, lambda *_: None))


def test_a_right_name_stands(made):
    (term,) = made.standing.found.terms
    assert (term.candidate.name, term.tails) == ("compass_offset", (1,))
    assert not raising(made.problem, made.standing.found.terms)


def test_a_name_that_every_report_alike_contradicts_does_not(made):
    """As where the changes along flights, of which the sums tell, show what the rest does not."""
    problem, terms = made.problem, made.standing.found.terms
    frame = problem.archive
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    there = (frame.aircraft == 1)[:, None]
    moved = frame.residual + ERROR * frame.airspeed[:, None] * right * there
    other = replace(frame, u_rep=frame.u_ref + moved[:, 0], v_rep=frame.v_ref + moved[:, 1])
    assert raising(replace(problem, archive=other), terms) == [0]
    assert "further from the simulation" in RAISES


def test_of_what_acts_for_a_week_only_its_own_blocks_tell():
    """A step of eleven compasses, of which the residual as it is held 0.01 +- 0.09."""
    rng = np.random.default_rng(4)
    block = np.repeat(np.arange(15), 200)
    own = np.where(block[:, None] > 12, 1.0, 0.0) * np.ones((3000, 2))

    def told(share):
        rest = (share - 1.0) * own + 0.8 * rng.standard_normal(own.shape)
        return _explained((rest + own) * own, own**2, block)

    explained, doubt = told(0.0)
    assert explained == pytest.approx(-(own**2).sum(), rel=0.2)
    assert explained < -4 * doubt  # over all blocks it would be one and a half
    explained, doubt = told(1.0)
    assert explained == pytest.approx((own**2).sum(), rel=0.2)
    assert _explained(0.0 * own, 0.0 * own, block) == (0.0, 0.0)


def test_the_error_between_blocks_is_that_of_many_draws():
    rng = np.random.default_rng(5)
    block = np.repeat(np.arange(15), 20)
    own = np.where(block[:, None] > 4, 1.0, 0.0) * np.ones((300, 2))
    made = np.array(
        [
            _explained((own + rng.standard_normal(15)[block][:, None]) * own, own**2, block)
            for _ in range(400)
        ]
    )
    assert np.mean(made[:, 1] ** 2) == pytest.approx(np.var(made[:, 0]), rel=0.25)
