"""Tables of stations as text: columns by name, times in UTC, faults told by file and column.

Assumes text in columns with one line of names, divided by commas, semicolons, tabs or blanks;
lines that begin with ``#`` are comments, of which ``# variable: T`` and ``# units: K`` are heeded
(the text format of the verification program Verif, Nipen et al. 2023, Bull. Amer. Meteor. Soc.
104). ``-999``, ``-999.0``, ``NA``, ``nan`` and nothing at all are missing. Valid for station and
forecast data of any network.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError

_MISSING = ["-999", "-999.0", "-999.00", "NA", "nan", "NaN", "null", ""]
_COMMENT = re.compile(r"#\s*(variable|units)\s*:\s*(.*?)\s*$", re.IGNORECASE)
# A time outside is a number misread as a date.
_FIRST, _LAST = pd.Timestamp("1900-01-01"), pd.Timestamp("2200-01-01")


def read_table(path: Path, columns: Mapping[str, str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Read one table, every value as text, and what its comments say of ``variable`` and ``units``.

    ``columns`` are their names to ours; others keep theirs, in lower case.

    Raises
    ------
    InputError
        If it is absent, no text, or no table.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as err:
        found = getattr(err, "strerror", None) or "octets that are no text"
        raise InputError("cannot be read as a table of text", file=path, found=found) from err
    lines = text.splitlines()
    told = {m[1].lower(): m[2] for line in lines if (m := _COMMENT.match(line.strip()))}
    body = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if len(body) < 2:
        raise InputError("a table without lines", file=path, found=f"{len(body)} lines of text")
    split = _splitter(body[0])
    names = [_plain(name) for name in split(body[0])]
    rows = [split(line) for line in body[1:]]
    whole = [row for row in rows if len(row) == len(names)]
    # A few broken lines are left out; where most are, it is no such table.
    if 2 * len(whole) < len(rows) or len(names) < 2:
        raise InputError(
            "not a table: most lines have another number of columns than the first",
            file=path,
            found=f"{len(names)} names, a line of {len(rows[0])} values",
        )
    table = pd.DataFrame(whole, columns=names, dtype=object)
    table = table.rename(columns={_plain(theirs): ours for theirs, ours in columns.items()})
    unknown = [theirs for theirs in columns if _plain(theirs) not in names]
    if unknown:
        raise InputError(
            "no such column", file=path, field=unknown[0], found="columns " + ", ".join(names)
        )
    again = table.columns[table.columns.duplicated()]
    if len(again):
        raise InputError(
            "two columns of one name",
            file=path,
            field=str(again[0]),
            remedy="Leave one of them out, or name them under columns",
        )
    table.attrs["lines_skipped"] = len(rows) - len(whole)
    return table, told


def _plain(name: str) -> str:
    return name.strip().strip('"').lower()


def _splitter(line: str) -> Callable[[str], list[str]]:
    """How the line of names is divided."""
    for mark in (",", ";", "\t"):
        if mark in line:
            return lambda text: [part.strip().strip('"') for part in text.split(mark)]
    return str.split


def optional_column(table: pd.DataFrame, names: Sequence[str]) -> pd.Series | None:
    """The first column of several names that is there, or none."""
    return next((table[name] for name in names if name in table), None)


def column(table: pd.DataFrame, names: Sequence[str], *, file: Path) -> pd.Series:
    """The first column of several names that is there; ``file`` is for the message.

    Raises
    ------
    InputError
        If there is none.
    """
    found = optional_column(table, names)
    if found is None:
        raise InputError(
            f"no column {' or '.join(names)}",
            file=file,
            found="columns " + ", ".join(map(str, table.columns)),
            remedy="Name it under columns, as `their name: our name`",
        )
    return found


def numbers(values: Iterable[object]) -> NDArray[np.float64]:
    """Read numbers; NaN where missing, absurd or none."""
    series = pd.Series(list(values), dtype=object).map(lambda text: str(text).strip())
    read = pd.to_numeric(series.where(~series.isin(_MISSING)), errors="coerce")
    found = read.to_numpy(dtype=np.float64)
    return np.where(np.abs(found) < 1e30, found, np.nan)  # fill values of files lie above


def times(values: Iterable[object]) -> NDArray[np.datetime64]:
    """Read times in UTC: ISO 8601, yyyymmdd[HH[MM[SS]]] or seconds since 1970; NaT where none."""
    codes, labels = pd.factorize(pd.Series(list(values), dtype=object))
    read = [_time(str(label).strip()) for label in labels]
    known = np.array([*read, np.datetime64("NaT")], dtype="datetime64[ns]")
    return known[codes]


def _time(text: str) -> np.datetime64:
    digits = text.removesuffix(".0")
    layout = {8: "%Y%m%d", 10: "%Y%m%d%H", 12: "%Y%m%d%H%M", 14: "%Y%m%d%H%M%S"}
    try:
        # Of 10 digits both are possible: a date begins with its century, and seconds since
        # 1970 that begin with 19 or 20 are of 2030 and later.
        if digits.isdigit() and len(digits) in layout and digits[:2] in ("19", "20"):
            stamp = pd.to_datetime(digits, format=layout[len(digits)])
        elif digits.isdigit():
            stamp = pd.Timestamp(int(digits), unit="s")
        else:
            stamp = pd.Timestamp(text)
    except (ValueError, OverflowError):
        return np.datetime64("NaT", "ns")
    plain = stamp.tz_convert("UTC").tz_localize(None) if stamp.tz is not None else stamp
    inside = _FIRST <= plain <= _LAST
    return np.datetime64(plain, "ns") if inside else np.datetime64("NaT", "ns")
