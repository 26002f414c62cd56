"""The export formats: every module of this folder that registers one is found by its name.

Assumes that a format's module is quick to import: heavy imports stand inside its functions, since
``airswing export --help`` lists all formats.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from airswing.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Handover

Account = dict[str, Any]
"""What an export wrote and left out, ready for JSON."""
Winds = Literal["corrected", "reported"]
WINDS: tuple[Winds, ...] = ("corrected", "reported")


@dataclass(frozen=True)
class Request:
    """What is to be handed over, where to and how."""

    corrected: xr.Dataset  # ``corrected.nc``, in memory or opened lazily
    path: Path  # file or folder to write
    folder: bool  # whether it is a folder
    settings: Handover  # of the configuration, with what the command line said over it
    winds: Winds = "corrected"
    window: float | None = None  # s; each such stretch of time gets a file of its own
    soundings: bool = False  # join every ascent and descent into one report
    overwrite: bool = False
    products: Path | None = None  # folder of the run's other products


@dataclass(frozen=True)
class ExportFormat:
    """One format reports or what is known of them can be written in."""

    name: str  # as given to ``--to``
    summary: str  # one line for a person: what it is and who reads it
    # Gives the account of what was written: ``files`` (list of ``{"path": ..., ...}``),
    # ``left_out`` (counts by reason), what else there is to tell, and ``notes`` for a person.
    write: Callable[[Request], Account]


_FORMATS: dict[str, ExportFormat] = {}


def register(export_format: ExportFormat) -> ExportFormat:
    """Add a format; a second one of its name is a ValueError."""
    known = _FORMATS.setdefault(export_format.name, export_format)
    if known is not export_format:
        raise ValueError(f"two export formats are named {export_format.name!r}")
    return export_format


def unregister(name: str) -> None:
    """Take a format out again."""
    del _FORMATS[name]


def formats() -> Mapping[str, ExportFormat]:
    """Every format by name, in alphabetical order, all modules of the room imported."""
    room = importlib.import_module("airswing.handover")
    for found in pkgutil.iter_modules(room.__path__):
        importlib.import_module(f"airswing.handover.{found.name}")
    return dict(sorted(_FORMATS.items()))


def format_of(name: str) -> ExportFormat:
    """Find a format.

    Raises
    ------
    InputError
        If there is none of this name.
    """
    known = formats()
    if name not in known:
        raise InputError(
            "no such export format", field="--to", found=name, remedy=f"Known: {', '.join(known)}"
        )
    return known[name]
