"""Flag codes: known, unknown, blank, and their tally."""

from __future__ import annotations

from airswing.flags import ICING, PHASE, ROLL, TEMPERATURE_QC
from airswing.reports.audit import Audit
from airswing.reports.values import FLAG_CODES, decode_flags


def decoded(name: str, values: list[object]) -> tuple[list[int], Audit]:
    audit = Audit()
    codes, missing = FLAG_CODES[name]
    return decode_flags(values, codes, missing, name=name, audit=audit).tolist(), audit


def test_roll_flags():
    found, audit = decoded("roll_flag", ["G", "b", "N", "", "-", " G ", None, "Z", float("nan")])
    names = [
        "good",
        "bad",
        "not_available",
        "missing",
        "missing",
        "good",
        "missing",
        "missing",
        "missing",
    ]
    assert found == [ROLL[name] for name in names]
    assert audit.flags["roll_flag"] == {"G": 2, "b": 1, "N": 1, "blank": 3, "-": 1, "Z": 1}
    assert audit.repaired == {"roll_flag_unknown_code": 1}


def test_temperature_checks():
    found, audit = decoded("temperature_qc", ["pass", "FAIL", "", "perhaps"])
    assert found == [TEMPERATURE_QC[name] for name in ("pass", "fail", "missing", "missing")]
    assert audit.repaired == {"temperature_qc_unknown_code": 1}


def test_phases():
    found, _ = decoded("phase", ["ascent", "Cruise", "DESCENT", "", "hover"])
    assert found == [PHASE[n] for n in ("ascent", "cruise", "descent", "unknown", "unknown")]


def test_icing_as_text_or_number():
    found, _ = decoded("icing", ["0", "1", 0.0, 1, 1.0, "", None, True, "2"])
    names = ["off", "on", "off", "on", "on", "missing", "missing", "on", "missing"]
    assert found == [ICING[name] for name in names]
