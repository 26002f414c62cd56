"""The export formats: every module of this folder that registers one is found by its name.

Assumes that a format's module is quick to import: heavy imports stand inside its functions, since
``airswing export --help`` lists all formats.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NotRequired, TypedDict

from airswing.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Handover

Winds = Literal["corrected", "reported"]
WINDS: tuple[Winds, ...] = ("corrected", "reported")


class FileAccount(TypedDict):
    """One file that was written; a format counts in it what it has."""

    path: str
    # reports, levels, first_time, last_time: of formats that hold reports
    reports: NotRequired[int]
    levels: NotRequired[int]
    first_time: NotRequired[str]
    last_time: NotRequired[str]
    rows: NotRequired[int]  # of a table
    # flight_phase, errors: of a table of errors; m/s by pressure in hPa
    flight_phase: NotRequired[str]
    errors: NotRequired[dict[str, float]]
    entries: NotRequired[int]  # of a reject list


class ArchiveWinds(TypedDict, total=False):
    """What an archive says of one aircraft's winds; nothing of one that it does not have."""

    name: str
    reports: int
    winds_a_day: float
    # reported, corrected: value of each criterion; those exceeded
    reported: dict[str, float]
    corrected: dict[str, float]
    reported_fails: list[str]
    corrected_fails: list[str]


class Listed(ArchiveWinds):
    """An aircraft of a reject list: whether it comes off, and why."""

    aircraft: str
    why: str


class TakenOff(Listed):
    """One that comes off it."""

    still_rejected: str  # flags of other things than wind that are left to it


class Account(TypedDict):
    """What an export wrote and left out, ready for JSON."""

    files: Sequence[FileAccount]
    # reports, levels, platforms, left_out (by reason): of formats that hold reports
    reports: NotRequired[int]
    levels: NotRequired[int]
    platforms: NotRequired[dict[str, int]]
    left_out: NotRequired[dict[str, int]]
    identifiers: NotRequired[dict[str, str]]  # aircraft to the number written for it
    max_obs: NotRequired[int]  # what WRF's namelist needs
    errors_from: NotRequired[str]
    types: NotRequired[list[str]]  # of report, in OBSPROC's table
    # of a reject list
    criteria: NotRequired[dict[str, float]]
    taken_off: NotRequired[list[TakenOff]]
    stay: NotRequired[list[Listed]]
    not_listed: NotRequired[list[ArchiveWinds]]
    winds_a_day_gained: NotRequired[float]
    blank_identifiers_filled: NotRequired[int]
    notes: NotRequired[list[str]]  # for a person


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
