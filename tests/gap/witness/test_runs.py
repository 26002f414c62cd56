"""Runs: one amount in neighbouring cells of some aircraft, beside tables that leave all open."""

from __future__ import annotations

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.gap.diagnose import diagnose
from airswing.gap.witness.fitted_tables import LEAST_EVIDENCE
from airswing.gap.witness.runs import _inside, evidence, spans

AIRCRAFT, CELLS = 14, 16
INFORMATION = 40.0


def archive(seed: int, amount: float, own: list[int], cells: list[int]) -> tuple[np.ndarray, ...]:
    """Scores and information of every aircraft and run, an amount in some cells of some of them."""
    rng = np.random.default_rng(seed)
    cell_score = np.sqrt(INFORMATION) * rng.standard_normal((AIRCRAFT, CELLS))
    cell_score[np.ix_(own, cells)] += INFORMATION * amount
    inside = _inside(spans("linear", CELLS), CELLS)
    gram = np.tile(INFORMATION * inside.sum(axis=1), (AIRCRAFT, 1))
    return cell_score @ inside.T, gram


def test_a_small_amount_of_some_aircraft_is_told_with_its_cells_aircraft_and_size() -> None:
    own, cells = [1, 4, 6, 9], [12, 13, 14]
    score, gram = archive(0, 0.45, own, cells)
    nats, place, tails, size = evidence(score, gram, (1.0, np.ones(score.shape[1])), 0.0)
    assert nats > LEAST_EVIDENCE
    assert spans("linear", CELLS)[place].tolist() == [12, 15]
    assert list(tails) == own
    assert size == pytest.approx(0.45, abs=0.1)


def test_nothing_is_told_where_nothing_is() -> None:
    told = [evidence(*archive(s, 0.0, [], []), (1.0, np.ones(135)), 0.0)[0] for s in range(12)]
    assert max(told) < 3.0


def test_what_days_of_the_fleet_share_and_what_lasts_is_no_evidence() -> None:
    score, gram = archive(0, 0.3, list(range(AIRCRAFT)), [3, 4])
    alone = evidence(score, gram, (1.0, np.ones(135)), 0.0)
    assert alone[2] == tuple(range(AIRCRAFT))
    assert evidence(score, gram, (1.0, np.full(135, 6.0)), 0.0)[0] < alone[0] - 5
    assert evidence(score, gram, (1.0, np.ones(135)), 0.2)[0] < alone[0] - 5


@pytest.mark.parametrize(("kind", "size", "number"), [("linear", 4, 9), ("circular", 4, 8)])
def test_runs_are_of_neighbours_and_go_through_zero_where_a_variable_turns(
    kind: str, size: int, number: int
) -> None:
    ends = spans(kind, size)
    assert len(ends) == number
    inside = _inside(ends, size)
    assert (inside.sum(axis=1) == ends[:, 1] - ends[:, 0]).all()
    through = any(row[0] and row[-1] for row in inside)
    assert through == (kind == "circular")
    assert spans("category", 3).tolist() == [[0, 1], [1, 2], [2, 3]]


def test_a_season_of_the_models_error_in_one_region_is_no_unknown_of_the_fleet() -> None:
    """Of the toy's model, off by 0.4 m/s in waves of 1500 km that last all days."""
    frame = make_frame(seed=16, aircraft=6, days=14, noise=1.5)
    report = diagnose(frame, catalogue={}).report
    assert not report.unknown.where
