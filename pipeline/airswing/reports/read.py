"""Read aircraft reports of any known format into one Dataset.

Assumes files named by path or glob; what a file is comes from its content, never its name. Files
are read one by one and piece by piece, and each file counts whole or not at all.
"""

from __future__ import annotations

import glob
import gzip
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import xarray as xr

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.canonical import clean
from airswing.reports.columns import ColumnMapping, parse_mapping
from airswing.reports.tabular import Mapped, csv_pieces, parquet_pieces

Format = Literal["auto", "csv", "parquet", "madis", "bufr"]
Policy = Literal["skip", "fail"]
Pieces = Callable[[Path, Mapped, Audit], Iterator[pd.DataFrame]]

FORMATS = ("auto", "csv", "parquet", "madis", "bufr")
_MAGIC = (
    (b"CDF\x01", "madis"),
    (b"CDF\x02", "madis"),
    (b"CDF\x05", "madis"),
    (b"\x89HDF\r\n\x1a\n", "madis"),
    (b"PAR1", "parquet"),
)


def read_reports(
    files: str | Path | Sequence[str | Path],
    *,
    format: Format = "auto",
    columns: ColumnMapping | None = None,
    on_bad_file: Policy = "skip",
) -> xr.Dataset:
    """Read aircraft reports into the canonical Dataset.

    Parameters
    ----------
    files : str, path, or sequence of them
        Paths or globs.
    format : {"auto", "csv", "parquet", "madis", "bufr"}, default "auto"
        "auto" tells it from each file's content.
    columns : mapping, optional
        For tables: their name to a canonical name (``wind_speed_kt``), or to
        ``{"name": "wind_speed_kt", "unit": "m/s"}`` where the unit is another.
    on_bad_file : {"skip", "fail"}, default "skip"
        Whether a file that cannot be read is left out and counted, or refused.

    Returns
    -------
    Dataset
        Dimension ``report`` in order of ``aircraft`` and time with ``row_size``: time,
        latitude, longitude (degrees), pressure (Pa), pressure_altitude (m), eastward_wind and
        northward_wind (m s-1, as reported), air_temperature (K), the flags, phase, flight,
        reported_airspeed (m s-1), reported_heading (degrees), and per aircraft the resolutions
        found in the data. ``attrs["reading_audit"]`` holds the counts as JSON.

    Raises
    ------
    InputError
        No file matches, none can be read, none holds a usable report, or (policy "fail") one
        cannot be read.
    """
    from airswing.reports.assemble import assembled, completed
    from airswing.reports.spool import Spool

    spool = Spool()
    spool.fill(files, format=format, columns=columns, on_bad_file=on_bad_file)
    tails = list(spool.counts())
    block = assembled(*spool.columns(tails[0], tails[-1]), spool.audit)
    (reports,) = completed([block])
    return reports.assign_attrs(reading_audit=spool.audit.as_json(), featureType="trajectory")


def iter_frames(
    files: str | Path | Sequence[str | Path],
    *,
    format: Format = "auto",
    columns: ColumnMapping | None = None,
    on_bad_file: Policy = "skip",
    audit: Audit | None = None,
) -> Iterator[pd.DataFrame]:
    """Read reports as canonical frames, file by file.

    Parameters
    ----------
    files, format, columns, on_bad_file
        As in :func:`read_reports`.
    audit : Audit, optional
        Takes the counts.

    Yields
    ------
    DataFrame
        Cleaned reports of (a piece of) one file, not yet ordered nor free of duplicates; see
        :func:`airswing.reports.canonical.clean`.

    Raises
    ------
    InputError
        As in :func:`read_reports`.
    """
    require_format(format)
    audit = Audit() if audit is None else audit
    mapping = parse_mapping(columns)
    paths = expand(files)
    errors: list[InputError] = []
    for path in paths:
        own = Audit()
        try:
            frames = list(file_frames(path, format, mapping, own))
        except InputError as error:
            if on_bad_file == "fail":
                raise
            errors.append(error)
            audit.files_skipped.append({"file": str(path), "reason": str(error)})
            continue
        audit.add(own)
        while frames:
            yield frames.pop(0)
    if len(errors) == len(paths):
        raise none_read(errors)


def require_format(format: str) -> None:
    """Refuse a format that is not known.

    Parameters
    ----------
    format : str

    Raises
    ------
    InputError
    """
    if format not in FORMATS:
        raise InputError(
            "unknown report format", field="reports.format", found=format,
            remedy=f"One of: {', '.join(FORMATS)}",
        )  # fmt: skip


