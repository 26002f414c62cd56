"""Report tables: CSV text and Parquet, read in pieces.

Assumes one report a row and a header row of column names; commas, semicolons or tabs between
columns; UTF-8 text. Text columns are never read as numbers, so a tail ``NA`` or ``007`` is
unchanged. A row with too many columns, or with values in fewer than two, is dropped and counted as
ragged; a row with too few has the rest missing. Folders named ``tail=N401`` (partitioned Parquet)
give that column of their files.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.physics.triangle import wrap_degrees
from airswing.products.whole_files import require_parquet
from airswing.reports.audit import Audit
from airswing.reports.columns import (
    FLAGS,
    ONLY,
    TEXT,
    Column,
    Mapped,
    Source,
    decode_flags,
    layout_of,
    numbers,
    parse_times,
    possible,
    seconds_since_1970,
    sources,
)
from airswing.reports.formats import ReportFormat, damage_named, is_text, opened

ROWS_PER_PIECE = 250_000  # the text of a table is many times larger than its kept columns
_LONGEST_HEADER = 100_000  # characters; a longer line is no header
_MOST_COMMENTS = 200  # lines that begin with #
_BLANKS = [
    *("", " ", "NA", "N/A", "n/a", "NaN", "nan", "NULL", "null", "None", "-", "--"),
    *("M", "MISSING", "missing", "9999", "99999", "-9999", "99999.0", "-9999.0"),
]
_FARTHEST, _NEAR = 10.0, 1.0  # s: how far messages may be apart
_FILLED = [
    *("latitude", "longitude", "pressure_altitude", "ground_speed", "track", "reported_airspeed"),
    *("indicated_airspeed", "mach", "air_temperature"),
]
_EXTRA = "columns past the header"

Header = tuple[list[str], str, int]
"""Names of the columns, separator, number of lines up to and including the header."""


def _read_csv(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    header = header_of(path)
    names = header[0]
    matched = sources(names, mapping)
    text = {
        column
        for name, source in matched.items()
        # A time made of parts or with a format too: 0930 read as a number loses its zero.
        if (name in TEXT or name.startswith(ONLY))
        and (name != "time" or source.parts or source.format)
        for column in source.columns
    }
    numeric = {c for source in matched.values() for c in source.columns} - text
    repeated = [
        variable
        for variable, source in matched.items()
        if any(name.startswith(f"{source.column} (column ") for name in names)
    ]

    def tables() -> Iterator[pd.DataFrame]:
        for table in csv_pieces(
            path,
            header,
            audit,
            # One column more than the header names, to find the rows that are too long.
            names=[*names, _EXTRA],
            dtype=dict.fromkeys([*text, _EXTRA], str),
            on_bad_lines="warn",
            # pandas' default would make a tail named NA missing; this list is for number columns
            # only.
            keep_default_na=False,
            na_values=dict.fromkeys(numeric, _BLANKS),
            # Types are inferred for a whole piece: in parts one column may get two types.
            low_memory=False,
            chunksize=ROWS_PER_PIECE,
        ):
            # pandas skips rows of two columns too many itself; those are counted by its warnings.
            ragged = (table.pop(_EXTRA).fillna("").str.strip() != "").to_numpy(dtype=bool)
            # A line of garbage has one value at most: it is no report whose time is missing.
            ragged = ragged | ((table.notna() & (table != "")).sum(axis=1).to_numpy() < 2)
            for variable in repeated:
                audit.repair(f"{variable}_column_repeated", len(table))
            audit.drop("ragged_row", int(ragged.sum()), unread=True)
            yield table.loc[~ragged] if ragged.any() else table

    yield from _in_si(tables(), names, matched, audit)


def _in_si(
    tables: Iterable[pd.DataFrame], names: Sequence[str], columns: Mapped, audit: Audit
) -> Iterator[pd.DataFrame]:
    """Raw columns in SI of the pieces of a table; one piece of a table of single messages."""
    layout, rows, pieces = layout_of(names), 0, []
    for table in tables:
        rows += len(table)
        raw = to_raw(table, columns, audit)
        if layout is not None and layout.messages:
            pieces.append(raw)
        else:
            yield raw
    if not rows:
        raise InputError("has a header but no reports")
    for variable, source in columns.items():
        if audit.repaired[f"{variable}_unparsable"] == rows:
            raise InputError(
                "holds no numbers",
                field=source.column,
                found=audit.examples.get(variable),
                remedy="Write numbers alone, with a decimal point; the unit is part of the "
                "column's name or of its mapping",
            )
    if pieces:
        yield merge_messages(pd.concat(pieces, ignore_index=True), audit)


def csv_pieces(path: Path, header: Header, audit: Audit, **options: Any) -> Iterator[pd.DataFrame]:
    """Pieces of a CSV file; rows that pandas skips (``on_bad_lines="warn"``) are counted."""
    _, separator, lines = header
    options |= dict(sep=separator, header=None, skiprows=lines, index_col=False, encoding="utf-8")
    reader: Iterator[pd.DataFrame] | None = None
    with opened(path) as file:
        while True:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                reader = reader or pd.read_csv(file, **options)
                table = next(reader, None)
            text = " ".join(str(entry.message) for entry in caught)
            audit.drop("ragged_row", len(re.findall(r"Skipping line \d+", text)), unread=True)
            if table is None:
                return
            yield table


def first_rows(path: Path) -> pd.DataFrame:
    """Return the first rows of a CSV or Parquet table, nothing renamed and nothing converted."""
    with path.open("rb") as file:
        parquet = file.read(4) == b"PAR1"
    with damage_named(path, "Parquet" if parquet else "CSV"):
        if parquet:
            import pyarrow.parquet as pq

            with pq.ParquetFile(path) as table:
                first: pd.DataFrame = next(table.iter_batches(batch_size=2000)).to_pandas()
            return first
        header = header_of(path)
        options = dict(names=header[0], chunksize=2000, on_bad_lines="skip", na_values=_BLANKS)
        return next(csv_pieces(path, header, Audit(), **options))


def header_of(path: Path) -> Header:
    """Read the header of a CSV file, which may follow comments; names that repeat are numbered."""
    # utf-8-sig: a byte order mark is no part of the first name.
    with io.TextIOWrapper(opened(path), encoding="utf-8-sig", newline="") as file:
        line, lines, comment = file.readline(_LONGEST_HEADER), 1, ""
        while line.startswith("#") and lines <= _MOST_COMMENTS:
            comment, line = line, file.readline(_LONGEST_HEADER)
            lines += 1
    # Lines that begin with # are comments; but where what follows them is no header (its first
    # entry is a number), the last of them names the columns.
    if comment and not re.match(r"\s*[\"']?[A-Za-z_]", line):
        line, lines = comment.lstrip("# "), lines - 1
    if len(line) >= _LONGEST_HEADER:
        raise InputError(
            f"has no header row within {_LONGEST_HEADER:,} characters",
            remedy="Tables have one line a report, the first of them names the columns",
        )
    if not line.strip():
        raise InputError("has no header row", remedy="The first row names the columns")
    separator = max(",;\t", key=line.count)  # a comma for a table of one column
    names: list[str] = []
    for name in next(csv.reader([line.rstrip("\r\n")], delimiter=separator)):
        # pandas refuses a name twice.
        names.append(name if name not in names else f"{name} (column {len(names) + 1})")
    return names, separator, lines


def _read_parquet(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    require_parquet(path)
    import pyarrow.parquet as pq

    # A little at a time: whole column chunks of a large row group are hundreds of MB.
    with pq.ParquetFile(path, buffer_size=2**20, pre_buffer=False) as file:
        inside = file.schema_arrow.names
        # A column of the file comes before one of its folder.
        pairs = (folder.split("=", 1) for folder in path.absolute().parent.parts if "=" in folder)
        folders = {
            name: "" if value == "__HIVE_DEFAULT_PARTITION__" else unquote(value)
            for name, value in pairs
            if name and name not in inside
        }
        names = [*inside, *folders]
        matched = sources(names, mapping)
        every = dict.fromkeys(column for source in matched.values() for column in source.columns)

        def tables() -> Iterator[pd.DataFrame]:
            columns = [column for column in every if column in inside]
            for batch in file.iter_batches(batch_size=ROWS_PER_PIECE, columns=columns):
                batch.validate(full=True)  # text that is not UTF-8
                yield batch.to_pandas(ignore_metadata=True).assign(**folders)

        yield from _in_si(tables(), names, matched, audit)


def to_raw(table: pd.DataFrame, columns: Mapped, audit: Audit) -> pd.DataFrame:
    """Bring a table with the file's column names to raw columns in SI."""
    raw: dict[str, NDArray[np.generic]] = {}
    for variable, source in columns.items():
        column = column_of(table, source)
        bad = np.zeros(len(table), dtype=bool)
        if variable == "time":
            time, blank = parse_times(column, source.format)
            raw |= {"time": time, "time_blank": blank}
            bad = ~possible(time) & ~blank
        elif variable in FLAGS:
            raw[variable] = decode_flags(column, variable, audit)
        elif variable in TEXT or variable.startswith(ONLY):
            # A whole number that another program wrote as 12.0 is 12.
            if pd.api.types.is_float_dtype(column.dtype) and (column.dropna() % 1 == 0).all():
                column = column.astype("Int64")
            raw[variable] = column.astype("string").fillna("").astype(str).to_numpy(dtype=object)
        else:
            values = pd.to_numeric(column, errors="coerce")
            bad = (values.isna() & column.notna()).to_numpy(dtype=bool)
            audit.repair(f"{variable}_unparsable", int(bad.sum()))
            raw[variable] = numbers(values, source.factor, source.offset)
        if bad.any():
            audit.example(variable, column.iloc[int(np.argmax(bad))])
    return pd.DataFrame(raw)


