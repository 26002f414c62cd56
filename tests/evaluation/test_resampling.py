"""Bootstrap over days, clustered means and the permutation test against plain computations."""

import numpy as np
import pytest

from airswing.evaluation.resampling import (
    cluster_sums,
    clustered_mean,
    day_weights,
    permutation_test,
)


@pytest.mark.parametrize("days", [3, 10])
def test_independent_days_drawn_again_vary_as_their_mean_does(days):
    values = np.random.default_rng(1).normal(size=days)
    weights = day_weights(days, draws=40_000, seed=2, length=1)
    assert np.allclose(weights.sum(axis=1), days)
    drawn = weights @ values / days
    assert drawn.var() == pytest.approx(values.var(ddof=1) / days, rel=0.03)


def test_blocks_of_days_contain_the_correlation_of_neighbours():
    """Pairs of equal days: the variance of the mean is twice that of independent days."""
    values = np.repeat(np.random.default_rng(3).normal(size=60), 2)
    weights = (day_weights(120, draws=4000, seed=1, length=length) for length in (1, None))
    spread = [(drawn @ values / 120).var() for drawn in weights]
    assert 1.5 < spread[1] / spread[0] < 2.1


def test_clustered_mean_agrees_with_a_loop_and_parts_add_up():
    rng = np.random.default_rng(0)
    flight = np.sort(rng.integers(0, 30, 400))
    group, value = flight % 3, rng.normal(size=400) + flight / 10
    sums = cluster_sums(value, group, flight, 4)
    mean, error = clustered_mean(sums)
    for g in range(3):
        inside = value[group == g]
        rests = [np.sum(value[flight == f] - inside.mean()) for f in np.unique(flight[group == g])]
        variance = len(rests) / (len(rests) - 1) * np.sum(np.square(rests)) / inside.size**2
        assert mean[g] == pytest.approx(inside.mean())
        assert error[g] == pytest.approx(np.sqrt(variance))
    assert np.isnan(mean[3]) and np.isnan(error[3])
    cut = int(np.searchsorted(flight, 9))
    halves = slice(cut), slice(cut, None)
    parts = [cluster_sums(value[rows], group[rows], flight[rows], 4) for rows in halves]
    np.testing.assert_allclose(parts[0] + parts[1], sums, rtol=1e-12)


@pytest.mark.parametrize("selection", ["at random", "as the worst"])
def test_the_permutation_test_has_its_size_however_the_aircraft_were_chosen(selection):
    rng, rejected, repeats = np.random.default_rng(5), 0, 400
    for seed in range(repeats):
        level = 7 + rng.normal(0, 0.8, 36)
        before, during = level + rng.normal(0, 0.6, 36), level + 1.2 + rng.normal(0, 0.6, 36)
        corrected = np.zeros(36, dtype=bool)
        order = rng.permutation(36) if selection == "at random" else np.argsort(-before)
        corrected[order[:19]] = True
        result = permutation_test(-during, corrected, covariate=before, draws=199, seed=seed)
        rejected += result[1] <= 0.05
    assert 0.025 <= rejected / repeats <= 0.08


def test_where_nothing_can_be_permuted_there_is_no_p_value():
    few, all_of_them = np.arange(4.0), np.ones(9, bool)
    for outcome, corrected in ((few, few > 1), (np.arange(9.0), all_of_them)):
        assert np.isnan(permutation_test(outcome, corrected)).all()
