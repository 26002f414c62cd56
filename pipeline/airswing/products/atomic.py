"""Files that are whole or not there, through a kill at any moment and through a loss of power.

Assumes that the file system renames atomically within a folder, and that what it says is on the
disk after fsync is. A file is written under another name, flushed to the disk and renamed, so that
no name ever stands for half a file; then its folder is flushed, so that what is done next (removing
what the file was made from) cannot outlive it.
"""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; take away what was made if the block fails."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for one in missing:
            with contextlib.suppress(OSError):  # not empty: somebody else's by now
                one.rmdir()
        raise


@contextlib.contextmanager
def replacing(path: Path, *, lasting: bool = True) -> Iterator[Path]:
    """Give a temporary name to write to, and rename it to ``path`` when the block ends well.

    Parameters
    ----------
    path : Path
        Where the finished file shall stand; its folder is made when absent.
    lasting : bool, default True
        Flush the folder too. Without it the file may be gone again after a loss of power, whole
        as it was: for what costs nothing but time.
    """
    path = Path(path)
    # Beside the target, since a rename is atomic within one file system only; hidden, so that
    # no pattern of products takes it up.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.part")
    with made_folder(path.parent):
        try:
            yield temporary
            # Before the rename: a name that outlives the power must not stand for
            # unwritten octets.
            _flush(temporary)
            os.replace(temporary, path)
            if lasting:
                with contextlib.suppress(OSError):  # some systems cannot flush a folder
                    _flush(path.parent)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
