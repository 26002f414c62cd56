"""The checks on the gap page: results beside assumptions, doubt marked, claims reviewed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from airswing.gap.result.schema import (
    AliasEntry,
    AssumptionEntry,
    CalibrationEntry,
    CalibrationPair,
    ClaimsEntry,
    FieldTestEntry,
    FitEntry,
    GapReport,
)
from airswing.report.gap.checks_section import (
    alias_lines,
    assumption_table,
    calibration_table,
    claims_section,
)

NAN = float("nan")


@pytest.fixture(scope="module")
def gap(gap_product: Path) -> GapReport:
    """A real diagnosis with the results of checks by hand."""
    told = CalibrationEntry(0.64, 0.68, 0.95, 0.05, 0.01, 0.88, 0.02)
    fit = FitEntry("N404", 0.31, 0.32, 0.05, 3.9, 4.3, 0.1, stays=False)
    return replace(
        GapReport.read(gap_product / "gap.json"),
        assumptions=[
            AssumptionEntry("luck", "a decoy", "closes +0.00 kt", ok=True),
            AssumptionEntry("noise", "distance", "20 % off", ok=False),
        ],
        calibration=CalibrationPair(after=replace(told, auc=NAN), before=told),
        aliases=[AliasEntry("tas_scale", "tas_offset", 0.913, "a wider range of airspeeds")],
        claims=ClaimsEntry(
            ["tas_scale"],
            [fit, replace(fit, aircraft="N499", amplitude_deg=NAN, stays=None)],
            stay=0,
            of=1,
            field_test=FieldTestEntry(1.5, [1.0, 2.0], 1.7, stays=True),
        ),
    )


def test_what_fails_is_marked(gap: GapReport) -> None:
    (made,) = assumption_table(gap)
    good, bad = str(made).split("20 % off")[0], str(made).split("closes +0.00 kt")[1]
    assert "doubt" not in good.split("luck")[0]
    assert "doubt" in bad
    assert "1 of 2 hold" in " ".join(str(made).split())


def test_calibration_beside_what_is_right(gap: GapReport) -> None:
    (made,) = calibration_table(gap)
    assert "0.68" in made
    assert "0.88" in made
    assert calibration_table(replace(gap, calibration=None)) == []


def test_claims_in_words(gap: GapReport) -> None:
    text = "".join(str(part) for part in claims_section(gap).parts)
    assert "0 of 1 trusted fits" in text
    assert "1.50 kt [1.00, 2.00] becomes 1.70 kt, within its interval" in text
    assert "3.90 ± 0.10" in text
    assert "not judged" in text
    none = replace(gap, claims=ClaimsEntry([]))
    assert "stand as they are" in str(claims_section(none).parts[0])
    assert claims_section(replace(gap, claims=None)).parts == []


def test_advice_stands_with_the_pair_that_looks_alike(gap: GapReport) -> None:
    (line,) = alias_lines(gap)
    assert line == (
        "airspeed wrong by a factor and airspeed wrong by an amount: 91 % of the first's energy in "
        "common; a wider range of airspeeds would tell"
    )
