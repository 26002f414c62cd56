"""The folder one run writes to: one run at a time, and no half-written file of an earlier one.

Assumes a file system that locks files for this machine. Where it cannot (some network file
systems, Windows), a second run into the same folder is not refused, and leftovers stay.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from airswing.errors import InputError

LOCK, HALF_WRITTEN = ".running", "*.part"


@contextlib.contextmanager
def workspace(folder: Path) -> Iterator[None]:
    """Hold an output folder for one run, and clear what a killed run left half-written.

    Parameters
    ----------
    folder : Path
        Made when absent; removed again when the run leaves nothing in it.

    Raises
    ------
    InputError
        If another run holds the folder, or it cannot be made or written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as err:
        raise InputError(
            "cannot write to the output folder",
            file=folder,
            found=err.strerror,
            remedy="Choose another folder with --output",
        ) from err
    try:
        if _hold(descriptor, folder):
            # Only with the lock held: a temporary file of a run under way looks the
            # same.
            for left in folder.rglob(HALF_WRITTEN):
                left.unlink(missing_ok=True)
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)
            # not empty: then it stays
            with contextlib.suppress(OSError):
                folder.rmdir()
    finally:
        os.close(descriptor)


def _hold(descriptor: int, folder: Path) -> bool:
    """Lock the folder; False where files cannot be locked. A lock ends with its process."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as err:
        raise InputError(
            "another run is writing to this folder",
            file=folder,
            remedy="Wait for its end or choose another folder with --output",
        ) from err
    except (ImportError, OSError):
        return False
    return True
