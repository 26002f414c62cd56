"""Fingerprints: short strings that are equal where nothing a product depends on has changed.

Assumes that a file which keeps its size and its modification time keeps its content.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path

from airswing.products.whole_files import plain
from airswing.version import __version__

ZARR_MARKS = ("zarr.json", ".zmetadata", ".zgroup")
"""Files of which every Zarr store has one at its top."""
PACKAGE = Path(__file__).parents[1]
_DIGITS = 32  # hexadecimal: 128 bits, so that no two fingerprints are equal by chance


def fingerprint(*parts: object) -> str:
    """Hash of everything a product depends on, this version of airswing included: 32 hex digits.

    Parameters
    ----------
    *parts : object
        Configuration sections (as mappings), file identities, code digests, identifiers of
        other products.
    """
    text = json.dumps([__version__, plain(list(parts))], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def file_identities(patterns: Sequence[str]) -> list[tuple[str, int, int]]:
    """Name, size and modification time (ns) of every file and Zarr store the patterns match."""
    paths = [os.path.expanduser(pattern) for pattern in patterns]
    matches = [
        [path] if os.path.isfile(path) else glob.glob(path, recursive=True) for path in paths
    ]
    found = []
    for name in sorted({name for names in matches for name in names}):
        if os.path.isfile(name):
            status = os.stat(name)
            found.append((name, status.st_size, status.st_mtime_ns))
        elif any(os.path.isfile(os.path.join(name, mark)) for mark in ZARR_MARKS):
            entries = [path.stat() for path in Path(name).rglob("*") if path.is_file()]
            # with the number of files: chunks of the same size may be added and removed
            size = sum(entry.st_size for entry in entries) + len(entries)
            found.append((name, size, max(entry.st_mtime_ns for entry in entries)))
    return found


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
