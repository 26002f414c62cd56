"""The closing summary in the terminal: what its numbers are; a dash where there is none."""

from __future__ import annotations

import math
from pathlib import Path

from airswing.workflow.main import summary_text as as_text

FITTED = ("offset", "amplitude", "phase", "before_kt", "after_kt")
ERRORS = ("offset_standard_error", "amplitude_standard_error")


def fit(**changes: object) -> dict:
    return {
        "aircraft": "N401",
        "status": "ok",
        "offset": 0.82,
        "amplitude": 5.83,
        "phase": 33.8,
        "amplitude_standard_error": 0.1,
        "offset_standard_error": 0.05,
        "reports": 4979,
        "before_kt": 17.4,
        "after_kt": 6.2,
    } | changes


def summary(**changes: object) -> dict:
    return {
        "reference": "ruc",
        "reports": {"read": 30796, "usable": 30796, "kept": 22991},
        "aircraft": 2,
        "status": {"ok": 1, "offset_only": 0},
        "disagreement_kt": {"before": 11.3, "after": 5.9},
        "fits": [fit()],
    } | changes


def test_intervals_are_of_95_percent_as_on_the_page_and_say_so():
    assert "5.81 m/s before, 3.04 m/s after" in as_text(summary(), Path("out"), units="m/s")
    text = as_text(summary(), Path("out"))
    assert "5.83 +- 0.20" in text
    assert "95 % intervals" in text


def test_what_was_not_fitted_is_a_dash():
    nothing = dict.fromkeys((*FITTED, *ERRORS), math.nan)
    unfitted = fit(aircraft="N406", status="too_few_reports", **nothing)
    text = as_text(summary(fits=[fit(), unfitted]), Path("out"))
    assert "nan" not in text
    lines = [line for line in text.splitlines() if line.startswith("N4")]
    assert len(lines[0].split("ok")[0]) == len(lines[1].split("too_few")[0])


def test_an_offset_alone_has_its_interval_and_no_amplitude():
    names = ("amplitude", "phase", "amplitude_standard_error")
    alone = fit(aircraft="N407", status="offset_only", **dict.fromkeys(names, math.nan))
    text = as_text(
        summary(status={"ok": 1, "offset_only": 1}, fits=[fit(), alone]),
        Path("out"),
    )
    assert "1 of 2 aircraft fitted against ruc, 1 with an offset alone" in text
    row = next(line for line in text.splitlines() if line.startswith("N407"))
    assert "0.82 +- 0.10" in row and row.count("+-") == 1
