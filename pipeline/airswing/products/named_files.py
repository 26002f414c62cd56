"""Why a pattern names no file: said in one way wherever files are looked for."""

from __future__ import annotations

import glob
import os
from pathlib import Path

from airswing.errors import InputError


def none_found(pattern: str | os.PathLike[str], field: str) -> InputError:
    """The error where a path or pattern names no file.

    Parameters
    ----------
    pattern : path-like
        As looked for: with the home folder spelt out.
    field : str
        Of the configuration.
    """
    text = os.fspath(pattern)
    if (closed := _closed(Path(text))) is not None:
        return InputError(
            "the folder may not be read: permission denied",
            file=closed,
            field=field,
            found=f"pattern {text!r}",
            remedy="Its owner can let you list and enter it",
        )
    folder = os.path.isdir(text)
    return InputError(
        "is a folder" if folder else "no file found",
        field=field,
        found=f"pattern {text!r} in folder {os.getcwd()}",
        remedy=f"Name the files in it, such as {_files_of(Path(text))}"
        if folder
        else "Check the pattern; relative paths start at the current directory",
    )


def _closed(path: Path) -> Path | None:
    """The folder on the way to a pattern's files that this user may not list or enter."""
    while glob.has_magic(str(path)):
        path = path.parent
    try:
        path.stat()
        if os.path.isdir(path):
            os.scandir(path).close()
    except PermissionError:
        # a folder that may be listed but not entered hides what is in it: the last that is seen
        return next(folder for folder in (path, *path.parents) if os.path.exists(folder))
    except OSError:
        return None
    return None


def _files_of(folder: Path) -> str:
    """A pattern for the files of a folder, after the first of them."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file())
    first = next(found, folder / "*")
    below = folder if first.parent == folder else folder / "**"
    return str(below / f"*{first.suffix}")
