"""Warnings name what was left out by reason and file; complete input causes none."""

from __future__ import annotations

import json

import pytest
import xarray as xr

from airswing.report.run.reading_warnings import (
    model_reasons,
    model_warnings,
    reading_warnings,
    tally,
)
from airswing.reports.audit import Audit, similar

SKIPPED = [
    {"file": "/a/one.grb", "what": "message", "reason": "truncated message", "count": 1},
    {"file": "/a/two.grb", "what": "wind", "reason": "u not on pressure levels", "count": 8},
    {"file": "/a/three.grb", "what": "wind", "reason": "u not on pressure levels", "count": 4},
    {"file": "/a/x.grb", "what": "file", "reason": "no whole GRIB message", "count": 1},
]


def test_model_files_by_reason_the_most_files_first():
    assert model_reasons(SKIPPED) == [
        "left out: u not on pressure levels, 12 times in two.grb and 1 more files",
        "left out: truncated message, 1 times in one.grb",
        "left out: no whole GRIB message, in x.grb",
    ]


def test_messages_without_wind_cause_no_warning():
    assert model_warnings(SKIPPED) == model_reasons([SKIPPED[0], SKIPPED[3]])


def test_reports_say_how_many_files_and_which_tails():
    audit = Audit(files_skipped=[{"file": "b.csv", "reason": "b.csv: is empty"}])
    audit.formats["csv"] = 3
    audit.similar_tails = [["N401", "n401"]]
    files, tails = reading_warnings(audit.as_dict())
    assert files == "1 of 4 report files left out; the first: b.csv: is empty"
    assert "different aircraft: 'N401', 'n401'" in tails
    assert reading_warnings(Audit().as_dict()) == reading_warnings({}) == []


def test_reports_left_out_are_counted_by_reason_the_most_first():
    audit = Audit(read=2000)
    for reason, number in {"ragged_row": 3, "unparsable_time": 1200, "averaged": 500}.items():
        audit.drop(reason, number)
    audit.example("pressure_altitude", "28,890")
    assert reading_warnings(audit.as_dict()) == [
        "1,203 of 2,000 reports left out: unparsable time 1,200, ragged row 3",
        "values that cannot be read: pressure_altitude such as '28,890'",
    ]


@pytest.mark.parametrize(
    ("tails", "groups"),
    [
        (["N401", "n401", "N402"], [["N401", "n401"]]),
        (["N 401", "N401", "b", "B", "b "], [["B", "b", "b "], ["N 401", "N401"]]),
        (["N401", "N-401", "N4O1"], []),
        ([], []),
    ],
)
def test_tails_that_differ_in_case_or_blanks(tails, groups):
    assert similar(tails) == groups


def test_a_tally_that_is_absent_or_broken_is_empty():
    assert tally(xr.Dataset(attrs={"a": "{"}), "a") == {}
    assert tally(xr.Dataset(), "a") == {}
    assert tally(xr.Dataset(attrs={"a": json.dumps({"b": 1})}), "a") == {"b": 1}
