"""Gains by aircraft and day against hand-made ones; prediction and outcome side by side."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet

from airswing.evaluation.backtest.gains import Apart, Gain, compared, gains_of
from airswing.evaluation.backtest.learning import fitted, judged_blocks

NAMES = xr.Dataset({"aircraft": ("aircraft", ["a", "b", "c"])})


def entry(name: str, gain: float | None, error: float = 0.5) -> dict:
    return {
        "aircraft": name,
        "expected_gain_kt": gain,
        "expected_gain_standard_error_kt": error,
    }


def gain(values: list[float], counts: list[float]) -> Gain:
    return Gain(np.arange(len(values)), np.array(values, float), np.array(counts, float))


def test_gains_are_summed_by_day_over_the_judged_reports():
    day = np.datetime64("2009-10-20", "ns")
    hours = np.array([1, 2, 30, 3, 31]) * np.timedelta64(1, "h")
    block = xr.Dataset({"time": ("report", day + hours), "row_size": ("aircraft", [3, 2])})
    judged = np.array([True, True, True, True, False])
    one, two = gains_of(block, np.array([1.0, 2.0, 4.0, 8.0, 16.0]), judged)
    first = int(day.astype("M8[D]").astype(int))
    assert one.day.tolist() == [first, first + 1]
    assert (one.total.tolist(), one.counts.tolist(), one.reports) == ([3.0, 4.0], [2.0, 1.0], 3)
    assert (two.day.tolist(), two.total.tolist()) == ([first], [8.0])


def test_the_fleet_is_weighted_by_its_judged_reports():
    gains = [gain([6.0, 6.0], [2, 2]), gain([1.0, 1.0], [6, 6]), gain([], [])]
    ranking = [entry("a", 2.0), entry("b", 1.0), entry("c", 5.0)]
    found = compared(NAMES, gains, ranking, draws=200, seed=1)
    assert [one["aircraft"] for one in found["by_aircraft"]] == ["a", "b"]
    assert found["by_aircraft"][0]["realised_gain_kt"] == 3.0
    assert found["realised_gain_kt"] == pytest.approx(14.0 / 16.0)
    assert found["predicted_gain_kt"] == pytest.approx((4 * 2.0 + 12 * 1.0) / 16)
    # independent errors of 0.5 with weights 1/4 and 3/4
    assert found["predicted_standard_error_kt"] == pytest.approx(0.5 * np.sqrt(10) / 4)


def test_agreement_asks_for_the_interval_of_the_difference():
    same = [gain([3.0] * 5, [1] * 5)]  # no spread over days: the prediction's error alone
    one = NAMES.isel(aircraft=[0])
    assert compared(one, same, [entry("a", 2.1)], draws=50, seed=1)["agree"]
    assert not compared(one, same, [entry("a", 1.9)], draws=50, seed=1)["agree"]


def test_one_day_tells_no_interval_and_no_verdict():
    one = NAMES.isel(aircraft=[0])
    found = compared(one, [gain([4.0], [2])], [entry("a", 2.0)], draws=50, seed=1)
    assert found["realised_gain_kt"] == 2.0
    assert np.isnan(found["realised_gain_ci_kt"]).all()
    assert found["agree"] is None and found["by_aircraft"][0]["agree"] is None


def test_without_a_prediction_there_is_nothing_to_compare():
    found = compared(
        NAMES.isel(aircraft=[0]), [gain([1.0], [1])], [entry("a", None)], draws=10, seed=1
    )
    assert found == {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}


def test_blocks_are_judged_as_the_whole():
    headings = fleet(3, Setting(aircraft=2, days=20), amplitude=5.0)[0]
    fits = fitted(headings, {"ruc": ["ruc"]}, "ruc", joint=False)
    told = [Apart.of(block, fits, ["ruc"], "ruc") for block, _ in judged_blocks(headings)]
    whole = Apart.of(headings, fits, ["ruc"], "ruc")
    assert np.concatenate([one.after for one in told]) == pytest.approx(whole.after, nan_ok=True)
    assert whole.done.any()
