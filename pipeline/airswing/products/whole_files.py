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
from typing import Any

import numpy as np

from airswing.errors import InputError
from airswing.products.atomic import replacing


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, and rename it to ``path`` when the block ends well.

    Parameters
    ----------
    path : Path
        Where the finished file shall stand; its folder is made when absent.

    Yields
    ------
    Path
        Where to write.

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
    """Make sure products can be written to a folder, before hours are spent on them.

    Parameters
    ----------
    folder : Path
        Made when absent.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    with atomic(Path(folder) / ".writable") as temporary:
        temporary.touch()
    (Path(folder) / ".writable").unlink()


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically.

    Returns
    -------
    Path
        The path written.
    """
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def write_json(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON file atomically; NaN and infinities become null.

    Returns
    -------
    Path
        The path written.
    """
    return write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """Turn numpy and pandas values into what JSON can hold.

    Parameters
    ----------
    value : object
        Nested mappings, sequences, arrays and scalars.

    Returns
    -------
    object
        The same with lists, floats, ints and strings; not-a-number becomes None.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()]
    if isinstance(value, (list, tuple, set)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
