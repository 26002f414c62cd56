"""An offset is no drift, a drift is; what the day fields take up is said to be untestable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.design.candidates import Candidate, candidates
from airswing.gap.diagnose import diagnose, usable_effects
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.gaussian import Score
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.passes import Search, run_pass
from airswing.gap.result.describe import ambiguity
from airswing.gap.search.candidate_ranking import _one_of_many, rank, remainder
from airswing.gap.search.stepwise import Rules, _stays, choose, struck
from airswing.gap.sums.whole_archive import held_archive

DRIFTING = {n: CATALOGUE[n] for n in ("compass_offset", "compass_drift")}


def found(error, catalogue):
    def own(context):
        return np.where(context["aircraft"] == 2, error(context), 0.0)

    frame = make_frame(seed=3, aircraft=5, days=16, noise=0.3, heading_error=own)
    made = diagnose(frame, catalogue=catalogue, dictionary=False)
    return [(e.name, e.tails) for e in made.report.effects], frame.tails[2]


def test_a_lasting_offset_is_not_named_a_drift():
    named, tail = found(lambda c: np.radians(1.0), DRIFTING)
    assert named == [("compass_offset", [tail])]


def test_a_drift_is_named():
    named, tail = found(lambda c: np.radians(0.2) * (c["time"] - c["time"].min()) / 86400, DRIFTING)
    assert named == [("compass_drift", [tail])]


def test_a_drift_beside_what_all_aircraft_have_is_no_step():
    """What lasts of all aircraft scatters in sums that grow in time, not in those of a step."""

    def error(context):
        rate = np.where(context["aircraft"] == 2, np.radians(0.06), 0.0)
        return np.radians(0.8) + rate * (context["time"] - context["time"].min()) / 86400

    catalogue = DRIFTING | {"compass_step": CATALOGUE["compass_step"]}
    frame = make_frame(seed=4, aircraft=6, days=24, noise=0.4, heading_error=error)
    made = diagnose(frame, catalogue=catalogue, dictionary=False).report.effects
    named = {e.name: e.tails for e in made}
    assert named == {"compass_offset": list(frame.tails), "compass_drift": [frame.tails[2]]}


def test_a_little_that_the_whole_fleet_has_is_named():
    """0.1 degrees of all, 0.2 m/s: under what a single aircraft may have of its own."""
    frame = make_frame(
        seed=3,
        aircraft=6,
        days=16,
        noise=0.3,
        model_error=0.5,
        heading_error=lambda c: np.full(c["aircraft"].size, np.radians(0.1)),
    )
    report = diagnose(frame, catalogue=DRIFTING, dictionary=False).report
    (effect,) = report.effects
    assert effect.name == "compass_offset"
    assert effect.parameters["offset_deg"] == pytest.approx(0.1, abs=0.02)


def test_what_some_aircraft_leave_is_met_by_the_fleet_in_their_share():
    rules = Rules()
    some = np.array([0.4, 0.0])
    whole = Candidate("declination_error", np.array([0]), "fleet", np.ones(1), True)
    alike = replace(score("declination_error", True, 9.0, 0.25), candidate=whole)
    assert struck(replace(alike, remainder=some), rules).size == 2  # the mean, 0.2: 0.22 in all
    assert struck(replace(alike, remainder=some + 0.1), rules).size == 0


def temperature(pressure):
    return 288.15 * (pressure / 101325.0) ** 0.19


def heaters(*errors):
    """Evidence of a heater between -10 and 0 degC on the one aircraft with errors below edges."""

    def own(context):
        cold = [temperature(context["pressure"]) < edge + 273.15 for edge, _ in errors]
        sizes = [np.radians(size) for _, size in errors]
        return np.where(context["aircraft"] == 2, np.transpose(cold) @ sizes, 0.0)

    frame = make_frame(seed=3, aircraft=5, days=16, noise=0.3, heading_error=own)
    frame = replace(frame, temperature=temperature(frame.pressure))
    effects = {"heater_current": CATALOGUE["heater_current"]}
    search = Search(effects, Rules(most_terms=0), False, 0, lambda stage, done: None)
    base = run_pass(held_archive(frame), search).problem.base
    pool = candidates(base.stats.layout, effects, dictionary=False)
    ranked = rank(base, given_terms(base, []), pool, {})
    return next(s for s in ranked if s.candidate.key == ("heater_current", "aircraft", (6, 12)))


def test_a_heater_between_two_temperatures_is_off_below_the_colder_one():
    band, other = heaters((0, 1.0), (-10, -1.0)), heaters((0, 0.7), (-10, 0.7))
    assert band.candidate.free == 1
    assert band.tempered > 10.0
    assert other.tempered < 0.0
    np.testing.assert_allclose(np.degrees(band.estimate[2]), [1.0, -1.0], atol=0.2)
    assert band.size[2] == pytest.approx(np.radians(1.0) * 130, rel=0.3)  # where it acts


def test_a_form_is_weighed_as_one_of_the_many_that_were_looked_at():
    def form(name, columns, evidence, kind="mean"):
        one = score(name, True, evidence, 0.4)
        held = np.array(columns)
        what = replace(one.candidate, columns=held, subset=tuple(columns), kind=kind)
        return replace(one, candidate=what)

    scores = [form("heater_current", c, e) for c, e in (((0,), 9.0), ((3,), 8.0), ((3, 6), 2.0))]
    scores += [form("compass_step", c, 5.0, "step") for c in ((1,), (1, 2))]
    out = [s.tempered for s in _one_of_many(scores)]
    both = np.log((np.exp(8.0) + np.exp(2.0)) / 2)
    np.testing.assert_allclose(out, [9.0, both, both - 6.0, 5.0, 5.0])


def score(name, known, tempered, size):
    one = np.ones(2)
    what = Candidate(name, np.array([0]), "aircraft", np.ones(1), known)
    return Score(what, tempered, tempered, 1.0, one, tempered * one, one[:, None], size * one, one)


def test_an_unknown_must_beat_effects_too_small_to_be_stated():
    rules = Rules(size=0.2, unknown_margin=3.0)
    small, group = score("heater_current", True, 8.0, 0.1), score("cross:icing", False, 9.0, 0.4)
    assert choose([group, small], rules) is None
    clear = score("cross:icing", False, 12.0, 0.4)
    assert choose([clear, small], rules) is clear


def test_an_unknown_stays_where_it_explains_clearly_more():
    rules, column = Rules(), np.array([0])
    term = Term(
        Candidate("along:altitude", column, "aircraft", np.ones(1), False), (0,), None, None
    )
    group = replace(score("along:altitude", False, 30.0, 0.5), raw=50.0)
    weaker, better = (replace(score("tas_scale", True, 31.0, 0.5), raw=raw) for raw in (40.0, 48.0))
    assert _stays([group, weaker], term, weaker, rules)
    assert not _stays([group, better], term, better, rules)


def test_a_step_of_the_whole_fleet_is_no_doubt_about_itself():
    """Days before and after a step scatter about any mean; the step takes that off first."""

    def swung(context):
        return np.where(context["time"] > 9.5 * 86400, np.radians(0.8), 0.0)

    frame = make_frame(seed=5, aircraft=5, days=20, noise=0.3, heading_error=swung)
    catalogue = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "compass_drift")}
    made = diagnose(frame, catalogue=catalogue, dictionary=False).report.effects
    assert [(e.name, e.tails) for e in made] == [("compass_step", list(frame.tails))]


def test_what_the_catalogue_lacks_is_placed_by_the_simplest_group():
    def two_cycles(context):
        own = np.radians(0.9) * np.sin(2 * context["magnetic_heading"])
        return np.where(context["aircraft"] == 1, own, 0.0)

    frame = make_frame(seed=6, aircraft=5, days=10, noise=0.3, heading_error=two_cycles)
    catalogue = {n: CATALOGUE[n] for n in ("compass_offset", "hard_iron")}
    report = diagnose(frame, catalogue=catalogue).report
    place = report.unknown.where[0]
    assert report.effects == []
    assert place.group == "cross:magnetic_heading 2 cycles"
    assert place.tails == [frame.tails[1]]


def test_a_rival_explains_what_the_term_explains():
    """What a candidate explains beside the term makes it no other name for it."""
    term = Term(
        Candidate("compass_step", np.array([0]), "aircraft", np.ones(1), True),
        (0,),
        None,
        score("compass_step", True, 20.0, 0.5),
    )
    alike, beside = score("compass_drift", True, 19.0, 0.5), score("turn_error", True, 25.0, 0.1)
    ranked = [beside, score("compass_step", True, 20.0, 0.5), alike]
    left = [score("turn_error", True, 24.0, 0.1), score("compass_drift", True, 0.5, 0.1)]
    (rival,) = ambiguity(term, ranked, left)
    assert rival.name == "compass_drift"
    assert rival.difference_nats == 1.5


def test_together_aircraft_tell_a_drift_that_none_tells_alone():
    def drifting(context):
        days = (context["time"] - context["time"].min()) / 86400
        return np.where(context["aircraft"] < 4, np.radians(0.03) * days, 0.0)

    frame = make_frame(seed=8, aircraft=8, days=20, noise=1.0, heading_error=drifting)
    made = diagnose(frame, catalogue=DRIFTING, dictionary=False).report.effects
    assert [(e.name, e.tails) for e in made] == [("compass_drift", list(frame.tails[:4]))]


def test_aircraft_that_change_together_are_dated_together():
    def swung(context):
        late = (context["aircraft"] < 4) & (context["time"] > 9.5 * 86400)
        return np.where(late, np.radians(0.3), 0.0)

    catalogue = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "compass_drift")}
    frame = make_frame(seed=8, aircraft=8, days=20, noise=1.0, heading_error=swung)
    made = diagnose(frame, catalogue=catalogue, dictionary=False).report.effects
    assert [(e.name, e.tails) for e in made] == [("compass_step", list(frame.tails[:4]))]


def test_what_inferred_columns_cannot_carry_is_nothing_else():
    """Of 1.6 m/s of which 76 % are told 0.9 stay; thinned out over four times the reports 0.45."""
    rules, reports = Rules(size=0.2, unknown_margin=3.0), np.array([100.0, 100.0])
    large = replace(score("acceleration_error", True, 40.0, 1.6), acting=reports)
    what = replace(large.candidate, told_share=0.76, heading=True)
    term = Term(what, (1,), None, large)

    def left(name, known, acting, **kind):
        made = replace(score(name, known, 30.0, 0.4), acting=acting)
        made = replace(made, candidate=replace(made.candidate, **kind))
        return replace(made, remainder=remainder([term], made))

    group = left("cross:phase*heading", False, reports, heading=True)
    np.testing.assert_allclose(group.remainder, [0.0, 1.6 * np.sqrt(0.24 / 0.76)])
    np.testing.assert_array_equal(struck(group, rules), [0])
    iron = left("soft_iron", True, 4 * reports, heading=True)
    np.testing.assert_allclose(iron.remainder, [0.0, 0.8 * np.sqrt(0.24 / 0.76)])
    speed = left("tas_scale", True, 4 * reports)
    np.testing.assert_array_equal(struck(speed, rules), [0, 1])


def test_what_a_gradient_leaves_of_the_models_error_sets_no_aircraft_apart():
    """A model hours late is met by all alike: asked of what all have, not of single compasses."""
    reports = np.array([100.0, 100.0])
    late = replace(score("reference_time_offset", True, 40.0, 0.5), acting=reports)
    what = replace(late.candidate, told_share=0.55, scope="fleet")
    term = Term(what, (0, 1), None, late)
    own = replace(score("compass_drift", True, 30.0, 0.4), acting=reports)
    own = replace(own, candidate=replace(own.candidate, heading=True))
    np.testing.assert_array_equal(remainder([term], own), [0.0, 0.0])
    shared = replace(own, candidate=replace(own.candidate, scope="fleet"))
    assert (remainder([term], shared) > 0.4).all()


def test_an_error_of_no_name_is_one_curve_and_not_a_dozen():
    """One aircraft's drift has the wrong sign: what a curve of it leaves (15 m/s) is no effect."""

    def mirrored(context):
        heading, (u, v) = context["heading"], context["wind"].T
        drift = np.arcsin((u * np.cos(heading) - v * np.sin(heading)) / context["airspeed"])
        return np.where(context["aircraft"] == 0, 2 * drift, 0.0)

    archive = held_archive(make_frame(seed=8, aircraft=4, days=12, heading_error=mirrored))
    catalogue = {name: CATALOGUE[name] for name in ("compass_offset", "tas_scale")}
    effects, _ = usable_effects(archive.view, catalogue)
    search = Search(effects, Rules(), dictionary=True, seed=0, tell=lambda stage, done: None)
    terms = run_pass(archive, search).standing.found.terms
    assert max(terms, key=lambda term: term.score.raw).candidate.component == "cross"
    assert len(terms) <= 3
    assert not any(term.candidate.known for term in terms)
