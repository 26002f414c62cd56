"""Model files on disk and elsewhere: their kinds, compressed copies, URLs, and identities.

Assumptions and validity
------------------------
* The kind of a file is that of its first bytes, never of its name.
* gzip, bzip2 and xz files are decompressed to a temporary file, which is removed when no longer
  used; a few are kept. Nothing is written into the data folder.
* URLs (``s3://``, ``gs://``, ``https://`` ...) are read through fsspec, if it and the package of
  the protocol are installed: Zarr stores in place, other files by a temporary copy. Their content
  is taken to be unchanged for the time of a run.
* A Zarr store is a folder; it is unchanged as long as its metadata and its files' sizes and times
  are. Other files are unchanged as long as their size and time are.
"""

from __future__ import annotations

import bz2
import glob
import gzip
import hashlib
import lzma
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import IO, Any

from airswing.errors import InputError
from airswing.model_formats import model_formats
from airswing.products.named_files import none_found
from airswing.reference.catalogue import ZARR_MARKS, Skipped, SourceFile, mark_of, skip

_KEPT_COPIES = 8
_SAMPLE = 256  # bytes of start, middle and end that identify a file written again in place
_MAGIC = ((b"CDF", "netcdf"), (b"\x89HDF", "netcdf"), (b"GRIB", "grib"))
_COMPRESSED: tuple[tuple[bytes, Callable[[str], Any]], ...] = (
    (b"\x1f\x8b", gzip.open),
    (b"BZh", bz2.open),
    (b"\xfd7zXZ", lzma.open),
)
_FAILED = "The download failed: fetch the file again"
#: First bytes (lower case) of files that hold no model winds: what they are, and what to do.
_FOREIGN = (
    (b"pk\x03\x04", "is a zip archive", "Unpack it first: unzip FILE"),
    (b"<!doctype html", "is a page of HTML", _FAILED),
    (b"<html", "is a page of HTML", _FAILED),
    (b"<?xml", "is an XML document", _FAILED),
    (b"<error", "is an XML document", _FAILED),
    (b"version https://git-lfs", "is a Git LFS pointer", "Fetch its content with git lfs pull"),
    (b"bufr", "is BUFR", "BUFR holds reports: give it under reports"),
    (b"\x28\xb5\x2f\xfd", "is compressed with zstandard", "Decompress it first: unzstd FILE"),
    (b"7z\xbc\xaf", "is a 7-Zip archive", "Unpack it first"),
    (b"\x0e\x03\x13\x01", "is HDF4", "Convert it to NetCDF first"),
    (b"%pdf", "is a PDF document", "Give GRIB, NetCDF or Zarr"),
    (b"par1", "is Parquet", "Parquet holds reports: give it under reports"),
    (b"{", "is JSON", "Open a kerchunk reference with xarray and give the Dataset"),
    (b"[", "is JSON", "Give GRIB, NetCDF or Zarr"),
)


def is_url(path: str) -> bool:
    """Whether a path is a URL."""
    return "://" in path


def is_zarr(path: str) -> bool:
    """Whether a folder is a Zarr store; of URLs by their ending."""
    if is_url(path):
        return path.rstrip("/").endswith(".zarr")
    return any(os.path.isfile(os.path.join(path, mark)) for mark in ZARR_MARKS)


def find_files(files: str | os.PathLike[str] | Sequence[str], name: str) -> list[str]:
    """Full paths of the files and Zarr stores that patterns name, sorted.

    Parameters
    ----------
    files : str or sequence of str
        Paths, glob patterns or URLs.
    name : str
        Name of the reference.

    Raises
    ------
    InputError
        If a pattern finds none.
    """
    patterns = [files] if isinstance(files, str | os.PathLike) else list(files)
    found: set[str] = set()
    for pattern in (os.path.expanduser(os.fspath(one)) for one in patterns):
        if is_url(pattern):
            found.update(_urls(pattern))
            continue
        # a path that exists is itself, whatever brackets its name holds
        matches = [pattern] if os.path.exists(pattern) else glob.glob(pattern, recursive=True)
        # a broken link is a missing file: opening it fails and names it
        usable = [
            os.path.abspath(path)
            for path in matches
            if os.path.isfile(path) or is_zarr(path) or not os.path.exists(path)
        ]
        if not usable:
            raise none_found(pattern, f"references.{name}.files")
        found.update(usable)
    if not found:
        raise InputError("names no file", field=f"references.{name}.files")
    return sorted(found)


def _urls(pattern: str) -> list[str]:
    if "*" not in pattern:
        return [pattern]
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(pattern)
        found = [system.unstrip_protocol(one) for one in system.glob(path)]
    except Exception as error:  # fsspec and its protocols raise many kinds
        raise _unreachable(pattern, error) from error
    if not found:
        raise none_found(pattern, "references")
    return found


