import numpy as np
import pytest
from scipy.stats import median_abs_deviation

from airswing.physics.robust_spread import robust_sd


def test_by_hand():
    # median 3, deviations 2 1 0 1 97, of which the median is 1
    assert robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 100.0])) == 1.4826
    # about zero the deviations are the values themselves
    assert robust_sd(np.array([1.0, -2.0, 3.0]), 0.0) == 2 * 1.4826
    assert robust_sd(np.array([])) == 0.0


def test_agrees_with_scipy():
    values = np.random.default_rng(5).normal(4.0, 2.5, 400)
    assert robust_sd(values) == pytest.approx(
        median_abs_deviation(values, scale="normal"), rel=1e-4
    )
