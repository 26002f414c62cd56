"""The permutation test keeps its size, however the aircraft were chosen."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.evaluation.permutation import matched_controls, permutation_test


@pytest.mark.parametrize("chosen", ["at random", "as the worst"])
def test_the_permutation_test_keeps_its_size_however_the_aircraft_were_chosen(chosen):
    rng, rejected, repeats = np.random.default_rng(5), 0, 400
    for seed in range(repeats):
        level = 7 + rng.normal(0, 0.8, 36)
        before, during = level + rng.normal(0, 0.6, 36), level + 1.2 + rng.normal(0, 0.6, 36)
        corrected = np.zeros(36, dtype=bool)
        order = rng.permutation(36) if chosen == "at random" else np.argsort(-before)
        corrected[order[:19]] = True
        rejected += permutation_test(before, during, corrected, draws=199, seed=seed)[1] <= 0.05
    assert 0.025 <= rejected / repeats <= 0.08


@pytest.mark.parametrize("step", [None, 0.5])
def test_each_corrected_aircraft_is_held_against_the_control_nearest_before(step):
    """As a table of all pairs has it; also where several are equally near."""
    rng = np.random.default_rng(6)
    before, during = rng.normal(7, 1, 40), rng.normal(6, 1, 40)
    if step:
        before = np.round(before / step) * step
    corrected = rng.random(40) < 0.4
    apart = np.abs(before[corrected][:, np.newaxis] - before[~corrected])
    change = before - during
    found = matched_controls(before, during, corrected)
    expected = change[corrected] - change[~corrected][apart.argmin(axis=1)]
    assert found["adjusted_reduction_kt"] == pytest.approx(expected.mean())
    assert found["mean_distance_kt"] == pytest.approx(apart.min(axis=1).mean())
