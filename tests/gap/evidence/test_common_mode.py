"""The shift that all aircraft's estimates share, against dense Gaussian integrals."""

from __future__ import annotations

import numpy as np
import pytest

import airswing  # noqa: F401
from airswing.gap.evidence.aircraft_mixture import mixture
from airswing.gap.evidence.common_mode import LEAST_SHARED, common_part, shared_part, shifts


def coupled(d, share):
    """Information of aircraft whose common part is taken up."""
    return np.diag(d) - share * np.outer(d, d) / d.sum()


def test_the_common_part_is_read_off_the_sums():
    d = np.array([100.0, 120.0, 80.0, 95.0, 130.0])
    m = coupled(d, 0.9)
    own, share = shared_part(np.diagonal(m).copy(), float(m.sum()))
    np.testing.assert_allclose(own, d, rtol=1e-4)
    assert share == pytest.approx(0.9, abs=1e-4)


def test_nothing_shared_is_nothing_to_average():
    d = np.full(6, 50.0)
    for own, fleet in ((d, d.sum()), (d, d.sum() * (1 - 0.7 * LEAST_SHARED)), (0 * d, 0.0)):
        found = shifts(own, np.zeros(6), float(fleet), 1.0)
        np.testing.assert_array_equal(found.own, own)
        assert found.values.tolist() == found.log_weight.tolist() == [0.0]


@pytest.mark.parametrize("factor", [1.0, 1.7])
@pytest.mark.parametrize("width", [0.05, 0.3, 1.0])
def test_averaging_over_the_shift_is_the_dense_integral(factor, width):
    """Log ratio of evidences of two priors N(0, w^2) and N(0, 0.1^2) on every aircraft."""
    rng = np.random.default_rng(7)
    d = rng.uniform(80, 140, 8)
    m = coupled(d, 0.85)
    score = m @ rng.normal(0, 0.3, 8) + rng.multivariate_normal(np.zeros(8), m)
    found = shifts(np.diagonal(m).copy(), score, float(m.sum()), factor)

    def dense(w):
        inner = m / factor + np.eye(8) / w**2
        solved = np.linalg.solve(inner, score / factor)
        return 0.5 * score @ solved / factor - 0.5 * np.linalg.slogdet(inner * w**2)[1]

    def averaged(w):
        spread = factor / found.own
        estimate = score / found.own + found.values[:, None]
        wide = spread + w**2
        log = -0.5 * (estimate**2 / wide + np.log(wide)).sum(axis=1) + found.log_weight
        return np.logaddexp.reduce(log)

    assert averaged(width) - averaged(0.1) == pytest.approx(dense(width) - dense(0.1), abs=0.05)


def evidence(m, score, level, width):
    """Evidence (T, 1, A), density of nothing (T, A) and weight (T,) by shift, one background."""
    found = shifts(np.diagonal(m).copy(), score, float(m.sum()), 1.0)
    estimate = score / found.own + found.values[:, None]
    quiet, struck = (1 / found.own + level**2 + w**2 for w in (0.0, width))
    nothing = -0.5 * (estimate**2 / quiet + np.log(quiet))
    tempered = -0.5 * (estimate**2 / struck + np.log(struck)) - nothing
    return tempered[:, None], nothing, found.log_weight


def test_three_struck_are_told_from_a_background_that_all_have():
    rng = np.random.default_rng(11)
    right, with_shift = 0, []
    for _ in range(20):
        m = coupled(np.full(14, 130.0), 0.95)
        truth = np.zeros(14)
        truth[[2, 5, 9]] = 0.7
        score = m @ truth + rng.multivariate_normal(np.zeros(14), m)
        mixed = mixture(*evidence(m, score, 0.03, 0.8), np.zeros(1))
        with_shift.append(mixed.total)
        right += set(np.flatnonzero(mixed.posterior > 0.5)) == {2, 5, 9}
    assert right >= 18
    assert np.median(with_shift) > 15


def test_a_quiet_fleet_raises_nothing():
    rng = np.random.default_rng(12)
    totals = []
    for _ in range(200):
        m = coupled(np.full(14, 130.0), 0.95)
        score = rng.multivariate_normal(np.zeros(14), m)
        totals.append(mixture(*evidence(m, score, 0.03, 0.8), np.zeros(1)).total)
    assert np.mean(np.array(totals) > 3.0) <= 0.01


def test_a_common_part_is_averaged_over_by_its_prior():
    """Log ratio of evidences of two priors on every aircraft, beside a common part, densely."""
    rng = np.random.default_rng(3)
    d, spread, factor = rng.uniform(80, 140, 9), 0.15, 1.3
    estimate = 0.2 + rng.normal(0, 0.1, 9)
    found = common_part(d, d * estimate, spread, factor)

    def dense(w):
        covariance = np.diag(factor / d + w**2) + spread**2
        solved = np.linalg.solve(covariance, estimate)
        return -0.5 * estimate @ solved - 0.5 * np.linalg.slogdet(covariance)[1]

    def averaged(w):
        wide, left = factor / d + w**2, estimate + found.values[:, None]
        log = -0.5 * (left**2 / wide + np.log(wide)).sum(axis=1) + found.log_weight
        return np.logaddexp.reduce(log)

    assert averaged(0.3) - averaged(0.02) == pytest.approx(dense(0.3) - dense(0.02), abs=0.05)
    # a mean of nothing changes nothing
    for score in (0 * d, d * 1e-3):
        assert common_part(d, score, spread, factor).values.tolist() == [0.0]


def test_one_struck_stands_out_from_what_all_share():
    rng = np.random.default_rng(12)
    right = without = 0
    for _ in range(20):
        d = np.full(14, 1 / 0.06**2)
        estimate = -0.15 + rng.normal(0, 0.06, 14)
        estimate[13] -= 0.45
        for common in (True, False):
            told = common_part(d, d * estimate, 0.1, 1.0)
            values = told.values if common else np.zeros(1)
            weight = told.log_weight if common else np.zeros(1)
            left = estimate + values[:, None]
            quiet, struck = (1 / d + 0.16**2 * (not common) + w**2 for w in (0.0, 0.5))
            nothing = -0.5 * (left**2 / quiet + np.log(quiet))
            tempered = -0.5 * (left**2 / struck + np.log(struck)) - nothing
            mixed = mixture(tempered[:, None], nothing, weight, np.zeros(values.size))
            struck_alone = set(np.flatnonzero(mixed.posterior > 0.5)) == {13}
            told_so = mixed.total > 3.0 and struck_alone
            right, without = right + (common and told_so), without + (told_so and not common)
    assert right >= 19 and without <= 5
