"""One effect of all aircraft, or as many of single ones."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import candidates
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import evaluate
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.cross_validated import settle
from airswing.gap.search.fewest import shared_by_all
from airswing.gap.search.stepwise import Rules, found_of
from airswing.gap.sums.whole_archive import held_archive

EFFECTS = {"compass_offset": CATALOGUE["compass_offset"]}


def sums(offsets):
    """Sums of one day whose aircraft have these offsets, degrees; candidates; singles of all."""
    frame = make_frame(
        seed=5,
        aircraft=len(offsets),
        days=1,
        noise=0.3,
        heading_error=lambda c: np.radians(offsets)[c["aircraft"]],
    )
    made = run_pass(held_archive(frame), Search(EFFECTS, Rules(), False, 0, lambda *_: None))
    base = made.problem.base
    pool = candidates(base.stats.layout, EFFECTS, dictionary=False)
    (single,) = (c for c in pool if c.scope == "aircraft")
    score = evaluate(base.stats, given_terms(base, []), single)
    return base, pool, Term(single, tuple(range(len(offsets))), None, score)


@pytest.fixture(scope="module")
def alike():
    return sums([4.0] * 6)


def test_what_all_share_is_one_effect(alike):
    base, pool, term = alike
    assert shared_by_all(base, pool, [term], 0)
    few = Term(term.candidate, (0, 1, 2), None, term.score)
    assert not shared_by_all(base, pool, [few], 0)
    (wide,) = (c for c in pool if c.scope == "fleet")
    assert shared_by_all(base, pool, [Term(wide, term.tails, None, term.score)], 0)


def test_what_each_has_of_its_own_is_not():
    base, pool, term = sums([4.0, -4.0, 3.0, -3.0, 5.0, -5.0])
    assert not shared_by_all(base, pool, [term], 0)


def test_of_a_day_it_is_not_stated_of_each_either(alike, monkeypatch):
    """Parts of the day did not confirm the fleet's form, and the search went on without it."""
    base, pool, term = alike
    ranking = Ranking(base, pool)
    singles = found_of(ranking, [term])
    monkeypatch.setattr("airswing.gap.search.cross_validated.search", lambda *_, **__: singles)
    standing = settle(ranking, Rules())
    assert standing.found.terms == ()
    (doubtful,) = standing.doubtful
    assert doubtful.probability == 0.0 and "may be their weather" in doubtful.reason
