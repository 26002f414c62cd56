"""Further kinds of model files, in addition to GRIB, NetCDF, WRF and Zarr.

A kind is recognised by a file's path or first bytes, and its winds are opened as a Dataset with CF
attributes (or the configuration names what is missing). A new kind is one new file in
``reference/gridded/formats`` that calls `register`; engines, messages and `inspect` then have it.
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

    name: str  # of the engine in the configuration
    tells: Callable[[str, bytes], bool]  # decides by path and first bytes
    # from a path to Datasets, preferably lazy; variables of different levels may be separate
    open: Callable[[str], Sequence[xr.Dataset]]


_FORMATS: dict[str, ModelFormat] = {}


def register(model_format: ModelFormat) -> ModelFormat:
    """Register a kind of model file and return it."""
    _FORMATS[model_format.name] = model_format
    return model_format


def unregister(name: str) -> None:
    """Remove a kind from the registry."""
    del _FORMATS[name]


def model_formats() -> dict[str, ModelFormat]:
    """Return every registered kind by name."""
    for found in pkgutil.iter_modules(importlib.import_module(_PACKAGE).__path__):
        importlib.import_module(f"{_PACKAGE}.{found.name}")
    return dict(_FORMATS)