def _unreachable(url: str, error: Exception) -> InputError:
    protocol = url.split("://")[0]
    package = {"s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "https": "fsspec[http]"}.get(protocol)
    missing = isinstance(error, ImportError)
    return InputError(
        "cannot be opened",
        file=url,
        found=f"{type(error).__name__}: {error}",
        remedy=f"Reading {protocol}:// needs: pip install {package or 'fsspec'}"
        if missing
        else None,
    )


def _identify_file(path: str) -> SourceFile:
    full = os.path.abspath(path)
    descriptor = os.open(full, os.O_RDONLY)
    try:
        status = os.fstat(descriptor)
        places = (0, status.st_size // 2, max(status.st_size - _SAMPLE, 0))
        n_bytes = b"".join(os.pread(descriptor, _SAMPLE, place) for place in places)
    finally:
        os.close(descriptor)
    sample = hashlib.blake2b(n_bytes, digest_size=12).hexdigest()
    return SourceFile(full, status.st_size, status.st_mtime_ns, sample)


def identify(path: str) -> SourceFile:
    """Identity of a file, a Zarr store or a URL.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    if is_url(path):
        return SourceFile(path, 0, 0, "")
    if not os.path.isdir(path):
        return _identify_file(path)
    full = os.path.abspath(path)
    status = os.stat(mark_of(full))
    digest = hashlib.blake2b(digest_size=12)
    for folder, folders, names in os.walk(full):
        folders.sort()
        for name in sorted(names):
            file = os.path.join(folder, name)
            entry = os.stat(file)
            digest.update(repr((file[len(full) :], entry.st_size, entry.st_mtime_ns)).encode())
    return SourceFile(full, status.st_size, status.st_mtime_ns, digest.hexdigest())


def identified(paths: Sequence[str], name: str, skipped: Skipped) -> list[SourceFile]:
    """Identities of files; those that cannot hold model winds are skipped and named.

    Raises
    ------
    InputError
        If none is left.
    """
    sources, refused = [], []
    for path in paths:
        try:
            refusal = foreign(path)
            if refusal is None:
                sources.append(identify(path))
                continue
            refused.append(refusal)
            skipped.append(skip(path, "file", refusal.what))
        except OSError as error:
            skipped.append(skip(path, "file", f"cannot be opened: {error.strerror or error}"))
    if refused and not sources:
        raise refused[0]
    return sources


def foreign(path: str) -> InputError | None:
    """The error for a file that cannot hold model winds by its first bytes; None for others."""
    if is_url(path) or os.path.isdir(path):
        return None
    content = first_bytes(path)
    if any(further.tells(path, content) for further in model_formats().values()):
        return None
    start = content.lstrip(b" \r\n\t\xef\xbb\xbf").lower()
    for magic, what, remedy in _FOREIGN:
        if start.startswith(magic):
            return InputError(
                what, file=path, remedy=remedy.replace("FILE", os.path.basename(path))
            )
    if os.path.getsize(path) == 0:
        return InputError("is empty", file=path, remedy=_FAILED)
    if start[257:262] == b"ustar":
        return InputError("is a tar archive", file=path, remedy="Unpack it first: tar -xf")
    if start and b"\0" not in start and start.isascii() and b"grib" not in start:
        return InputError("is text, no model file", file=path, remedy="Give GRIB, NetCDF or Zarr")
    return None


def first_bytes(path: str, length: int = 1024) -> bytes:
    """First bytes of a file, decompressed; empty if they are damaged."""
    with open(path, "rb") as file:
        start = file.read(length)
    for magic, opener in _COMPRESSED:
        if start.startswith(magic):
            try:
                with opener(path) as file:
                    return bytes(file.read(length))
            except (OSError, EOFError, lzma.LZMAError):
                return b""
    return start


def kind_of(path: str) -> str:
    """Kind of a file: ``netcdf``, ``zarr``, ``grib``, a further kind's name, or empty.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    if is_zarr(path):
        return "zarr"
    if os.path.isdir(path):
        return ""
    start = first_bytes(local_path(path))
    for further in model_formats().values():
        if further.tells(path, start):
            return further.name
    kind = next((kind for magic, kind in _MAGIC if start.startswith(magic)), "")
    return kind or ("grib" if b"GRIB" in start else "")


def local_path(path: str) -> str:
    """Path under which a file can be read: itself, or a temporary copy.

    Raises
    ------
    InputError
        If a compressed file is damaged or a URL cannot be read.
    """
    if is_url(path):
        return str(_download(path).name)
    try:
        with open(path, "rb") as file:
            start = file.read(8)
        status = os.stat(path)
    except IsADirectoryError:
        return path
    if any(start.startswith(magic) for magic, _ in _COMPRESSED):
        return str(_decompressed(path, status.st_size, status.st_mtime_ns).name)
    return path


@lru_cache(maxsize=_KEPT_COPIES)
def _decompressed(path: str, size: int, mtime_ns: int) -> IO[bytes]:
    copy = tempfile.NamedTemporaryFile(prefix="airswing-")  # noqa: SIM115  (lives in the cache)
    try:
        with open(path, "rb") as file:
            start = file.read(8)
        opener = next(opener for magic, opener in _COMPRESSED if start.startswith(magic))
        with opener(path) as file:
            shutil.copyfileobj(file, copy, 1 << 20)
    except (OSError, EOFError, lzma.LZMAError) as error:
        copy.close()
        raise InputError(
            "cannot be decompressed", file=path, found=error, remedy="Fetch the file again"
        ) from error
    copy.flush()
    return copy


@lru_cache(maxsize=_KEPT_COPIES)
def _download(url: str) -> IO[bytes]:
    copy = tempfile.NamedTemporaryFile(prefix="airswing-")  # noqa: SIM115  (lives in the cache)
    try:
        import fsspec

        with fsspec.open(url, "rb") as file:
            shutil.copyfileobj(file, copy, 1 << 20)
    except Exception as error:  # fsspec and its protocols raise many kinds
        copy.close()
        raise _unreachable(url, error) from error
    copy.flush()
    return copy
