"""Headers of GRIB files, kept between runs in the user's cache folder.

An entry is valid for a file's path, size, modification time and a sample of its bytes, and for the
code that read it. Nothing is written into the data folder. A cache that cannot be read or written
costs time, not the run: one warning is given, and a damaged one is replaced.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import sqlite3
import sys
import warnings
import zlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

from airswing.errors import InputError
from airswing.reference import grids, state
from airswing.reference.catalogue import SourceFile
from airswing.reference.files import local_path
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
    path = Path(folder) if folder is not None else _default_folder()
    database = _opened(path)
    pending: list[tuple[str, bytes]] = []
    try:
        for file in files:
            key = hashlib.blake2b(
                "\0".join([*map(str, file), _code_version()]).encode(), digest_size=16
            ).hexdigest()
            known = _known(database, key)
            if known is None:
                try:
                    known = headers.scan_file(local_path(file.path))
                except (OSError, InputError) as error:
                    yield error
                    continue
                pending.append((key, zlib.compress(pickle.dumps(_plain(known)), 1)))
                if len(pending) >= _TOGETHER:
                    database = _write(database, path, pending)
            yield known
    finally:
        database = _write(database, path, pending)
        if database is not None:
            database.close()


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


def _plain(contents: FileContents) -> tuple[object, ...]:
    """Contents as tuples and bytes, which unpickle without any class."""
    skipped = [(*key, count) for key, count in contents.skipped.items()]
    table = contents.table().tobytes()
    return table, contents.grids, skipped, contents.messages, contents.parts


class _TuplesOnly(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> object:
        raise pickle.UnpicklingError(f"{module}.{name} in the cache")


def _known(database: sqlite3.Connection | None, key: str) -> FileContents | None:
    """Contents by the cache; None if they are unknown or damaged."""
    if database is None:
        return None
    try:
        row = database.execute("SELECT content FROM files WHERE key = ?", (key,)).fetchone()
        if row is None:
            return None
        import io

        import numpy as np

        table, grids_, skipped, messages, parts = _TuplesOnly(
            io.BytesIO(zlib.decompress(row[0]))
        ).load()
        rows = np.frombuffer(table, dtype=headers.FIELD_DTYPE)
        found = FileContents(grids=grids_, messages=messages, parts=parts)
        found.fields = [headers.Field(*one) for one in rows.tolist()]
        found.skipped.update({(what, why): count for what, why, count in skipped})
    except (sqlite3.Error, zlib.error, pickle.UnpicklingError, ValueError, TypeError, EOFError):
        return None
    return found


def _opened(folder: Path) -> sqlite3.Connection | None:
    """The database, a new one if it is damaged, one to read if the folder cannot be written."""
    path = folder / _NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            return _prepared(path)
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:
            return _anew(path, error)
    except (OSError, sqlite3.Error) as error:
        _warn(folder, error)
    try:
        # immutable: a folder that cannot be written takes no lock file either
        database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        database.execute("SELECT key FROM files LIMIT 1")
    except (OSError, sqlite3.Error):
        return None
    return database


def _prepared(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, timeout=30.0)
    database.execute("PRAGMA synchronous=OFF")  # everything can be read again
    database.execute("PRAGMA journal_mode=TRUNCATE")  # a kill leaves the database whole
    database.execute("CREATE TABLE IF NOT EXISTS files (key TEXT PRIMARY KEY, content BLOB)")
    return database


def _anew(path: Path, error: sqlite3.Error) -> sqlite3.Connection:
    warnings.warn(f"{path} is damaged ({error}): GRIB headers are read again", stacklevel=2)
    for old in (path, path.with_name(f"{path.name}-journal")):
        old.unlink(missing_ok=True)
    return _prepared(path)


def _write(
    database: sqlite3.Connection | None, folder: Path, pending: list[tuple[str, bytes]]
) -> sqlite3.Connection | None:
    """Write what is pending; the database, replaced if it is damaged."""
    if database is None or not pending:
        return database
    try:
        with database:
            database.executemany("INSERT OR REPLACE INTO files VALUES (?, ?)", pending)
    except sqlite3.OperationalError as error:  # read-only, locked or a full disk
        if "readonly" not in str(error):
            _warn(folder, error)
    except sqlite3.DatabaseError as error:
        database.close()
        with contextlib.suppress(OSError, sqlite3.Error):
            database = _anew(folder / _NAME, error)
    pending.clear()
    return database


def _warn(folder: Path, error: Exception) -> None:
    warnings.warn(
        f"cache folder {folder} cannot be written ({error}): GRIB headers will be read again by "
        "the next run",
        stacklevel=3,
    )
