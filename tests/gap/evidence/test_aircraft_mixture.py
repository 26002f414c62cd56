"""Aircraft struck by one and the same coefficient, or by ones of their own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from airswing.gap.evidence.aircraft_mixture import Same, mixture
from airswing.gap.evidence.between_aircraft_variance import GRID, whole_prior
from airswing.gap.evidence.gaussian import (
    ABOUT,
    OwnFit,
    evidence_of_same,
    evidence_over_backgrounds,
    log_prior_of_sizes,
)
from airswing.gap.evidence.of_candidate import SAME, SAME_PRIOR

ERROR = 0.04  # m/s, of every aircraft's estimate


def evidence(estimates, *, same):
    """Mixture of aircraft with these estimates, m/s, sizes of the background averaged over."""
    n = len(estimates)
    fit = OwnFit(
        np.full((n, 1, 1), ERROR**2), np.asarray(estimates)[None, :, None], np.ones((n, 1))
    )
    beside = {"factor": np.ones(n), "unit": np.ones((n, 1, 1)), "levels": GRID}
    own, _, nothing = evidence_over_backgrounds(fit, **beside)
    values = np.repeat(SAME[:, None], n, axis=1)
    alike = np.moveaxis(evidence_of_same(fit, **beside, values=values)[:, 0], 0, 1)
    return mixture(
        np.moveaxis(own[:, 0], 0, 1),
        nothing[0],
        whole_prior(),
        same=Same(alike, SAME_PRIOR) if same else None,
    )


def test_evidence_of_a_value_is_the_ratio_of_two_densities():
    fit = OwnFit(
        np.array([[[0.3]], [[0.2]]]), np.array([[[0.8], [-0.1]]]), np.array([[2.0], [0.5]])
    )
    values = np.array([[1.5, 1.5], [-0.7, -0.7]])
    unit, levels = np.array([[[0.4]], [[0.9]]]), np.array([0.0, 0.3])
    found = evidence_of_same(
        fit, factor=np.array([1.2, 1.7]), unit=unit, levels=levels, values=values
    )
    assert found.shape == (2, 1, 2, 2)
    for a, (hat, spread, factor) in enumerate([(1.6, 0.3 * 4, 1.2), (-0.05, 0.2 * 0.25, 1.7)]):
        for t, level in enumerate(levels):
            variance = factor * spread + level**2 * unit[a, 0, 0]
            for v, value in enumerate(values[:, a]):
                wide = np.sqrt(variance + (ABOUT * value) ** 2)
                expected = norm(value, wide).logpdf(hat) - norm(0, np.sqrt(variance)).logpdf(hat)
                assert found[v, 0, t, a] == pytest.approx(expected)


def test_the_values_share_one_probability_largest_at_common_sizes():
    prior = np.exp(log_prior_of_sizes(SAME))
    assert prior.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(prior[: SAME.size // 2], prior[SAME.size // 2 :])
    assert 0.2 < abs(SAME[np.argmax(prior)]) < 1.6


def test_four_of_fourteen_that_are_alike_stand_out_from_what_each_may_have():
    """A lag of 20 to 24 s on four of fourteen, whose size passed for what every aircraft has."""
    rng = np.random.default_rng(1)
    quiet = rng.normal(0.0, ERROR, 10)
    told, before = (
        evidence(np.r_[0.33, 0.32, 0.28, 0.29, quiet], same=same) for same in (True, False)
    )
    assert told.total > before.total + 2.0
    assert told.posterior[:4].min() > 0.95
    assert told.posterior[4:].max() < 0.3
    # as large on average, and unlike: a background as well
    unlike = evidence(np.r_[0.55, -0.2, 0.3, -0.1, quiet], same=True)
    assert unlike.total < told.total


def test_one_alone_loses_no_more_than_the_choice():
    rng = np.random.default_rng(2)
    estimates = np.r_[0.6, rng.normal(0.0, ERROR, 13)]
    with_, without = (evidence(estimates, same=same).total for same in (True, False))
    assert without - np.log(2.0) - 1e-9 <= with_ < without + 1.5


def test_where_nobody_is_struck_evidence_is_rare_as_it_says():
    """A ratio of densities is over 20 at most once in 20 draws of the denominator's."""
    rng = np.random.default_rng(3)
    levels = rng.choice(GRID, 400, p=np.exp(whole_prior()))
    draws = rng.normal(0.0, np.hypot(ERROR, levels)[:, None], (400, 14))
    totals = np.array([evidence(own, same=True).total for own in draws])
    assert np.mean(totals > np.log(20.0)) <= 0.05
    assert np.mean(np.exp(np.minimum(totals, 10.0))) < 1.5
