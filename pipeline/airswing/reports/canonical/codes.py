"""Flag codes of report sources and what they mean here.

Assumes codes of one or a few characters, compared without regard to case or spaces around
them. A code that is not in a table counts as missing; the reader tallies every code it met.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from airswing.flags import ICING, PHASE, ROLL, TEMPERATURE_QC
from airswing.reports.canonical.audit import Audit

BLANK = ""
LARGEST_ROLL = 5.0  # degrees

ROLL_CODES = {
    BLANK: ROLL["missing"],
    "-": ROLL["missing"],
    "M": ROLL["missing"],
    "G": ROLL["good"],
    "GOOD": ROLL["good"],
    "B": ROLL["bad"],
    "BAD": ROLL["bad"],
    "N": ROLL["not_available"],
    "NOT_AVAILABLE": ROLL["not_available"],
}
"""Roll angle: G up to 5 degrees, B above or suspect, N not available, '-' missing."""

QC_CODES = {
    BLANK: TEMPERATURE_QC["missing"],
    "-": TEMPERATURE_QC["missing"],
    "PASS": TEMPERATURE_QC["pass"],
    "P": TEMPERATURE_QC["pass"],
    "PASSED": TEMPERATURE_QC["pass"],
    "FAIL": TEMPERATURE_QC["fail"],
    "F": TEMPERATURE_QC["fail"],
    "FAILED": TEMPERATURE_QC["fail"],
}

PHASE_CODES = {
    BLANK: PHASE["unknown"],
    "-": PHASE["unknown"],
    "UNKNOWN": PHASE["unknown"],
    "ASCENT": PHASE["ascent"],
    "ASC": PHASE["ascent"],
    "CLIMB": PHASE["ascent"],
    "CRUISE": PHASE["cruise"],
    "LEVEL": PHASE["cruise"],
    "ENROUTE": PHASE["cruise"],
    "LVR": PHASE["cruise"],
    "LVW": PHASE["cruise"],
    "DESCENT": PHASE["descent"],
    "DES": PHASE["descent"],
}

ICING_CODES = {
    BLANK: ICING["missing"],
    "-": ICING["missing"],
    "NAN": ICING["missing"],
    "0": ICING["off"],
    "0.0": ICING["off"],
    "FALSE": ICING["off"],
    "OFF": ICING["off"],
    "NO": ICING["off"],
    "1": ICING["on"],
    "1.0": ICING["on"],
    "TRUE": ICING["on"],
    "ON": ICING["on"],
    "YES": ICING["on"],
}

TABLES = {
    "roll_flag": (ROLL_CODES, ROLL["missing"]),
    "temperature_qc": (QC_CODES, TEMPERATURE_QC["missing"]),
    "wind_qc": (QC_CODES, TEMPERATURE_QC["missing"]),
    "phase": (PHASE_CODES, PHASE["unknown"]),
    "icing": (ICING_CODES, ICING["missing"]),
}
"""Code table and the value that means missing, per flag column of a report table."""


def roll_flags(roll: NDArray[np.float64]) -> NDArray[np.int8]:
    """Flag of a roll angle (degrees, either way): bad beyond 5 as the ACARS flag has it."""
    flags = np.where(np.abs(roll) <= LARGEST_ROLL, ROLL["good"], ROLL["bad"])
    return np.where(np.isnan(roll), ROLL["missing"], flags).astype(np.int8)


def decode_flags(
    values: ArrayLike, codes: Mapping[str, int], missing: int, *, name: str, audit: Audit
) -> NDArray[np.int8]:
    """Turn code strings into flag values (report,), counting each code met under the field's name.

    Parameters
    ----------
    values : array_like of str, shape (report,)
        Codes of the source.
    codes : mapping of str to int
        Upper-case code to flag value.
    missing : int
        Value of an unknown code, which is counted as a repair.
    """
    index, labels = pd.factorize(np.asarray(values, dtype=object), use_na_sentinel=True)
    found = np.full(len(labels) + 1, missing, dtype=np.int8)  # the last stands for NaN
    counts = np.bincount(np.where(index < 0, len(labels), index), minlength=len(labels) + 1)
    tally: dict[str, int] = {}
    unknown = 0
    for position, label in enumerate(labels):
        code = str(label).strip()
        tally[code or "blank"] = tally.get(code or "blank", 0) + int(counts[position])
        if code.upper() in codes:
            found[position] = codes[code.upper()]
        else:
            unknown += int(counts[position])
    if counts[-1]:
        tally["blank"] = tally.get("blank", 0) + int(counts[-1])
    audit.codes(name, tally)
    audit.repair(f"{name}_unknown_code", unknown)
    return np.asarray(found[index], dtype=np.int8)
