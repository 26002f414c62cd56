"""Model files on disk and elsewhere: their kinds, compressed copies, URLs, and identities.

The kind of a file is recognised by its first bytes, not by its name. The content of a URL is
assumed to be constant during a run. Compressed files and URLs are read through temporary copies;
nothing is written into the data folder.
"""

from __future__ import annotations

import bz2
import gzip
import hashlib
import lzma
import os
import shutil
import tempfile
import urllib.request
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, NamedTuple, TypedDict

from airswing.errors import InputError
from airswing.products.foreign_files import foreign_file
from airswing.products.whole_files import ZARR_MARKS

NOT_OPENED, REPLACED = "cannot be opened", "replaced since it was catalogued"
_KEPT_COPIES = 8
_SAMPLE = 256  # bytes of start, middle and end that identify a file written again in place
_MAGIC = ((b"CDF", "netcdf"), (b"\x89HDF", "netcdf"), (b"GRIB", "grib"))
_COMPRESSED: tuple[tuple[bytes, Callable[[Any], Any]], ...] = (
    (b"\x1f\x8b", gzip.open),
    (b"BZh", bz2.open),
    (b"\xfd7zXZ", lzma.open),
)


class SourceFile(NamedTuple):
    """A file as the catalogue saw it; `sample` is a hash of parts of its content."""

    path: str
    size: int
    mtime_ns: int
    sample: str


class SkippedPart(TypedDict):
    """A part of a model file that gave no wind: file, kind of part, reason, and how often."""

    file: str
    what: str
    reason: str
    count: int


Skipped = list[SkippedPart]


def skip(file: str, kind: str, reason: str, count: int = 1) -> SkippedPart:
    """One entry of a list of skipped content."""
    return {"file": file, "what": kind, "reason": reason, "count": count}


def is_lost_file(reason: str) -> bool:
    """Whether a problem is a file that vanished or changed, which may be there at the next run."""
    return reason.startswith((NOT_OPENED, REPLACED))


def is_url(path: str) -> bool:
    """Whether a path is a URL."""
    return "://" in path


def _is_zarr(path: str) -> bool:
    if not is_url(path):
        return any(os.path.isfile(os.path.join(path, mark)) for mark in ZARR_MARKS)
    name = path.rstrip("/").rsplit("/", 1)[-1]
    if "." in name:
        return ".zarr" in name
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(path)
        return any(system.exists(f"{path.rstrip('/')}/{mark}") for mark in ZARR_MARKS)
    except Exception:  # fsspec and its protocols raise many kinds; opening it names the problem
        return False


def _status(path: str) -> os.stat_result:
    """Status of a file, or of the metadata of a Zarr store."""
    marks = (os.path.join(path, mark) for mark in ZARR_MARKS)
    return os.stat(next((mark for mark in marks if os.path.isfile(mark)), path))


class Reader:
    """Counts of reading, and files that are opened if unchanged since they were catalogued."""

    def __init__(self) -> None:
        self.problems: dict[tuple[str, str], None] = {}  # file and reason, noted once
        self.decoded = 0
        self._opened: dict[SourceFile, Any] = {}

    def open(self, file: SourceFile, opener: Callable[[SourceFile], Any]) -> Any:
        """Result of `opener` for a file; None if it is gone or was replaced."""
        if file not in self._opened:
            self._opened[file] = None
            try:
                status = None if is_url(file.path) else _status(file.path)
                if status is None or (status.st_size, status.st_mtime_ns) == file[1:3]:
                    self._opened[file] = opener(file)
                else:
                    self.problems[file.path, REPLACED] = None
            except InputError as error:
                found = "" if error.found is None else f" (found: {error.found})"
                self.problems[file.path, f"{NOT_OPENED}: {error.what}{found}"] = None
            except OSError as error:
                self.problems[file.path, f"{NOT_OPENED}: {error.strerror or error}"] = None
        return self._opened[file]


def find_files(files: str | os.PathLike[str] | Sequence[str], name: str) -> list[str]:
    """Full paths of the files and Zarr stores that the patterns of a reference name, sorted."""
    patterns = [os.fspath(files)] if isinstance(files, str | os.PathLike) else list(files)
    paths = {path for pattern in patterns if is_url(pattern) for path in _urls(pattern)}
    local = [pattern for pattern in patterns if not is_url(pattern)]
    if local or not paths:
        from airswing.reports.read import expand  # here: pandas would slow the start of decoders

        field = f"references.{name}.files"
        names = expand(local, field, lambda path: os.path.isfile(path) or _is_zarr(path))
        paths.update(map(os.path.abspath, names))
    return sorted(paths)


def _urls(pattern: str) -> list[str]:
    if "*" not in pattern:
        return [pattern]
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(pattern)
        return [system.unstrip_protocol(name) for name in system.glob(path)]
    except Exception as error:  # fsspec and its protocols raise many kinds
        raise _unreachable(pattern, error) from error


def _unreachable(url: str, error: Exception) -> InputError:
    return InputError(
        "cannot be opened",
        file=url,
        found=f"{type(error).__name__}: {error}",
        remedy="Check the address; protocols other than http and https need fsspec and the package "
        "of the protocol (s3fs, gcsfs)",
    )


