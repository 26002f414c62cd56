"""Times and flag codes of report files.

Times
-----
ISO 8601 text (UTC where it has no offset), or a number, which is read by the first of these
notations that gives a possible time: seconds since 1970, ``yyyymmddHH``, ``yyyymmddHHMM``,
``yyyymmddHHMMSS``, milliseconds, microseconds or nanoseconds since 1970, Julian date. Other
notations (``01/02/2009``) are ambiguous and count as unparsable unless their format is given.

Possible are the times from :data:`EARLIEST` to one day after now. The notations do not overlap for
possible times before July 2032, when seconds since 1970 become as large as ``1973010100``.

Flag codes
----------
One or a few characters, compared without regard to case and to blanks around them. An unknown code
counts as missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from airswing.flags import ICING, PHASE, ROLL, TEMPERATURE_QC
from airswing.reports.audit import Audit

Column: TypeAlias = "pd.Series[Any]"
"""A column of a table, of whatever type its file gives it."""
Times: TypeAlias = NDArray[np.datetime64]

EARLIEST = np.datetime64("1973-01-01", "ns")
"""First year of aircraft reports in the archives that reanalyses use (NCAR ds353.4)."""
_LARGEST_SECONDS = 4.2e9  # the year 2103
_JULIAN_DATE_1970 = 2440587.5
_SCALES = (1.0, 1e3, 1e6, 1e9)
_CALENDARS = ((10, "%Y%m%d%H"), (12, "%Y%m%d%H%M"), (14, "%Y%m%d%H%M%S"))

LARGEST_ROLL = 5.0  # degrees: limit of a good roll angle in AMDAR and ACARS

ROLL_CODES = {
    "": ROLL["missing"],
    "-": ROLL["missing"],
    "M": ROLL["missing"],
    "G": ROLL["good"],
    "GOOD": ROLL["good"],
    "B": ROLL["bad"],
    "BAD": ROLL["bad"],
    "N": ROLL["not_available"],
    "NOT_AVAILABLE": ROLL["not_available"],
}
_QC_CODES = {
    **dict.fromkeys(("", "-"), TEMPERATURE_QC["missing"]),
    **dict.fromkeys(("P", "PASS", "PASSED"), TEMPERATURE_QC["pass"]),
    **dict.fromkeys(("F", "FAIL", "FAILED"), TEMPERATURE_QC["fail"]),
}
_PHASE_CODES = {
    **dict.fromkeys(("", "-", "UNKNOWN"), PHASE["unknown"]),
    **dict.fromkeys(("ASCENT", "ASC", "CLIMB"), PHASE["ascent"]),
    **dict.fromkeys(("CRUISE", "LEVEL", "ENROUTE", "LVR", "LVW"), PHASE["cruise"]),
    **dict.fromkeys(("DESCENT", "DES"), PHASE["descent"]),
}
_ICING_CODES = {
    **dict.fromkeys(("", "-", "NAN"), ICING["missing"]),
    **dict.fromkeys(("0", "0.0", "FALSE", "OFF", "NO"), ICING["off"]),
    **dict.fromkeys(("1", "1.0", "TRUE", "ON", "YES"), ICING["on"]),
}
FLAG_CODES = {
    "roll_flag": (ROLL_CODES, ROLL["missing"]),
    "temperature_qc": (_QC_CODES, TEMPERATURE_QC["missing"]),
    "wind_qc": (_QC_CODES, TEMPERATURE_QC["missing"]),
    "phase": (_PHASE_CODES, PHASE["unknown"]),
    "icing": (_ICING_CODES, ICING["missing"]),
}
"""Flag values by upper-case code, and the value for missing, for each flag column of a table."""


def possible(time: Times) -> NDArray[np.bool_]:
    """Return True where a report can have been sent at a time; False for NaT."""
    latest = np.datetime64("now", "ns") + np.timedelta64(1, "D")
    return np.asarray((time >= EARLIEST) & (time < latest))


def parse_times(values: Column, format: str | None = None) -> tuple[Times, NDArray[np.bool_]]:
    """Read a column of text, numbers or timestamps.

    Parameters
    ----------
    values : Series, shape (report,)
    format : str, optional
        Of text in another notation than those of this module (codes of ``strftime``).

    Returns
    -------
    time : array of datetime64[ns], shape (report,)
        NaT where there is none or it cannot be read. Times that are not possible are returned as
        they are.
    blank : array of bool, shape (report,)
        True where no time was given.
    """
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        values = values.dt.tz_convert("UTC").dt.tz_localize(None)
    if np.issubdtype(getattr(values.dtype, "type", object), np.datetime64):
        time = values.to_numpy(dtype="datetime64[ns]")
        return time, np.isnat(time)
    if format is None and pd.api.types.is_numeric_dtype(values.dtype):
        numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
        return _of_numbers(numbers), np.isnan(numbers)
    index, labels = pd.factorize(values)  # many reports share a time; each text is read once
    text = pd.Series(labels, dtype="object").map(lambda label: str(label).strip())
    parsed = pd.to_datetime(text, format=format or "ISO8601", utc=True, errors="coerce")
    time = parsed.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]").copy()
    digits = text.str.fullmatch(r"\d{7,19}(\.\d+)?").to_numpy(dtype=bool)
    if format is None and digits.any():
        time[digits] = _of_numbers(text[digits].to_numpy(dtype=np.float64))
    blank = np.append((text == "").to_numpy(dtype=bool), True)  # the last is that of absent values
    return np.append(time, np.datetime64("NaT", "ns"))[index], blank[index]


def from_epoch(seconds: NDArray[np.float64]) -> Times:
    """Convert seconds since 1970 to times, to the microsecond; NaT for NaN and outside 1970-2103.

    A float64 of seconds since 1970 resolves 0.2 microseconds.
    """
    time = np.full(seconds.shape, np.datetime64("NaT", "ns"))
    known = (seconds >= 0.0) & (seconds < _LARGEST_SECONDS)
    time[known] = np.round(seconds[known] * 1e6).astype(np.int64).view("datetime64[us]")
    return time


def _of_numbers(values: NDArray[np.float64]) -> Times:
    time = from_epoch(values)

    def fill(candidates: Times) -> None:
        better = possible(candidates) & ~possible(time)
        time[better] = candidates[better]

    for width, pattern in _CALENDARS:
        dates = (values >= 10.0 ** (width - 1)) & (values < 10.0**width)
        if dates.any():
            text = pd.Series(np.where(dates, values, 0.0).astype(np.int64)).astype(str)
            parsed = pd.to_datetime(text, format=pattern, errors="coerce")
            fill(parsed.to_numpy(dtype="datetime64[ns]"))
    for scale in _SCALES[1:]:
        fill(from_epoch(values / scale))
    # A float64 of a Julian date resolves 40 microseconds.
    fill(from_epoch(np.round((values - _JULIAN_DATE_1970) * 86400.0, 3)))
    return time


def roll_flags(roll: NDArray[np.float64]) -> NDArray[np.int8]:
    """Flags of roll angles (degrees, either sign): bad beyond :data:`LARGEST_ROLL`."""
    flags = np.where(np.abs(roll) <= LARGEST_ROLL, ROLL["good"], ROLL["bad"])
    return np.where(np.isnan(roll), ROLL["missing"], flags).astype(np.int8)


def decode_flags(
    values: ArrayLike, codes: Mapping[str, int], missing: int, *, name: str, audit: Audit
) -> NDArray[np.int8]:
    """Turn codes into flag values and count each code under the field's name.

    Parameters
    ----------
    values : array_like of str, shape (report,)
        Codes of the source.
    codes : mapping of str to int
        Flag values by upper-case code.
    missing : int
        Flag value of an unknown code, which is counted as a repair.

    Returns
    -------
    array of int8, shape (report,)
    """
    index, labels = pd.factorize(np.asarray(values, dtype=object), use_na_sentinel=True)
    texts = [*(str(label).strip() for label in labels), ""]  # the last is that of absent values
    counts = np.bincount(np.where(index < 0, len(labels), index), minlength=len(texts))
    flags = np.array([codes.get(text.upper(), missing) for text in texts], dtype=np.int8)
    for text, count in zip(texts, counts.tolist(), strict=True):
        if count:
            audit.codes(name, {text or "blank": count})
            audit.repair(f"{name}_unknown_code", 0 if text.upper() in codes else count)
    return np.asarray(flags[index], dtype=np.int8)
