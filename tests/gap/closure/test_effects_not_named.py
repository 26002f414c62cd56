"""What effects that were not named could still close."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import airswing  # noqa: F401
from airswing.gap.closure.effects_not_named import (
    LEAST_ACTING,
    _beside,
    _Silent,
    _units,
    closure_slopes,
)


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


def test_what_the_named_effects_copy_closes_nothing():
    """A named effect is smaller by what an effect alike would take: beside it nothing is left."""
    rng = np.random.default_rng(5)
    named = rng.normal(0, 1.0, (300, 2, 2))
    alike = named @ np.array([[1.0], [-2.0]])
    other = rng.normal(0, 1.0, (300, 2, 1))
    left = _beside(np.concatenate([alike, other], axis=2), named)
    np.testing.assert_allclose(left[..., 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.einsum("ncj,nck->jk", left, named), 0.0, atol=1e-9)
    assert np.square(left[..., 1]).sum() > 0.9 * np.square(other).sum()


def test_an_effect_of_the_fleet_gives_back_over_all_its_aircraft():
    """One coefficient of the named effect serves all aircraft: sums over them, not each alone."""
    rng = np.random.default_rng(7)
    residual, fields = rng.normal(0, 3.0, (2, 200, 2)), rng.normal(0, 1.0, (2, 200, 2, 2))
    score = SimpleNamespace(candidate=SimpleNamespace(columns=np.zeros(1)))
    one = _Silent(score, 1.0, np.ones(1, bool))
    for aircraft in range(2):
        one.add(0, residual[aircraft], fields[aircraft])
    slope, curve = one.net()
    both, named = np.concatenate(fields)[..., 0], np.concatenate(fields)[..., 1]
    net = both - named * (both * named).sum() / np.square(named).sum()
    expected = closure_slopes(np.concatenate(residual), net[..., None])
    np.testing.assert_allclose(slope[0], expected[0])
    np.testing.assert_allclose(curve[0], expected[1])


@pytest.mark.parametrize(
    ("scope", "free"), [("fleet", [False]), ("aircraft", [False, True, False])]
)
def test_what_has_its_name_is_not_left_over_as_well(scope, free):
    """Of three aircraft the first is named, and on the third the effect hardly acts."""
    found = SimpleNamespace(terms=[SimpleNamespace(key=("tas_scale", scope), tails=(0,))])
    score = SimpleNamespace(
        candidate=SimpleNamespace(name="tas_scale", scope=scope),
        acting=np.array([LEAST_ACTING, LEAST_ACTING, LEAST_ACTING - 1]),
    )
    assert _units(found, score).tolist() == free
    other = SimpleNamespace(terms=[SimpleNamespace(key=("compass_offset", scope), tails=(0,))])
    assert _units(other, score)[0]
