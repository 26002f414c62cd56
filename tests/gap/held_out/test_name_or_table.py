"""A doubtful name beside a table: the name where it explains as much, else the table."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap import names_and_unknowns
from airswing.gap.design.candidates import candidates
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import evaluate
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.name_or_table import explains
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.belief import STATED, TABLE_ODDS, beside_table
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.cross_validated import ANOTHER, Doubtful, with_name
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

OFFSET = {"compass_offset": CATALOGUE["compass_offset"]}
ERROR = np.radians(0.4)
#: Nothing is stated by the search itself.
SHY = Rules(evidence=1e6)


@pytest.fixture(scope="module")
def fleet():
    """All headings 0.4 degrees off: the pass without a name, the pool, the name, the true error."""
    frame = make_frame(
        seed=3,
        aircraft=5,
        days=14,
        noise=0.3,
        model_error=0.5,
        heading_error=lambda c: np.full(c["aircraft"].size, ERROR),
    )
    made = run_pass(held_archive(frame), Search(OFFSET, SHY, False, 0, lambda *_: None))
    base = made.problem.base
    pool = candidates(base.stats.layout, OFFSET, dictionary=False)
    whole = next(c for c in pool if c.scope == "fleet")
    score = evaluate(base.stats, given_terms(base, []), whole)
    name = Term(whole, tuple(range(5)), None, score)
    right = np.stack([np.cos(frame.heading), -np.sin(frame.heading)], -1)
    return made, pool, name, -ERROR * frame.airspeed[:, None] * right


def test_a_name_is_what_a_table_of_the_same_error_is(fleet):
    made, _, name, true = fleet
    everyone = range(5)
    assert explains(made.problem, [], name, (0.9 * true, everyone))
    assert explains(made.problem, [], name, (true, everyone))


def test_a_table_that_explains_more_stays(fleet):
    made, _, name, true = fleet
    more = made.problem.archive.residual * 0.3 + 0.7 * true
    assert not explains(made.problem, [], name, (more, range(5)))


def test_a_table_of_other_aircraft_stays(fleet):
    made, _, name, true = fleet
    own = np.isin(made.problem.archive.aircraft, [0, 1])
    assert not explains(made.problem, [], name, (np.where(own[:, None], true, 0.0), [0, 1]))


def test_a_name_that_a_table_confirmed_is_stated_with_its_odds(fleet):
    made, pool, name, _ = fleet
    assert not made.standing.found.terms
    chance = beside_table(0.5)
    assert chance == pytest.approx(TABLE_ODDS / (1 + TABLE_ODDS))
    doubtful = Doubtful(name, chance, np.zeros(5), "")
    told = with_name(Ranking(made.problem.base, pool), made.standing, doubtful)
    (term,) = told.found.terms
    assert (term.candidate.key, term.score.probability) == (name.candidate.key, chance)
    assert told.probability == pytest.approx([chance])
    assert told.energy[0] > 2 * told.error[0] > 0
    again = with_name(Ranking(made.problem.base, pool), told, doubtful)
    assert len(again.found.terms) == 1
    assert not with_name(Ranking(made.problem.base, []), made.standing, doubtful).found.terms


def test_a_table_does_not_bring_back_what_is_likelier_another_effect(monkeypatch):
    monkeypatch.setattr(names_and_unknowns, "explains", lambda *given: True)
    doubted = [Doubtful(None, 0.45, np.zeros(5), ANOTHER), Doubtful(None, 0.4, np.zeros(5), "days")]
    frame = SimpleNamespace(residual=np.zeros((2, 2)))
    final = SimpleNamespace(
        problem=SimpleNamespace(archive=frame),
        standing=SimpleNamespace(found=SimpleNamespace(terms=()), doubtful=doubted),
    )
    taken = SimpleNamespace(unknown=SimpleNamespace(tails=(0,)))
    named = names_and_unknowns._name_of(final, taken, frame)
    assert named.reason == "days"
    assert named.probability > STATED
    final.standing.doubtful = doubted[:1]
    assert names_and_unknowns._name_of(final, taken, frame) is None
