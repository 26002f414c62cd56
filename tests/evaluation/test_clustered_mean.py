"""Clustered means from sums: a plain loop's values, and parts that add up."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.evaluation.clustered_mean import cluster_sums, clustered_mean


def test_clustered_mean_agrees_with_a_loop() -> None:
    rng = np.random.default_rng(0)
    flight = np.sort(rng.integers(0, 30, 400))
    group, value = flight % 3, rng.normal(size=400) + flight / 10
    mean, error = clustered_mean(cluster_sums(value, group, flight, 4))
    for g in range(3):
        inside = value[group == g]
        sums = [np.sum(value[flight == f] - inside.mean()) for f in np.unique(flight[group == g])]
        variance = len(sums) / (len(sums) - 1) * np.sum(np.square(sums)) / inside.size**2
        assert mean[g] == pytest.approx(inside.mean())
        assert error[g] == pytest.approx(np.sqrt(variance))
    assert np.isnan(mean[3])
    assert np.isnan(error[3])


def test_sums_of_parts_with_whole_clusters_add_up() -> None:
    rng = np.random.default_rng(1)
    flight, group = np.sort(rng.integers(0, 20, 300)), rng.integers(0, 3, 300)
    value = rng.normal(size=300)
    cut = int(np.searchsorted(flight, 9))
    whole = cluster_sums(value, group, flight, 3)
    parts = [cluster_sums(value[s], group[s], flight[s], 3) for s in (slice(cut), slice(cut, None))]
    np.testing.assert_allclose(parts[0] + parts[1], whole, rtol=1e-12)


def test_a_clustered_error_by_hand() -> None:
    """Two clusters with sums of deviations +2 and -2: sqrt(2 (4 + 4)) / 4 = 1."""
    values, one = np.array([1.0, 1.0, -1.0, -1.0]), np.zeros(4, dtype=np.int64)
    for cluster, error in (([0, 0, 1, 1], 1.0), ([0, 1, 0, 1], 0.0), ([0, 0, 0, 0], np.nan)):
        sums = cluster_sums(values, one, np.array(cluster), 1)
        np.testing.assert_equal(clustered_mean(sums)[1], [error])
