"""The field test: the seed's arithmetic and honest intervals."""

from __future__ import annotations

from datetime import date

import pytest

from airswing.errors import InputError
from airswing.evaluation.field_test import adjusted_reductions, field_test
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
    for seed in range(60):
        fleet = simulate_fleet(seed, days=(25, 25), corrected=6, controls=5, flights=2, reports=4)
        low, high = run(fleet, draws=300)["adjusted_reduction_ci_kt"]
        inside += low <= fleet.true_adjusted <= high
    # 60 draws of a 95 % interval fall below 51 with probability 0.1 %.
    assert inside >= 51


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


def test_regression_to_the_mean_shows_where_the_worst_were_chosen():
    fleet = simulate_fleet(3, days=(10, 10), flights=1, reports=2, compass_kt=(2, 2, 2, 2))
    spurious = run(fleet)["regression_to_the_mean"]["spurious_reduction_kt"]
    assert spurious > 0.5  # nothing was corrected: choosing the worst alone makes this


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
