"""The background's prior by hand, and what fleets of simulated aircraft tell of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import halfnorm, norm

from airswing.gap.evidence.between_aircraft_variance import (
    GRID,
    either,
    half_normal,
    told,
    whole_prior,
)

ERROR = 0.03


def likelihood(values):
    """Log density of aircraft's effects known to within an error, at every size (T,)."""
    return norm(0, np.hypot(GRID, ERROR)[:, None]).logpdf(values).sum(axis=1)


def mean_size(log):
    return float(np.sqrt((np.exp(log) * GRID**2).sum()))


def test_the_prior_is_a_half_normal_in_cells():
    log = half_normal(0.08)
    assert np.exp(log).sum() == pytest.approx(1.0)
    edges = [0.07, 0.095]  # of the cell about 0.08
    exact = np.diff(halfnorm(scale=0.08).cdf(edges))[0]
    assert np.exp(log[GRID == 0.08])[0] == pytest.approx(exact, rel=0.03)
    assert np.exp(whole_prior()).sum() == pytest.approx(1.0)


def test_nothing_told_leaves_all_scales_alike():
    np.testing.assert_allclose(told([]), whole_prior())
    np.testing.assert_allclose(told([np.zeros(GRID.size)] * 5), whole_prior())


def test_quiet_fleets_make_quiet_priors_and_restless_ones_restless():
    rng = np.random.default_rng(3)
    sizes = []
    for size in (0.0, 0.1):
        made = [
            told([likelihood(rng.normal(0, np.hypot(size, ERROR), 14)) for _ in range(6)])
            for _ in range(40)
        ]
        sizes.append([mean_size(m) for m in made])
    vague = mean_size(whole_prior())
    assert max(sizes[0]) < vague < min(sizes[1])


def test_aircraft_that_may_be_struck_by_hand():
    evidence = np.log(np.array([[[3.0], [5.0]]]))
    np.testing.assert_allclose(np.exp(either(evidence)), [[0.8 + 0.2 * 4.0]])