def identify(path: str) -> SourceFile:
    """Identity of a file, a Zarr store or a URL."""
    if is_url(path):
        return SourceFile(path, 0, 0, "")
    full = os.path.abspath(path)
    digest, status = hashlib.blake2b(digest_size=12), _status(full)
    if os.path.isdir(full):
        for file in sorted(path for path in Path(full).rglob("*") if path.is_file()):
            entry = file.stat()
            name = str(file.relative_to(full))
            digest.update(repr((name, entry.st_size, entry.st_mtime_ns)).encode())
    else:
        with open(full, "rb") as opened:
            status = os.fstat(opened.fileno())
            for place in (0, status.st_size // 2, max(status.st_size - _SAMPLE, 0)):
                opened.seek(place)
                digest.update(opened.read(_SAMPLE))
    return SourceFile(full, status.st_size, status.st_mtime_ns, digest.hexdigest())


def identified(paths: Sequence[str], skipped: Skipped) -> list[SourceFile]:
    """Identities of files; those that cannot hold model winds are skipped; an error if all are."""
    sources: list[SourceFile] = []
    refused: list[InputError] = []
    for path in paths:
        try:
            if not (os.path.isdir(path) or _is_zarr(path)):
                start = first_bytes(path)
                if (refusal := foreign_file(path, start, "winds")) is not None:
                    raise refusal
                if start.isascii() and b"\0" not in start and b"GRIB" not in start:
                    remedy = "Model winds come as GRIB, NetCDF or Zarr"
                    raise InputError("is text, not model data", file=path, remedy=remedy)
            sources.append(identify(path))
        except InputError as error:
            refused.append(error)
            skipped.append(skip(path, "file", error.what))
        except OSError as error:
            skipped.append(skip(path, "file", f"{NOT_OPENED}: {error.strerror or error}"))
    if refused and not sources:
        raise refused[0]
    return sources


def _open(path: str) -> IO[bytes]:
    if not is_url(path):
        return open(path, "rb")
    try:
        if path.startswith(("http://", "https://")):  # needs no optional package
            return urllib.request.urlopen(path, timeout=60)  # type: ignore[no-any-return]
        import fsspec

        return fsspec.open(path, "rb").open()  # type: ignore[no-any-return]
    except Exception as error:  # fsspec and its protocols raise many kinds
        raise _unreachable(path, error) from error


def first_bytes(path: str, length: int = 1024) -> bytes:
    """First bytes of a file or a URL, decompressed unless they are damaged."""
    with _open(path) as file:
        start = file.read(length)
    opener = _opener(start)
    if opener is None:
        return start
    try:
        with _open(path) as file, opener(file) as content:
            return bytes(content.read(length))
    except (OSError, EOFError, ValueError, lzma.LZMAError, zlib.error):
        return start


def _opener(start: bytes) -> Callable[[Any], Any] | None:
    return next((opener for magic, opener in _COMPRESSED if start.startswith(magic)), None)


def kind_of(path: str) -> str:
    """Kind of a file: ``netcdf``, ``zarr``, ``grib``, or empty."""
    if _is_zarr(path):
        return "zarr"
    if os.path.isdir(path):
        return ""
    start = first_bytes(path)
    kind = next((kind for magic, kind in _MAGIC if start.startswith(magic)), "")
    return kind or ("grib" if b"GRIB" in start else "")


class LocalPath(str):
    """A path that keeps its temporary copy alive while it is in use."""

    copy: IO[bytes] | None = None


def local_path(path: str) -> LocalPath:
    """Path under which a file can be read: its path, or that of a temporary copy.

    The copy exists as long as the returned object does.
    """
    size = mtime_ns = 0
    if os.path.isdir(path):
        return LocalPath(path)
    if not is_url(path):
        with open(path, "rb") as file:
            start, status = file.read(8), os.fstat(file.fileno())
        if _opener(start) is None:
            return LocalPath(path)
        size, mtime_ns = status.st_size, status.st_mtime_ns
    copy = _copy(path, size, mtime_ns)
    local = LocalPath(copy.name)
    local.copy = copy
    return local


@lru_cache(maxsize=_KEPT_COPIES)
def _copy(path: str, size: int, mtime_ns: int) -> IO[bytes]:
    """A temporary copy of a URL or a compressed file, decompressed; it lives in the cache."""
    copy = tempfile.NamedTemporaryFile(prefix="airswing-")  # noqa: SIM115
    try:
        with _open(path) as file:
            shutil.copyfileobj(file, copy, 1 << 20)
        copy.seek(0)
        opener = _opener(copy.read(8))
        copy.seek(0)
        if opener is not None:
            decompressed = tempfile.NamedTemporaryFile(prefix="airswing-")  # noqa: SIM115
            with copy, opener(copy) as content:
                shutil.copyfileobj(content, decompressed, 1 << 20)
            copy = decompressed
    except (OSError, EOFError, lzma.LZMAError, zlib.error) as error:
        remedy = "Fetch the file again"
        raise InputError("cannot be decompressed", file=path, found=error, remedy=remedy) from error
    copy.flush()
    return copy
