"""Files of any kind written whole or not at all, text and JSON among them.

Assumes a disk that may be full or closed: that is told in words, and what stood there before stays
(:mod:`airswing.products.atomic`).
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from airswing.errors import InputError
from airswing.products.atomic import replacing


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """As `airswing.products.atomic.replacing`, with what cannot be written told in words.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    try:
        with replacing(path) as temporary:
            yield temporary
    except (OSError, RuntimeError) as err:
        # The NetCDF and HDF5 libraries tell a full disk as a RuntimeError of their own.
        told = re.search(r"error message = '([^']*)'", str(err))
        if isinstance(err, RuntimeError) and "NetCDF" not in str(err) and told is None:
            raise
        raise InputError(
            "cannot write the product; nothing was changed",
            file=path,
            found=told[1] if told else getattr(err, "strerror", None) or err,
            remedy="Free space or choose another folder with --output",
        ) from err


def require_writable(folder: Path) -> None:
    """Make sure products can be written to a folder, before hours are spent on them."""
    with atomic(Path(folder) / ".writable") as temporary:
        temporary.touch()
    (Path(folder) / ".writable").unlink()


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def write_json(path: Path, content: Mapping[str, object]) -> Path:
    """Write a JSON file atomically; NaN and infinities become null."""
    return write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


def plain(value: object) -> object:
    """Turn numpy and pandas values, nested in mappings, sequences and arrays, into what JSON holds.

    Not-a-number becomes None; what is none of these its text.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()]
    if isinstance(value, (list, tuple, set)):
        return [plain(item) for item in value]
    # Before float: numpy's doubles are floats too, and their item is the plain one.
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
