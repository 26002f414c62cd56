"""The permutation test keeps its size, however the aircraft were chosen."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from airswing.evaluation import permutation
from airswing.evaluation.permutation import (
    matched_controls,
    permutation_test,
    unconditional_p_value,
)


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


def test_the_plain_p_value_is_that_of_all_choices_of_aircraft():
    """Seven aircraft, three corrected: 35 choices, each as likely under permutation."""
    change = np.array([0.3, 1.9, 0.2, 1.2, -0.4, 0.1, 0.6])
    corrected = np.array([False, True, False, True, False, False, True])
    found = abs(change[corrected].mean() - change[~corrected].mean())
    apart = []
    for chosen in combinations(range(7), 3):
        inside = np.isin(np.arange(7), chosen)
        apart.append(abs(change[inside].mean() - change[~inside].mean()))
    expected = np.mean(np.array(apart) >= found - 1e-12)
    draws = 20_000
    p_value = unconditional_p_value(change, corrected, draws=draws, seed=1)
    assert p_value == pytest.approx(expected, abs=4 * np.sqrt(expected / draws))


def test_draws_are_the_same_in_batches_of_any_size(monkeypatch):
    rng = np.random.default_rng(8)
    before, during = rng.normal(7, 1, (2, 30))
    corrected = rng.random(30) < 0.5
    whole = permutation_test(before, during, corrected, draws=101, seed=2)
    plain = unconditional_p_value(before - during, corrected, draws=101, seed=2)
    monkeypatch.setattr(permutation, "_TOGETHER", 7 * 30)
    parts = permutation_test(before, during, corrected, draws=101, seed=2)
    assert parts[1] == whole[1] and np.allclose(parts[2], whole[2], rtol=1e-12, atol=1e-14)
    assert unconditional_p_value(before - during, corrected, draws=101, seed=2) == plain


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
