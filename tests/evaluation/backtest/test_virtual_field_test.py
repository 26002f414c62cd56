"""The virtual field test: what was predicted comes out on later reports."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet

from airswing.errors import InputError
from airswing.evaluation.backtest.virtual_field_test import predicted_reduction, virtual_field_test

SETTING = Setting(aircraft=5, days=50, outliers=0.005)
AGAINST = {"pools": {"ruc": ["ruc"]}, "reference": "ruc"}
QUICK = AGAINST | {"joint": False}
UNTIL = date(2008, 8, 1)


@pytest.fixture(scope="module")
def headings():
    return fleet(3, SETTING, amplitude=5.0)[0]


def test_predicted_and_realised_gains_agree_over_many_fleets():
    scores = []
    for seed in range(12):
        ds = fleet(seed, SETTING, amplitude=5.0)[0]
        found = virtual_field_test(ds, learned_until=UNTIL, draws=300, **QUICK)
        for entry in found["by_aircraft"]:
            low, high = entry["difference_ci_kt"]
            scores.append(entry["difference_kt"] / ((high - low) / 3.92))
    scores = np.array(scores)
    assert scores.size >= 55
    # 60 standard scores: the mean within 3 / sqrt(60), 86 % or more inside 95 % intervals.
    assert abs(scores.mean()) < 0.4
    assert np.mean(np.abs(scores) < 1.96) >= 0.86
    assert np.abs(scores).max() < 4.5


def test_the_gain_is_what_the_corrected_winds_themselves_show(headings):
    found = virtual_field_test(headings, learned_until=UNTIL, draws=50, **AGAINST)
    group = found["groups"]["corrected"]
    assert set(found["groups"]) == {"corrected"}
    fall = group["during_uncorrected_kt"] - group["during_kt"]
    assert found["realised_gain_kt"] == pytest.approx(fall, abs=1e-9)
    low, high = found["realised_gain_ci_kt"]
    assert low < found["realised_gain_kt"] < high


def test_controls_keep_their_winds_and_any_split_will_do(headings):
    found = virtual_field_test(
        headings, learned_until=UNTIL, corrected=["N001", "N003"], draws=50, **QUICK
    )
    controls = found["groups"]["controls"]
    assert controls["during_kt"] == controls["during_uncorrected_kt"]
    assert controls["aircraft"] == 3
    assert {entry["aircraft"] for entry in found["by_aircraft"]} == {"N001", "N003"}


def test_nothing_after_the_date_reaches_the_fit(headings):
    """Ruin every later wind: the prediction stays what it was to the last bit."""
    late = headings["time"].to_numpy() >= np.datetime64(UNTIL)
    ruined = headings.copy(deep=True)
    for name in ("heading_error", "airspeed_error"):
        ruined[name][:, late] = 40.0
    ruined["eastward_wind"][late] += 30.0
    one, two = (
        virtual_field_test(ds, learned_until=UNTIL, draws=20, **QUICK) for ds in (headings, ruined)
    )
    assert one["predicted_gain_kt"] == two["predicted_gain_kt"]
    assert one["realised_gain_kt"] != two["realised_gain_kt"]


def test_the_prediction_for_a_field_test_uses_the_corrected_aircraft_only(headings):
    found = predicted_reduction(headings, start=UNTIL, corrected=["N002"], **QUICK)
    own = next(entry for entry in found["ranking"] if entry["aircraft"] == "N002")
    assert found["predicted_reduction_kt"] == pytest.approx(own["expected_gain_kt"])
    assert found["predicted_aircraft"] == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"corrected": ["N999"]}, ["N999", "does not hold"]),
        ({"corrected": []}, ["no aircraft"]),
        ({"learned_until": date(2001, 1, 1)}, ["2001-01-01", "2008-07-01"]),
        ({"learned_until": date(2020, 1, 1)}, ["no screened report from"]),
        ({"reference": "nam"}, ["nam", "ruc"]),
    ],
)
def test_bad_input_is_named(headings, options, words):
    asked = {"learned_until": UNTIL, "draws": 10} | QUICK | options
    with pytest.raises(InputError) as caught:
        virtual_field_test(headings, **asked)
    assert all(word in str(caught.value) for word in words), str(caught.value)
