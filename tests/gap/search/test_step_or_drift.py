"""What changes in time is told as it goes, with the odds that it goes so."""

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import candidates
from airswing.gap.diagnose import diagnose, usable_effects
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.of_candidate import evaluate
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.candidate_ranking import evaluate_named
from airswing.gap.search.step_or_drift import as_it_goes
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive

CHANGING = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "compass_drift")}

KINDS = ("drift", "step", "offset")


def drifting(context):
    days = (context["time"] - context["time"].min()) / 86400
    return np.where(context["aircraft"] < 3, np.radians(0.02) * days, 0.0)


def stepping(context):
    late = context["time"] - context["time"].min() > 14.5 * 86400
    return np.where((context["aircraft"] < 3) & late, np.radians(0.3), 0.0)


def fleet(seed, error):
    return make_frame(seed=seed, aircraft=9, days=30, noise=1.0, heading_error=error)


def test_three_that_drift_a_little_are_told_as_they_go():
    made = diagnose(fleet(0, drifting), catalogue=CHANGING, dictionary=False).report.effects
    assert [(e.name, e.tails) for e in made] == [("compass_drift", ["N400", "N401", "N402"])]


def test_how_it_goes_is_a_part_of_its_probability():
    """Of this archive's draw a drift explains the step nearly as well: two to one."""
    report = diagnose(fleet(2, stepping), catalogue=CHANGING, dictionary=False).report
    (effect,) = report.effects
    assert effect.name == "compass_step"
    assert 0.5 < effect.probability < 0.9


@pytest.fixture(scope="module")
def summed():
    """Sums of an archive in which three compasses drift, and its candidates of single aircraft."""
    archive = held_archive(fleet(0, drifting))
    effects, _ = usable_effects(archive.view, CHANGING)
    made = run_pass(archive, Search(effects, Rules(), False, 0, lambda *a: None))
    base = made.problem.base
    pool = candidates(base.stats.layout, effects, dictionary=False)
    return base, [c for c in pool if c.scope == "aircraft"]


def term_of(base, candidate, tails):
    allowed = np.isin(np.arange(len(base.stats.tails)), tails)
    given = given_terms(base, [])
    score = evaluate_named(base, given, candidate, allowed, None)
    return Term(candidate, tails, score.period, score)


def test_the_odds_of_the_two_add_up_to_one_and_what_lasts_is_not_asked(summed):
    base, pool = summed
    own = {c.name: c for c in pool if c.subset == (0,)}
    drift, step, offset = (term_of(base, own[f"compass_{x}"], (0, 1, 2)) for x in KINDS)
    only = [c for c in pool if c.subset == (0,)]
    chances = [float(as_it_goes(base, only, [term])[0]) for term in (drift, step, offset)]
    assert chances[0] > 0.99
    assert chances[0] + chances[1] == pytest.approx(1.0, abs=1e-6)
    assert chances[2] == 1.0


def test_a_drift_is_held_against_a_step_that_the_catalogue_lacks(summed):
    base, pool = summed
    own = {c.name: c for c in pool if c.subset == (0,)}
    drift = term_of(base, own["compass_drift"], (0, 1, 2))
    without = [c for c in pool if c.name != "compass_step"]
    only = [c for c in pool if c.subset == (0,)]
    alone, beside = (as_it_goes(base, some, [drift])[0] for some in (without, only))
    assert alone == pytest.approx(beside)
    assert evaluate(base.stats, given_terms(base, []), drift.candidate).raw > 0.0
