"""Screening: one report for each rule, the policies, the limits and the audit."""

import numpy as np
import pytest

from airswing.compass.screening import audit, mark_corrected_units, screen
from airswing.errors import ConfigError
from airswing.flags import PHASE, QC, ROLL, SCREENING
from tests.ragged import ragged

GOOD = {
    "phase": PHASE["cruise"],
    "roll_flag": ROLL["good"],
    "temperature_qc": QC["pass"],
    "wind_qc": QC["pass"],
    "turn": 1.0,
    "ground_speed": 130.0,
    "ground_velocity_error": 1.0,
    "airspeed": 120.0,
    "eastward_wind": 10.0,
    "northward_wind": -4.0,
}
WORST = {  # what breaks each rule and nothing else
    "phase": {"phase": PHASE["ascent"]},
    "roll": {"roll_flag": ROLL["bad"]},
    "temperature_qc": {"temperature_qc": QC["fail"]},
    "turn": {"turn": -10.5},
    "ground_speed": {"ground_speed": 40.0},
    "no_ground_vector": {"ground_velocity_error": 25.0},
    "no_reference": {"reference_eastward_wind": (np.nan, np.nan)},
    "missing_wind": {"eastward_wind": np.nan},
    "wind_qc": {"wind_qc": QC["fail"]},
    "gross_error": {"reference_northward_wind": (60.0, 60.0)},
}


def headings(*changes, row_size=None):
    """HEADINGS with one good report for each dict of changes."""
    reports = [{**GOOD, **change} for change in changes]
    columns = {name: np.array([r[name] for r in reports]) for name in GOOD}
    for name, default in (("east", (12.0, 11.0)), ("north", (-3.0, -5.0))):
        pairs = [change.get(f"reference_{name}ward_wind", default) for change in changes]
        columns[f"reference_{name}ward_wind"] = np.array(pairs, dtype=float).T
    columns["heading_error"] = columns["reference_eastward_wind"] * 0.1
    return ragged(columns, row_size or [len(reports)], reference=["ruc", "rtfdaa"])


def bits(ds, **options):
    return list(screen(ds, **options).screening.values)


def test_every_rule_has_its_bit_and_only_its_bit():
    # The field test's bit is set by mark_corrected_units, not by a rule of screen.
    assert [*WORST, "field_test"] == list(SCREENING)
    marked = bits(headings({}, *WORST.values()))
    assert [*marked, SCREENING["field_test"]] == [0, *SCREENING.values()]


@pytest.mark.parametrize(
    ("name", "codes", "policy", "rejected"),
    [
        ("roll_flag", ROLL, "reject_bad", ["bad"]),
        ("roll_flag", ROLL, "require_good", ["missing", "bad", "not_available"]),
        ("roll_flag", ROLL, "ignore", []),
        ("temperature_qc", QC, "reject_fail", ["fail"]),
        ("temperature_qc", QC, "require_pass", ["missing", "fail"]),
        ("wind_qc", QC, "require_pass", ["missing", "fail"]),
        ("wind_qc", QC, "ignore", []),
    ],
)
def test_policies_of_flags(name, codes, policy, rejected):
    rule = name.removesuffix("_flag")
    marked = bits(headings(*({name: code} for code in codes.values())), **{rule: policy})
    assert marked == [SCREENING[rule] if word in rejected else 0 for word in codes]
    absent = headings({}).drop_vars(name)  # counts as missing
    assert bits(absent, **{rule: policy}) == [SCREENING[rule] if "missing" in rejected else 0]
    with pytest.raises(ConfigError, match=rf"screening.{rule}.*require_{rule}"):
        bits(absent, **{rule: f"require_{rule}"})


def test_phases_and_absent_ground_vectors():
    ds = headings(*({"phase": code} for code in PHASE.values()))
    assert np.flatnonzero(np.array(bits(ds, phases=["ascent", "descent"])) == 0).tolist() == [1, 3]
    with pytest.raises(ConfigError, match=r"screening.phases.*cruising"):
        screen(ds, phases=["cruising"])
    absent = ("ground_speed", "ground_velocity_error", "airspeed", "turn")
    assert bits(headings(dict.fromkeys(absent, np.nan))) == [SCREENING["no_ground_vector"]]
    assert screen(ds).screening.attrs["flag_meanings"].split() == list(SCREENING)


def test_values_beyond_each_limit_are_rejected():
    turns = headings(*({"turn": turn} for turn in (9.99, -9.99, 10.01, np.nan)))
    assert [bit > 0 for bit in bits(turns)] == [False, False, True, False]
    turns = headings({"turn": 5.0})
    assert bits(turns, max_turn=np.radians(4.9)) == [SCREENING["turn"]]
    assert bits(turns, max_turn=np.radians(5.1)) == [0]
    slow = headings({"ground_speed": 41.0}, {"ground_speed": 41.3})  # 80 kt is 41.16 m/s
    assert bits(slow) == [SCREENING["ground_speed"], 0]
    coarse = headings({"ground_velocity_error": 15.0}, {"ground_velocity_error": 40.0})
    assert bits(coarse) == [0, SCREENING["no_ground_vector"]]


def test_gross_errors_are_rejected_and_large_deviations_are_not():
    distant = {"reference_northward_wind": (60.0, -4.0)}  # the other agrees: it would bend one fit
    assert bits(headings(distant)) == [SCREENING["gross_error"]]
    assert bits(headings({"reference_northward_wind": (np.nan, -4.0)})) == [0]
    assert bits(headings({"airspeed": 10.0}, {"airspeed": 500.0})) == [SCREENING["gross_error"]] * 2
    # a compass 12 degrees off on a jet at 230 m/s: 48 m/s, and yet no gross error
    jet = {"airspeed": 230.0, "reference_eastward_wind": (58.0, 58.0)}
    assert bits(headings(jet)) == [0]
    assert bits(headings({**jet, "airspeed": 100.0})) == [SCREENING["gross_error"]]


def test_the_audit_counts_rejections_together_and_alone():
    ds = headings(
        {},
        WORST["turn"],
        {**WORST["turn"], **WORST["roll"]},
        {},
        WORST["phase"],
        {**WORST["phase"], **WORST["roll"]},
        row_size=(4, 2),
    )
    counts = audit(screen(ds))
    rules = counts.sel(rule=["turn", "roll", "phase"]).transpose("rule", ...)
    assert rules.together.values.tolist() == [[2, 0], [1, 1], [0, 2]]
    assert rules.alone.values.tolist() == [[1, 0], [0, 0], [0, 1]]
    assert counts.reports.values.tolist() == [4, 2]
    assert counts.kept.values.tolist() == [2, 0]
    assert counts.aircraft.values.tolist() == ["N0", "N1"]


def test_reports_of_corrected_units_are_marked_from_the_test_on_and_not_fitted_or_corrected():
    time = np.array(["2009-10-19", "2009-10-20", "2009-10-21"] * 2, "M8[ns]")
    ds = ragged({"time": time, "screening": np.array([0, 1, 0, 0, 0, 0], np.int32)}, [3, 3])
    start, end = np.datetime64("2009-10-20"), np.datetime64("2009-10-21")
    bit = 1024
    for until, expected in ((None, [0, 1 | bit, bit, 0, 0, 0]), (end, [0, 1 | bit, 0, 0, 0, 0])):
        marked = mark_corrected_units(ds, aircraft=["N0"], start=start, end=until)
        assert marked["screening"].to_numpy().tolist() == expected
