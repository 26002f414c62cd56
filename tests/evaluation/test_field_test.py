"""The field test: its arithmetic, its intervals, and what it refuses."""

from datetime import date, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import rice

from airswing.errors import ConfigError, InputError
from airswing.evaluation.field_test import (
    DaySums,
    adjusted_reductions,
    field_test,
    regression_to_the_mean,
)
from airswing.flags import QC, ROLL
from airswing.units import KNOT
from tests.ragged import ragged

START = date(2009, 10, 20)
NOISE_KT = (5.4, 6.4)  # before and during the test
COMPASS_KT = ((5.0, 2.6), (1.5, 1.5))  # corrected aircraft and controls, before and during


def simulate_fleet(seed, *, corrected=19, controls=17, days=(60, 60), flights=3, reports=6):
    """Draw a fleet whose mean disagreement with the reference is known, before and during the test.

    The wind error of a report is the sum of a day's model error shared by the fleet, the flight's,
    white noise, and a vector of fixed length an aircraft for its compass: a Rice distribution.
    """
    rng = np.random.default_rng(seed)
    number, per_day = corrected + controls, flights * reports
    names = [f"N{i:03d}" for i in range(number)]
    day = np.repeat(np.arange(sum(days)), per_day)
    during = (day >= days[0]).astype(int)
    shape = (number, day.size, 2)
    # the day's error of the fleet, that of the flight, and that of the report
    error = rng.normal(size=(sum(days), 2))[day] + rng.normal(size=shape)
    flight = np.repeat(np.arange(sum(days) * flights), reports)
    error += rng.normal(size=(number, flight[-1] + 1, 2))[:, flight]
    error *= np.array(NOISE_KT)[during][:, None] / np.sqrt(3.0)
    # a vector of fixed length (aircraft, window) in a random direction
    size = np.repeat(COMPASS_KT, [corrected, controls], axis=0)
    size = size * rng.gamma(20.0, 1.0 / 20.0, (number, 1))
    angle = rng.uniform(0, 2 * np.pi, shape[:2])
    error += size[:, during, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    east, north = error.reshape(-1, 2).T * KNOT
    hour = np.tile(np.linspace(1.0, 23.0, per_day), sum(days))
    time = np.datetime64(START - timedelta(days=days[0]), "s") + (
        day * 86400 + (hour * 3600).astype(int)
    ).astype("m8[s]")
    zeros = np.zeros((1, east.size))
    columns = {
        "time": np.tile(time, number).astype("M8[ns]"),
        "eastward_wind": east,
        "northward_wind": north,
        "reference_eastward_wind": zeros,
        "reference_northward_wind": zeros,
        "heading": rng.uniform(0, 360, east.size),
        "roll_flag": np.full(east.size, ROLL["good"], np.int8),
        "temperature_qc": np.full(east.size, QC["pass"], np.int8),
        "screening": np.zeros(east.size, np.int32),
    }
    headings = ragged(columns, np.full(number, day.size), names, ["rr"])
    true = rice.mean(size / NOISE_KT, scale=NOISE_KT)  # (aircraft, window)
    groups = {"corrected": slice(corrected), "controls": slice(corrected, None)}
    levels = {name: true[group].mean(axis=0) for name, group in groups.items()}
    members = {name: names[group] for name, group in groups.items()}
    return SimpleNamespace(headings=headings, levels=levels, **members)


def run(fleet, headings=None, **options):
    asked = {"start": START, "before_start": date(2009, 7, 20), "draws": 400}
    asked |= {"corrected": fleet.corrected, "controls": fleet.controls}
    asked |= {"pools": {"rr": ["rr"]}, "reference": "rr"}
    return field_test(fleet.headings if headings is None else headings, **(asked | options))


def test_the_seeds_table_gives_its_adjusted_reduction_both_ways():
    linear, quadrature = adjusted_reductions(8.86, 7.62, 6.96, 8.19)
    assert linear == pytest.approx(2.47, abs=1e-9)
    assert quadrature == pytest.approx(2.24, abs=0.005)


def test_intervals_hold_the_truth_over_many_fleets():
    inside = 0
    for seed in range(20):
        fleet = simulate_fleet(seed, days=(25, 25), corrected=6, controls=5, flights=2, reports=4)
        low, high = run(fleet, draws=300)["adjusted_reduction_ci_kt"]
        rise, of_controls = (np.diff(fleet.levels[name]) for name in ("corrected", "controls"))
        inside += low <= of_controls - rise <= high
    # 20 draws of a 95 % interval fall below 16 with probability 0.3 %
    assert inside >= 16


def test_a_fleet_built_to_the_seeds_numbers_gives_its_table():
    fleet = simulate_fleet(1)
    result = run(fleet)
    for group in ("corrected", "controls"):
        entry = result["groups"][group]
        pair = entry["before_kt"], entry["during_kt"]
        assert pair == pytest.approx(fleet.levels[group], abs=0.35)
        assert entry["reduction_kt"] == pytest.approx(entry["before_kt"] - entry["during_kt"])
    assert result["groups"]["corrected"]["aircraft"] == 19
    assert result["permutation"]["p_value_unconditional"] < 0.01
    assert result["groups"]["controls"]["reports_before"] == 17 * 60 * 18


def test_means_by_hand():
    """Every mean is that of the reports of its group and window; other aircraft do not count."""
    fleet = simulate_fleet(2, days=(4, 3), corrected=3, controls=3, flights=1, reports=3)
    fleet.controls.pop()  # of neither group
    result = run(fleet, draws=50)
    ds = fleet.headings
    speed = np.hypot(ds["eastward_wind"], ds["northward_wind"]).to_numpy() / KNOT
    names = np.repeat(ds["aircraft"].to_numpy(), ds["row_size"].to_numpy())
    during = ds["time"].to_numpy() >= np.datetime64(START)
    for group, members in (("corrected", fleet.corrected), ("controls", fleet.controls)):
        for window, days in (("before", ~during), ("during", during)):
            rows = np.isin(names, members) & days
            entry = result["groups"][group]
            assert entry[f"{window}_kt"] == pytest.approx(speed[rows].mean())
            assert entry[f"reports_{window}"] == rows.sum()
    assert (result["days_before"], result["days_during"]) == (4, 3)
    levels = {entry["aircraft"]: entry for entry in result["by_aircraft"]}
    assert set(levels) == {*fleet.corrected, *fleet.controls}
    rows = (names == fleet.corrected[1]) & during
    assert levels[fleet.corrected[1]]["during_kt"] == pytest.approx(speed[rows].mean())


def test_regression_to_the_mean_by_hand():
    """One report a day; the worst two fall by 4 and 2, the others rise by 1 and 0."""
    total = np.array([[9, 9, 5, 5, 5, 5], [8, 8, 6, 6, 5, 5], [5, 5, 6, 6, 5, 5], [4.0] * 6])
    during = np.arange(6) >= 4
    sums = DaySums(np.ones((4, 6)), total, np.array([False, True, True, False]), during)
    content = regression_to_the_mean(sums)
    assert content["spurious_reduction_kt"] == pytest.approx(3.0 - -0.5)
    assert content["rule"].startswith("the 2 aircraft")
    none = DaySums(np.ones((4, 6)), total, np.ones(4, bool), during)
    assert "too few" in regression_to_the_mean(none)["why"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"corrected": ["N999"]}, ["N999", "does not hold"]),
        ({"controls": ["N000"]}, ["N000", "both groups"]),
        ({"controls": []}, ["no aircraft", "controls"]),
        ({"start": date(2011, 1, 1), "before_start": date(2010, 1, 1)}, ["no usable report"]),
        ({"reference": "nam"}, ["nam", "no such reference", "rr"]),
    ],
)
def test_bad_groups_and_windows_are_named(options, words):
    fleet = simulate_fleet(0, days=(5, 5), corrected=3, controls=3, flights=1, reports=2)
    with pytest.raises(InputError) as caught:
        run(fleet, **options)
    assert all(word in str(caught.value) for word in words)


def test_a_flag_that_no_report_has_is_noted_and_not_required():
    fleet = simulate_fleet(0, days=(5, 5), corrected=3, controls=3, flights=1, reports=2)
    fleet.headings["roll_flag"][:] = 0
    assert "roll_flag" in run(fleet)["notes"][0]
    assert "roll_flag" in run(fleet, fleet.headings.drop_vars("roll_flag"))["notes"][0]


def test_an_absent_flag_rejects_no_report_and_an_unknown_policy_is_refused():
    fleet = simulate_fleet(0, days=(5, 5), corrected=3, controls=3, flights=1, reports=2)
    without = fleet.headings.drop_vars(["roll_flag", "temperature_qc"])
    policies = {"roll": "reject_bad", "temperature_qc": "reject_fail"}
    assert run(fleet, without, **policies)["groups"] == run(fleet)["groups"]
    with pytest.raises(ConfigError, match=r"field_test\.roll"):
        run(fleet, roll="good")
