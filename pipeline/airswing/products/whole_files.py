"""Files written whole or not at all, through a kill at any moment and through a loss of power.

Assumes that the file system renames atomically within a folder, and that what it reports as flushed
is on the disk. A file is written under another name, flushed and renamed; then its folder is
flushed. Where the disk is full or not writable the earlier file stays.
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
    """Make a folder and those above it; take away what was made if the block fails."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for one in missing:
            with contextlib.suppress(OSError):  # not empty: somebody else's by now
                one.rmdir()
        raise


@contextlib.contextmanager
def replacing(path: Path, *, lasting: bool = True) -> Iterator[Path]:
    """Give a temporary name to write to, and rename it to ``path`` when the block ends well.

    Parameters
    ----------
    path : Path
        Of the finished file; its folder is made when absent.
    lasting : bool, default True
        Flush the folder too; else the file may be missing after a loss of power.
    """
    path = Path(path)
    # In the same folder, since a rename is atomic within one file system only; hidden, so that no
    # pattern of products matches it.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.part")
    with made_folder(path.parent):
        try:
            yield temporary
            # Before the rename: a file that outlives the power must not have
            # unwritten bytes.
            _flush(temporary)
            os.replace(temporary, path)
            if lasting:
                with contextlib.suppress(OSError):  # some systems cannot flush a folder
                    _flush(path.parent)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """As :func:`replacing`; a file that cannot be written is an `InputError`.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    try:
        with replacing(path) as temporary:
            yield temporary
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


def read_note(path: Path) -> dict[str, Any]:
    """A JSON note of an earlier run; empty where there is none that is whole."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


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
