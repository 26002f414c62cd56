"""The checks on the gap page: results beside assumptions, doubt marked, claims reviewed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.report import gap_factories
from tests.report.run.test_page import parsed

from airswing.report import write_gap_page
from airswing.report.gap.checks_section import (
    alias_lines,
    assumption_table,
    calibration_table,
    claims_section,
)


def checks() -> dict[str, Any]:
    """Return the keys of gap.json that hold the checks."""
    calibration = {"spread": 0.95, "crps_m_s": 0.64, "crps_expected_m_s": 0.68, "lag_one": 0.05}
    fit = {
        "aircraft": "N404",
        "offset_deg": 0.31,
        "offset_deg_after": 0.32,
        "offset_deg_standard_error": 0.05,
        "amplitude_deg": 3.9,
        "amplitude_deg_after": 4.3,
        "amplitude_deg_standard_error": 0.1,
        "stays": False,
    }
    poor = fit | {"aircraft": "N499", "amplitude_deg": None, "stays": None}
    return {
        "assumptions": [
            {"assumption": "luck", "check": "a decoy", "result": "closes +0.00 kt", "ok": True},
            {"assumption": "noise", "check": "distance", "result": "20 % off", "ok": False},
        ],
        "calibration": {
            "before": calibration | {"auc": 0.88},
            "after": calibration | {"auc": None},
        },
        "aliases": [{"effect": "tas_scale", "other": "tas_offset", "alias_share": 0.913}],
        "claims": {
            "taken_off": ["tas_scale"],
            "aircraft": [fit, poor],
            "stay": 0,
            "of": 1,
            "field_test": {
                "reduction_kt": 1.5,
                "reduction_ci_kt": [1.0, 2.0],
                "reduction_kt_after": 1.7,
                "stays": True,
            },
        },
    }


def test_page_shows_every_check(tmp_path: Path) -> None:
    text, found = parsed(write_gap_page(tmp_path, gap=gap_factories.gap() | checks()))
    assert found.open == []
    order = [text.index(f'<section id="{name}"') for name in ("open", "claims", "method")]
    assert order == sorted(order)
    assert "closes +0.00 kt" in text
    assert "1 of 2 hold" in " ".join(text.split())
    assert "airspeed wrong by a factor and airspeed wrong by an amount: 91 %" in text


def test_what_fails_is_marked() -> None:
    (made,) = assumption_table(checks(), ())
    good, bad = str(made).split("20 % off")[0], str(made).split("closes +0.00 kt")[1]
    assert "doubt" not in good.split("luck")[0]
    assert "doubt" in bad


def test_without_results_the_checks_are_still_named() -> None:
    (made,) = assumption_table({}, [("an assumption", "a check")])
    assert "an assumption" in made
    assert "result" not in made
    assert calibration_table({}) == []
    assert alias_lines({}) == []
    assert claims_section({}).parts == []


def test_calibration_beside_what_is_right() -> None:
    (made,) = calibration_table(checks())
    assert "0.68" in made
    assert "0.88" in made


def test_claims_in_words() -> None:
    text = "".join(str(part) for part in claims_section(checks()).parts)
    assert "0 of 1 trusted fits" in text
    assert "1.50 kt [1.00, 2.00] becomes 1.70 kt, within its interval" in text
    assert "3.90 ± 0.10" in text
    assert "not judged" in text
    none = {"claims": checks()["claims"] | {"taken_off": []}}
    assert "stand as they are" in str(claims_section(none).parts[0])


def test_advice_stands_with_the_pair_that_looks_alike() -> None:
    pair = checks()["aliases"][0] | {"separated_by": "reports over a wider range of airspeeds"}
    (line,) = alias_lines({"aliases": [pair]})
    assert line.endswith("in common; reports over a wider range of airspeeds would tell")
