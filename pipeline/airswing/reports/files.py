"""One report file: found by name or pattern, told by its content, read piece by piece.

Assumes a file counts whole or not at all; what it is comes from its content, never its name.
"""

from __future__ import annotations

import glob
import gzip
import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.products.named_files import none_found
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.cleaning import clean
from airswing.reports.canonical.columns import ONLY
from airswing.reports.canonical.report_formats import Mapped, formats, is_text

Format = str
"""``auto``, or the name of a registered format."""
Policy = Literal["skip", "fail"]

# What libraries raise on octets that contradict each other.
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
)


def require_format(format: str) -> None:
    """Refuse a format that is not known."""
    known = ("auto", *formats())
    if format not in known:
        raise InputError(
            "unknown report format",
            field="reports.format",
            found=format,
            remedy=f"One of: {', '.join(known)}",
        )


def none_usable(audit: Audit) -> InputError:
    """Say why no report was usable."""
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
    """Say why no file could be read, from one error a file."""
    if len(errors) == 1:
        return errors[0]
    return InputError(
        f"none of the {len(errors)} report files can be read; the first: {errors[0]}",
        field="reports.files",
    )


def file_frames(path: Path, format: str, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Read one file as canonical frames, piece by piece.

    The audit takes the counts, and is not to be used where the file cannot be read to its end.
    """
    kind = _detect_format(path) if format == "auto" else format
    audit.formats[kind] += 1
    try:
        for piece in _pieces(kind, path, mapping, audit):
            yield clean(_wanted(piece, mapping, path, audit), audit)
    except OSError as error:
        raise InputError(f"cannot be read: {error}", file=path) from error


def _wanted(piece: pd.DataFrame, mapping: Mapped, path: Path, audit: Audit) -> pd.DataFrame:
    """Rows whose values are among those the configuration keeps."""
    keep = np.ones(len(piece), dtype=bool)
    for name, (theirs, source) in mapping.items():
        if not name.startswith(ONLY):
            continue
        if name not in piece:
            raise InputError(
                "has no column by which reports could be chosen",
                file=path,
                field=f"reports.only.{theirs}",
                found=", ".join(piece.columns),
                remedy="Leave it out for these files",
            )
        keep &= piece[name].isin(source.wanted).to_numpy(dtype=bool)
    # `clean` counts what it is given; what is left out here it never sees.
    audit.read += int(np.count_nonzero(~keep))
    audit.drop("not_wanted", int(np.count_nonzero(~keep)))
    return piece if keep.all() else piece.loc[keep]


def _pieces(kind: str, path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Pieces of a file; whatever its octets lead a library to raise is a fault of the file."""
    pieces = formats()[kind].pieces(path, mapping, audit)
    while True:
        try:
            piece = next(pieces, None)
        except _DAMAGE as error:
            raise InputError(
                f"cannot be read: {type(error).__name__}: {error}", file=path
            ) from error
        if piece is None:
            return
        yield piece


def expand(files: str | Path | Iterable[str | Path]) -> list[Path]:
    """Paths that names and globs stand for, each once.

    Raises
    ------
    InputError
        If one of them matches nothing.
    """
    patterns = [files] if isinstance(files, str | Path) else list(files)
    found: dict[str, None] = {}
    for pattern in patterns:
        text = str(Path(pattern).expanduser())
        # A file whose name holds brackets is itself first, and a pattern only where there
        # is none.
        names = [text] if os.path.isfile(text) else glob.glob(text, recursive=True)
        # A link that leads nowhere is a file that is missing: reading it fails and names it.
        names = sorted(name for name in names if os.path.isfile(name) or not os.path.exists(name))
        if not names:
            raise none_found(text, "reports.files")
        found.update(dict.fromkeys(names))
    if not found:
        raise InputError("names no file", field="reports.files")
    return [Path(name) for name in found]


def _detect_format(path: Path) -> str:
    """Tell a report file's format from its first bytes."""
    start = _first_bytes(path)
    if not start:
        raise InputError("is empty", file=path)
    for name, one in formats().items():
        if one.tells(start):
            return name
    if b"GRIB" in start and not is_text(start):
        raise InputError(
            "is a GRIB file, not reports", file=path, remedy="Name it under references"
        )
    raise InputError("is no report file of a known format", file=path, found=start[:16])


def _first_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            start = file.read(4096)
        if start[:2] == b"\x1f\x8b":
            with gzip.open(path, "rb") as packed:
                start = packed.read(4096)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be opened: {error}", file=path) from error
    return start
