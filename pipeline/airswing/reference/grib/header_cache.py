"""Headers of GRIB files, kept between runs in the user's cache folder.

An entry is valid for a file's path, size, modification time and a sample of its bytes, and for the
code that read it. A cache that cannot be read or written costs time and one warning, not the run; a
damaged one is replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sqlite3
import sys
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from airswing.errors import InputError
from airswing.products.whole_files import code_digest
from airswing.reference.files import SourceFile, local_path
from airswing.reference.grib import headers
from airswing.reference.grib.headers import Field, FileContents

_NAME = "grib-headers-3.sqlite"
_TOGETHER = 500  # entries of one transaction: each costs a write to the disk


def contents_of(
    files: Sequence[SourceFile], folder: str | os.PathLike[str] | None = None
) -> Iterator[FileContents | OSError | InputError]:
    """Contents of files in turn, from the cache or a scan; the error if a file is unreadable.

    The cache is by default in ``AIRSWING_CACHE``, else the system's cache folder.
    """
    cache = _Cache(Path(folder) if folder is not None else _default_folder())
    try:
        for file in files:
            key = hashlib.blake2b(
                "\0".join([*map(str, file), code_digest()]).encode(), digest_size=16
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


class _Cache:
    """Contents of files by key, in a database; without one if it cannot be opened."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / _NAME
        self.pending: list[tuple[str, bytes]] = []
        self.database: sqlite3.Connection | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._open()
        except (OSError, sqlite3.Error) as error:
            self._failed(error)

    def _open(self) -> None:
        self.database = sqlite3.connect(self.path, timeout=30.0)
        self.database.execute("PRAGMA synchronous=OFF")  # everything can be read again
        self.database.execute("PRAGMA journal_mode=TRUNCATE")  # a kill leaves the database whole
        self.database.execute(
            "CREATE TABLE IF NOT EXISTS files (key TEXT PRIMARY KEY, content BLOB)"
        )

    def _failed(self, error: Exception) -> None:
        """Go on without a database, or with a new one in place of a damaged one."""
        if isinstance(error, OSError | sqlite3.OperationalError):
            what = f"cache folder {self.path.parent} cannot be written"
        else:
            what = f"{self.path} is damaged"
        warnings.warn(f"{what} ({error}): GRIB headers are read again", stacklevel=4)
        self.close()
        if what.endswith("damaged"):
            with contextlib.suppress(OSError, sqlite3.Error):
                for old in (self.path, self.path.with_name(f"{_NAME}-journal")):
                    old.unlink(missing_ok=True)
                self._open()

    def get(self, key: str) -> FileContents | None:
        """Contents by key; None if they are unknown or damaged."""
        if self.database is None:
            return None
        try:
            query = "SELECT content FROM files WHERE key = ?"
            row = self.database.execute(query, (key,)).fetchone()
            if row is None:
                return None
            fields, grids, skipped, *counts = json.loads(zlib.decompress(row[0]))
            return FileContents(
                [Field(*one) for one in fields],
                [(edition, bytes.fromhex(section)) for edition, section in grids],
                Counter({(what, why): count for what, why, count in skipped}),
                *counts,
            )
        except (sqlite3.Error, zlib.error, ValueError, TypeError):
            return None

    def put(self, key: str, contents: FileContents) -> None:
        """Keep contents."""
        plain = (
            contents.fields,
            [(edition, section.hex()) for edition, section in contents.grids],
            [(*reason, count) for reason, count in contents.skipped.items()],
            contents.messages,
            contents.parts,
        )
        self.pending.append((key, zlib.compress(json.dumps(plain).encode(), 1)))
        if len(self.pending) >= _TOGETHER:
            self._write()

    def _write(self) -> None:
        rows, self.pending = self.pending, []
        if self.database is not None and rows:
            try:
                with self.database:
                    self.database.executemany("INSERT OR REPLACE INTO files VALUES (?, ?)", rows)
            except sqlite3.Error as error:  # read-only, locked, a full disk, or damaged
                self._failed(error)

    def close(self) -> None:
        """Write what is pending and close the database."""
        self._write()
        if self.database is not None:
            self.database.close()
            self.database = None
