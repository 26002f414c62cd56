"""Evidence against textbook densities, mixtures by hand, clusters by simulation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from airswing.gap.evidence.aircraft_mixture import SHARE_GRID, by_share, log_mean, mixture
from airswing.gap.evidence.between_aircraft_variance import GRID
from airswing.gap.evidence.gaussian import (
    SCALE_GRID,
    SIZE_GRID,
    SUREST,
    allowance_covariance,
    evidence_over_backgrounds,
    gaussian_evidence,
    grid_evidence,
    own_fit,
    plain_probability,
    raw_evidence,
)
from airswing.gap.evidence.localisation import cross_fitted, false_discovery, score_test
from airswing.gap.scatter.moment_verdict import against_chance
from airswing.gap.sums import cluster_inflation as clusters
from airswing.gap.sums.cluster_inflation import cluster_factor


def test_gaussian_evidence_is_the_ratio_of_two_densities():
    information = np.array([[50.0, 8.0], [8.0, 30.0]])
    estimate = np.array([0.4, -0.3])
    prior, allowance = np.array([0.5, 1.0]), np.array([[0.01, 0.002], [0.002, 0.02]])
    value, shrunk = gaussian_evidence(
        information, information @ estimate, factor=1.7, allowance=allowance, prior=prior
    )
    spread = 1.7 * np.linalg.inv(information) + allowance
    expected = multivariate_normal(cov=spread + np.diag(prior**2)).logpdf(estimate)
    expected -= multivariate_normal(cov=spread).logpdf(estimate)
    assert value == pytest.approx(expected, abs=1e-3)
    gain = np.diag(prior**2) @ np.linalg.inv(spread + np.diag(prior**2))
    np.testing.assert_allclose(shrunk, gain @ estimate, atol=1e-4)


@pytest.mark.parametrize("size", [1, 3, 5])
def test_the_grid_of_scales_is_the_evidence_at_each_scale(size):
    rng = np.random.default_rng(size)
    half = rng.normal(size=(6, size, size + 3))
    information = 40 * half @ np.swapaxes(half, -1, -2)
    score, scales = 30 * rng.normal(size=(6, size)), rng.uniform(0.1, 2, size)
    allowance = 0.01 * np.tile(np.diag(scales**2), (6, 1, 1))
    fit = own_fit(information, score, scales)
    found, raw = grid_evidence(fit, factor=1.4, allowance=allowance), raw_evidence(fit)
    for k, factor in enumerate(SCALE_GRID):
        prior = scales * factor
        value, shrunk = gaussian_evidence(
            information, score, factor=1.4, allowance=allowance, prior=prior
        )
        np.testing.assert_allclose(found.tempered[k], value, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(found.estimate[k], shrunk, rtol=1e-7, atol=1e-9)
        value, _ = gaussian_evidence(
            information, score, factor=1.0, allowance=0 * allowance, prior=prior
        )
        np.testing.assert_allclose(raw[k], value, rtol=1e-7, atol=1e-9)


def test_collinear_columns_carry_the_evidence_of_one():
    one = gaussian_evidence(
        np.array([[40.0]]),
        np.array([20.0]),
        factor=1.0,
        allowance=np.zeros((1, 1)),
        prior=np.array([1.0]),
    )[0]
    two = gaussian_evidence(
        np.full((2, 2), 40.0),
        np.full(2, 20.0),
        factor=1.0,
        allowance=np.zeros((2, 2)),
        prior=np.full(2, np.sqrt(0.5)),
    )[0]
    assert two == pytest.approx(one, abs=0.05)


@given(st.floats(0, 3), st.floats(1, 5))
def test_more_clustering_never_adds_evidence_where_there_is_some(size, factor):
    information, score = np.array([[100.0]]), np.array([100.0 * size])
    options = {"allowance": np.zeros((1, 1)), "prior": np.array([1.0])}
    plain = gaussian_evidence(information, score, factor=1.0, **options)[0]
    tempered = gaussian_evidence(information, score, factor=factor, **options)[0]
    assert tempered <= max(plain, 0.0) + 1e-9


def test_widths_in_metres_a_second_are_the_evidence_of_their_densities():
    information = np.array([[50.0, 8.0], [8.0, 30.0]])
    estimate, scales = np.array([0.4, -0.3]), np.array([0.5, 1.0])
    unit = np.array([[0.4, 0.1], [0.1, 0.9]])
    background = np.array([0.0, 0.09])[:, None, None] * unit
    found = grid_evidence(
        own_fit(information, information @ estimate, scales),
        factor=1.7,
        allowance=background,
        unit=unit,
    )
    for t in range(2):
        spread = 1.7 * np.linalg.inv(information) + background[t]
        nothing = multivariate_normal(cov=spread).logpdf(estimate)
        for k, width in enumerate(SIZE_GRID):
            expected = multivariate_normal(cov=spread + width**2 * unit).logpdf(estimate) - nothing
            assert found.tempered[k, t] == pytest.approx(expected, abs=1e-3)
    # up to one constant for all sizes of the background
    density = [
        multivariate_normal(cov=1.7 * np.linalg.inv(information) + b).logpdf(estimate)
        for b in background
    ]
    assert np.diff(found.nothing) == pytest.approx(np.diff(density), abs=1e-3)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_sizes_of_the_background_are_the_evidence_at_each_allowance(size):
    rng = np.random.default_rng(size)
    half = rng.normal(size=(2, 6, size, size + 3))
    information, unit = (
        np.einsum("naij,nakj->naik", half, half) * np.array([40, 0.3])[:, None, None, None]
    )
    score, scales = 30 * rng.normal(size=(2, 6, size)), rng.uniform(0.1, 2, size)
    levels = np.array([0.0, 0.05, 0.3])
    options = {"factor": 1.4, "unit": unit}
    tempered, estimate, nothing = evidence_over_backgrounds(
        own_fit(information, score, scales), levels=levels, **options
    )
    for c in range(2):
        expected = grid_evidence(
            own_fit(information, score[c], scales),
            allowance=levels[:, None, None, None] ** 2 * unit,
            **options,
        )
        np.testing.assert_allclose(tempered[:, c], expected.tempered, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(estimate[:, c], expected.estimate, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(nothing[c], expected.nothing, rtol=1e-8, atol=1e-9)


def test_aircraft_of_which_a_share_is_struck_by_hand():
    each = by_share(np.log([[2.0, 5.0]]))
    assert each.shape == (SHARE_GRID.size, 1, 2)
    np.testing.assert_allclose(np.exp(each[:, 0, 1]), 1 - SHARE_GRID + 5.0 * SHARE_GRID)


def test_mixture_names_the_aircraft_struck_and_stays_quiet_on_nothing():
    evidence = np.full((1, 2, 14), -2.0)
    quiet = mixture(evidence)
    assert quiet.total < 0
    assert quiet.posterior.max() < 0.1
    evidence[0, 0, 3] = 25.0
    mixed = mixture(evidence)
    assert mixed.total > 15
    assert mixed.best == (0, 0)
    assert mixed.posterior[3] > 0.99
    assert np.delete(mixed.posterior, 3).max() < 0.1
    whole = mixture(np.full((1, 2, 14), 1.0))
    assert whole.total > 8
    assert whole.posterior.min() > 0.5


def fleet_evidence(values, error=0.03):
    """Mixture over aircraft whose effects of one column, m/s, are known to within an error."""
    information = np.full((values.size, 1, 1), 1 / error**2)
    unit = np.ones((values.size, 1, 1))
    found = grid_evidence(
        own_fit(information, information[..., 0] * values[:, None], np.ones(1)),
        factor=1.0,
        unit=unit,
        allowance=(GRID**2)[:, None, None, None] * unit,
    )
    return mixture(found.tempered.swapaxes(0, 1), found.nothing)


def test_what_every_aircraft_has_a_little_of_is_background():
    rng = np.random.default_rng(7)
    claims, sizes = [], []
    for _ in range(200):
        mixed = fleet_evidence(rng.normal(0, np.hypot(0.1, 0.03), 14))
        claims.append(mixed.total > 3.0)
        sizes.append(mixed.background)
    assert np.mean(claims) < 0.02
    assert np.median(sizes) == pytest.approx(0.1, abs=0.02)


def test_a_quiet_fleet_lets_a_weak_effect_of_one_aircraft_be_seen():
    rng = np.random.default_rng(8)
    seen, sizes = [], []
    for background in (0.0, 0.1):
        found = []
        for _ in range(100):
            values = rng.normal(0, np.hypot(background, 0.03), 14)
            values[5] = 0.3
            mixed = fleet_evidence(values)
            found.append(mixed.total > 3.0 and mixed.posterior[5] > 0.5)
            sizes.append(mixed.background)
        seen.append(np.mean(found))
    assert seen[0] > 0.9
    assert seen[1] < 0.2


def test_an_effect_the_whole_fleet_has_is_no_background():
    rng = np.random.default_rng(9)
    mixed = [fleet_evidence(rng.choice([-1, 1], 14) * rng.normal(0.5, 0.1, 14)) for _ in range(50)]
    assert min(m.total for m in mixed) > 3.0
    assert min(m.posterior.min() for m in mixed) > 0.5


def test_cluster_factors_of_many_units_are_those_of_each():
    rng = np.random.default_rng(1)
    half = rng.normal(size=(5, 40, 3, 8))
    half[2, 10:30] = 0.0  # an aircraft that stood for three weeks
    half[4, :, 2] = half[4, :, 1]  # and one whose columns are collinear
    grams = half @ np.swapaxes(half, -1, -2)
    scores, whole = rng.normal(size=(5, 40, 3)), grams.sum(axis=1)
    together = cluster_factor(grams, scores, whole)
    for a in range(5):
        np.testing.assert_allclose(
            together[a], cluster_factor(grams[a], scores[a], whole[a]), rtol=1e-6
        )


def test_cluster_factor_is_one_for_independent_and_grows_with_block_errors():
    rng = np.random.default_rng(0)
    grams = np.tile(np.eye(2) * 10, (600, 1, 1))
    scores = rng.normal(0, np.sqrt(10), (600, 2))
    np.testing.assert_allclose(cluster_factor(grams, scores, grams.sum(0)), 1.0, atol=0.35)
    blocks = np.repeat(rng.normal(0, np.sqrt(10), (86, 2)), 7, axis=0)[:600]
    factors = cluster_factor(grams, blocks, grams.sum(0))
    assert factors[2] == pytest.approx(7, rel=0.4)
    assert factors[0] == pytest.approx(1, rel=0.3)


def test_a_steady_effect_is_no_clustering():
    rng = np.random.default_rng(1)
    grams = np.tile(np.eye(1) * 10, (60, 1, 1))
    scores = rng.normal(0, np.sqrt(10), (60, 1)) + 50.0
    assert np.nanmax(cluster_factor(grams, scores, grams.sum(0))) < 2.0


def test_freedom_fitted_away_is_given_back():
    """A mean of either half taken off beforehand leaves too little scatter; `spent` counts it."""
    rng = np.random.default_rng(4)
    grams = np.tile(np.eye(1) * 10, (42, 1, 1))
    factors = []
    for _ in range(300):
        scores = rng.normal(0, np.sqrt(10), (42, 1))
        scores[:21] -= scores[:21].mean()
        scores[21:] -= scores[21:].mean()
        factors.append(cluster_factor(grams, scores, grams.sum(0), spent=1)[[0, 2]])
    np.testing.assert_allclose(np.mean(factors, axis=0), 1.0, atol=0.12)


def test_few_long_blocks_are_drawn_towards_many_short_ones():
    steadied = clusters._steadied(np.array([2.0, 2.0, 5.0]), 63)
    # nine weeks have eight degrees of freedom, as many as the prior has
    np.testing.assert_allclose(steadied, [2.0, 2.0, 3.5])
    np.testing.assert_allclose(clusters._steadied(np.array([1.0, np.nan, 3.0]), 63)[2], 3.0)


def test_nothing_left_is_no_evidence():
    """Rounding may leave less than nothing where all is explained by what is given."""
    allowance = allowance_covariance(np.eye(2) * 100, 100.0, 0.1, np.ones(2))
    value, estimate = gaussian_evidence(
        np.diag([-1e-3, 1e-4]),
        np.array([0.1, 0.1]),
        factor=1.0,
        allowance=allowance,
        prior=np.ones(2),
    )
    assert np.isfinite(value) and value <= 0.0
    np.testing.assert_allclose(estimate, 0.0, atol=1e-12)


def test_allowance_is_the_stated_size():
    second = np.array([[200.0, 10.0], [10.0, 300.0]])
    covariance = allowance_covariance(second, 100.0, 0.1, np.ones(2))
    assert np.trace(covariance @ second) / 100 == pytest.approx(0.02, rel=0.03)


def test_a_share_against_chance_by_hand():
    # 10 of 10 where chance gives half: ten times ln 2
    assert against_chance(10, 1.0, 0.5) == pytest.approx(10 * np.log(2), rel=1e-6)
    assert against_chance(10, 0.4, 0.5) == 0.0


def test_log_mean():
    assert log_mean(np.log([1.0, 2.0, 3.0])) == pytest.approx(np.log(2.0))


def test_false_discovery_by_hand():
    np.testing.assert_allclose(false_discovery([0.01, 0.5, 0.02, 0.9]), [0.04, 2 / 3, 0.04, 0.9])


def test_score_test_is_uniform_on_nothing_and_cross_fitted_energy_centred():
    rng = np.random.default_rng(2)
    gram = np.array([[200.0, 40.0], [40.0, 100.0]])
    half = np.arange(20) % 2 == 0
    p_values, energies = [], []
    for _ in range(400):
        scores = rng.multivariate_normal(np.zeros(2), gram / 20, 20)
        p_values.append(score_test(gram, scores.sum(0), 1.0)[0])
        energies.append(cross_fitted(gram, scores, half))
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.05)
    assert abs(np.mean(energies)) < 4 * np.std(energies) / 20
    strong = gram @ np.array([0.5, -0.4]) / 20 + scores
    assert cross_fitted(gram, strong, half) > 20


def test_medians_over_what_is_finite_are_those_of_numpy():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(6, 5, 3))
    values[rng.random(values.shape) < 0.4] = np.nan
    values[2, :, 1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        expected = np.nanmedian(values, axis=1)
    np.testing.assert_array_equal(clusters._median(values), expected)


def test_evidence_alone_makes_nothing_certain():
    assert plain_probability(np.log(50.0)) == pytest.approx(SUREST / 2)
    assert plain_probability(-1000.0) == pytest.approx(0.0, abs=1e-12)
    assert plain_probability(1000.0) == SUREST
