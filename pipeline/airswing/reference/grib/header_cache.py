"""Headers of GRIB files, kept between runs in the user's cache folder, one entry for each file.

An entry is valid for a file's path, size, modification time and a sample of its bytes, and for the
code that read it. If an entry is damaged or incomplete, the file is read again; a folder that
cannot be written causes one warning and a longer run.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
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


def contents_of(
    files: Sequence[SourceFile], folder: str | os.PathLike[str] | None = None
) -> Iterator[FileContents | OSError | InputError]:
    """Contents of files in turn, from the cache or a scan; the error if a file is unreadable.

    The cache is by default in ``AIRSWING_CACHE``, else the system's cache folder.
    """
    cache = (Path(folder) if folder is not None else _default_folder()) / "grib-headers"
    known, writable = set[str](), False
    with contextlib.suppress(OSError):
        cache.mkdir(parents=True, exist_ok=True)
        known, writable = set(os.listdir(cache)), os.access(cache, os.W_OK)
    if not writable:
        text = f"cache folder {cache} cannot be written: GRIB headers are read again"
        warnings.warn(text, stacklevel=2)
    for file in files:
        key = "\0".join([*map(str, file), code_digest()]).encode()
        name = hashlib.blake2b(key, digest_size=16).hexdigest()
        entry, contents = os.path.join(cache, name), None
        if name in known:
            # a damaged entry is replaced
            with contextlib.suppress(OSError, zlib.error, ValueError, TypeError):
                contents = _from_bytes(Path(entry).read_bytes())
        if contents is None:
            try:
                contents = headers.scan_file(local_path(file.path))
            except (OSError, InputError) as error:
                yield error
                continue
            if writable:
                with contextlib.suppress(OSError), open(entry, "wb") as kept:
                    kept.write(_to_bytes(contents))
        yield contents


def _default_folder() -> Path:
    named = os.environ.get("AIRSWING_CACHE")
    if named:
        return Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "airswing"
    root = os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None
    return Path(root or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "airswing"


def _from_bytes(entry: bytes) -> FileContents:
    fields, grids, skipped, *counts = json.loads(zlib.decompress(entry))
    return FileContents(
        [Field(*one) for one in fields],
        [(edition, bytes.fromhex(section)) for edition, section in grids],
        Counter({(what, why): count for what, why, count in skipped}),
        *counts,
    )


def _to_bytes(contents: FileContents) -> bytes:
    grids = [(edition, section.hex()) for edition, section in contents.grids]
    skipped = [(*reason, count) for reason, count in contents.skipped.items()]
    plain = contents.fields, grids, skipped, contents.messages, contents.parts
    return zlib.compress(json.dumps(plain).encode(), 1)
