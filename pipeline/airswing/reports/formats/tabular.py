"""Report tables: CSV text and Parquet, read in pieces.

Assumes one report a row and a header row of column names; commas, semicolons or tabs between
columns; UTF-8 text, plain or gzip-compressed. Text columns are never read as numbers, so a tail
``NA`` or ``007`` stays what it is. A row with too many columns is dropped and counted; a row
with too few has the rest missing. Folders named ``tail=N401``, as programs that divide a Parquet
table by a column write them, hold that column for the Parquet files below them.
"""

from __future__ import annotations

import csv
import gzip
import re
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TextIO
from urllib.parse import unquote

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.codes import TABLES, decode_flags
from airswing.reports.canonical.columns import ONLY, TEXT, Source, parse_mapping, sources
from airswing.reports.canonical.dialects import dialect_of
from airswing.reports.canonical.report_formats import Mapped, ReportFormat, is_text, register
from airswing.reports.canonical.times import Column, parse_times

if TYPE_CHECKING:
    from pandas.io.parsers import TextFileReader

# Rows in memory at a time: text of a table is many times what is kept of it.
ROWS_PER_PIECE = 250_000
_BUFFER = 2**20
# Octets and lines: what goes on longer before a head is no table.
_LONGEST_HEADER = 100_000
# A file of nothing but remarks is not read to its end.
_MOST_REMARKS = 200
# What is added to a name that stands in a header a second time.
_AGAIN = re.compile(r" \(column \d+\)")
_BLANKS = [
    "",
    " ",
    "NA",
    "N/A",
    "n/a",
    "NaN",
    "nan",
    "NULL",
    "null",
    "None",
    "-",
    "--",
    "M",
    "MISSING",
    "missing",
    "9999",
    "99999",
    "-9999",
    "99999.0",
    "-9999.0",
]
_EXTRA = "columns past the header"
_NO_VALUE = "__HIVE_DEFAULT_PARTITION__"
_SKIPPED = re.compile(r"Skipping line \d+")


def _csv_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read a CSV file."""
    head = _header(path)
    names = head.names
    found = sources(names, _with_dialect(names, mapping), path)
    repeated = _repeated(names, found)
    text = {
        column: str
        for name, source in found.items()
        # time joined of parts: 0930 read as a number has lost its nought
        if (name in TEXT or name.startswith(ONLY)) and (name != "time" or source.parts)
        for column in source.columns
    }
    wanted = [column for source in found.values() for column in source.columns]

    def begun() -> TextFileReader:
        return pd.read_csv(
            path,
            sep=head.separator,
            header=None,
            skiprows=head.lines,
            # One column more than the header names, to see the rows that are too long.
            names=[*names, _EXTRA],
            index_col=False,
            on_bad_lines="warn",
            dtype={**text, _EXTRA: str},
            # pandas' own list would make a tail named NA a missing one: ours is of number columns
            # alone
            keep_default_na=False,
            # a type is inferred of a whole piece: in parts one column may come out as two types
            low_memory=False,
            na_values={column: _BLANKS for column in wanted if column not in text},
            encoding="utf-8",
            compression=head.compression,
            chunksize=ROWS_PER_PIECE,
        )

    rows = 0
    for table in _tables(path, begun, audit):
        rows += len(table)
        for variable in repeated:
            audit.repair(f"{variable}_column_repeated", len(table))
        yield _raw_piece(_whole_rows(table, audit), found, audit)
    if not rows:
        raise InputError("has a header but no reports", file=path)


def first_rows(path: Path) -> pd.DataFrame:
    """The beginning of a CSV or Parquet table as it stands: nothing renamed, nothing converted."""
    with path.open("rb") as file:
        packed = file.read(4) == b"PAR1"
    if packed:
        import pyarrow.parquet as pq

        with pq.ParquetFile(path) as opened:
            first: pd.DataFrame = next(opened.iter_batches(batch_size=2000)).to_pandas()
        return first
    head = _header(path)
    try:
        return pd.read_csv(
            path,
            sep=head.separator,
            header=None,
            skiprows=head.lines,
            names=head.names,
            index_col=False,
            nrows=2000,
            on_bad_lines="skip",
            na_values=_BLANKS,
            compression="gzip" if head.compression else None,
        )
    except (ValueError, OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be read as CSV: {error}", file=path) from error


def _repeated(names: list[str], found: Mapping[str, Source]) -> list[str]:
    """Columns wanted that the header names again: the first of them counts, which is said."""
    return [
        variable
        for variable, source in found.items()
        if any(_AGAIN.fullmatch(name.removeprefix(source.column)) for name in names)
    ]


def _tables(
    path: Path, begun: Callable[[], TextFileReader], audit: Audit
) -> Iterator[pd.DataFrame]:
    """Tables of a CSV file; rows pandas skips for having far too many columns are counted."""
    reader: TextFileReader | None = None
    try:
        while True:
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    reader = begun() if reader is None else reader
                    table = next(reader, None)
            except UnicodeDecodeError as error:
                raise _not_utf8(path) from error
            except (ValueError, EOFError, OSError, zlib.error) as error:
                raise InputError(f"cannot be read as CSV: {error}", file=path) from error
            ragged = sum(len(_SKIPPED.findall(str(entry.message))) for entry in caught)
            audit.read += ragged
            audit.drop("ragged_row", ragged)
            if table is None:
                return
            yield table
    finally:
        if reader is not None:
            reader.close()


def _whole_rows(table: pd.DataFrame, audit: Audit) -> pd.DataFrame:
    """Drop rows with more columns than the header names; a lone trailing separator is no harm."""
    # pandas skips rows of two columns too many by itself: those are counted by its warnings
    ragged = (table.pop(_EXTRA).fillna("").str.strip() != "").to_numpy(dtype=bool)
    audit.read += int(ragged.sum())
    audit.drop("ragged_row", int(ragged.sum()))
    return table.loc[~ragged] if ragged.any() else table


class _Head(NamedTuple):
    """What stands before the rows of a CSV file."""

    names: list[str]
    separator: str
    compression: Literal["gzip"] | None
    lines: int


def _with_dialect(names: Sequence[str], mapping: Mapped) -> Mapped:
    """The user's mapping before that of the program which wrote the table, where it is known."""
    known = dialect_of(names)
    return mapping if known is None else {**parse_mapping(known.columns_in(names)), **mapping}


