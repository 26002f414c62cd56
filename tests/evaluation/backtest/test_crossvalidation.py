"""Cross-validation: held-out flights show the predicted gain, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet, flown

from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.table import add_tables
from airswing.errors import InputError
from airswing.evaluation.backtest import crossvalidation
from airswing.evaluation.backtest.crossvalidation import cross_validate
from airswing.evaluation.backtest.learning import fitted
from airswing.evaluation.backtest.ranking import rank_aircraft

SETTING = Setting(aircraft=5, days=50, outliers=0.005)
AGAINST = {"pools": {"ruc": ["ruc"]}, "reference": "ruc"}
QUICK = AGAINST | {"joint": False}


@pytest.fixture(scope="module")
def headings():
    return fleet(3, SETTING, amplitude=5.0)[0]


def test_an_unbent_compass_gains_nothing_when_held_out():
    ds = flown(np.zeros((4, 5)), Setting(aircraft=4, days=30), 5)
    found = cross_validate(ds, folds=4, draws=100, **QUICK)
    # The curve bent to noise looks like a gain on its own reports and costs on others.
    assert found["in_sample_gain_kt"] > found["realised_gain_kt"]
    assert found["realised_gain_kt"] < 0.02
    assert found["predicted_gain_kt"] < 0.02


def test_held_out_flights_agree_with_the_prediction(headings):
    found = cross_validate(headings, folds=4, draws=200, **QUICK)
    assert found["agree"]
    assert found["realised_gain_kt"] > 1.0
    assert found["in_sample_gain_kt"] >= found["realised_gain_kt"] - 0.02


def test_fits_at_hand_are_not_made_again(headings, monkeypatch):
    options = {"folds": 3, "draws": 50, "resolution": 1.0}
    alone = cross_validate(headings, **options, **QUICK)
    fits = add_tables(fit_deviation(headings, joint=False), headings, resolution=1.0)
    ranking = rank_aircraft(headings, fits, **AGAINST)
    made = []
    monkeypatch.setattr(
        crossvalidation, "fitted", lambda *args, **kw: made.append(1) or fitted(*args, **kw)
    )
    assert cross_validate(headings, whole=(fits, ranking), **options, **QUICK) == alone
    assert len(made) == 3
    finer = cross_validate(headings, folds=3, draws=50, **QUICK)
    assert finer["realised_gain_kt"] > alone["realised_gain_kt"]  # whole degrees cost something


@pytest.mark.parametrize("folds", [1, 100_000])
def test_impossible_folds_are_refused(headings, folds):
    with pytest.raises(InputError, match="folds"):
        cross_validate(headings, folds=folds, **AGAINST)
