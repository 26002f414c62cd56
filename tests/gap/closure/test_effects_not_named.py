"""What effects that were not named could still close."""

from __future__ import annotations

import numpy as np
import pytest

import airswing  # noqa: F401
from airswing.gap.closure.effects_not_named import closure_slopes


def test_slopes_are_the_derivatives_of_the_summed_disagreement():
    rng = np.random.default_rng(3)
    residual = rng.normal(0, 3.0, (400, 2))
    residual[np.hypot(*residual.T) < 0.6] += 1.0
    fields = rng.normal(0, 1.0, (400, 2, 2))
    slope, curve = closure_slopes(residual, fields)
    step = np.array([0.02, -0.01])

    def closed(steps):
        return np.hypot(*residual.T).sum() - np.hypot(*(residual - fields @ steps).T).sum()

    assert slope @ step == pytest.approx((closed(step) - closed(-step)) / 2, rel=1e-3)
    even = (closed(step) + closed(-step)) / 2
    assert -0.5 * step @ curve @ step == pytest.approx(even, rel=1e-2)


def test_slopes_by_hand():
    residual = np.array([[3.0, 4.0], [0.0, 2.0]])
    fields = np.array([[[1.0], [0.0]], [[0.0], [1.0]]])
    slope, curve = closure_slopes(residual, fields)
    # along (3, 4)/5 and (0, 1); what is across, by the size: 1 - 0.36 over 5, and nothing
    assert slope[0] == pytest.approx(1.6)
    assert curve[0, 0] == pytest.approx(0.64 / 5)
