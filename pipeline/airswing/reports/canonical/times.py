"""Times of reports as text or numbers, to UTC.

Assumes ISO 8601 text (a time without an offset is UTC), whole numbers of the form
``yyyymmddHHMM`` or ``yyyymmddHHMMSS``, or seconds or milliseconds since 1970-01-01 (the latter from
1976 on, where they cannot be taken for anything else). Other notations
(``01/02/2009``) are ambiguous and count as unparsable. Valid for 1970 to 2100.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Column: TypeAlias = "pd.Series[Any]"
"""A column of a table, of whatever type its file gives it."""
EARLIEST = np.datetime64("1970-01-02", "ns")
"""Seconds since 1970 of no value come as zero, or nearly: the first day is none."""
LATEST = np.datetime64("2100-01-01", "ns")
_LARGEST_EPOCH = 4.2e9  # seconds: the year 2103
_SMALLEST_MILLISECONDS = 2.11e11  # larger than any yyyymmddHHMM before the year 2110


def parse_times(values: Column) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    """Read a column of text, numbers or timestamps, (report,).

    Returns
    -------
    time : array of datetime64[ns], shape (report,)
        NaT where there is none or it cannot be read.
    blank : array of bool, shape (report,)
        No time was given at all.
    """
    if isinstance(values.dtype, pd.DatetimeTZDtype):
        values = values.dt.tz_convert("UTC").dt.tz_localize(None)
    if np.issubdtype(getattr(values.dtype, "type", object), np.datetime64):
        time = values.to_numpy(dtype="datetime64[ns]")
        return time, np.isnat(time)
    if pd.api.types.is_numeric_dtype(values.dtype):
        return _numbers(values.to_numpy(dtype=np.float64, na_value=np.nan))
    return _text(values)


def from_epoch(seconds: NDArray[np.float64]) -> NDArray[np.datetime64]:
    """Times of seconds since 1970, to the nanosecond; NaT for NaN and outside 1970 to 2103."""
    time = np.full(seconds.shape, np.datetime64("NaT", "ns"))
    known = (seconds >= 0.0) & (seconds < _LARGEST_EPOCH)
    time[known] = np.round(seconds[known] * 1e9).astype(np.int64).view("datetime64[ns]")
    return time


def _text(values: Column) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    index, labels = pd.factorize(values)  # many reports share a time; each text is read once
    stripped = pd.Series(labels, dtype="object").map(lambda label: str(label).strip())
    parsed = pd.to_datetime(stripped, format="ISO8601", utc=True, errors="coerce")
    time = parsed.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]").copy()
    digits = stripped.str.fullmatch(r"\d{9,14}(\.\d+)?").to_numpy(dtype=bool)
    if digits.any():
        time[digits] = _numbers(stripped[digits].to_numpy(dtype=np.float64))[0]
    time = np.append(time, np.datetime64("NaT", "ns"))
    blank = np.append((stripped == "").to_numpy(dtype=bool), True)
    return time[index], blank[index]


def _numbers(values: NDArray[np.float64]) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    time = from_epoch(values)
    thousandths = (values >= _SMALLEST_MILLISECONDS) & (values < 1e3 * _LARGEST_EPOCH)
    time[thousandths] = (values[thousandths] * 1e6).astype(np.int64).view("datetime64[ns]")
    for width, pattern in ((12, "%Y%m%d%H%M"), (14, "%Y%m%d%H%M%S")):
        calendar = (values >= 10.0 ** (width - 1)) & (values < 10.0**width) & ~thousandths
        if calendar.any():
            text = pd.Series(values[calendar].astype(np.int64)).astype(str)
            parsed = pd.to_datetime(text, format=pattern, errors="coerce")
            time[calendar] = parsed.to_numpy(dtype="datetime64[ns]")
    return time, np.isnan(values)
