"""Kernels of the gap's model against hand-worked numbers; the exact fit has the size put in."""

from __future__ import annotations

from dataclasses import replace
from math import comb

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.effects import CATALOGUE
from airswing.gap.model.candidates import Curve, Group, Table, curve_of, unit_size
from airswing.gap.model.closure import day_interval
from airswing.gap.model.evidence import common_variance, static_evidence
from airswing.gap.model.localisation import knots_in_words, score_test
from airswing.gap.model.passes import prepared
from airswing.gap.model.refit import without_errors
from airswing.gap.model.terms import Statistics, Term, noise_factor, number_prior
from airswing.gap.result.schema import CurveEntry
from airswing.gap.result.statement import claims_of, probability, shape_in_words


def statistics(estimate, information, *, fleet_share=1.0, fleet_factor=1.0):
    """Statistics of one coefficient an aircraft from its estimates and information."""
    estimate = np.asarray(estimate, float)
    gram = np.full((estimate.size, 1, 1), float(information))
    fleet = fleet_share * gram.sum(0)
    ridge = np.full((1, 1), 1e-12)
    factor = np.ones(estimate.size)
    score = gram[:, :, 0] * estimate[:, None]
    inverse = np.linalg.inv(fleet)
    return Statistics(score, gram, fleet, ridge, inverse, factor, fleet_factor, 0.1**2, 0.0)


def test_a_candidate_is_scaled_to_a_metre_a_second_where_it_acts():
    columns = np.zeros((700, 2, 1), np.float32)
    columns[:350, 0, 0] = 4.0
    (scale,) = unit_size(columns, np.eye(1)).ravel()
    assert scale == pytest.approx(0.25)
    assert unit_size(np.zeros((70, 2, 1), np.float32), np.eye(1)) is None


def test_hat_functions_sum_to_one_and_are_zero_where_unknown():
    values = np.linspace(-60.0, 20.0, 400)
    curve = curve_of("temperature", values)
    made = curve.functions(np.r_[values, np.nan])
    np.testing.assert_allclose(made[:-1].sum(1), 1.0)
    assert not made[-1].any()
    around = Curve("track", np.arange(12) * 30.0).functions(np.array([0.0, 15.0, 345.0, 359.9]))
    np.testing.assert_allclose(around.sum(1), 1.0)
    assert around[2, 0] == pytest.approx(0.5) and around[2, 11] == pytest.approx(0.5)


def test_the_prior_of_sets_of_aircraft_sums_to_one():
    for aircraft in (1, 5, 14):
        prior = np.exp(number_prior(aircraft))
        total = sum(comb(aircraft, k) * p for k, p in enumerate(prior))
        assert total == pytest.approx(1.0)


def test_one_aircraft_of_eight_is_the_one_affected():
    estimate = np.zeros(8)
    estimate[3] = 0.8
    found = static_evidence(statistics(estimate, 400.0), 1.0, "af")
    assert found["a"].tails == (3,)
    assert found["a"].evidence > found["f"].evidence + 10
    # 0.8 m/s at a variance of 1 / 400 + 0.06^2 is 52 nats, less what scales and sets cost
    assert 35 < found["a"].evidence < 52


def test_an_error_of_all_aircraft_is_the_fleets():
    found = static_evidence(statistics(np.full(8, 0.9), 400.0), 1.0, "af")
    assert found["f"].evidence > found["a"].evidence


def test_what_lasts_in_the_reference_is_no_effect():
    """0.1 m/s on all aircraft is usual whatever the number of reports."""
    found = static_evidence(statistics(np.full(8, 0.1), 1e6), 1.0, "af")
    assert found["f"].evidence < 0


def test_what_inexact_columns_of_a_term_leave_is_no_effect():
    """The remainder of an effect of 1 m/s with columns of reliability 0.8 has 0.5 m/s rms."""
    estimate = np.zeros(8)
    estimate[3] = 0.5
    exact = statistics(estimate, 400.0)
    left = replace(exact, remainder=np.where(np.arange(8) == 3, 0.25, 0.0))
    assert static_evidence(exact, 1.0, "a")["a"].tails == (3,)
    assert static_evidence(left, 1.0, "a")["a"].tails == ()


def test_what_the_day_fields_absorb_is_given_back():
    """Day fields that absorb three quarters of the fleet's information leave its estimate alone."""
    whole = statistics(np.full(8, 0.9), 400.0)
    absorbed = replace(
        whole,
        score=whole.score / 4,
        fleet_information=whole.fleet_information / 4,
        fleet_inverse=whole.fleet_inverse * 4,
    )
    given_back = common_variance(absorbed)[1]
    np.testing.assert_allclose(given_back, 3.0 / 3200.0)
    restored = absorbed.score + absorbed.information @ (given_back @ absorbed.score.sum(0))
    np.testing.assert_allclose(restored, whole.score)


def test_the_noise_factor_of_independent_errors_is_one():
    rng = np.random.default_rng(3)
    factors = []
    for _ in range(60):
        rows = rng.normal(size=(4, 20, 30, 3))
        score = np.einsum("adnm,adn->adm", rows, rng.normal(size=(4, 20, 30)))
        gram = np.einsum("adnm,adnk->admk", rows, rows)
        factors.append(noise_factor(score, gram).factor.mean())
    # the larger of blocks of one and of four days
    assert np.mean(factors) == pytest.approx(1.15, abs=0.15)


def test_days_with_errors_of_their_own_raise_the_noise_factor():
    rng = np.random.default_rng(4)
    rows = rng.normal(1.0, 0.2, size=(4, 40, 30, 1))
    error = rng.normal(size=(4, 40, 30)) + rng.normal(size=(4, 40, 1))
    score = np.einsum("adnm,adn->adm", rows, error)
    gram = np.einsum("adnm,adnk->admk", rows, rows)
    assert noise_factor(score, gram).factor.mean() > 10


