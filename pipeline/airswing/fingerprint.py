"""What a product depends on, as one short string; equal strings mean nothing changed.

Assumes a file that keeps its size and its modification time keeps its content.
"""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import airswing
from airswing.products import plain


def fingerprint(*parts: Any) -> str:
    """Hash of everything a product depends on, this version of airswing included.

    Parameters
    ----------
    *parts : object
        Configuration sections (as mappings), file identities, identifiers of other products.

    Returns
    -------
    str
        32 hexadecimal digits.
    """
    text = json.dumps([airswing.__version__, plain(list(parts))], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def file_identities(patterns: Sequence[str]) -> list[tuple[str, int, int]]:
    """Name, size and modification time of every file the patterns match.

    Parameters
    ----------
    patterns : sequence of str

    Returns
    -------
    list of (str, int, int)
        Sorted by name.
    """
    names = sorted({name for pattern in patterns for name in glob.glob(pattern, recursive=True)})
    found = [(name, Path(name).stat()) for name in names]
    return [(name, entry.st_size, entry.st_mtime_ns) for name, entry in found]
