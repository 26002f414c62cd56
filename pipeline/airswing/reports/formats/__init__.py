"""Report formats: the tuples ``FORMATS`` of the modules of this package.

The format of a file is recognised by its first bytes (after decompression); specific formats are
tried before general ones (``priority``). A new format is a new module with such a tuple; nothing
else is changed.
"""

from __future__ import annotations

import bz2
import gzip
import importlib
import pkgutil
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

import pandas as pd

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.columns import Mapped

START = 1 << 16  # bytes by which a format is recognised; HDF5 names its groups in them
LARGEST_FILE = 1 << 30  # bytes after decompression, of formats that are read as a whole

Reader = Callable[[Path, Mapped, Audit], Iterator[pd.DataFrame]]
"""Yields raw columns in SI for :func:`airswing.reports.cleaning.clean`, piece by piece.

Takes the file, the user's mapping of :func:`airswing.reports.columns.parse_mapping` (a format with
fixed names ignores it) and the audit, to which everything dropped, repaired or coded is added.
"""


@dataclass(frozen=True)
class ReportFormat:
    """One format of report files; those of lower priority number are tried first."""

    name: str  # in the configuration
    recognises: Callable[[bytes], bool]  # whether a file that begins with these bytes is one
    read: Reader
    priority: int = 0
    title: str = "reports"  # in messages


def formats() -> dict[str, ReportFormat]:
    """Every format by name, in the order in which they are tried."""
    modules = [
        importlib.import_module(f"{__name__}.{module.name}")
        for module in pkgutil.iter_modules(__path__)
    ]
    every: list[ReportFormat] = [f for module in modules for f in module.FORMATS]
    return {f.name: f for f in sorted(every, key=lambda f: (f.priority, f.name))}


@contextmanager
def damage_named(path: Path, title: str) -> Iterator[None]:
    """Name the file in every InputError, to which any exception of a library is converted."""
    try:
        yield
    except InputError as error:
        raise error.located(file=path) from error.__cause__
    except UnicodeDecodeError as error:
        remedy = "Save it as UTF-8, or remove it"
        raise InputError("is not UTF-8 text", file=path, remedy=remedy) from error
    except Exception as error:
        self_explanatory = isinstance(error, OSError | ValueError | EOFError | zlib.error)
        problem = str(error) if self_explanatory else f"{type(error).__name__}: {error}"
        raise InputError(f"cannot be read as {title}: {problem}", file=path) from error


def is_text(start: bytes) -> bool:
    """Return True where bytes look like those of a text file."""
    # A NUL or two is a damaged row; in UTF-16 every second byte is one.
    beginning = start[:4096]
    control = sum(byte < 32 and byte not in (9, 10, 13) for byte in beginning)
    return control <= 0.05 * len(beginning)


def opened(path: Path) -> BinaryIO:
    """Open a file for reading, decompressed where it is compressed with gzip or bzip2."""
    with path.open("rb") as file:
        start = file.read(3)
    opener = gzip.open if start[:2] == b"\x1f\x8b" else bz2.open if start == b"BZh" else open
    return cast(BinaryIO, opener(path, "rb"))


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file after decompression."""
    try:
        with opened(path) as file:
            return file.read(START)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be opened: {error}", file=path) from error


def content_of(path: Path) -> bytes:
    """Return a file's decompressed content, which is at most :data:`LARGEST_FILE`."""
    with opened(path) as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise InputError(f"decompresses to more than {LARGEST_FILE:,} bytes")
    return content