def _header(path: Path) -> _Head:
    with path.open("rb") as file:
        # by its first octets: downloads are named as they may
        packed = file.read(2) == b"\x1f\x8b"
    try:
        # utf-8-sig: a byte order mark, as spreadsheets write it, is no part of the first name
        with _opened(path, packed=packed) as file:
            line, lines = _naming_line(file)
    except UnicodeDecodeError as error:
        raise _not_utf8(path) from error
    except (EOFError, OSError, zlib.error) as error:
        raise InputError(f"cannot be read as CSV: {error}", file=path) from error
    if len(line) >= _LONGEST_HEADER:
        raise InputError(
            f"has no header row within {_LONGEST_HEADER:,} characters",
            file=path,
            remedy="Tables have one line a report, the first of them names the columns",
        )
    if not line.strip():
        raise InputError("has no header row", file=path, remedy="The first row names the columns")
    # The one most met; a comma where none is, for a table of one column.
    separator = max(",;\t", key=line.count)
    names: list[str] = []
    for name in next(csv.reader([line.rstrip("\r\n")], delimiter=separator)):
        # pandas refuses a name twice
        names.append(name if name not in names else f"{name} (column {len(names) + 1})")
    return _Head(names, separator, "gzip" if packed else None, lines)


def _opened(path: Path, *, packed: bool) -> TextIO:
    if packed:
        return gzip.open(path, "rt", encoding="utf-8-sig", newline="")
    return path.open(encoding="utf-8-sig", newline="")


def _naming_line(file: TextIO) -> tuple[str, int]:
    """The line that names the columns, and how many lines end with it.

    Lines that begin with ``#`` are remarks; but where what follows them is no header (its first
    entry is a number), the last of them names the columns.
    """
    line, lines, remark = file.readline(_LONGEST_HEADER), 1, ""
    while line.startswith("#") and lines <= _MOST_REMARKS:
        remark, line = line, file.readline(_LONGEST_HEADER)
        lines += 1
    if remark and not re.match(r"\s*[\"']?[A-Za-z_]", line):
        return remark.lstrip("# "), lines - 1
    return line, lines


def _not_utf8(path: Path) -> InputError:
    return InputError("is not UTF-8 text", file=path, remedy="Save it as UTF-8, or remove it")


