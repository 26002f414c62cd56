"""What files hold, remembered between runs in the user's cache folder.

An entry stands for a file's path, size, modification time and a sample of
its octets, and for the code that read it: a change of any of them means a
new scan. Nothing is ever written beside the data. A cache that cannot be read
or written costs time, not the run: one warning is given.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import sys
import warnings
import zlib
from collections import Counter
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np

from airswing.reference.geometry import grids
from airswing.reference.geometry.model_time import SourceFile
from airswing.reference.grib import (
    consistency,
    edition1,
    edition2,
    fields,
    gridsections,
    messages,
)
from airswing.reference.grib.fields import FIELD_DTYPE, Field, FileContents
from airswing.reference.packing import octets

# Octets of start, middle and end that tell a file written over in place.
_SAMPLE = 256
_NAME = "grib-headers.sqlite"


def _default_folder() -> Path:
    """Folder for caches of this user: `AIRSWING_CACHE`, else the system's custom."""
    named = os.environ.get("AIRSWING_CACHE")
    if named:
        return Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "airswing"
    root = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    return Path(root or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "airswing"


def identify(path: str) -> SourceFile:
    """Identity of a file: path, size, modification time and a hash of octets here and there."""
    full = os.path.abspath(path)
    descriptor = os.open(full, os.O_RDONLY)
    try:
        status = os.fstat(descriptor)
        places = (0, status.st_size // 2, max(status.st_size - _SAMPLE, 0))
        octets_seen = b"".join(os.pread(descriptor, _SAMPLE, place) for place in places)
    finally:
        os.close(descriptor)
    sample = hashlib.blake2b(octets_seen, digest_size=12).hexdigest()
    return SourceFile(full, status.st_size, status.st_mtime_ns, sample)


@lru_cache(maxsize=1)
def _code_version() -> str:
    """Hash of the source that reads headers."""
    digest = hashlib.blake2b(digest_size=12)
    for module in (octets, grids, gridsections, fields, consistency, edition1, edition2, messages):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


class FileCache:
    """A small database of file contents; use as a context manager."""

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        self.folder = Path(folder) if folder is not None else _default_folder()
        self._database: sqlite3.Connection | None = None
        self._pending: list[tuple[str, bytes, bytes]] = []
        self._writable = True

    def __enter__(self) -> FileCache:
        path = self.folder / _NAME
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._database = _connect(path)
        except (OSError, sqlite3.Error) as error:
            self._give_up_writing(error)
            self._open_readonly(path)
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open_readonly(self, path: Path) -> None:
        try:
            # immutable: a folder that cannot be written takes no lock file either.
            uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
            self._database = sqlite3.connect(uri, uri=True)
            self._database.execute("SELECT key FROM contents LIMIT 1")
        except (OSError, sqlite3.Error):
            self._database = None

    def _give_up_writing(self, error: Exception) -> None:
        if self._writable:
            warnings.warn(
                f"cache folder {self.folder} cannot be written ({error}): "
                "GRIB headers will be read again by the next run",
                stacklevel=2,
            )
        self._writable = False

    def get(self, file: SourceFile) -> FileContents | None:
        """Contents of a file seen before, None where they are not known."""
        if self._database is None:
            return None
        try:
            row = self._database.execute(
                "SELECT about, rows FROM contents WHERE key = ?", (_key(file),)
            ).fetchone()
            return None if row is None else _unpack(*row)
        except sqlite3.DatabaseError as error:
            self._begin_anew(error)
            return None
        except (zlib.error, ValueError, KeyError, TypeError):
            # damaged, or of another version: headers are read again
            return None

    def put(self, file: SourceFile, contents: FileContents) -> None:
        """Remember a file's contents."""
        if self._database is not None and self._writable:
            self._pending.append((_key(file), *_pack(contents)))
            # One transaction for many files: each costs a write to the disk.
            if len(self._pending) >= 500:
                self.flush()

    def flush(self) -> None:
        """Write what is pending."""
        if not self._pending or self._database is None:
            return
        try:
            with self._database:
                self._database.executemany(
                    "INSERT OR REPLACE INTO contents VALUES (?, ?, ?)", self._pending
                )
        except sqlite3.DatabaseError as error:
            self._begin_anew(error)
        self._pending = []

    def _begin_anew(self, error: sqlite3.DatabaseError) -> None:
        """Replace a damaged database, as a loss of power may leave it; without that, write no more.

        Nothing in it cannot be read again.
        """
        if isinstance(error, sqlite3.OperationalError) or not self._writable:
            self._give_up_writing(error)
            return
        assert self._database is not None
        self._database.close()
        try:
            self._database = _anew(self.folder / _NAME, error)
        except (OSError, sqlite3.Error) as again:
            self._database = None
            self._give_up_writing(again)


def _connect(path: Path) -> sqlite3.Connection:
    """Open the database, anew where it is damaged: it holds nothing that cannot be read again."""
    try:
        return _prepared(path)
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError):
            raise
        return _anew(path, error)


def _anew(path: Path, error: sqlite3.DatabaseError) -> sqlite3.Connection:
    """A new database in place of a damaged one; its journal goes too."""
    warnings.warn(
        f"{path} is damaged ({error}): begun anew, GRIB headers are read again", stacklevel=2
    )
    for old in (path, path.with_name(f"{path.name}-journal")):
        old.unlink(missing_ok=True)
    return _prepared(path)


def _prepared(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, timeout=30.0)
    # Nothing here cannot be read again: not worth waiting for the disk.
    database.execute("PRAGMA synchronous=OFF")
    # A journal on disk: a kill in the middle of a write leaves the database whole.
    database.execute("PRAGMA journal_mode=TRUNCATE")
    database.execute(
        "CREATE TABLE IF NOT EXISTS contents (key TEXT PRIMARY KEY, about BLOB, rows BLOB)"
    )
    return database


def _key(file: SourceFile) -> str:
    text = "\0".join([*map(str, file), _code_version()])
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _pack(contents: FileContents) -> tuple[bytes, bytes]:
    about = {
        "grids": [[edition, section.hex()] for edition, section in contents.grids],
        "skipped": [[what, why, count] for (what, why), count in contents.skipped.items()],
        "messages": contents.messages,
        "parts": contents.parts,
    }
    rows = contents.table().tobytes()
    return zlib.compress(json.dumps(about).encode(), 1), zlib.compress(rows, 1)


def _unpack(about: bytes, rows: bytes) -> FileContents:
    said = json.loads(zlib.decompress(about))
    table = np.frombuffer(zlib.decompress(rows), dtype=FIELD_DTYPE)
    return FileContents(
        fields=[Field(*row) for row in table.tolist()],
        grids=[(edition, bytes.fromhex(section)) for edition, section in said["grids"]],
        skipped=Counter({(what, why): count for what, why, count in said["skipped"]}),
        messages=said["messages"],
        parts=said["parts"],
    )


def contents_of(files: Iterable[SourceFile], cache: FileCache) -> Iterable[FileContents | OSError]:
    """Contents of files in turn, from the cache or a scan; `OSError` where one is unreadable."""
    for file in files:
        known = cache.get(file)
        if known is None:
            try:
                known = messages.scan_file(file.path)
            except OSError as error:
                yield error
                continue
            cache.put(file, known)
        yield known
