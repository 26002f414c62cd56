"""Claims are held against days they were not fitted on; effects are as few as explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, t
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import candidates
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import fleet_allowance
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.belief import features, probabilities
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.confirmation import (
    BLOCK,
    PARTS,
    Confirmation,
    _persistent,
    blocks_of_days,
    confirm,
    confirm_lasting,
)
from airswing.gap.search.cross_validated import _believed
from airswing.gap.search.fewest import fewest, worth
from airswing.gap.search.stepwise import Rules, _prune, found_of
from airswing.gap.search.tail_swaps import NEEDED, beside
from airswing.gap.sums.whole_archive import held_archive

SMALL = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "tas_scale")}


@pytest.fixture(scope="module")
def late():
    """An archive whose third aircraft is 1.5 degrees off on its last five days: base, pool, term"""

    def swung(context):
        here = (context["aircraft"] == 2) & (context["time"] > 15 * 86400)
        return np.where(here, np.radians(1.5), 0.0)

    frame = make_frame(seed=4, aircraft=6, days=20, noise=0.3, heading_error=swung)
    search = Search(SMALL, Rules(), False, 0, lambda *_: None)
    made = run_pass(held_archive(frame), search)
    base = made.problem.base
    pool = candidates(base.stats.layout, SMALL, dictionary=False)
    (term,) = made.standing.found.terms
    return base, pool, term


def test_deviations_are_those_of_student():
    tests = Confirmation(
        *np.zeros((2, 3)), np.array([3.0, -1.0, 5.0]), np.ones(3), np.array([5, 7, 2])
    )
    expected = [norm.isf(t.sf(3.0, 4)), norm.isf(t.sf(-1.0, 6)), 0.0]
    np.testing.assert_allclose(tests.deviations, expected, rtol=1e-6)
    assert tests.tested.tolist() == [True, True, False]


def test_a_change_in_the_last_week_is_confirmed_on_days_left_out(late):
    base, _, term = late
    assert (term.candidate.name, term.tails) == ("compass_step", (2,))
    assert term.period == (15, base.stats.days.size)
    tests = confirm(base, [term])
    assert tests.parts[0] >= 3
    assert tests.multiple[0] == pytest.approx(1.0, abs=0.15)
    assert tests.deviations[0] > 2.5
    assert probabilities(features([term], tests), tests)[0] > 0.95


def test_what_lasts_is_judged_on_blocks_of_days_and_with_what_persists(late):
    """Sixths of an archive of few weeks, three days of a longer one; errors by hand."""
    base, pool, term = late
    offset = next(c for c in pool if c.key == ("compass_offset", "aircraft", (0,)))
    lasting = replace(term, candidate=offset, period=None)
    assert confirm_lasting(base, [lasting]).parts[0] == PARTS
    long = replace(base.stats, weeks=np.arange(7), days=np.r_[np.arange(10), 20 + np.arange(10)])
    score = replace(lasting.score, size=np.full(6, 0.4), acting=np.full(6, 50.0), background=0.06)
    two = replace(lasting, tails=(1, 2), score=score)
    assert _persistent(base, two) == pytest.approx(0.06 / 0.4 / np.sqrt(2))
    fleet = next(c for c in pool if c.key == ("compass_offset", "fleet", (0,)))
    every = replace(two, candidate=fleet, tails=tuple(range(6)))
    assert _persistent(base, every) == pytest.approx(fleet_allowance(base, fleet.columns) / 0.4)
    sure = replace(two, score=replace(score, background=0.0))
    less, more = (confirm_lasting(base, [one]).doubt[0] for one in (sure, two))
    assert more**2 - less**2 == pytest.approx(_persistent(base, two) ** 2, rel=1e-6)
    assert blocks_of_days(long).max() + 1 == 20 // BLOCK


def test_a_change_that_is_none_is_not_confirmed(late):
    base, _, term = late
    for tail, period in ((0, (3, 8)), (4, (10, 14))):
        wrong = replace(term, tails=(tail,), period=period)
        tests = confirm(base, [term, wrong])
        assert tests.deviations[1] < 2.0 < tests.deviations[0]
        assert probabilities(features([term, wrong], tests), tests)[1] < 0.9


def test_what_is_in_force_on_two_days_cannot_be_tested_and_is_not_found(late):
    base, pool, term = late
    short = replace(term, tails=(1,), period=(6, 8))
    tests = confirm(base, [term, short])
    assert tests.tested.tolist() == [True, False]
    ranking = Ranking(base, pool)
    standing = _believed(ranking, found_of(ranking, [term, short]), Rules())
    assert [x.tails for x in standing.found.terms] == [(2,)]
    (doubtful,) = standing.doubtful
    assert doubtful.term.tails == (1,) and doubtful.probability == 0.0
    assert "too few days" in doubtful.reason


def test_what_the_other_terms_leave_nothing_for_goes(late):
    base, pool, term = late
    other = replace(term, tails=(5,), period=(14, base.stats.days.size))
    nothing = replace(term, tails=(0,), period=(2, 9))
    kept = _prune(base, Ranking(base, pool), [term, other, nothing], Rules())
    assert [(x.tails, x.period) for x in kept] == [((2,), (15, base.stats.days.size))]


def test_changes_of_two_aircraft_join_on_one_date():
    def swung(context):
        here = np.isin(context["aircraft"], (1, 3)) & (context["time"] > 9 * 86400)
        return np.where(here, np.radians(1.2), 0.0)

    frame = make_frame(seed=8, aircraft=6, days=20, noise=0.3, heading_error=swung)
    search = Search(SMALL, Rules(), False, 0, lambda *_: None)
    made = run_pass(held_archive(frame), search)
    base, (term,) = made.problem.base, made.standing.found.terms
    pool = candidates(base.stats.layout, SMALL, dictionary=False)
    end = base.stats.days.size
    apart = [replace(term, tails=(1,), period=(9, end)), replace(term, tails=(3,), period=(8, end))]
    (joined,) = fewest(base, pool, apart)
    assert (joined.tails, joined.period) == ((1, 3), (9, end))
    one, two = worth(base, [joined]), worth(base, apart)
    assert one.explained + one.fixed > two.explained + two.fixed


def test_a_step_told_as_a_drift_joins_the_step_and_a_drift_stays_one():
    def swung(context):
        day = context["time"] / 86400
        stepped = np.where((context["aircraft"] == 3) | (context["aircraft"] == 1), day > 9, 0)
        return np.radians(1.2 * stepped + np.where(context["aircraft"] == 5, 0.1 * day, 0.0))

    frame = make_frame(seed=8, aircraft=6, days=20, noise=0.3, heading_error=swung)
    effects = SMALL | {"compass_drift": CATALOGUE["compass_drift"]}
    made = run_pass(held_archive(frame), Search(effects, Rules(), False, 0, lambda *_: None))
    base = made.problem.base
    pool = candidates(base.stats.layout, effects, dictionary=False)
    own = {term.candidate.name: term for term in made.standing.found.terms}
    step, drift = own["compass_step"], own["compass_drift"]
    assert (step.tails, drift.tails) == ((1, 3), (5,))
    mixed = [replace(drift, tails=(3, 5)), replace(step, tails=(1,))]
    told = {term.candidate.name: term.tails for term in fewest(base, pool, mixed)}
    assert told == {"compass_step": (1, 3), "compass_drift": (5,)}
    (one,) = fewest(base, pool, [replace(drift, tails=(3,)), replace(step, tails=(1,))])
    assert (one.candidate.name, one.tails, one.period) == ("compass_step", (1, 3), step.period)


def test_what_has_no_name_makes_a_claim_less_likely(late):
    _, _, term = late
    score = replace(term.score, tempered=20.0)
    claim = replace(term, score=score)
    unknown = replace(
        term,
        period=None,
        candidate=replace(term.candidate, known=False),
        score=replace(term.score, tempered=400.0),
    )
    tests = Confirmation(*np.ones((2, 2)), np.array([1.0, 1.0]), np.full(2, 0.3), np.full(2, 6))
    one = Confirmation(*np.ones((2, 1)), np.ones(1), np.full(1, 0.3), np.full(1, 6))
    alone = probabilities(features([claim], one), one)[0]
    besides = probabilities(features([claim, unknown], tests), tests)[0]
    assert besides < alone
    np.testing.assert_allclose(features([claim, unknown], tests)[0, 2], np.log1p(20.0))


def test_an_exchange_is_looked_for_beside_what_marks_no_airframe(late):
    _, _, term = late
    unknown = replace(
        term,
        period=None,
        candidate=replace(term.candidate, known=False, name="cross:phase"),
        score=replace(term.score, tempered=200.0),
    )
    kept, needed = beside([term, unknown])
    assert kept == [unknown]
    assert needed == pytest.approx(NEEDED + 10.0)


def test_a_large_effect_does_not_price_out_a_small_one():
    """What an exchange changes is tempered by its own factor, not by a mean that moves with it."""
    frame = make_frame(
        seed=8,
        aircraft=5,
        days=14,
        noise=0.3,
        heading_error=lambda c: (
            np.radians(5.0) * np.sin(c["magnetic_heading"])
            + np.where(c["aircraft"] == 2, np.radians(1.2) * np.sin(2 * c["magnetic_heading"]), 0.0)
        ),
    )
    small = {name: CATALOGUE[name] for name in ("hard_iron", "soft_iron", "compass_offset")}
    effects = diagnose(frame, catalogue=small, dictionary=False).report.effects
    found = {effect.name: effect.tails for effect in effects}
    assert len(found["hard_iron"]) == 5
    assert found["soft_iron"] == [frame.tails[2]]
