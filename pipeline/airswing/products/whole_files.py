"""Files written whole or not at all, also if the process is killed or the power is lost.

Assumes that the file system renames atomically within a folder and has written to the disk what it
reports as flushed. A file is written under a temporary name, flushed and renamed; then its folder
is flushed. If the disk is full or not writable, the earlier file stays.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from airswing.errors import InputError


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and its parents; remove the new ones if the block fails."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in missing:
            with contextlib.suppress(OSError):  # not empty: another process uses it
                path.rmdir()
        raise


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, and rename it to ``path`` when the block ends well.

    Parameters
    ----------
    path : Path
        Of the finished file; its folder is made when absent.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    path = Path(path)
    # In the same folder, because a rename is atomic within one file system only; hidden, so that
    # no pattern of products matches it.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.part")
    try:
        with made_folder(path.parent):
            try:
                yield temporary
                # before the rename, so that no file survives a loss of power without its content
                _flush(temporary)
                os.replace(temporary, path)
                with contextlib.suppress(OSError):  # some systems cannot flush a folder
                    _flush(path.parent)
            finally:
                with contextlib.suppress(OSError):
                    temporary.unlink(missing_ok=True)
    except (OSError, RuntimeError) as err:
        # The NetCDF and HDF5 libraries report a full disk as a RuntimeError.
        message = re.search(r"error message = '([^']*)'", str(err))
        if isinstance(err, RuntimeError) and "NetCDF" not in str(err) and message is None:
            raise
        raise InputError(
            "cannot write the product; nothing was changed",
            file=path,
            found=message[1] if message else getattr(err, "strerror", None) or err,
            remedy="Free space or choose another folder with --output",
        ) from err


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def require_writable(folder: Path) -> None:
    """Check that a folder can be written to; InputError if not."""
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


def read_note(path: Path) -> dict[str, Any]:
    """Read the JSON file of an earlier run; empty if it is absent or damaged."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def plain(value: object) -> object:
    """Convert numpy and pandas values, also nested, to JSON types.

    NaN and infinities become None; objects of other types become text.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()]
    if isinstance(value, (list, tuple, set)):
        return [plain(item) for item in value]
    # before float: numpy's doubles are floats too
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