def _parquet_pieces(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read a Parquet file."""
    try:
        import pyarrow.parquet as pq
    except ImportError as error:
        raise InputError(
            "reading Parquet needs pyarrow",
            file=path,
            remedy="Install it with: pip install 'airswing[parquet]'",
        ) from error
    try:
        # Read a little at a time: whole column chunks of a large row group are hundreds of MB.
        file = pq.ParquetFile(path, buffer_size=_BUFFER, pre_buffer=False)
    except Exception as error:  # pyarrow's own errors share no base with the rest
        raise InputError(f"cannot be read as Parquet: {error}", file=path) from error
    with file:
        inside = file.schema_arrow.names
        # what stands in the file counts before what its folder is called
        folders = {name: value for name, value in _of_folders(path).items() if name not in inside}
        names = [*inside, *folders]
        found = sources(names, _with_dialect(names, mapping), path)
        every = {column: None for source in found.values() for column in source.columns}
        wanted = [column for column in every if column in inside]
        if not file.metadata.num_rows:
            raise InputError("holds no reports", file=path)
        batches = file.iter_batches(batch_size=ROWS_PER_PIECE, columns=wanted)
        while (table := _next_table(batches, path)) is not None:
            yield _raw_piece(table.assign(**folders), found, audit)


class _Batch(Protocol):
    """A record batch of pyarrow."""

    def validate(self, *, full: bool) -> None: ...

    def to_pandas(self, *, ignore_metadata: bool) -> pd.DataFrame: ...


def _next_table(batches: Iterator[_Batch], path: Path) -> pd.DataFrame | None:
    try:
        batch = next(batches, None)
        if batch is None:
            return None
        batch.validate(full=True)  # text that is not UTF-8 would be noticed where it is looked at
        return batch.to_pandas(ignore_metadata=True)
    except Exception as error:  # pyarrow's own errors share no base with the rest
        raise InputError(f"cannot be read as Parquet: {error}", file=path) from error


def _of_folders(path: Path) -> dict[str, str]:
    """Columns that stand in the names of the folders of a file."""
    pairs = (part.split("=", 1) for part in path.absolute().parent.parts if "=" in part)
    return {name: "" if value == _NO_VALUE else unquote(value) for name, value in pairs if name}


def _raw_piece(table: pd.DataFrame, found: Mapping[str, Source], audit: Audit) -> pd.DataFrame:
    """Bring one table, with the file's own column names, to SI and decoded flags."""
    piece: dict[str, NDArray[np.generic]] = {}
    for variable, source in found.items():
        column = _origin(table, source)
        if variable == "time":
            time, blank = parse_times(column)
            piece |= {"time": time, "time_blank": blank}
            _first_bad(column, np.isnat(time) & ~blank, "time", audit)
        elif variable in TABLES:
            codes, missing = TABLES[variable]
            piece[variable] = decode_flags(column, codes, missing, name=variable, audit=audit)
        elif variable in TEXT or variable.startswith(ONLY):
            piece[variable] = _as_text(column)
        else:
            piece[variable] = _as_number(column, variable, audit) * source.factor + source.offset
    return pd.DataFrame(piece)


def _origin(table: pd.DataFrame, source: Source) -> Column:
    """The column a source names: constant, joined of parts, or filled row by row by others."""
    if source.value is not None:
        return pd.Series(source.value, index=table.index)
    column = table[source.column]
    for other in source.others:
        # text columns hold blanks where number columns hold nothing
        column = column.where(column.notna() & (column.astype(str).str.strip() != ""), table[other])
    if source.parts:
        column = column.astype(str).str.strip()
        for number, part in enumerate(source.parts):
            column = column + ("T" if number == 0 else "") + table[part].astype(str).str.strip()
    return column


def _first_bad(column: Column, bad: NDArray[np.bool_], variable: str, audit: Audit) -> None:
    if bad.any():
        audit.example(variable, column.iloc[int(np.argmax(bad))])


def _as_text(column: Column) -> NDArray[np.object_]:
    """Text of a column; a whole number written as 12.0 by another program is 12."""
    if pd.api.types.is_float_dtype(column.dtype) and (column.dropna() % 1 == 0).all():
        column = column.astype("Int64")
    return column.astype("string").fillna("").astype(str).to_numpy(dtype=object)


def _as_number(column: Column, variable: str, audit: Audit) -> NDArray[np.float64]:
    if pd.api.types.is_numeric_dtype(column.dtype):
        return column.to_numpy(dtype=np.float64, na_value=np.nan)
    numbers = pd.to_numeric(column, errors="coerce")
    bad = (numbers.isna() & column.notna()).to_numpy(dtype=bool)
    audit.repair(f"{variable}_unparsable", int(bad.sum()))
    _first_bad(column, bad, variable, audit)
    return numbers.to_numpy(dtype=np.float64, na_value=np.nan)


register(ReportFormat("csv", is_text, _csv_pieces, rank=9))
register(ReportFormat("parquet", lambda start: start.startswith(b"PAR1"), _parquet_pieces))
