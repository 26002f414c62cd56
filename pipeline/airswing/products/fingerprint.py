"""What a product depends on, as one short string; equal strings mean nothing changed.

Assumes a file that keeps its size and its modification time keeps its content, and that a module
names every other module of the package it uses in an import statement.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

from airswing.products.whole_files import plain
from airswing.version import __version__

ZARR_MARKS = ("zarr.json", ".zmetadata", ".zgroup")
"""Files of which every Zarr store has one at its top."""
PACKAGE = Path(__file__).parents[1]


def fingerprint(*parts: object) -> str:
    """Hash of everything a product depends on, this version of airswing included: 32 hex digits.

    Parameters
    ----------
    *parts : object
        Configuration sections (as mappings), file identities, code digests, identifiers of
        other products.
    """
    text = json.dumps([__version__, plain(list(parts))], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]  # 128 bits: none alike by chance


def file_identities(patterns: Sequence[str]) -> list[tuple[str, int, int]]:
    """Name, size and modification time of every file and Zarr store the patterns match."""
    paths = [os.path.expanduser(pattern) for pattern in patterns]
    matches = [
        [path] if os.path.isfile(path) else glob.glob(path, recursive=True) for path in paths
    ]
    # A broken link gives nothing that a product could depend on.
    names = sorted({name for found in matches for name in found if os.path.exists(name)})
    found = [
        (name, *(_of_store(name) if os.path.isdir(name) else _of_file(name))) for name in names
    ]
    return [one for one in found if one[1] >= 0]


def _of_file(name: str) -> tuple[int, int]:
    """Size and time of modification."""
    entry = Path(name).stat()
    return entry.st_size, entry.st_mtime_ns


def _of_store(name: str) -> tuple[int, int]:
    """Size of all files of a folder that is a Zarr store, and the last time one changed.

    Of another folder, which is no file, a size below zero.
    """
    if not any(os.path.isfile(os.path.join(name, mark)) for mark in ZARR_MARKS):
        return -1, 0
    files = [os.path.join(at, one) for at, _, inside in os.walk(name) for one in inside]
    entries = [_of_file(one) for one in files]
    # The count of files too: chunks of one size may come and go.
    return sum(size for size, _ in entries) + len(entries), max(last for _, last in entries)


@functools.cache
def code_digest(*modules: str, package: Path = PACKAGE) -> str:
    """Hash (32 hex digits) of the source of some modules and of every module of ours they use.

    A change of a module that none of them uses leaves it as it is.
    """
    digest = hashlib.sha256()
    waiting, seen = set(modules), set()
    while waiting:
        name = waiting.pop()
        path = _source(name, package)
        if path is None or path in seen:
            continue
        seen.add(path)
        waiting |= _imported(path, package.name)
    for path in sorted(seen):
        digest.update(f"{path.relative_to(package)}\0".encode())
        digest.update(path.read_bytes())
        if (table := path.with_suffix(".csv")).is_file():  # of the vocabulary
            digest.update(table.read_bytes())
    # 128 bits distinguish versions; whole digests make attributes long
    return digest.hexdigest()[:32]


def _source(name: str, package: Path) -> Path | None:
    """File of a module; None for the package itself, whose version counts separately."""
    parts = name.split(".")[1:]
    if not parts:
        return None
    file = package.joinpath(*parts).with_suffix(".py")
    folder = package.joinpath(*parts, "__init__.py")
    return next((path for path in (file, folder) if path.is_file()), None)


# A statement per line or in parentheses, as the formatter leaves them: building the syntax trees of
# a whole run's modules took a second, this takes hundredths.
_IMPORT = re.compile(r"^[ \t]*(?:from ([\w.]+) import (\([^)]*\)|.*)|import (.*))", re.MULTILINE)


@functools.cache
def _imported(path: Path, package: str) -> set[str]:
    """Modules of the package, and names in them that may be modules, that a file imports."""
    found: set[str] = set()
    for module, names, whole in _IMPORT.findall(path.read_text("utf-8")):
        found |= {module, *(f"{module}.{name}" for name in re.findall(r"\w+", names))}
        found |= set(re.findall(r"[\w.]+", whole))
    return {name for name in found if name.split(".")[0] == package}
