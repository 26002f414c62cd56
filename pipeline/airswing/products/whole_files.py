"""Files and folders: written whole or not at all, locked, named in errors, and their fingerprints.

Assumes that the file system renames atomically within a folder and that a file that keeps its size
and its modification time keeps its content. A file is written under a temporary name, flushed and
renamed, so that a full disk, a kill or a loss of power leaves the earlier file. Where files cannot
be locked (some network file systems, Windows), a second run into the same folder is not refused.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import json
import math
import os
import re
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from airswing.errors import InputError, shortened
from airswing.version import __version__

ZARR_MARKS = ("zarr.json", ".zmetadata", ".zgroup")
"""Files, one of which is at the top of every Zarr store."""
PACKAGE = Path(__file__).parents[1]
_LOCK = ".running"
_MOST_LISTED = 1000  # files and folders in which an example of a file is searched for
_DIGITS = 32  # hexadecimal: 128 bits, so that no two fingerprints are equal by chance


@contextlib.contextmanager
def atomic(path: Path, kind: str = "product") -> Iterator[Path]:
    """Give a temporary name to write to, and rename it to ``path`` when the block ends well.

    Its folder is created if absent; ``kind`` names the file in the error if it cannot be written.
    """
    path = Path(path)
    # In the same folder, because a rename is atomic within one file system only; hidden, so that
    # no pattern of products matches it.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.part")
    missing = [folder for folder in path.parents if not folder.exists()]
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            # before the rename, so that no file survives a loss of power without its content
            _flush(temporary)
            os.replace(temporary, path)
            with contextlib.suppress(OSError):  # some systems cannot flush a folder
                _flush(path.parent)
        except BaseException:
            with contextlib.suppress(OSError):  # absent; or another process uses the folder
                temporary.unlink(missing_ok=True)
                for folder in missing:
                    folder.rmdir()
            raise
    except (OSError, RuntimeError) as err:
        # The NetCDF and HDF5 libraries report a full disk as a RuntimeError.
        message = re.search(r"error message = '([^']*)'", str(err))
        if isinstance(err, RuntimeError) and "NetCDF" not in str(err) and message is None:
            raise
        raise InputError(
            f"cannot write the {kind}; nothing was changed",
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


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def write_json(path: Path, content: Mapping[str, object]) -> Path:
    """Write a JSON file atomically; NaN and infinities become null."""
    return write_text(path, json.dumps(json_types(content), indent=2, allow_nan=False) + "\n")


def read_note(path: Path) -> dict[str, Any]:
    """Read the JSON file of an earlier run; empty if it is absent or damaged."""
    try:
        note = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}


def json_types(value: object) -> object:
    """Convert numpy and pandas values, also nested, to JSON types.

    NaN and infinities become None; objects of other types become text.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): json_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set):
        return [json_types(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


@contextlib.contextmanager
def workspace(folder: Path) -> Iterator[None]:
    """Lock an output folder for one run, and remove partial files of a killed run.

    The folder is created if absent, and removed if the run leaves it empty.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / _LOCK).open("a")
    except OSError as err:
        raise InputError(
            "cannot write to the output folder",
            file=folder,
            found=err.strerror,
            remedy="Choose another folder with --output",
        ) from err
    with lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as err:
            raise InputError(
                "another run is writing to this folder",
                file=folder,
                remedy="Wait for its end or choose another folder with --output",
            ) from err
        except (ImportError, OSError):
            pass  # files cannot be locked here
        else:
            # only with the lock: temporary files of a running process look the same
            for partial in folder.rglob("*.part"):
                partial.unlink(missing_ok=True)
        try:
            yield
        finally:
            (folder / _LOCK).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()


def require_parquet(path: Path) -> None:
    """Raise InputError about a Parquet file if the library of Parquet is not installed."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as err:
        remedy = "Install it with: pip install 'airswing[parquet]'"
        raise InputError("Parquet needs pyarrow", file=path, remedy=remedy) from err


def none_found(pattern: str | os.PathLike[str], field: str) -> InputError:
    """Return the error for a path or pattern of a key (`field`) that names no file."""
    text = os.fspath(pattern)
    message, folder = "no file found that may be read", Path(text)
    remedy = (
        "Check the pattern and the permissions of its folders; relative paths start at the current "
        "directory"
    )
    if os.path.isdir(folder):  # False where a folder above may not be entered
        # of a large tree only the beginning, because one file is enough for an example
        some = sorted(itertools.islice(folder.rglob("*"), _MOST_LISTED))
        first = next((path for path in some if os.path.isfile(path)), folder / "*")
        below = folder if first.parent == folder else folder / "**"
        message, remedy = "is a folder", f"Name the files in it, such as {below}/*{first.suffix}"
    return InputError(
        message, field=field, found=f"pattern {text!r} in folder {os.getcwd()}", remedy=remedy
    )


def fingerprint(*parts: object) -> str:
    """Hash (32 hex digits) of everything a product depends on, the version of airswing included."""
    text = json.dumps([__version__, json_types(list(parts))], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


@functools.cache
def code_digest() -> str:
    """Hash (32 hex digits) of the source code and tables of the package.

    Products of an earlier state of the code are remade also where the version is the same.
    """
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in (".py", ".csv"):
            digest.update(f"{path.relative_to(PACKAGE)}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:_DIGITS]


class Findings(dict[str, Any]):
    """A stage's result: a mapping whose ``repr`` has a line a key, of at most 100 characters."""

    def __repr__(self) -> str:
        return "\n".join(f"{key}: {shortened(value, 98 - len(key))}" for key, value in self.items())
