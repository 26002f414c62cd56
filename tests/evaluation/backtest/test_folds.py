"""Folds: whole flights, spread over the days; marking leaves the original alone."""

from __future__ import annotations

import numpy as np
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet

from airswing.evaluation.backtest.folds import flight_folds, only

SETTING = Setting(aircraft=5, days=50, outliers=0.005)


@pytest.fixture(scope="module")
def headings():
    return fleet(3, SETTING, amplitude=5.0)[0]


def test_folds_hold_whole_flights_evenly_over_the_days(headings):
    number = flight_folds(headings, folds=4, seed=1).of(headings)
    flight = headings["flight"].to_numpy()
    for one in np.unique(flight)[::37]:
        assert np.unique(number[flight == one]).size == 1
    # 4 flights a day and aircraft and 4 folds: every fold holds each day once.
    day = headings["time"].to_numpy().astype("datetime64[D]")
    first = np.unique(flight, return_index=True)[1]
    row = np.repeat(np.arange(5), 200)
    for aircraft in range(5):
        mine = first[row == aircraft]
        for k in range(4):
            assert np.unique(day[mine][number[mine] == k]).size == 50


def test_only_marks_the_others_and_leaves_the_original_alone(headings):
    chosen = np.zeros(headings.sizes["report"], dtype=bool)
    chosen[:10] = True
    part = only(headings, lambda reports: chosen[: reports.sizes["report"]])
    assert (part["screening"].to_numpy() == 0).sum() == 10
    assert (headings["screening"].to_numpy() == 0).all()
