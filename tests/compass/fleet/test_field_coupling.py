"""The design of an aircraft's own unknowns, and the information it gives were the field known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from airswing.compass.fleet.field_coupling import OWN, direct_information, own_design, unknowns


@pytest.mark.parametrize("component", [0, 1])
def test_design_times_unknowns_is_the_error_they_make(component):
    rng = np.random.default_rng(1)
    slopes, coefficients, bias = rng.normal(0, 100, (2, 6, 5)), rng.normal(0, 0.1, 6), [0.7, -1.3]
    made = np.array([coefficients @ slopes[component][:, k] + bias[component] for k in range(5)])
    one = SimpleNamespace(slopes=slopes, weight=np.full(5, 4.0))
    known = np.append(coefficients, bias[component])
    assert known @ own_design(one, component) == pytest.approx(made)


def test_information_of_an_aircraft_by_hand():
    """One piece of two blocks, tied by w / (w_1 + w_2) of a common error: X'WX less its mean's."""
    slopes = np.arange(24.0).reshape(2, 6, 2)
    weight, tied = np.array([2.0, 3.0]), np.array([0.1])
    one = SimpleNamespace(
        slopes=slopes, weight=weight, aircraft=np.array([1, 1]), opens=np.array([0])
    )
    precision = SimpleNamespace(stretch=one, weight=weight, tied=tied)
    found = direct_information(precision, 2)
    assert not found[0].any()
    for component in range(2):
        x = np.vstack([slopes[component], np.ones(2)])
        inside = np.diag(weight) - 0.1 * np.outer(weight, weight)
        kept = [*range(6), 6 + component]
        share = x @ inside @ x.T
        assert found[1][6 + component, kept] == pytest.approx(share[6])
        assert found[1][6 + component, 7 - component] == 0.0
    own, lasting = unknowns(2, 3)
    assert own.shape == (2, OWN) and own[1].tolist() == [*range(6, 12), 14, 15]
    assert lasting.tolist() == [[16, 17, 18], [19, 20, 21]]
