"""The diagnosis of toy archives: what is there is named, placed and closed, and nothing else."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.closure.not_seen import hidden_interval
from airswing.gap.design.candidates import candidates
from airswing.gap.diagnose import diagnose
from airswing.gap.effects import CATALOGUE
from airswing.gap.held_out.gradient_reliability import path_derivative
from airswing.gap.held_out.reduction import take_off
from airswing.gap.passes import Search, run_pass
from airswing.gap.scatter.coded_values import coarsest, lattice_share
from airswing.gap.search.candidate_ranking import Ranking
from airswing.gap.search.cross_validated import settle
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive
from airswing.products.whole_files import plain

SMALL = {
    n: CATALOGUE[n]
    for n in ("compass_offset", "hard_iron", "soft_iron", "compass_step", "tas_scale")
}


@pytest.fixture(scope="module")
def quiet():
    return make_frame(seed=5, aircraft=6, days=12, noise=0.3)


@pytest.fixture(scope="module")
def struck():
    def error(context):
        own = np.isin(context["aircraft"], [1, 4])
        return np.where(own, np.radians(1.5) * np.sin(context["magnetic_heading"] + 0.7), 0.0)

    frame = make_frame(seed=5, aircraft=6, days=12, noise=0.3, heading_error=error)
    return frame, diagnose(frame, catalogue=SMALL)


def test_nothing_is_named_where_nothing_is(quiet):
    report = diagnose(quiet, catalogue=SMALL).report
    assert report.effects == []
    assert not report.unknown.present
    assert report.closure.before == report.closure.after


def test_one_day_bounds_no_closure():
    closure = diagnose(make_frame(seed=5, aircraft=5, days=1), catalogue=SMALL).report.closure
    assert closure.ci is None and closure.reduction_ci is None
    assert closure.before == closure.after


def one_day(error):
    frame = make_frame(seed=5, aircraft=6, days=1, noise=0.3, heading_error=error)
    return frame, diagnose(frame, catalogue=SMALL, dictionary=False).report


def test_what_one_aircraft_shows_on_all_parts_of_a_day_has_its_name():
    frame, report = one_day(lambda c: np.where(c["aircraft"] == 2, np.radians(4.0), 0.0))
    (effect,) = report.effects
    assert (effect.name, effect.tails) == ("compass_offset", [frame.tails[2]])
    assert effect.parameters["offset_deg"] == pytest.approx(4.0, abs=0.3)
    low, high = report.closure.reduction_ci
    assert 0 < low < report.closure.reduction < high


def test_what_all_aircraft_share_on_one_day_is_told_as_unconfirmed():
    _, report = one_day(lambda c: np.full(c["aircraft"].shape, np.radians(4.0)))
    assert report.effects == []
    (doubtful,) = report.unconfirmed
    assert doubtful.name == "compass_offset" and "may be their weather" in doubtful.reason


def test_no_unknown_is_raised_on_a_single_day():
    frame = make_frame(
        seed=5,
        aircraft=6,
        days=1,
        noise=0.3,
        heading_error=lambda c: np.radians(4.0) * (c["airspeed"] - 130.0) / 10.0,
    )
    report = diagnose(frame, catalogue=SMALL).report
    assert not report.unknown.present and report.effects == []


def test_silence_excludes_a_small_loss_as_little_as_a_gain(quiet, monkeypatch):
    both = np.tile([-0.05, 0.08], 150)  # m/s
    monkeypatch.setattr("airswing.gap.closure.interval.left_over", lambda *_, **__: both)
    made = diagnose(quiet, catalogue=SMALL, dictionary=False)
    closure = made.report.closure
    unseen = np.array(hidden_interval(closure.before, quiet.size))
    np.testing.assert_allclose(closure.reduction_ci, np.array([-0.05, 0.08]) * 3600 / 1852 + unseen)


def test_one_cycle_on_two_aircraft(struck, quiet):
    frame, made = struck
    report = made.report
    (effect,) = report.effects
    assert effect.name == "hard_iron"
    assert effect.tails == [frame.tails[1], frame.tails[4]]
    assert effect.probability > 0.95
    for tail in effect.tails:
        values = effect.per_tail[tail].parameters
        errors = effect.per_tail[tail].standard_errors
        assert values["amplitude_deg"] == pytest.approx(1.5, abs=4 * errors["amplitude_deg"] + 0.05)
        assert values["phase_deg"] == pytest.approx(
            np.degrees(0.7), abs=4 * errors["phase_deg"] + 2
        )
    true = np.hypot(*quiet.residual.T).mean() / 0.514444
    assert report.closure.after == pytest.approx(true, abs=0.1)
    low, high = report.closure.ci
    assert low < report.closure.after < high < report.closure.before
    assert report.where[0].variable == "aircraft"
    assert not report.unknown.present


def test_products_are_complete_and_serialise(struck):
    frame, made = struck
    json.dumps(plain(made.report.content()), allow_nan=False)
    assert [w.label for w in made.report.waterfall][-1] == "noise floor"
    heading = made.dataset["heading_map"]
    assert heading.dims == ("aircraft", "octant")
    assert heading.sizes["aircraft"] == len(frame.tails)
    evidence = made.dataset["log_evidence"]
    assert set(evidence["effect"].values) == set(SMALL)
    assert evidence["effect"].values[0] == "hard_iron" and evidence.values[0] > 10
    own = made.dataset["aircraft_probability"].sel(effect="hard_iron").values
    assert own[[1, 4]].min() > 0.95 and own[[0, 2, 3, 5]].max() < 0.5
    strong = np.abs(heading / made.dataset["heading_map_standard_error"]).max("octant")
    assert set(strong.argsort().values[-2:]) == {1, 4}


def test_a_search_ends_alike_from_nothing_from_its_result_and_from_a_wrong_start(struck):
    frame, _ = struck
    search = Search(SMALL, Rules(), False, 0, lambda *_: None)
    first = run_pass(held_archive(frame), search)
    base = first.problem.base
    pool = candidates(base.stats.layout, SMALL, dictionary=False)
    (right,) = first.standing.found.terms
    wrong = replace(right, candidate=next(c for c in pool if c.name == "tas_scale"), tails=(0,))
    for start in ([right], [wrong]):
        (term,) = settle(Ranking(base, pool), Rules(), start).found.terms
        assert (term.key, term.tails) == (right.key, (1, 4))


def test_step_is_dated():
    day = 9

    def error(context):
        late = context["time"] > day * 86400
        return np.where((context["aircraft"] == 2) & late, np.radians(1.2), 0.0)

    frame = make_frame(seed=6, aircraft=6, days=16, noise=0.3, heading_error=error)
    report = diagnose(frame, catalogue=SMALL, dictionary=False).report
    effect = report.effects[0]
    assert effect.name == "compass_step"
    assert effect.tails == [frame.tails[2]]
    start = np.datetime64(effect.period[0])
    assert abs((start - (np.datetime64("1970-01-01") + day)).astype(int)) <= 1


def test_effect_outside_the_catalogue_is_unknown_and_placed_and_its_mean_told_with_it():
    def factor(context):
        height = np.log(9.5e4 / context["pressure"])
        return np.where(context["aircraft"] == 3, 1 + 0.03 * (height - 0.35), 1.0)

    frame = make_frame(seed=7, aircraft=5, days=14, noise=0.3, airspeed_factor=factor)
    report = diagnose(frame, catalogue=SMALL).report
    assert report.effects == []
    assert report.closure.reduction == 0.0
    assert report.unknown.present
    place = report.unknown.where[0]
    assert place.component in ("along_heading", "airspeed_factor")
    assert place.tails == [frame.tails[3]]
    assert {"altitude", "airspeed", "phase", "temperature"} & set(place.variables)
    assert place.closure.reduction > 0
    assert place.nearest_effect in ("tas_scale", "tas_offset")
    assert 0.1 < place.nearest_effect_share < 0.9
    assert place.held_out_energy > 2 * place.held_out_energy_standard_error


def test_exchanged_identifiers_are_found_and_given_back():
    def error(context):
        a = context["aircraft"]
        one = np.where(a == 0, np.radians(2.0) * np.sin(context["magnetic_heading"]), 0.0)
        return one + np.where(a == 2, np.radians(-1.2), 0.0)

    frame = make_frame(seed=8, aircraft=5, days=18, noise=0.3, heading_error=error)
    late = frame.time > 10 * 86400
    names = frame.aircraft.copy()
    names[(frame.aircraft == 0) & late], names[(frame.aircraft == 2) & late] = 2, 0
    order = np.lexsort((frame.time, names))
    swapped = replace(frame, aircraft=names).take(order)
    catalogue = SMALL | {"tail_swap": CATALOGUE["tail_swap"]}
    report = diagnose(swapped, catalogue=catalogue, dictionary=False).report
    found = {e.name: e for e in report.effects}
    assert found["tail_swap"].tails == [frame.tails[0], frame.tails[2]]
    assert found["tail_swap"].period[0] == "1970-01-11"
    assert found["hard_iron"].tails == [frame.tails[0]]
    assert found["compass_offset"].tails == [frame.tails[2]]


def test_missing_context_is_untestable_not_guessed(quiet):
    blind = replace(quiet, icing=np.full(quiet.size, -1), temperature=np.full(quiet.size, np.nan))
    catalogue = SMALL | {"heater_current": CATALOGUE["heater_current"]}
    made = diagnose(blind, catalogue=catalogue, dictionary=False)
    assert "icing" in made.report.untestable["heater_current"]


def test_too_few_reports_are_refused(quiet):
    with pytest.raises(InputError, match="too few reports"):
        diagnose(quiet.take(np.arange(20)))


def test_taking_off_a_large_heading_error_is_exact(quiet):
    turn = np.radians(12.0)
    right = np.stack([np.cos(quiet.heading), -np.sin(quiet.heading)], -1)
    linear = -quiet.airspeed[:, None] * turn * right
    out = take_off(quiet, linear, np.zeros_like(linear))
    true = quiet.airspeed[:, None] * np.stack(
        [np.sin(quiet.heading - turn), np.cos(quiet.heading - turn)], -1
    )
    wind = np.stack([quiet.ground_u, quiet.ground_v], -1) - true
    np.testing.assert_allclose(out, wind - np.stack([quiet.u_ref, quiet.v_ref], -1), atol=1e-9)


def test_lattices():
    rng = np.random.default_rng(0)
    whole = np.round(rng.uniform(0, 80, 4000))
    assert abs(lattice_share(whole, 5.0, base=1.0)) < 0.04
    assert coarsest(whole, (2.0, 5.0, 10.0), base=1.0) == (1.0, 1.0)
    coarse = 5.0 * np.round(whole / 5.0)
    assert coarsest(coarse, (2.0, 5.0, 10.0), base=1.0)[0] == 5.0
    half = np.where(rng.random(4000) < 0.5, coarse, whole)
    step, share = coarsest(half, (2.0, 5.0, 10.0), base=1.0)
    assert step == 5.0
    assert share == pytest.approx(0.5, abs=0.06)


def test_path_derivative_by_hand():
    values = np.array([[0.0, 1.0], [1.0, 1.0], [4.0, 1.0], [9.0, 1.0]])
    out = path_derivative(values, np.array([0.0, 1.0, 2.0, 3.0]), np.array([1, 1, 1, 2]))
    np.testing.assert_allclose(out[1], [2.0, 0.0])
    assert np.isnan(out[[0, 2, 3]]).all()


def test_checks_come_with_the_diagnosis(struck):
    frame, made = struck
    assert len(made.report.assumptions) >= 6
    assert made.report.decoy.closes_nothing
    after, before = (made.report.calibration.after, made.report.calibration.before)
    assert after.crps_m_s < before.crps_m_s
    assert int(made.dataset["pit_count"].sum()) <= 2 * frame.size
    assert made.adjustment.names == ()
    assert not made.adjustment.reported.any()
