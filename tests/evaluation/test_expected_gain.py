"""The ranking: expected gain by hand, its order, its intervals."""

from __future__ import annotations

import numpy as np
import pytest

from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.gains import expected_gain, rank_aircraft
from tests.compass.flown import Setting
from tests.evaluation.archives import flown

AMPLITUDE = np.array([6.0, 0.0, 3.0, 1.5])


@pytest.fixture(scope="module")
def ranked():
    deviation = np.zeros((4, 5))
    deviation[:, 1] = AMPLITUDE
    ds = flown(deviation, Setting(aircraft=4, days=40), 2)
    fits = fit_deviation(ds)
    return ds, fits, rank_aircraft(ds, fits, pools={"ruc": ["ruc"]}, reference="ruc")


def by_hand(spread_deg: float) -> tuple[float, float, np.ndarray]:
    """Four headings, calm reference, exact unit 10 degrees off at every heading, 100 m/s."""
    heading = np.radians([0.0, 90.0, 180.0, 270.0])
    shown = np.radians(10.0)
    u = 100 * (np.sin(heading - shown) - np.sin(heading))
    v = 100 * (np.cos(heading - shown) - np.cos(heading))
    noise = np.array([1.0, -1.0, 1.0, -1.0])
    covariance = np.zeros((5, 5))
    covariance[0, 0] = spread_deg**2
    return expected_gain(
        np.stack([u + noise, v]),
        np.zeros((2, 4)),
        heading,
        heading,
        np.full(4, 100.0),
        np.arange(4),
        np.array([10.0, 0, 0, 0, 0]),
        covariance,
        draws=200,
    )


def test_the_gain_by_hand():
    """The unit's error is 2 V sin 5 deg = 17.43 m/s; the noise of 1 m/s is left."""
    before, gain, _ = by_hand(0.0)
    assert before == pytest.approx(2 * 100 * np.sin(np.radians(5.0)), abs=0.1)
    assert gain == pytest.approx(before - 1.0, abs=1e-9)


def test_an_uncertain_curve_is_expected_to_gain_less_by_its_optimism():
    """0.1 degrees at 100 m/s is s = 0.1745 m/s; 2 s^2 pi / 8 = 0.0239 m/s with |e| = 1."""
    _, certain, _ = by_hand(0.0)
    _, uncertain, drawn = by_hand(0.1)
    assert certain - uncertain == pytest.approx(2 * 0.17453**2 * np.pi / 8, rel=1e-3)
    assert drawn.std() > 0.1


def test_the_worst_compass_comes_first_and_a_good_one_gains_nothing(ranked):
    _, _, ranking = ranked
    assert [entry["aircraft"] for entry in ranking] == ["N000", "N002", "N003", "N001"]
    assert [entry["rank"] for entry in ranking] == [1, 2, 3, 4]
    assert abs(ranking[-1]["expected_gain_kt"]) < 0.15
    for entry in ranking:
        low, high = entry["expected_gain_ci_kt"]
        assert low <= entry["expected_gain_kt"] <= high
        assert entry["rank_ci"][0] <= entry["rank"] <= entry["rank_ci"][1]


def test_an_aircraft_without_a_fit_is_last_with_its_reason(ranked):
    ds, _, _ = ranked
    few = ds.copy(deep=True)
    few["screening"][50 : ds.sizes["report"] // 4] = 1
    fits = fit_deviation(few)
    ranking = rank_aircraft(few, fits, pools={"ruc": ["ruc"]}, reference="ruc")
    assert ranking[-1]["aircraft"] == "N000"
    assert ranking[-1]["rank"] is None
    assert "too_few_reports" in ranking[-1]["why"]


@pytest.mark.filterwarnings("error")
def test_one_day_leaves_the_interval_open(ranked):
    ds, fits, _ = ranked
    day = ds["time"].to_numpy().astype("datetime64[D]")
    few = ds.copy(deep=True)
    few["screening"][day != day[0]] = 1
    ranking = rank_aircraft(few, fits, pools={"ruc": ["ruc"]}, reference="ruc")
    assert np.isfinite(ranking[0]["expected_gain_kt"])
    assert np.isnan(ranking[0]["expected_gain_ci_kt"]).all()


def test_an_unknown_reference_is_named(ranked):
    ds, fits, _ = ranked
    with pytest.raises(InputError, match="rr"):
        rank_aircraft(ds, fits, pools={"ruc": ["ruc"]}, reference="rr")
