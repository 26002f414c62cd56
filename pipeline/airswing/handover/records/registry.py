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

Winds = Literal["corrected", "reported"]
WINDS: tuple[Winds, ...] = ("corrected", "reported")


@dataclass(frozen=True)
class Request:
    """What is to be handed over, where to and how.

    Parameters
    ----------
    corrected : Dataset
        ``corrected.nc``, in memory or opened lazily.
    path : Path
        File or folder to write.
    folder : bool
        Whether it is a folder.
    settings : Handover
        Section ``handover`` of the configuration, with what the command line said over it.
    winds : {"corrected", "reported"}
        Which winds to write.
    window : float, optional
        Length of the time windows that get a file each, s; one file for all when not given.
    soundings : bool
        Join every ascent and descent into one report.
    overwrite : bool
        Replace files that are there.
    products : Path, optional
        Folder of the run's other products.
    """

    corrected: xr.Dataset
    path: Path
    folder: bool
    settings: Handover
    winds: Winds = "corrected"
    window: float | None = None
    soundings: bool = False
    overwrite: bool = False
    products: Path | None = None


@dataclass(frozen=True)
class ExportFormat:
    """One format reports or what is known of them can be written in.

    Parameters
    ----------
    name : str
        As given to ``--to``.
    summary : str
        One line for a person: what it is and who reads it.
    write : callable
        Takes a :class:`Request`, writes, and returns the account of what was written:
        ``files`` (list of ``{"path": ..., ...}``), ``left_out`` (counts by reason) and what
        else there is to tell; ``notes`` are lines for a person.
    """

    name: str
    summary: str
    write: Callable[[Request], dict[str, Any]]


_FORMATS: dict[str, ExportFormat] = {}


def register(export_format: ExportFormat) -> ExportFormat:
    """Add a format.

    Returns
    -------
    ExportFormat
        The same.

    Raises
    ------
    ValueError
        If another format has its name.
    """
    known = _FORMATS.setdefault(export_format.name, export_format)
    if known is not export_format:
        raise ValueError(f"two export formats are named {export_format.name!r}")
    return export_format


def unregister(name: str) -> None:
    """Take a format out again."""
    del _FORMATS[name]


def formats(package: str = "airswing.handover") -> Mapping[str, ExportFormat]:
    """Every format by name, all modules of the package imported.

    Returns
    -------
    mapping of str to ExportFormat
        In alphabetical order.
    """
    folder = importlib.import_module(package)
    for found in pkgutil.iter_modules(folder.__path__):
        importlib.import_module(f"{package}.{found.name}")
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
