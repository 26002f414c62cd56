"""Times, numbers and flag codes of report files.

Times are ISO 8601 text (UTC where it has no offset), or a number, which is read by the first of
these notations that gives a possible time: seconds since 1970, ``yyyymmddHH``, ``yyyymmddHHMM``,
``yyyymmddHHMMSS``, milliseconds, microseconds or nanoseconds since 1970, Julian date. They do not
overlap before July 2032, when seconds since 1970 become as large as ``1973010100``. Other notations
(``01/02/2009``) are ambiguous and count as unparsable unless their format is given.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from airswing.flags import ICING, PHASE, ROLL, TEMPERATURE_QC
from airswing.reports.audit import Audit

Column: TypeAlias = "pd.Series[Any]"  # A column of a table, of any type
Times: TypeAlias = NDArray[np.datetime64]
Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Index: TypeAlias = NDArray[np.integer]
Mask: TypeAlias = NDArray[np.bool_]

EARLIEST = np.datetime64("1973-01-01", "ns")
"""First year of aircraft reports in the archives that reanalyses use (NCAR ds353.4)."""
_LARGEST_SECONDS = 4.2e9  # the year 2103
_JULIAN_DATE_1970 = 2440587.5
_CALENDARS = ((10, "%Y%m%d%H"), (12, "%Y%m%d%H%M"), (14, "%Y%m%d%H%M%S"))

LARGEST_ROLL = 5.0  # degrees: limit of a good roll angle in AMDAR and ACARS

# Codes by meaning; the first meaning applies without a code.
_QC = {"missing": "-", "pass": "P PASS PASSED", "fail": "F FAIL FAILED"}
_CODES = {
    "roll_flag": (
        ROLL,
        {"missing": "- M", "good": "G GOOD", "bad": "B BAD", "not_available": "N NOT_AVAILABLE"},
    ),
    "temperature_qc": (TEMPERATURE_QC, _QC),
    "wind_qc": (TEMPERATURE_QC, _QC),
    "phase": (
        PHASE,
        {
            "unknown": "- UNKNOWN",
            "ascent": "ASCENT ASC CLIMB",
            "cruise": "CRUISE LEVEL ENROUTE LVR LVW",
            "descent": "DESCENT DES",
        },
    ),
    "icing": (ICING, {"missing": "- NAN", "off": "0 0.0 FALSE OFF NO", "on": "1 1.0 TRUE ON YES"}),
}
FLAGS = tuple(_CODES)  # flag columns of a table


def possible(time: Times) -> Mask:
    """Return True where a report can have been sent at a time; False for NaT."""
    latest = np.datetime64("now", "ns") + np.timedelta64(1, "D")
    return np.asarray((time >= EARLIEST) & (time < latest))


def parse_times(values: Column, format: str | None = None) -> tuple[Times, Mask]:
    """Read a column of text (in a format of ``strftime``), numbers or timestamps.

    Returns times (report,), NaT where there is none or it cannot be read, whether they are possible
    or not, and a mask (report,) of where no time was given.
    """
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        values = values.dt.tz_convert("UTC").dt.tz_localize(None)
    if np.issubdtype(getattr(values.dtype, "type", object), np.datetime64):
        time = values.to_numpy(dtype="datetime64[ns]")
        return time, np.isnat(time)
    if format is None and pd.api.types.is_numeric_dtype(values.dtype):
        numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
        return _of_numbers(numbers), np.isnan(numbers)
    index, labels = pd.factorize(values)  # many reports share a time, so each text is parsed once
    text = pd.Series(labels, dtype="object").map(lambda label: str(label).strip())
    parsed = pd.to_datetime(text, format=format or "ISO8601", utc=True, errors="coerce")
    time = parsed.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]").copy()
    digits = text.str.fullmatch(r"\d{7,19}(\.\d+)?").to_numpy(dtype=bool)
    if format is None and digits.any():
        time[digits] = _of_numbers(text[digits].to_numpy(dtype=np.float64))
    blank = np.append((text == "").to_numpy(dtype=bool), True)  # the last is that of absent values
    return np.append(time, np.datetime64("NaT", "ns"))[index], blank[index]


def seconds_since_1970(time: Times) -> Floats:
    """Times as float64 seconds since 1970-01-01 UTC."""
    return time.astype("datetime64[ns]").astype(np.int64) / 1e9


def from_epoch(seconds: Floats) -> Times:
    """Seconds since 1970 as times, to the microsecond; NaT for NaN and outside 1970-2103."""
    time = np.full(seconds.shape, np.datetime64("NaT", "ns"))
    known = (seconds >= 0.0) & (seconds < _LARGEST_SECONDS)
    time[known] = np.round(seconds[known] * 1e6).astype(np.int64).view("datetime64[us]")
    return time


def _of_numbers(values: Floats) -> Times:
    notations = []
    for width, pattern in _CALENDARS:
        dates = (values >= 10.0 ** (width - 1)) & (values < 10.0**width)
        if dates.any():
            text = pd.Series(np.where(dates, values, 0.0).astype(np.int64)).astype(str)
            parsed = pd.to_datetime(text, format=pattern, errors="coerce")
            notations.append(parsed.to_numpy(dtype="datetime64[ns]"))
    notations += [from_epoch(values / scale) for scale in (1e3, 1e6, 1e9)]
    # A float64 of a Julian date resolves 40 microseconds.
    notations.append(from_epoch(np.round((values - _JULIAN_DATE_1970) * 86400.0, 3)))
    time = from_epoch(values)
    for candidates in notations:
        better = possible(candidates) & ~possible(time)
        time[better] = candidates[better]
    return time


def numbers(column: Column, factor: float = 1.0, offset: float = 0.0) -> Floats:
    """Numbers of a column times a factor plus an offset; NaN where a value is none."""
    found = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    return np.asarray(found * factor + offset)


def roll_flags(roll: Floats) -> NDArray[np.int8]:
    """Flags of roll angles (degrees, either sign): bad beyond :data:`LARGEST_ROLL`."""
    flags = np.where(np.abs(roll) <= LARGEST_ROLL, ROLL["good"], ROLL["bad"])
    return np.where(np.isnan(roll), ROLL["missing"], flags).astype(np.int8)


def decode_flags(
    values: ArrayLike, flag: str, audit: Audit, *, name: str | None = None
) -> NDArray[np.int8]:
    """Codes (report,) as values of one of :data:`FLAGS`, counted under the name of their field."""
    name = name or flag
    meanings, words = _CODES[flag]
    codes = {code: meanings[word] for word, known in words.items() for code in known.split()}
    codes[""] = meanings[next(iter(words))]
    index, labels = pd.factorize(np.asarray(values, dtype=object), use_na_sentinel=True)
    texts = [*(str(label).strip() for label in labels), ""]  # the last is that of absent values
    counts = np.bincount(np.where(index < 0, len(labels), index), minlength=len(texts))
    flags = np.array([codes.get(text.upper(), codes[""]) for text in texts], dtype=np.int8)
    for text, count in zip(texts, counts.tolist(), strict=True):
        if count:
            audit.codes(name, {text or "blank": count})
            audit.repair(f"{name}_unknown_code", 0 if text.upper() in codes else count)
    return np.asarray(flags[index], dtype=np.int8)
