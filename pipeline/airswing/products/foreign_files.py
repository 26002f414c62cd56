"""Names files of kinds that airswing does not read, with the remedy.

The table is ``foreign_files.csv`` next to this module: a pattern of the first bytes (after a byte
order mark and blanks); whether such a file is refused as ``reports``, as ``winds`` or, if empty, as
both; what the file is, in which ``{}`` is the first group of the pattern; and the remedy.
"""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path

from airswing.errors import InputError


@cache
def _kinds() -> list[dict[str, str]]:
    with Path(__file__).with_suffix(".csv").open(encoding="ascii", newline="") as table:
        return list(csv.DictReader(table))


def foreign_file(path: object, start: bytes, role: str = "") -> InputError | None:
    """Error for a file of a kind in the table, by its first bytes after decompression, else None.

    ``role`` is ``reports`` or ``winds``; without it only files that are neither are refused.
    """
    content = start.removeprefix(b"\xef\xbb\xbf").lstrip() or start
    for kind in _kinds():
        match = re.match(kind["first_bytes"].encode("ascii"), content)
        if match and kind["refused_as"] in ("", role):
            message = kind["what"].format(*(group.decode() for group in match.groups(b"")))
            return InputError(message, file=path, remedy=kind["remedy"])
    return None