def test_the_interval_over_days_covers():
    rng = np.random.default_rng(0)
    inside = 0
    for k in range(200):
        day = np.repeat(np.arange(20), 30)
        values = rng.normal(0.3, 1.0, 600) + rng.normal(0, 0.5, 20)[day]
        low, high = day_interval(values, day, k)
        inside += low < 0.3 < high
    assert 0.89 <= inside / 200 <= 0.98


def test_the_score_test_by_hand():
    p_value, estimate = score_test(np.diag([4.0, 1.0]), np.array([4.0, 0.0]), 1.0)
    assert p_value == pytest.approx(np.exp(-2.0))  # chi squared 4 of two degrees of freedom
    np.testing.assert_allclose(estimate, [1.0, 0.0])


def term(name, kind="name", scope="a", score=10.0, start=None):
    group = Group(name, kind, slice(0, 1), np.eye(1), "af", 0.0)
    return Term(group, scope, (0,), 1.0, start or {}, score, score)


def test_a_name_in_two_scopes_is_one_claim_and_a_dated_one_another():
    terms = [
        term("date|heading_angle", "table", score=90.0),
        term("tas_scale", scope="f", score=20.0),
        term("tas_scale", score=30.0),
        term("compass_drift", start={0: 4}),
        term("compass_drift"),
    ]
    found = claims_of(terms)
    assert [claim.terms for claim in found] == [(1, 2), (3,), (4,), (0,)]
    assert [claim.named for claim in found] == [True, True, True, False]
    assert found[0].score == 30.0


def test_the_probability_grows_with_the_evidence():
    values = [probability(gate) for gate in (3.0, 10.0, 30.0, 300.0)]
    assert values == sorted(values) and values[-1] > 0.9


def curve(values, name="temperature"):
    edges = np.linspace(-60.0, 20.0, len(values) + 1)
    values = [float(x) for x in values]
    return CurveEntry(
        [""] * len(values), values, "degree", [name], ["degC"], [[float(x) for x in edges]], values
    )


def test_shapes_in_words():
    x = np.linspace(-58.0, 18.0, 20)
    assert shape_in_words(curve(0.05 * x)) == "linear in temperature: +0.05 degree per degC"
    assert "a step of +2 degree at temperature -20" in shape_in_words(curve(2.0 * (x > -20)))
    assert "a bump of +3 degree near temperature" in shape_in_words(curve(3.0 * (abs(x) < 4)))
    assert shape_in_words(curve(np.sin(x / 6.0))) is None


def test_slices_are_labelled_by_the_knots_of_their_variables():
    longitude = Curve("longitude", np.array([-90.1234, -84.0]))
    phase = Curve("phase", np.array([1.0, 2.0]))
    heading = Curve("magnetic_heading", np.zeros(1))
    pair = knots_in_words(Table((longitude, phase), "along_wind"))
    assert pair == ["-90.123; cruise", "-90.123; descent", "-84; cruise", "-84; descent"]
    cycles = knots_in_words(Table((heading,), "heading_angle"))
    assert cycles[:4] == ["constant", "sin1", "cos1", "sin2"] and len(cycles) == 11


AMPLITUDE = 2.0


def iron(context):
    affected = np.isin(context["aircraft"], [1, 4])
    cycle = np.radians(AMPLITUDE) * np.sin(context["magnetic_heading"] + 0.7)
    return np.where(affected, cycle, 0.0)


@pytest.fixture(scope="module")
def fitted():
    frame = make_frame(seed=5, aircraft=6, days=8, noise=0.3, heading_error=iron)
    effects = {"hard_iron": CATALOGUE["hard_iron"]}
    made = prepared(frame, effects, tables=False, seed=0)
    group = next(g for g in made.model.sums.candidates.groups if g.named and g.form == (0, 1))
    made.terms = [Term(group, "a", (1, 4), 2.7)]
    made.model.condition(made.terms)
    made.refit(effects)
    return made


def amplitudes(fitted):
    group = fitted.terms[0].group
    own = fitted.exact.theta[fitted.model.offsets[1] :].reshape(2, group.size)
    scales = np.asarray(CATALOGUE["hard_iron"].column_scales)
    return np.degrees(np.hypot(*((own @ group.transform.T) * scales).T))


def test_the_amplitude_is_that_put_in(fitted):
    assert amplitudes(fitted) == pytest.approx([AMPLITUDE, AMPLITUDE], rel=0.03)


def test_aircraft_with_one_fault_share_its_size(fitted):
    first, second = amplitudes(fitted)
    assert abs(first - second) < 0.02 * AMPLITUDE


def test_coefficients_without_a_group_of_days_scatter_about_those_of_all(fitted):
    spread = fitted.exact.by_fold - fitted.exact.theta
    assert np.abs(spread[:, fitted.model.offsets[1] :]).max() < 0.2
    assert np.linalg.eigvalsh(fitted.exact.covariance)[0] > 0


def test_a_sensor_effect_is_removed_exactly(fitted):
    frame = fitted.frame
    sine, cosine, turn = np.sin(frame.heading), np.cos(frame.heading), np.radians(3.0)
    effect = -frame.airspeed[:, None] * turn * np.stack([cosine, -sine], -1)
    corrected, off, faster = without_errors(frame, effect)
    assert off == pytest.approx(turn) and faster == pytest.approx(0.0, abs=1e-9)
    rotated = corrected.ground_u - corrected.airspeed * np.sin(frame.heading - turn)
    before = frame.ground_u - frame.airspeed * sine
    assert corrected.u_rep - frame.u_rep == pytest.approx(rotated - before, abs=1e-9)
