"""Days with Student's errors: normal in the limit, integrals by quadrature, gross days alone."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from scipy.stats import t as student

from airswing.evaluation.monitoring import heavy_tails
from airswing.evaluation.monitoring.heavy_tails import FREEDOM, SINGLE_DAY, corroborated_ratio
from airswing.evaluation.monitoring.sequential_test import _marginal, _mixture


def test_with_many_degrees_of_freedom_it_is_the_ratio_of_normal_errors(monkeypatch):
    monkeypatch.setattr(heavy_tails, "FREEDOM", 1e9)
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 2, 3))
    weight = np.einsum("nki,nkj->nij", root, root)  # two headings a day: singular
    score = np.einsum("nij,j->ni", weight, [1.0, -0.5, 0.4])
    level, shapes = np.diag([0.2, 0.1, 0.3]), np.array([[1.5, 0.0, 0.0], [1.5, 1.0, 0.5]])
    found, _ = heavy_tails._ratio(weight, score, level, shapes)
    one = _marginal(weight.sum(0)[None], score.sum(0)[None], level[None])
    each = [_mixture(*one, shape)[0] for shape in shapes]
    assert found == pytest.approx(np.logaddexp.reduce(each) - np.log(2.0), abs=1e-6)


def test_the_ratio_is_that_of_the_integrals():
    """One unknown: days of Student's t integrated over a normal level by quadrature."""
    days, weight = np.array([2.1, 2.6, 1.7, 9.0]), np.array([4.0, 6.0, 3.0, 5.0])
    level, step = 0.04, 2.0

    def law(variance):
        def density(x):
            z = np.sqrt(weight) * (days - x)
            return norm.pdf(x, scale=np.sqrt(variance)) * np.prod(student.pdf(z, FREEDOM))

        return np.log(quad(density, -15, 15, points=[0.0, 2.1], limit=500)[0])

    expected = law(level + step**2) - law(level)
    found, farthest = heavy_tails._ratio(
        weight[:, None, None], (weight * days)[:, None], np.array([[level]]), np.array([[step]])
    )
    assert found == pytest.approx(expected, abs=0.3) and expected > 8.0
    assert farthest == 3


def test_no_single_day_tells_a_step_and_two_do():
    weight = np.tile(9.0 * np.eye(2), (3, 1, 1))
    day = np.array([[20.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    level, shapes = 0.05 * np.eye(2), np.array([[5.0, 5.0]])
    alone = corroborated_ratio(weight[:1], 9.0 * day[:1], level, shapes)
    assert alone == SINGLE_DAY
    assert corroborated_ratio(weight, 9.0 * day, level, shapes) <= SINGLE_DAY
    both = corroborated_ratio(weight[:2], 9.0 * day[[0, 0]], level, shapes)
    assert both > SINGLE_DAY + 5.0