def none_usable(audit: Audit) -> InputError:
    """Say why no report was usable.

    Parameters
    ----------
    audit : Audit

    Returns
    -------
    InputError
    """
    reasons = ", ".join(f"{reason} {n}" for reason, n in audit.dropped.most_common())
    unread = ", ".join(f"{name} such as {value}" for name, value in audit.examples.items())
    return InputError(
        "no usable report",
        field="reports.files",
        found=f"{audit.read} reports read, dropped for: {reasons}"
        + (f"; cannot be read: {unread}" if unread else ""),
        remedy="Times are ISO 8601 UTC, yyyymmddHHMM or seconds since 1970; numbers have a "
        "decimal point",
    )


def none_read(errors: list[InputError]) -> InputError:
    """Say why no file could be read.

    Parameters
    ----------
    errors : list of InputError
        One a file.

    Returns
    -------
    InputError
    """
    if len(errors) == 1:
        return errors[0]
    return InputError(
        f"none of the {len(errors)} report files can be read; the first: {errors[0]}",
        field="reports.files",
    )


def file_frames(path: Path, format: str, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one file as canonical frames, piece by piece.

    Parameters
    ----------
    path : Path
    format : str
    mapping : mapping
        Of :func:`airswing.reports.columns.parse_mapping`.
    audit : Audit
        Takes the counts; not to be used where the file cannot be read to its end.

    Yields
    ------
    DataFrame
        As :func:`iter_frames`.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    kind = detect_format(path) if format == "auto" else format
    audit.formats[kind] += 1
    try:
        for piece in _reader(kind)(path, mapping, audit):
            yield clean(piece, audit)
    except OSError as error:
        raise InputError(f"cannot be read: {error}", file=path) from error


def _reader(kind: str) -> Pieces:
    if kind == "csv":
        return csv_pieces
    if kind == "parquet":
        return parquet_pieces
    if kind == "madis":
        from airswing.reports.madis import madis_pieces

        return madis_pieces
    from airswing.reports.bufr import bufr_pieces

    return bufr_pieces


def expand(files: str | Path | Iterable[str | Path]) -> list[Path]:
    """Paths that names and globs stand for.

    Parameters
    ----------
    files : str, path, or iterable of them

    Returns
    -------
    list of Path
        Each once, in order of name.

    Raises
    ------
    InputError
        If one of them matches nothing.
    """
    patterns = [files] if isinstance(files, str | Path) else list(files)
    found: dict[str, None] = {}
    for pattern in patterns:
        text = str(Path(pattern).expanduser())
        names = [text] if Path(text).is_file() else glob.glob(text, recursive=True)
        names = sorted(name for name in names if Path(name).is_file())
        if not names:
            folder = Path(text).is_dir()
            raise InputError(
                "is a folder" if folder else "no file matches",
                field="reports.files",
                found=f"pattern {str(pattern)!r} in folder {Path.cwd()}",
                remedy=f"Name the files in it, such as {text}/*.csv"
                if folder
                else "Relative paths start at the current directory",
            )
        found.update(dict.fromkeys(names))
    if not found:
        raise InputError("names no file", field="reports.files")
    return [Path(name) for name in found]


def detect_format(path: Path) -> str:
    """Tell a report file's format from its first bytes.

    Parameters
    ----------
    path : Path

    Returns
    -------
    {"csv", "parquet", "madis", "bufr"}

    Raises
    ------
    InputError
        The file is empty, cannot be opened, or is none of these.
    """
    start = _first_bytes(path)
    if not start:
        raise InputError("is empty", file=path)
    for magic, kind in _MAGIC:
        if start.startswith(magic):
            return kind
    text = b"\x00" not in start and _share_of_control_bytes(start) <= 0.05
    if b"BUFR" in start and not text:
        return "bufr"
    if b"GRIB" in start and not text:
        raise InputError(
            "is a GRIB file, not reports", file=path, remedy="Name it under references"
        )
    if not text:
        raise InputError("is no report file of a known format", file=path, found=start[:16])
    return "csv"


def _first_bytes(path: Path, number: int = 4096) -> bytes:
    try:
        with path.open("rb") as file:
            start = file.read(number)
        if start[:2] == b"\x1f\x8b":
            with gzip.open(path, "rb") as packed:
                start = packed.read(number)
    except (OSError, EOFError) as error:
        raise InputError(f"cannot be opened: {error}", file=path) from error
    return start


def _share_of_control_bytes(start: bytes) -> float:
    control: Any = sum(byte < 32 and byte not in (9, 10, 13) for byte in start)
    return float(control) / len(start)
