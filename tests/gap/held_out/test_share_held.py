"""The share of an error that a residual holds, and how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.gap.held_out.share_held import BLOCK, BOUND, share_held


def test_of_what_acts_for_a_week_only_its_own_blocks_tell():
    """A step of eleven compasses, of which the residual as it is held 0.01 +- 0.09."""
    rng = np.random.default_rng(4)
    day = np.repeat(np.arange(15 * BLOCK), 70)
    error = np.where(day[:, None] >= 13 * BLOCK, 1.0, 0.0) * np.ones((day.size, 2))
    for share in (0.0, 1.0):
        told = share_held(share * error + 0.8 * rng.standard_normal(error.shape), error, day)
        assert told.share == pytest.approx(share, abs=0.15)
        assert told.error < 0.15
        assert told.energy == (error**2).sum()


def test_the_error_between_blocks_is_that_of_many_draws():
    rng = np.random.default_rng(5)
    day = np.repeat(np.arange(15 * BLOCK), 7)
    error = np.where(day[:, None] >= 5 * BLOCK, 1.0, 0.0) * np.ones((day.size, 2))
    made = [
        share_held(error + rng.standard_normal(15)[day // BLOCK][:, None], error, day)
        for _ in range(400)
    ]
    assert np.mean([one.error**2 for one in made]) == pytest.approx(
        np.var([one.share for one in made]), rel=0.25
    )


def test_gross_reports_hold_nothing_and_nothing_has_no_share():
    day, error = np.arange(30), np.ones((30, 2))
    residual = error.copy()
    residual[::10] = 2 * BOUND
    told = share_held(residual, error, day)
    assert (told.share, told.error, told.energy) == (1.0, 0.0, 54.0)
    assert share_held(residual, 0.0 * error, day).error == np.inf