def column_of(table: pd.DataFrame, source: Source) -> Column:
    """Return the column of a source: constant, joined from parts, or with fallbacks in its gaps."""
    if source.value is not None:
        return pd.Series(source.value, index=table.index)
    column = table[source.column]
    for name in source.fallbacks:
        # Text columns hold blanks where number columns hold NaN.
        column = column.where(column.notna() & (column.astype(str).str.strip() != ""), table[name])
    if source.parts:
        date, clock, *offset = (
            table[name].astype(str).str.strip() for name in (source.column, *source.parts)
        )
        # Tables leave out the first zero of 06 and 0930.
        clock = clock.where(~clock.str.fullmatch(r"\d(\d\d)*"), "0" + clock)
        column = sum(offset, date + (" " if source.format else "T") + clock)
    return column


def merge_messages(raw: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    """Make reports, a row each, of single Mode-S messages in SI, a row each in any order.

    A transponder sends position, ground vector, and heading and airspeed in separate messages. A
    report is made of each message with a heading (without any, of each position): missing values
    are interpolated linearly in time between the same aircraft's messages with values. Both must be
    within 10 s, or one within 1 s. Messages that do not make reports are counted as
    ``merged_message``.
    """
    raw = raw.sort_values(["tail", "time"], kind="stable", ignore_index=True)
    headings = raw.columns.intersection(["magnetic_heading", "reported_heading"])
    heading = raw[headings].notna().any(axis=1)
    position = raw[["latitude", "longitude"]].notna().all(axis=1)
    wanted = (heading if heading.any() else position).to_numpy()
    audit.drop("merged_message", np.count_nonzero(~wanted), unread=True)
    seconds = seconds_since_1970(raw["time"].to_numpy())
    reports = raw.loc[wanted].copy()
    for name in raw.columns.intersection(_FILLED):
        values = pd.DataFrame({"value": raw[name], "seconds": seconds})
        valid = values.where(np.isfinite(values["value"])).groupby(raw["tail"])
        before, after = valid.ffill(), valid.bfill()
        since = (seconds - before["seconds"]).fillna(np.inf)
        until = (after["seconds"] - seconds).fillna(np.inf)
        step = after["value"] - before["value"]
        if name in ("longitude", "track"):
            step = pd.Series(wrap_degrees(step.to_numpy()))
        filled = before["value"].where(since <= until, after["value"])
        filled = filled.where(np.minimum(since, until) <= _NEAR)
        is_bracketed = (since <= _FARTHEST) & (until <= _FARTHEST) & (since + until > 0.0)
        between = before["value"] + step * since / (since + until)
        if name == "track":
            between %= 360.0
        elif name == "longitude":
            between = pd.Series(wrap_degrees(between.to_numpy()))
        filled = between.where(is_bracketed, filled)
        reports[name] = raw[name].where(np.isfinite(raw[name]), filled)[wanted]
    if "flight" in raw:
        # A callsign is sent every few seconds and applies until another one.
        label = raw["flight"].where(raw["flight"].str.strip() != "")
        reports["flight"] = label.groupby(raw["tail"]).ffill(limit=500)[wanted].fillna("")
    return reports.reset_index(drop=True)


FORMATS = (
    ReportFormat("csv", is_text, _read_csv, 9, "CSV"),
    ReportFormat("parquet", lambda start: start[:4] == b"PAR1", _read_parquet, title="Parquet"),
)
