"""What a name leaves on its own aircraft says whether it is that name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import candidates
from airswing.gap.effects import CATALOGUE
from airswing.gap.passes import Search, run_pass
from airswing.gap.search import cross_validated
from airswing.gap.search.belief import NAMED_EVEN, NAMED_SLOPE, as_named
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.left_beside import (
    SHARE,
    USUAL,
    _left_of_others,
    left_beside,
    share_left,
)
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

EFFECTS = {name: CATALOGUE[name] for name in ("compass_offset", "hard_iron")}


@pytest.fixture(scope="module")
def made():
    """Search of an archive in which one aircraft has an offset and one cycle."""

    def erring(context):
        error = np.radians(1.5) + np.radians(3.0) * np.sin(context["magnetic_heading"])
        return np.where(context["aircraft"] == 3, error, 0.0)

    frame = make_frame(seed=8, aircraft=6, days=14, noise=0.3, heading_error=erring)
    return run_pass(held_archive(frame), Search(EFFECTS, Rules(), False, 0, lambda *_: None))


def test_a_name_leaves_what_another_explains(made):
    base, terms = made.problem.base, made.standing.found.terms
    assert {term.candidate.name for term in terms} == {"compass_offset", "hard_iron"}
    pool = candidates(base.stats.layout, EFFECTS, dictionary=False)
    assert left_beside(base, pool, terms).max() < 0.1
    for one in terms:  # the other one is left, over what is usual and a share of its own
        (left,) = left_beside(base, pool, [one])
        assert left * (USUAL + SHARE * one.score.raw) > 100.0
        # on an aircraft that has neither it is not, and stands for what is usual
        assert left_beside(base, pool, [replace(one, tails=(1,))])[0] == 0.0


def test_an_effect_by_what_is_inferred_leaves_more(made):
    """A quarter of an acceleration error's energy is not in its columns, and goes by phase."""
    (offset,) = [t for t in made.standing.found.terms if t.candidate.name == "compass_offset"]
    assert share_left(offset.candidate) == SHARE
    inferred = replace(offset.candidate, told_share=CATALOGUE["acceleration_error"].told_share)
    assert 2 * SHARE < share_left(inferred) < 0.1


@pytest.mark.parametrize(
    ("told_share", "tails", "heading", "nats"),
    [
        (1.0, (3,), True, 0.0),
        (0.76, (3, 4), True, 0.25 * (1 / 0.76 - 1) * 1000.0),
        (0.76, (4,), True, 0.0),  # on another aircraft
        (0.76, (3,), False, 0.0),  # along the heading
    ],
)
def test_what_an_inferred_effect_leaves_speaks_against_no_other_name(
    made, told_share, tails, heading, nats
):
    (offset,) = [t for t in made.standing.found.terms if t.candidate.name == "compass_offset"]
    offset = replace(offset, candidate=replace(offset.candidate, told_share=1.0))
    what = replace(offset.candidate, told_share=told_share, heading=heading)
    other = replace(offset, candidate=what, tails=tails, score=replace(offset.score, raw=1000.0))
    assert _left_of_others([offset, other], 0) == pytest.approx(nats)
    assert _left_of_others([offset, other], 1) == 0.0


def test_a_name_that_is_likelier_another_effect_is_not_told(made, monkeypatch):
    """What the offset leaves stands for an effect that the catalogue lacks."""
    terms = made.standing.found.terms
    ranking = Ranking(
        made.problem.base, candidates(made.problem.base.stats.layout, EFFECTS, dictionary=False)
    )

    def left(base, pool, terms):
        return np.array([2.0 * (t.candidate.name == "compass_offset") for t in terms])

    monkeypatch.setattr(cross_validated, "left_beside", left)
    standing = cross_validated.settle(ranking, Rules(), terms)
    assert [term.candidate.name for term in standing.found.terms] == ["hard_iron"]
    assert standing.found.terms[0].score.probability > 0.9
    (doubtful,) = standing.doubtful
    assert doubtful.term.candidate.name == "compass_offset"
    assert doubtful.probability < 0.1 and "likelier another effect" in doubtful.reason
    assert standing.energy.size == standing.probability.size == len(standing.weighed) == 1


def test_what_a_doubtful_name_explains_speaks_less_against_another(made):
    """The offset leaves the cycle: with the cycle as likely as 0.8, the offset is nearly so."""
    base, terms = made.problem.base, made.standing.found.terms
    pool = candidates(base.stats.layout, EFFECTS, dictionary=False)
    first, second = sorted(terms, key=lambda term: term.candidate.name)
    # it was found on another aircraft; that it is on the offset's as well its evidence there tells
    doubt = cross_validated.Doubtful(replace(second, tails=(1,)), 0.8, np.zeros(5), "")
    alone = cross_validated._likely_as_named(base, pool, [first], [])
    beside = cross_validated._likely_as_named(base, pool, [first], [doubt])
    weak = cross_validated._likely_as_named(base, pool, [first], [replace(doubt, probability=0.4)])
    assert alone[0] < 0.01
    assert beside[0] == pytest.approx(0.8 / (1 + np.exp(-NAMED_EVEN)), abs=0.05)
    assert weak == alone
    assert cross_validated._likely_as_named(base, pool, [], [doubt]).size == 0


def test_terms_without_a_name_are_not_asked(made):
    base, (term, *_) = made.problem.base, made.standing.found.terms
    pool = candidates(base.stats.layout, EFFECTS, dictionary=False)
    curve = replace(term, candidate=replace(term.candidate, known=False))
    assert left_beside(base, pool, [curve]).tolist() == [0.0]


def test_the_more_is_left_the_less_a_name_is_likely():
    left, alone = np.array([0.0, 0.5, 2.0]), np.zeros(3, bool)
    chance = as_named(left, alone)
    assert chance[0] == pytest.approx(1 / (1 + np.exp(-NAMED_EVEN)))
    assert chance[2] == pytest.approx(1 / (1 + np.exp(NAMED_SLOPE * np.log(3.0) - NAMED_EVEN)))
    assert (np.diff(chance) < 0).all()
    # what all aircraft have is not held against others
    assert as_named(left, ~alone).tolist() == [chance[0], chance[1], 0.5]
