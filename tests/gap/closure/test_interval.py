"""The interval of the closure, and coefficients pooled over aircraft."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import airswing  # noqa: F401
from airswing.gap.closure.interval import reductions, rounding_error
from airswing.gap.result.describe import pooled


def test_reduction_of_a_draw_is_that_of_the_reports_it_touches():
    residual = np.array([[3.0, 4.0], [0.0, 2.0], [1.0, 0.0]])
    fields = np.array([[[1.0], [0.0]], [[0.0], [1.0]]])  # on the first two reports
    changes = [(np.array([0, 1]), fields, np.array([[0.0], [1.0]]))]
    found = reductions(residual, changes, 2)
    # second draw: |(2, 4)| and |(0, 1)| instead of 5 and 2
    assert found == pytest.approx([0.0, (7 - np.sqrt(20) - 1) / 3])


def test_a_report_in_two_terms_has_both_taken_off():
    residual = np.array([[2.0, 0.0]])
    fields = np.array([[[1.0], [0.0]]])
    one = (np.array([0]), fields, np.array([[1.0]]))
    assert reductions(residual, [one, one], 1) == pytest.approx([2.0])
    assert reductions(residual, [], 3) == pytest.approx([0.0, 0.0, 0.0])


def test_rounding_of_a_whole_knot_and_degree():
    n = 400
    frame = SimpleNamespace(
        size=n,
        aircraft=np.zeros(n, int),
        u_rep=np.full(n, 20.0),
        v_rep=np.zeros(n),
        wind_speed_resolution=np.array([0.5144]),
        wind_direction_resolution=np.array([1.0]),
    )
    changes = [(np.arange(n), np.zeros((n, 2, 1)), np.zeros((1, 1)))]
    rng = np.random.default_rng(1)
    draws = []
    for _ in range(300):  # the same winds, rounded from two nearby values
        errors = []
        for _ in range(2):
            along, across = rng.uniform(-0.5, 0.5, (2, n))
            errors.append(np.stack([0.5144 * along, np.radians(1.0) * 20 * across], -1))
        other = rng.normal(0, 3.0, (n, 2))
        draws.append((np.hypot(*(other + errors[0]).T) - np.hypot(*(other + errors[1]).T)).mean())
    assert rounding_error(frame, changes) == pytest.approx(np.std(draws), rel=0.15)


def test_aircraft_that_agree_are_drawn_together_and_others_are_not():
    rng = np.random.default_rng(2)
    formal = np.tile(0.04 * np.eye(2), (12, 1, 1))
    allowed = np.tile(0.01 * np.eye(2), (12, 1, 1))
    alike = np.array([1.0, -0.5]) + rng.normal(0, 0.2, (12, 2))
    values, spreads = pooled(alike, formal, allowed)
    assert np.std(values - [1.0, -0.5]) < 0.6 * np.std(alike - [1.0, -0.5])
    # what may be the same in all of them does not average out
    assert np.sqrt(spreads[0, 0, 0]) > 0.1
    apart = alike + rng.normal(0, 3.0, (12, 2))
    values, spreads = pooled(apart, formal, allowed)
    np.testing.assert_allclose(values, apart, atol=0.15)
    one, _ = pooled(alike[:1], formal[:1], allowed[:1])
    np.testing.assert_array_equal(one, alike[:1])
