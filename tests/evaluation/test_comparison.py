"""Comparison: equal references are poolable, a biased one is not; cost of long intervals."""

from dataclasses import replace

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.evaluation.comparison import compare, hats_of, regional_bias
from airswing.products.ragged import aircraft_of_report
from tests.evaluation.archives import LASTING_ERRORS as SETTING
from tests.evaluation.archives import day_number, references

TWO = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}


def test_references_of_equal_truth_are_poolable_and_intervals_contain_zero():
    # verdicts and differences of A to E do not depend on the fits: the quickest is used
    equal = [compare(references(seed, SETTING), pools=TWO, joint=False) for seed in range(5)]
    # of 95 % each; the benchmark measures the rate
    assert sum(comparison["pairs"][0]["poolable"] for comparison in equal) >= 4
    entries = [entry for comparison in equal for entry in comparison["pairs"][0]["aircraft"]]
    assert len(entries) >= 20
    for name in (*"ABCDE", "offset", "amplitude", "phase"):
        bounds = [entry[name]["ci"] if name in entry else entry["ci"][name] for entry in entries]
        inside = np.mean([low <= 0 <= high for low, high in bounds])
        assert inside >= (0.84 if name in "ABCDE" else 0.75)


@pytest.mark.parametrize("without", ["a second reference", "a common report"])
def test_references_that_cannot_be_compared_are_refused(without):
    ds = references(1, replace(SETTING, days=6))
    half = np.arange(ds.sizes["report"]) % 2 == 0
    ds["reference_eastward_wind"][0, half] = np.nan
    ds["reference_eastward_wind"][1, ~half] = np.nan
    with pytest.raises(InputError, match=r"two references|every reference"):
        compare(ds, pools={"ruc": ["ruc"]} if without == "a second reference" else TWO)


def test_a_regional_bias_of_one_metre_a_second_is_not_poolable():
    for seed in range(2):
        ds = references(seed, SETTING, regional={"rtfdaa": 1.0})
        pair = compare(ds, pools=TWO, joint=False)["pairs"][0]
        assert pair["poolable"] is False
        assert "eastward" in pair["why"]


def test_nam_is_compared_and_never_called_poolable():
    ds = references(1, replace(SETTING, references=3, days=40))
    pools = {**TWO, "nam": ["nam"], "ruc+rtfdaa": ["ruc", "rtfdaa"]}
    content = compare(ds, pools=pools, never_pool=["NAM"], joint=False)
    pairs = {tuple(pair["references"]): pair for pair in content["pairs"]}
    for reference in ("ruc", "rtfdaa"):
        pair = pairs[reference, "nam"]
        assert pair["poolable"] is False
        assert "never_pool" in pair["why"]
        assert len(pair["aircraft"]) == 8
    assert "never_pool" not in pairs["ruc", "rtfdaa"]["why"]
    # a pool of two differs from a member by half the difference of the members: one test
    pool, alone = pairs["ruc+rtfdaa", "ruc"], pairs["ruc", "rtfdaa"]
    assert [single["own_test"] for single in (pool, alone)] == [False, True]
    assert pool["fleet"]["p_value"] == pytest.approx(alone["fleet"]["p_value"])
    assert 2 * pool["fleet"]["curve_rms_deg"] == pytest.approx(alone["fleet"]["curve_rms_deg"])
    assert [len(entry["references"]) for entry in content["three_way"]] == [3]
    for name in ("by_lead_time", "by_phase", "by_level", "by_season"):
        assert content[name], name
    assert {entry["slice"] for entry in content["by_season"]} == {"JJA"}


def test_the_three_cornered_hat_by_hand_and_a_negative_variance():
    """Differences a-b, a-c, b-c with mean squares 1, 4, 9: (1+4-9)/2 = -2, (1+9-4)/2 = 3, 6."""
    count = np.array([100.0, 100.0])
    squares = {("a", "b"): 1.0 * count, ("a", "c"): 4.0 * count, ("b", "c"): 9.0 * count}
    (hat,) = hats_of(count, squares, ["a", "b", "c"])
    assert [entry["variance"] for entry in hat["errors"]] == pytest.approx([-2.0, 3.0, 6.0])
    assert hat["errors"][0]["component_rms"] is None


def test_a_regional_bias_by_hand():
    """Region 1 is 2 m/s off every day, region 0 not at all: no scatter, so no error."""
    sums = np.zeros((3, 9, 30))
    sums[0, :2], sums[1, 1] = 1.0, 2.0
    by_cell = {(e["region"], e["component"]): e for e in regional_bias(sums)}
    assert by_cell[1, "eastward"]["difference"] == 2.0
    assert by_cell[1, "eastward"]["contrast"] == 2.0
    assert by_cell[0, "eastward"]["contrast"] == -2.0
    assert by_cell[1, "eastward"]["difference_p_value"] < 1e-9
    assert by_cell[1, "northward"]["difference"] == 0.0


def test_a_report_without_a_magnetic_heading_is_left_out():
    ds = references(0, SETTING)
    heading = ds["magnetic_heading"].to_numpy().copy()
    heading[::50] = np.nan
    holed = ds.assign(magnetic_heading=("report", heading))
    complete, reduced = (compare(case, pools=TWO, joint=False)["reports"] for case in (ds, holed))
    assert reduced == complete - np.isnan(heading).sum()


def test_an_aircraft_with_one_day_does_not_change_the_comparison():
    """Its day leaves no scatter about eight coefficients: it has no difference."""
    ds = references(3, replace(SETTING, days=40, reports_a_flight=30))
    late = (aircraft_of_report(ds) == 7) & (day_number(ds) > 0)
    short = ds.assign(screening=("report", late.astype(np.int32)))
    without = ds.isel(report=aircraft_of_report(ds) < 7, aircraft=slice(7))
    pairs = [compare(case, pools=TWO, joint=False)["pairs"][0] for case in (short, without)]
    with_short, without_it = (pair["fleet"] for pair in pairs)
    assert [with_short["aircraft"], without_it["aircraft"]] == [8, 7]
    assert len(pairs[0]["aircraft"]) == 7
    for name in "ABCDE":
        difference = with_short["difference"][name] - without_it["difference"][name]
        assert abs(difference) < 0.5 * without_it["standard_error"][name]
