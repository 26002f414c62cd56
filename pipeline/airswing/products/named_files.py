"""Error for a path or pattern that names no file."""

from __future__ import annotations

import glob
import os
from pathlib import Path

from airswing.errors import InputError


def none_found(pattern: str | os.PathLike[str], field: str) -> InputError:
    """Return the error for a path or pattern that names no file.

    Parameters
    ----------
    pattern : path-like
        With the home folder expanded.
    field : str
        Key of the configuration.
    """
    text = os.fspath(pattern)
    closed = _unreadable_folder(Path(text))
    if closed is not None:
        return InputError(
            "the folder may not be read: permission denied",
            file=closed,
            field=field,
            found=f"pattern {text!r}",
            remedy="Its owner can let you list and enter it",
        )
    folder = Path(text)
    if folder.is_dir():
        first = next((path for path in sorted(folder.rglob("*")) if path.is_file()), folder / "*")
        below = folder if first.parent == folder else folder / "**"
        what, remedy = "is a folder", f"Name the files in it, such as {below}/*{first.suffix}"
    else:
        what = "no file found"
        remedy = "Check the pattern; relative paths start at the current directory"
    return InputError(
        what, field=field, found=f"pattern {text!r} in folder {os.getcwd()}", remedy=remedy
    )


def _unreadable_folder(path: Path) -> Path | None:
    """Folder on the path to a pattern's files that this user may not list or enter."""
    while glob.has_magic(str(path)):
        path = path.parent
    try:
        path.stat()
        if path.is_dir():
            os.scandir(path).close()
    except PermissionError:
        # of a folder that may be listed but not entered, the last path that can be seen
        return next(folder for folder in (path, *path.parents) if os.path.exists(folder))
    except OSError:
        return None
    return None
