"""The report formats: every module of ``reports/formats`` that registers one is found.

Assumes a file's format shows in its first octets (a compressed file's unpacked ones): every format
says whether it knows them, the more specific before the general (``rank``).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.columns import Source

Mapped = Mapping[str, tuple[str, Source]]
"""Column of the piece to the user's name and source; of `parse_mapping`."""
Pieces = Callable[[Path, Mapped, Audit], Iterator[pd.DataFrame]]
"""Reads a file piece by piece: raw pieces in SI for `airswing.reports.canonical.cleaning.clean`.

Takes the file, the columns as the user maps them (of
:func:`airswing.reports.canonical.columns.parse_mapping`; a format of fixed names passes them over)
and the audit, to which all is added that is dropped, repaired or coded.
"""


@dataclass(frozen=True)
class ReportFormat:
    """One format of report files; those of a lower rank are asked first."""

    name: str  # as the configuration says it
    tells: Callable[[bytes], bool]  # whether a file that begins with these octets is one
    pieces: Pieces
    rank: int = 0


_FORMATS: dict[str, ReportFormat] = {}


def register(report_format: ReportFormat) -> ReportFormat:
    """Add a format; a second one of its name is a ValueError."""
    known = _FORMATS.setdefault(report_format.name, report_format)
    if known.name != report_format.name or known.pieces is not report_format.pieces:
        raise ValueError(f"two report formats are named {report_format.name!r}")
    return report_format


def unregister(name: str) -> None:
    """Take a format out again."""
    del _FORMATS[name]


def formats() -> dict[str, ReportFormat]:
    """Every format by name, in the order in which they are asked."""
    room = importlib.import_module("airswing.reports.formats")
    for found in pkgutil.iter_modules(room.__path__):
        importlib.import_module(f"airswing.reports.formats.{found.name}")
    return dict(sorted(_FORMATS.items(), key=lambda item: (item[1].rank, item[0])))


def is_text(start: bytes) -> bool:
    """Tell whether octets are those of a text file."""
    # A NUL or two is a damaged row; text in two octets a character has them all over.
    control = sum(byte < 32 and byte not in (9, 10, 13) for byte in start)
    return control <= 0.05 * len(start)
