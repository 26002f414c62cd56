"""The field test: its arithmetic, its intervals, and what it refuses."""

from datetime import date

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.evaluation.field_test import (
    DaySums,
    adjusted_reductions,
    field_test,
    regression_to_the_mean,
)
from airswing.units import KNOT
from tests.evaluation.fleets import START, simulate_fleet


def run(fleet, **options):
    asked = {
        "start": START,
        "before_start": date(2009, 7, 20),
        "corrected": fleet.corrected,
        "controls": fleet.controls,
        "pools": {"rr": ["rr"]},
        "reference": "rr",
        "draws": 400,
    }
    return field_test(fleet.headings, **(asked | options))


def test_the_seeds_table_gives_its_adjusted_reduction_both_ways():
    linear, quadrature = adjusted_reductions(8.86, 7.62, 6.96, 8.19)
    assert linear == pytest.approx(2.47, abs=1e-9)
    assert quadrature == pytest.approx(2.24, abs=0.005)


def test_intervals_hold_the_truth_over_many_fleets():
    inside = 0
    for seed in range(20):
        fleet = simulate_fleet(seed, days=(25, 25), corrected=6, controls=5, flights=2, reports=4)
        low, high = run(fleet, draws=300)["adjusted_reduction_ci_kt"]
        inside += low <= fleet.true_adjusted <= high
    # 20 draws of a 95 % interval fall below 16 with probability 0.3 %
    assert inside >= 16


def test_a_fleet_built_to_the_seeds_numbers_gives_its_table():
    fleet = simulate_fleet(1)
    result = run(fleet)
    for group in ("corrected", "controls"):
        entry = result["groups"][group]
        assert entry["before_kt"] == pytest.approx(fleet.true_before[group], abs=0.35)
        assert entry["during_kt"] == pytest.approx(fleet.true_during[group], abs=0.35)
        assert entry["reduction_kt"] == pytest.approx(entry["before_kt"] - entry["during_kt"])
    assert result["groups"]["corrected"]["aircraft"] == 19
    assert result["permutation"]["p_value_unconditional"] < 0.01
    assert result["groups"]["controls"]["reports_before"] == 17 * 60 * 18


def test_means_by_hand_and_blocks_of_aircraft_make_no_difference(monkeypatch):
    """Every mean is that of the reports of its group and window; other aircraft do not count."""
    fleet = simulate_fleet(2, days=(4, 3), corrected=3, controls=3, flights=1, reports=3)
    fleet.controls.pop()  # of neither group
    result = run(fleet, draws=50)
    ds = fleet.headings
    speed = np.hypot(ds["eastward_wind"], ds["northward_wind"]).to_numpy() / KNOT
    names = np.repeat(ds["aircraft"].to_numpy(), ds["row_size"].to_numpy())
    during = ds["time"].to_numpy() >= np.datetime64(START)
    for group, members in (("corrected", fleet.corrected), ("controls", fleet.controls)):
        for window, chosen in (("before", ~during), ("during", during)):
            rows = np.isin(names, members) & chosen
            entry = result["groups"][group]
            assert entry[f"{window}_kt"] == pytest.approx(speed[rows].mean())
            assert entry[f"reports_{window}"] == rows.sum()
            components = result["components"][group][window]
            assert components["reports"] == rows.sum()
            assert components["mean_vector"] == pytest.approx(speed[rows].mean() * KNOT)
    assert (result["days_before"], result["days_during"]) == (4, 3)
    levels = {entry["aircraft"]: entry for entry in result["by_aircraft"]}
    assert set(levels) == {*fleet.corrected, *fleet.controls}
    rows = (names == fleet.corrected[1]) & during
    assert levels[fleet.corrected[1]]["during_kt"] == pytest.approx(speed[rows].mean())
    monkeypatch.setattr("airswing.products.ragged.BLOCK_REPORTS", 10)
    parts = run(fleet, draws=50)
    assert parts["groups"]["corrected"]["before_kt"] == pytest.approx(
        result["groups"]["corrected"]["before_kt"]
    )


def test_the_worst_of_the_first_half_fall_by_themselves():
    """One report a day; the worst two fall by 4 and 2, the others rise by 1 and 0."""
    total = np.array([[9, 9, 5, 5, 5, 5], [8, 8, 6, 6, 5, 5], [5, 5, 6, 6, 5, 5], [4.0] * 6])
    during = np.arange(6) >= 4
    sums = DaySums(np.ones((4, 6)), total, np.array([False, True, True, False]), during)
    found = regression_to_the_mean(sums)
    assert found["spurious_reduction_kt"] == pytest.approx(3.0 - -0.5)
    assert found["rule"].startswith("the 2 aircraft")
    none = DaySums(np.ones((4, 6)), total, np.ones(4, bool), during)
    assert "too few" in regression_to_the_mean(none)["why"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"corrected": ["N999"]}, ["N999", "does not hold"]),
        ({"controls": ["N000"]}, ["N000", "both groups"]),
        ({"controls": []}, ["no aircraft", "controls"]),
        ({"start": date(2011, 1, 1), "before_start": date(2010, 1, 1)}, ["no usable report"]),
    ],
)
def test_bad_groups_and_windows_are_named(options, words):
    fleet = simulate_fleet(0, days=(5, 5), corrected=3, controls=3, flights=1, reports=2)
    with pytest.raises(InputError) as caught:
        run(fleet, **options)
    assert all(word in str(caught.value) for word in words)


def test_a_flag_no_report_carries_cannot_be_required_and_is_said():
    fleet = simulate_fleet(0, days=(5, 5), corrected=3, controls=3, flights=1, reports=2)
    fleet.headings["roll_flag"][:] = 0
    assert "roll_flag" in run(fleet)["notes"][0]
