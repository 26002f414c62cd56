"""Kinds of model file beside GRIB, NetCDF, wrfout and Zarr: every module of one folder is found.

Assumes a kind shows in a file's first octets or its path, and that its winds make a Dataset which
says what it is by CF attributes (or the configuration says it). A new kind is one new file in
``reference/gridded/formats`` that calls `register`; engine, `auto`, messages and `inspect` have it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ModelFormat", "model_formats", "register", "unregister"]

_PACKAGE = "airswing.reference.gridded.formats"


@dataclass(frozen=True)
class ModelFormat:
    """One kind of model file."""

    name: str  # of the engine, as the configuration says it
    tells: Callable[[str, bytes], bool]  # whether a file is one, from its path and its first octets
    # path to Datasets, best lazy; variables of different levels may be apart
    open: Callable[[str], Sequence[xr.Dataset]]


_FORMATS: dict[str, ModelFormat] = {}


def register(model_format: ModelFormat) -> ModelFormat:
    """Add a kind."""
    _FORMATS[model_format.name] = model_format
    return model_format


def unregister(name: str) -> None:
    """Take a kind out again."""
    del _FORMATS[name]


def model_formats() -> dict[str, ModelFormat]:
    """Every kind by name."""
    for found in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__):
        importlib.import_module(f"{_PACKAGE}.{found.name}")
    return dict(_FORMATS)
