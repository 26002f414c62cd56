"""A name that raises the disagreement of weeks left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.held_out.raising import raising
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
