"""Headers of GRIB files, kept between runs in the user's cache folder.

An entry is valid for a file's path, size, modification time and a sample of its bytes, and for the
code that read it. Nothing is written into the data folder. A cache that cannot be read or written
costs time, not the run: one warning is given, and a damaged one is replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
import sqlite3
import sys
import warnings
import zlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from airswing.errors import InputError
from airswing.reference import grids, state
from airswing.reference.files import SourceFile, local_path
from airswing.reference.grib import grid_sections, headers
from airswing.reference.grib.headers import FileContents

_NAME = "grib-headers-2.sqlite"
_TOGETHER = 500  # entries of one transaction: each costs a write to the disk


def contents_of(
    files: Sequence[SourceFile], folder: str | os.PathLike[str] | None = None
) -> Iterator[FileContents | OSError | InputError]:
    """Contents of files in turn, from the cache or a scan; the error if a file is unreadable.

    Parameters
    ----------
    folder : path-like, optional
        Folder of the cache; by default ``AIRSWING_CACHE``, else the system's cache folder.
    """
    cache = _Cache(Path(folder) if folder is not None else _default_folder())
    try:
        for file in files:
            key = hashlib.blake2b(
                "\0".join([*map(str, file), _code_version()]).encode(), digest_size=16
            ).hexdigest()
            contents = cache.get(key)
            if contents is None:
                try:
                    contents = headers.scan_file(local_path(file.path))
                except (OSError, InputError) as error:
                    yield error
                    continue
                cache.put(key, contents)
            yield contents
    finally:
        cache.close()


def _default_folder() -> Path:
    named = os.environ.get("AIRSWING_CACHE")
    if named:
        return Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "airswing"
    root = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    return Path(root or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "airswing"


@lru_cache(maxsize=1)
def _code_version() -> str:
    digest = hashlib.blake2b(digest_size=12)
    for module in (grids, grid_sections, state, headers):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


class _TuplesOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> object:
        raise pickle.UnpicklingError(f"{module}.{name} in the cache")


class _Cache:
    """Contents of files by key, in a database; without one if it cannot be opened."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / _NAME
        self.pending: list[tuple[str, bytes]] = []
        self.database: sqlite3.Connection | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._open()
        except (OSError, sqlite3.OperationalError) as error:
            self._warn(error)
            # immutable: a folder that cannot be written takes no lock file either
            with contextlib.suppress(OSError, sqlite3.Error):
                address = f"{self.path.absolute().as_uri()}?mode=ro&immutable=1"
                self.database = sqlite3.connect(address, uri=True)
        except sqlite3.DatabaseError as error:
            self._replace(error)

    def _open(self) -> None:
        self.database = sqlite3.connect(self.path, timeout=30.0)
        self.database.execute("PRAGMA synchronous=OFF")  # everything can be read again
        self.database.execute("PRAGMA journal_mode=TRUNCATE")  # a kill leaves the database whole
        self.database.execute(
            "CREATE TABLE IF NOT EXISTS files (key TEXT PRIMARY KEY, content BLOB)"
        )

    def _replace(self, error: sqlite3.Error) -> None:
        warnings.warn(
            f"{self.path} is damaged ({error}): GRIB headers are read again", stacklevel=3
        )
        try:
            for old in (self.path, self.path.with_name(f"{_NAME}-journal")):
                old.unlink(missing_ok=True)
            self._open()
        except (OSError, sqlite3.Error):
            self.database = None

    def _warn(self, error: Exception) -> None:
        warnings.warn(
            f"cache folder {self.path.parent} cannot be written ({error}): GRIB headers will be "
            "read again by the next run",
            stacklevel=3,
        )

    def get(self, key: str) -> FileContents | None:
        """Contents by key; None if they are unknown or damaged."""
        if self.database is None:
            return None
        try:
            row = self.database.execute(
                "SELECT content FROM files WHERE key = ?", (key,)
            ).fetchone()
            if row is None:
                return None
            plain = _TuplesOnly(io.BytesIO(zlib.decompress(row[0]))).load()
            table, sections, skipped, messages, parts = plain
            found = FileContents(grids=sections, messages=messages, parts=parts)
            rows = np.frombuffer(table, dtype=headers.FIELD_DTYPE)
            found.fields = [headers.Field(*one) for one in rows.tolist()]
            found.skipped.update({(what, why): count for what, why, count in skipped})
        except (sqlite3.Error, zlib.error, pickle.UnpicklingError, ValueError, TypeError, EOFError):
            return None
        return found

    def put(self, key: str, contents: FileContents) -> None:
        """Keep contents, as tuples and bytes, which unpickle without any class."""
        skipped = [(*reason, count) for reason, count in contents.skipped.items()]
        table = contents.table().tobytes()
        plain = (table, contents.grids, skipped, contents.messages, contents.parts)
        self.pending.append((key, zlib.compress(pickle.dumps(plain), 1)))
        if len(self.pending) >= _TOGETHER:
            self._write()

    def _write(self) -> None:
        if self.database is not None and self.pending:
            try:
                with self.database:
                    command = "INSERT OR REPLACE INTO files VALUES (?, ?)"
                    self.database.executemany(command, self.pending)
            except sqlite3.OperationalError as error:  # read-only, locked or a full disk
                if "readonly" not in str(error):
                    self._warn(error)
            except sqlite3.DatabaseError as error:
                self._replace(error)
        self.pending.clear()

    def close(self) -> None:
        """Write what is pending and close the database."""
        self._write()
        if self.database is not None:
            self.database.close()
