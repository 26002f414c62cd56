"""Lock of an output folder: one run at a time, and no partial file of an earlier one.

Assumes a file system that locks files for this machine. Where it cannot (some network file
systems, Windows), a second run into the same folder is not refused, and partial files stay.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from airswing.errors import InputError

LOCK, PARTIAL = ".running", "*.part"


@contextlib.contextmanager
def workspace(folder: Path) -> Iterator[None]:
    """Lock an output folder for one run, and remove partial files of a killed run.

    Parameters
    ----------
    folder : Path
        Made when absent; removed again when the run leaves nothing in it.

    Raises
    ------
    InputError
        If another run uses the folder, or it cannot be made or written to.
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
            pass  # files cannot be locked here
        else:
            # only with the lock: temporary files of a running process look the same
            for left in folder.rglob(PARTIAL):
                left.unlink(missing_ok=True)
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()
    finally:
        os.close(descriptor)
