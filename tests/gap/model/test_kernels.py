"""Kernels of the gap's model against hand-worked numbers."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest

from airswing.gap.model.candidates import Group
from airswing.gap.model.closure import day_interval
from airswing.gap.model.evidence import static_evidence
from airswing.gap.model.localisation import score_test
from airswing.gap.model.sums import field_variance
from airswing.gap.model.terms import Statistics, Term, noise_factor, number_prior
from airswing.gap.result.schema import CurveEntry
from airswing.gap.result.statement import claims_of, shape_in_words


def statistics(estimate, information):
    """Statistics of one coefficient an aircraft from its estimates and information."""
    estimate = np.asarray(estimate, float)
    gram = np.full((estimate.size, 1, 1), float(information))
    fleet = gram.sum(0)
    ridge = np.full((1, 1), 1e-12)
    factor = np.ones(estimate.size)
    score = gram[:, :, 0] * estimate[:, None]
    inverse = np.linalg.inv(fleet)
    return Statistics(score, gram, fleet, ridge, inverse, factor, 1.0, 0.1**2, 0.0)


def test_the_prior_of_sets_of_aircraft_sums_to_one():
    for aircraft in (1, 5, 14):
        prior = np.exp(number_prior(aircraft))
        total = sum(comb(aircraft, k) * p for k, p in enumerate(prior))
        assert total == pytest.approx(1.0)


def test_evidence_of_one_aircraft_of_the_fleet_and_of_what_lasts_in_the_reference():
    estimate = np.where(np.arange(8) == 3, 0.8, 0.0)
    evidence = static_evidence(statistics(estimate, 400.0), 1.0, "af")
    assert evidence["a"].tails == (3,)
    assert evidence["a"].evidence > evidence["f"].evidence + 10
    # 0.8 m/s at a variance of 1 / 400 + 0.03^2 is 94 nats, less what scales and sets cost
    assert 70 < evidence["a"].evidence < 94
    evidence = static_evidence(statistics(np.full(8, 0.9), 400.0), 1.0, "af")
    assert evidence["f"].evidence > evidence["a"].evidence
    # 0.1 m/s on all aircraft is usual whatever the number of reports
    assert static_evidence(statistics(np.full(8, 0.1), 1e6), 1.0, "f")["f"].evidence < 0
    # the remainder of an effect of 1 m/s with columns of reliability 0.8 has 0.5 m/s rms
    exact = statistics(estimate * 0.5 / 0.8, 400.0)
    inexact = replace(exact, remainder=np.where(estimate > 0, 0.25, 0.0))
    assert static_evidence(exact, 1.0, "a")["a"].tails == (3,)
    assert static_evidence(inexact, 1.0, "a")["a"].tails == ()
    # an aircraft that has the effect by a term in the model has no second one
    assert static_evidence(exact, 1.0, "a", having=[3])["a"].inclusion[3] == 0


@pytest.mark.parametrize(("shared", "low", "high"), [(0.0, 1.0, 1.3), (1.0, 10.0, 40.0)])
def test_the_noise_factor_is_one_unless_errors_last_for_a_day(shared, low, high):
    """A little above one, as the larger of blocks of one and of four days."""
    rng = np.random.default_rng(3)
    factors = []
    for _ in range(60):
        rows = rng.normal(shared, 1.0, size=(4, 20, 30, 1))
        error = rng.normal(size=(4, 20, 30)) + shared * rng.normal(size=(4, 20, 1))
        score = np.einsum("adnm,adn->adm", rows, error)
        factors.append(noise_factor(score, np.einsum("adnm,adnk->admk", rows, rows)).factor.mean())
    assert low < np.mean(factors) < high


@pytest.mark.parametrize(("change", "low", "high"), [(0, 0.2, 0.3), (3, 0.2, 0.3), (0.5, 0.2, 0.4)])
def test_a_change_of_the_mean_on_a_day_is_no_variance_of_the_days(change, low, high):
    rng = np.random.default_rng(5)
    variances = []
    for _ in range(40):
        fields = rng.normal(0.0, 0.5, (24, 2))
        fields[17:] += change
        gram = np.tile(50.0 * np.eye(2), (24, 1, 1))
        score = 50.0 * fields + np.sqrt(50.0) * rng.normal(size=(24, 2))
        variances.append(field_variance(gram, score))
    assert low < np.mean(variances) < high


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


def term(name, kind="name", scope="a", score=10.0, period=None):
    group = Group(name, kind, slice(0, 1), np.eye(1), "af", 0.0)
    return Term(group, scope, (0,), 1.0, period or {}, score, score)


def test_a_name_in_two_scopes_is_one_claim_and_a_dated_one_another():
    terms = [
        term("date|heading_angle", "table", score=90.0),
        term("tas_scale", scope="f", score=20.0),
        term("tas_scale", score=30.0),
        term("compass_drift", period={0: (4, 9)}),
        term("compass_drift"),
    ]
    claims = claims_of(terms)
    assert [claim.terms for claim in claims] == [(1, 2), (3,), (4,), (0,)]
    assert [claim.named for claim in claims] == [True, True, True, False]
    assert claims[0].score == 30.0


def curve(values, name="temperature"):
    edges, values = np.linspace(-60.0, 20.0, len(values) + 1).tolist(), values.tolist()
    return CurveEntry([""] * len(values), values, "degree", [name], ["degC"], [edges], values)


def test_shapes_in_words():
    x = np.linspace(-58.0, 18.0, 20)
    assert shape_in_words(curve(0.05 * x)) == "linear in temperature: +0.05 degree per degC"
    assert shape_in_words(curve(0 * x + 0.5)) == "a constant of +0.5 degree"
    assert "a step of +2 degree at temperature -20" in shape_in_words(curve(2.0 * (x > -20)))
    assert "a bump of +3 degree near temperature" in shape_in_words(curve(3.0 * (abs(x) < 4)))
    assert shape_in_words(curve(np.sin(x / 6.0))) is None
