"""Stated probabilities are those learned from the committed claims, and mean what they say."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from benchmarks.gap_probabilities import CLAIMS, claims_of, fitted, left_out, log_score

from airswing.gap.search.belief import (
    FEATURES,
    STATED,
    learned_weights,
    of_one_day,
    outside_catalogue,
    probabilities,
)
from airswing.gap.search.confirmation import Confirmation


@pytest.fixture(scope="module")
def table():
    return pd.read_csv(CLAIMS)


def test_weights_are_fitted_to_the_claims(table):
    constant, weights = fitted(table[list(FEATURES)].to_numpy(float), table["right"].to_numpy())
    known, own = learned_weights()
    assert known == pytest.approx(constant, abs=0.01)
    np.testing.assert_allclose(own, weights, atol=0.01)
    assert own[0] > 0 and own[1] > 0  # more evidence, better confirmed: likelier


def test_claims_left_out_are_as_often_right_as_stated(table):
    stated, right = left_out(table), table["right"].to_numpy()
    high = stated >= STATED
    assert high.sum() >= 15
    assert abs(right[high].mean() - stated[high].mean()) < 0.06
    assert log_score(stated, right) > 0.5 * log_score(np.full(right.size, right.mean()), right)


def test_log_score_by_hand():
    expected = (np.log2(0.5) + np.log2(0.75)) / 2
    assert log_score(np.array([0.5, 0.25]), np.array([1, 0])) == pytest.approx(expected)


def test_what_could_not_be_tested_has_no_probability():
    tests = Confirmation(*np.ones((2, 2)), np.ones(2), np.full(2, 0.1), np.array([6, 2]))
    sure = np.array([[4.0, 6.0, 0.0, 0.0, 0.0]] * 2)
    constant, weights = learned_weights()
    chance = probabilities(sure, tests)
    assert chance[0] == pytest.approx(1 / (1 + np.exp(-(constant + sure[0] @ weights))))
    assert chance[1] == 0.0


def test_a_claim_is_right_on_one_of_its_aircraft():
    effect = {"name": "hard_iron", "tails": ["N1", "N2"]}
    label = {"name": "case", "background": ["outliers"], "effects": [effect]}
    claim = {"tails": ["N2", "N3"], "weighed": [1.0, 2.0, 0.0, 0.0, 0.0]}
    gap = {
        "effects": [claim | {"name": "hard_iron"}, claim | {"name": "outliers"}],
        "unconfirmed": [
            claim | {"name": "hard_iron", "tails": ["N4"]},
            claim | {"name": "soft_iron"},
        ],
    }
    rows = claims_of(json.loads(json.dumps(label)), gap)
    assert [(row["name"], row["right"]) for row in rows] == [
        ("hard_iron", 1),
        ("hard_iron", 0),
        ("soft_iron", 0),
    ]
    assert rows[0]["deviations"] == 2.0


def test_of_one_day_evidence_decides_where_its_parts_confirm():
    weighed = np.zeros((3, 5))
    weighed[:, 0] = np.log([8.915, 80.0, 5.0])
    weighed[:, 1] = [2.5, 1.9, 6.0]
    # ln 9 = 2.197 = 3.8 ln(8.915 / 5)
    np.testing.assert_allclose(of_one_day(weighed), [0.9, 0.0, 0.5], atol=2e-3)


def test_a_table_that_a_known_effect_explains_is_hardly_of_another():
    told = [outside_catalogue(share) for share in (0.0, 0.3, 0.45, 0.54, 0.9)]
    assert told == sorted(told, reverse=True)
    assert told[1] > STATED and told[2] == 0.75
    assert told[-1] == pytest.approx(0.5, abs=1e-3)  # it may be either
