"""The assumptions' rows: what passes, what fails, and what cannot be told."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from airswing.gap.checks.assumptions import assumptions
from airswing.gap.checks.calibration import Calibration
from airswing.gap.checks.negative_control import Decoy
from airswing.gap.search.stepwise import Found

GOOD = Calibration(np.full(20, 100), 0.57, 0.57, 1.0, 0.01, 0.005, 0.52, 0.01)


def _noise(measured, model):
    return SimpleNamespace(
        autocovariance=np.asarray(measured, float),
        autocovariance_model=np.asarray(model, float),
        pair_count=np.full(len(measured), 1000.0),
        distance_km=np.arange(len(measured)) * 50.0,
    )


def _score(scope, factor):
    candidate = SimpleNamespace(scope=scope, known=True)
    return SimpleNamespace(candidate=candidate, factor=factor)


def _rows(*, noise=None, after=GOOD, decoy=None, clipped=1.0, left=()):
    stats = SimpleNamespace(
        day_count=np.full((2, 5), 100.0), clipped=np.array([clipped, 0.0]), gross=np.zeros(2)
    )
    return assumptions(
        base=SimpleNamespace(stats=stats),
        noise=noise or _noise([4, 2, 1], [4, 2.1, 1]),
        found=Found((), None, (), tuple(left)),
        after=after,
        decoy=decoy or Decoy(0.01, 0.0, (-0.01, 0.01), 4),
    )


def _failed(**wrong):
    return [k for k, row in enumerate(_rows(**wrong)) if not row.ok]


def test_all_is_well():
    assert _failed() == []
    assert all(row.result for row in _rows())


def test_each_failure_is_told_apart():
    assert _failed(noise=_noise([4, 2, 1], [4, 3, 1])) == [0]
    lean = np.full(20, 100)
    lean[0] = 300
    values = vars(GOOD)
    assert _failed(after=Calibration(**values | {"pit_count": lean})) == [1]
    assert _failed(after=Calibration(**values | {"spread": 1.3})) == [1]
    assert _failed(after=Calibration(**values | {"lag_one": -0.2})) == [2]
    assert _failed(after=Calibration(**values | {"auc": 0.8})) == [3]
    assert _failed(clipped=50.0) == [4]
    assert _failed(decoy=Decoy(0.2, 0.1, (0.05, 0.15), 4)) == [5]


def test_misfit_is_placed():
    row = _rows(noise=_noise([4, 2, 1], [4, 3, 1]))[0]
    assert row.result == "largest misfit 25 % of the variance, at 50 km"


def test_what_cannot_be_told_is_no_pass():
    assert _failed(after=Calibration(**vars(GOOD) | {"auc": float("nan")})) == [3]
    few = _noise([4, 2], [4, 2])
    few.pair_count[:] = 1
    assert _failed(noise=few) == [0]
    assert "too few" in _rows(noise=few)[0].result


def test_cluster_factors_of_aircraft_and_fleet_have_rows_of_their_own():
    left = [_score("aircraft", 1.2), _score("fleet", 12.0)]
    rows = _rows(left=left)[5:7]
    assert [row.ok for row in rows] == [True, False]
    assert "fleet" in rows[1].assumption
