"""A reference's equations some days at a time: the same sums, and memory that does not grow."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from airswing.compass.fleet.flight_segments import ROWS, Blocks
from airswing.compass.fleet.reference_equations import Reference
from airswing.compass.fleet.solution import solve_fleet

FREE = np.ones((4, 6), dtype=bool)
FREE[2, 3:5] = False


def fleet(days: int, seed: int = 0, a_segment: int = 5) -> list[Blocks]:
    """Blocks of four aircraft; the third flew on half of the days only."""
    found = []
    for number in range(4):
        rng = np.random.default_rng((seed, number))
        segment = 40_000 + np.repeat(np.arange(days * 4 // (2 if number == 2 else 1)), a_segment)
        n = segment.size
        sums = np.zeros((ROWS, n), np.float32)
        sums[0] = rng.uniform(3, 8, n)
        sums[1:3] = sums[0] * rng.normal(0, 0.6, (2, n))
        sums[3:] = sums[0] * rng.normal(0, 100, (ROWS - 3, n))
        found.append(
            Blocks(
                sums,
                8.0 * n,
                8.0 * n,
                rng.uniform(39, 46, n),
                rng.uniform(-92, -82, n),
                np.log(rng.uniform(3e4, 9e4, n)),
                segment,
                np.arange(n) // 2,
            )
        )
    return found


def reference(days: int) -> Reference:
    return Reference(fleet(days), FREE, 40_000 + 4 * np.arange(days))


@pytest.mark.parametrize("most", [60, 200, 10_000])
def test_the_scores_do_not_depend_on_where_the_days_are_cut(monkeypatch, most):
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 600)
    whole = reference(20)
    assert whole.thinned
    cut = reference(20)
    segments = np.concatenate(cut.runs)
    size = most // 70 + 1
    cut.runs = [segments[4 * k : 4 * (k + size)] for k in range(0, 20, size)]
    cut.worth[:], cut.lasting_worth[:] = 0.0, 0.0
    np.testing.assert_allclose(cut._survey(), whole.start, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(cut.worth, whole.worth, rtol=1e-12)
    np.testing.assert_allclose(cut.lasting_worth, whole.lasting_worth, rtol=1e-12)
    unknowns = np.random.default_rng(1).normal(0, 0.01, whole.start.shape[1])
    np.testing.assert_allclose(cut.scores(unknowns), whole.scores(unknowns), rtol=1e-11, atol=1e-9)


def test_runs_are_whole_days_of_at_most_so_many_blocks(monkeypatch):
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 300)
    runs = reference(20).runs
    assert [run[0] % 4 for run in runs] == [0] * len(runs)
    np.testing.assert_array_equal(np.concatenate(runs), 40_000 + np.arange(80))
    # 80 blocks on a day with all four aircraft, 60 on the later ones
    assert [run.size for run in runs] == [12, 12, 12, 16, 20, 8]


def test_memory_beside_the_sums_hardly_grows_with_the_archive(monkeypatch):
    monkeypatch.setattr("airswing.compass.fleet.reference_equations.MOST_BLOCKS", 4000)

    def peak(days: int) -> int:
        blocks = [[one] for one in fleet(days, a_segment=40)]
        solve_fleet(blocks, FREE)
        tracemalloc.start()
        solve_fleet(blocks, FREE)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(160) < 1.2 * peak(40)
